"""Errors that end a verb, and their exit codes, known by their names, so that telling a mistake loads nobody who may make one."""

from __future__ import annotations

from appliance.cli.output import Exit

CONFIG = "appliance.store.config.load:ConfigError"
STORAGE = "appliance.store.atomic:StorageError"
DEVICE = "drivers.errors:DeviceError"
# A rig file and a list are typed by a person, too, so that an error in them is one of usage.
USAGE = frozenset((CONFIG, "appliance.cli.output:UsageError", "appliance.store.scan_list:ListError"))
FAILED = frozenset(
    (
        STORAGE,
        DEVICE,
        "appliance.workshop.step:BringupError",
        "appliance.measure.calibration.file:CalibrationError",
        "appliance.calibrate.recordings:RecordingError",
        "appliance.cli.output:OutputError",
        "appliance.desk.export.suffixes:ExportError",
        "appliance.desk.foreign.problem:ForeignError",
        "appliance.base.kernel_build:CompileError",
        "appliance.desk.anew.results:ResultsError",
        "appliance.desk.anew.work:SchedulerError",
        "appliance.desk.pull.source:PullError",
        "appliance.desk.registration.reference:SurfaceMatchError",
        "appliance.base.sealed_file:ContentError",
        "appliance.store.library:UnknownScan",
        "appliance.desk.object_store:ObjectError",
        "appliance.store.scan:ScanError",
        "appliance.base.libraries:MissingLibraryError",
        "appliance.desk.surface.drawing_file:NominalError",
    )
)
"""Errors whose text is for the person at the keyboard, as ``module:class``."""


def exit_code_of(error: BaseException) -> Exit | None:
    """Return the exit code of an error whose text is for the person at the keyboard; ``None``: a fault of the
    program."""
    if is_one_of(error, USAGE):
        return Exit.USAGE
    if is_one_of(error, FAILED):
        return Exit.FAILED
    # Errors of a simulated world, which nothing here knows by name, bring their own.
    code: int | None = getattr(error, "exit_code", None)
    return None if code is None else Exit(code)


def is_one_of(error: BaseException, names: frozenset[str]) -> bool:
    """Return True if ``error`` is of one of the classes ``names`` (``module:class``), or of one derived from them."""
    # Whatever was raised is imported; asking for its class instead would import everything else that might have been.
    return any(f"{kind.__module__}:{kind.__qualname__}" in names for kind in type(error).__mro__)
