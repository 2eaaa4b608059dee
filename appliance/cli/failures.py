"""Owns which errors end a verb with which exit code; imported when there is one, since it loads whoever may raise."""

from __future__ import annotations

from appliance.bringup.finding import BringupError
from appliance.calibration.file import CalibrationError
from appliance.calibration.recordings import RecordingError
from appliance.cli.output import Exit, UsageError
from appliance.config import ConfigError
from appliance.export.content import ExportError
from appliance.foreign.problem import ForeignError
from appliance.kernel_build import CompileError
from appliance.offline.anew.many import SchedulerError
from appliance.offline.anew.results import ResultsError
from appliance.offline.pull.source import PullError
from appliance.registration.reference import SurfaceMatchError
from appliance.storage.atomic import StorageError
from appliance.storage.library import UnknownScan
from appliance.storage.objects import ObjectError
from appliance.storage.scan import ScanError
from appliance.surface.libraries import MissingLibraryError
from appliance.surface.nominal import NominalError
from drivers.api import DeviceError


def exit_code_of(error: Exception) -> Exit | None:
    """Return the exit code of an error whose text is for the person at the keyboard; ``None``: a fault of the
    program."""
    match error:
        # A rig file is typed by a person, too, so that an error in it is one of usage.
        case ConfigError() | UsageError():
            return Exit.USAGE
        case (
            StorageError()
            | BringupError()
            | UnknownScan()
            | ScanError()
            | CalibrationError()
            | RecordingError()
            | ExportError()
            | MissingLibraryError()
            | ForeignError()
            | ObjectError()
            | NominalError()
            | SurfaceMatchError()
            | DeviceError()
            | CompileError()
            | ResultsError()
            | SchedulerError()
            | PullError()
        ):
            return Exit.FAILED
        case _:  # errors of a simulated world, which nothing here knows by name, bring their own
            code: int | None = getattr(error, "exit_code", None)
            return None if code is None else Exit(code)
