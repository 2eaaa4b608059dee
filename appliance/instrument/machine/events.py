"""Events of the machine: every input of ``step`` as a frozen value.

Some events are values of other modules: the keys (``KeyPress`` …), the board's reports (``Telemetry``,
``BoardBooted``), results of a scan (``News``, ``LiveGuidance``), the calibration's ``Session`` as it is on the disk, or
the ``Failure`` of a task, the state of the scan ``Transfer``, and a part's self-test (``PartResult``). Events about a
scan carry the ``number`` of the Capture effect that began it, so that late answers are recognised and ignored.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.calibrate import RecordingCheck, Session
from appliance.instrument.machine.states import Device, Failure, Part, PartResult, Transfer
from appliance.instrument.ranging.reach import Range
from appliance.measure import Fault, FaultCode, LiveGuidance, News
from drivers.api import BoardBooted, KeyFreed, KeyLongPress, KeyPress, KeyStuck, Telemetry


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passed. Sent at least ten times a second; deadlines are judged only here."""

    now_ns: int


@dataclass(frozen=True, slots=True)
class DeviceUp:
    device: Device


@dataclass(frozen=True, slots=True)
class DeviceDown:
    """A device was lost.

    ``code``: a more precise name than LOST, such as a slow link or a refused setting.
    """

    device: Device
    reason: str
    code: FaultCode | None = None


@dataclass(frozen=True, slots=True)
class ConditionRaised:
    """A condition is present until it is cleared (uncalibrated, no vsync)."""

    fault: Fault


@dataclass(frozen=True, slots=True)
class ConditionCleared:
    code: FaultCode
    device: str | None = None


@dataclass(frozen=True, slots=True)
class FaultReported:
    """A fault that was found before the machine began; shown until the next key."""

    fault: Fault


@dataclass(frozen=True, slots=True)
class StorageCounted:
    """Number of scans in the library, and of those that still fit; ``None``: the disk does not report it."""

    scans: int
    last_scan: str | None
    scans_left: int | None


@dataclass(frozen=True, slots=True)
class ObjectsCounted:
    """Largest object number of the scans on the disk, 0 if none has one."""

    largest: int


@dataclass(frozen=True, slots=True)
class BootFinished:
    """Every device was tried once."""


@dataclass(frozen=True, slots=True)
class PartBusy:
    """A part without a result reported progress."""

    part: Part


@dataclass(frozen=True, slots=True)
class Armed:
    """Lasers are proven off, and both cameras wait for the first pulse."""

    number: int


@dataclass(frozen=True, slots=True)
class CaptureFinished:
    """The sequence is complete and every witness agrees."""

    number: int


@dataclass(frozen=True, slots=True)
class CaptureFailed:
    number: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class RawStored:
    """The raw frames are durable."""

    number: int


@dataclass(frozen=True, slots=True)
class Saved:
    """The scan is published and durable."""

    number: int
    scan_id: str


@dataclass(frozen=True, slots=True)
class SaveFailed:
    """The disk refused raw frames or publication; all data are still in memory."""

    number: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class TrialExamined:
    """A recording for a step of the calibration was examined."""

    number: int
    check: RecordingCheck


@dataclass(frozen=True, slots=True)
class CalibrationProgressed:
    """Progress of the adjustment, 0..1."""

    progress: float


@dataclass(frozen=True, slots=True)
class RangeMeasured:
    """Distance of the object by the laser dots in the live images; ``None``: unknown."""

    range: Range | None


@dataclass(frozen=True, slots=True)
class ScansListed:
    """Numbers of all scans on the disk, the newest first."""

    scans: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StopRequested:
    """The operating system wants the service to end (SIGTERM)."""


Event = (
    Tick
    | KeyPress
    | KeyLongPress
    | KeyStuck
    | KeyFreed
    | Telemetry
    | BoardBooted
    | DeviceUp
    | DeviceDown
    | ConditionRaised
    | ConditionCleared
    | FaultReported
    | StorageCounted
    | ObjectsCounted
    | Transfer
    | BootFinished
    | PartResult
    | PartBusy
    | Armed
    | CaptureFinished
    | CaptureFailed
    | RawStored
    | News
    | LiveGuidance
    | Saved
    | SaveFailed
    | TrialExamined
    | Session
    | CalibrationProgressed
    | Failure
    | RangeMeasured
    | ScansListed
    | StopRequested
)
