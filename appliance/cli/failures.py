"""End of a command by an error: its exit code, and the service's error file for the safe screen.

Errors are listed by name (``module:class``), not by class. So an exit code is found without importing the modules that
define all the other errors. If you move or rename a listed class, change its name here; a test finds stale names. A new
error that a user can cure must be added, or it ends as a fault of the program.

The error file is ``last-words.json`` in the service's run-time folder. ``systemd/kingfisher_safe`` reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from appliance.cli.output import Exit

CONFIG = "appliance.store.config.load:ConfigError"
STORAGE = "appliance.store.atomic:StorageError"
DEVICE = "drivers.errors:DeviceError"
# Rig file, list, board and pictures are given by a person, too, so that their errors are errors of usage.
USAGE = frozenset(
    (
        CONFIG,
        "appliance.cli.output:UsageError",
        "appliance.calibrate.air.board:BoardError",
        "appliance.calibrate.pictures:PicturesError",
        "appliance.store.pull.pulling:PullWordError",
        "appliance.store.scan_list:ListError",
    )
)
FAILED = frozenset(
    (
        STORAGE,
        DEVICE,
        "appliance.instrument.service.air_live:LiveError",
        "appliance.workshop.finding:BringupError",
        "appliance.measure.calibration.file:CalibrationError",
        "appliance.calibrate.air.calibrate:AirCalibrationError",
        "appliance.calibrate.recordings:RecordingError",
        "appliance.cli.output:OutputError",
        "appliance.desk.export.formats:ExportError",
        "appliance.desk.foreign.problem:ForeignError",
        "appliance.base.kernel_build:CompileError",
        "appliance.desk.anew.results:ResultsError",
        "appliance.desk.anew.work:SchedulerError",
        "appliance.store.pull.source:PullError",
        "appliance.desk.registration.reference:SurfaceMatchError",
        "appliance.base.sealed_file:ContentError",
        "appliance.store.library:UnknownScan",
        "appliance.desk.object_store:ObjectError",
        "appliance.store.scan:ScanError",
        "appliance.base.libraries:MissingLibraryError",
        "appliance.desk.surface.drawing_file:NominalError",
    )
)
"""Errors whose text is for the user, as ``module:class``."""


def exit_code_of(error: BaseException) -> Exit | None:
    """Return the exit code of an error whose text is for the user; ``None`` for a fault of the program."""
    if is_one_of(error, USAGE):
        return Exit.USAGE
    if is_one_of(error, FAILED):
        return Exit.FAILED
    # Errors of a simulated world are not listed here and have their own exit code.
    code: int | None = getattr(error, "exit_code", None)
    return None if code is None else Exit(code)


def is_one_of(error: BaseException, names: frozenset[str]) -> bool:
    """Return True if ``error`` is of one of the classes ``names`` (``module:class``), or of a derived one."""
    # By name, because a test by class would import all modules with listed errors.
    return any(f"{kind.__module__}:{kind.__qualname__}" in names for kind in type(error).__mro__)


# ------------------------------------------------------------------------------------------ last words

FILE_NAME = "last-words.json"
"""Name of the file in the service's run-time folder, which is in memory, as a full disk is one of the errors."""
MOST_CHARACTERS = 600


@contextmanager
def error_file_for_safe_screen(environment: Mapping[str, str]) -> Iterator[None]:
    """Write an error that ends the block to the error file, and raise it again.

    Nothing is written unless ``environment`` is that of a service.
    """
    folder, invocation = environment.get("RUNTIME_DIRECTORY"), environment.get("INVOCATION_ID")
    # Both are set by systemd; a person who starts the service reads the error on the terminal.
    if not folder or not invocation:
        yield
        return
    path = Path(folder.split(":")[0]) / FILE_NAME
    with suppress(OSError):
        path.unlink(missing_ok=True)  # of an earlier start
    try:
        yield
    except Exception as error:
        # With systemd's number of this start, so that the safe screen never shows the error of an earlier one.
        record = {"invocation": invocation, "kind": _kind(error), "text": _text(error)}
        with suppress(OSError):
            path.write_text(json.dumps(record) + "\n", encoding="utf-8")
        raise


def _kind(error: Exception) -> str:
    kinds = {"config": CONFIG, "storage": STORAGE, "device": DEVICE}
    return next((kind for kind, name in kinds.items() if is_one_of(error, frozenset((name,)))), "program")


def _text(error: Exception) -> str:
    message = " ".join(str(error).split())
    text = message if _kind(error) != "program" else f"{type(error).__name__}: {message}"
    return text[:MOST_CHARACTERS]
