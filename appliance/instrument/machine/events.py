"""Owns what can happen to the instrument: every input of ``step`` as a frozen value.

Where somebody below has a value for it, that is the event: what the diver does with the keys (``KeyPress`` …), what the
board reports (``Telemetry``, ``BoardBooted``), what a scan's frames give (``News``, ``LiveGuidance``), the
calibration's ``Session`` as it lies on the disk, also as the answer to what changed it, or the ``Failure`` of what was
wanted of it, what the program that serves scans tells (``Transfer``), and a part's self-test (``PartTested``). Events
about a scan carry the ``number`` of the Capture effect that began it, so that an answer that comes too late is
recognised and ignored.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.calibrate import RecordingCheck, Session
from appliance.instrument.machine.states import Device, Failure, Part, PartTested, Transfer
from appliance.instrument.ranging.reach import Range
from appliance.measure import Fault, FaultCode, LiveGuidance, News
from drivers.api import BoardBooted, KeyFreed, KeyLongPress, KeyPress, KeyStuck, Telemetry


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passed. Sent at least ten times a second; deadlines are judged here only."""

    now_ns: int


@dataclass(frozen=True, slots=True)
class DeviceUp:
    device: Device


@dataclass(frozen=True, slots=True)
class DeviceDown:
    """A device was lost; ``code`` where the loss has a more precise name than LOST (a slow link, a refused setting)."""

    device: Device
    reason: str
    code: FaultCode | None = None


@dataclass(frozen=True, slots=True)
class ConditionRaised:
    """Something is wrong until cleared (uncalibrated, no vertical sync)."""

    fault: Fault


@dataclass(frozen=True, slots=True)
class ConditionCleared:
    code: FaultCode
    device: str | None = None


@dataclass(frozen=True, slots=True)
class Told:
    """Something that happened by itself before the machine began; read once, gone with the next key."""

    fault: Fault


@dataclass(frozen=True, slots=True)
class StorageCounted:
    """The library was counted: what it holds and how many scans still fit; ``scans_left`` is None where the disk does
    not tell."""

    scans: int
    last_scan: str | None
    scans_left: int | None


@dataclass(frozen=True, slots=True)
class ObjectsCounted:
    """The scans on the disk were looked at: the largest number of an object that one of them carries, 0 if none does."""

    largest: int


@dataclass(frozen=True, slots=True)
class BootFinished:
    """Everything that can be opened was tried once."""


@dataclass(frozen=True, slots=True)
class PartBusy:
    """A part without a result yet was seen to get on with what leads to one."""

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
    """The raw frames survive the loss of power from now on."""

    number: int


@dataclass(frozen=True, slots=True)
class Saved:
    """Published: the scan survives the loss of power a millisecond later."""

    number: int
    scan_id: str


@dataclass(frozen=True, slots=True)
class SaveFailed:
    """Raw frames or publication were refused by the disk; everything is still in memory."""

    number: int
    fault: Fault


@dataclass(frozen=True, slots=True)
class TrialExamined:
    """A recording for a step of the calibration was judged."""

    number: int
    check: RecordingCheck


@dataclass(frozen=True, slots=True)
class CalibrationProgressed:
    """The adjustment went on: its progress, 0..1."""

    progress: float


@dataclass(frozen=True, slots=True)
class Ranged:
    """The laser dots in the live images were measured: where the object is now; ``None``: nothing can be said for
    sure."""

    range: Range | None


@dataclass(frozen=True, slots=True)
class ScansListed:
    """The numbers of all scans on the disk, the newest first."""

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
    | Told
    | StorageCounted
    | ObjectsCounted
    | Transfer
    | BootFinished
    | PartTested
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
    | Ranged
    | ScansListed
    | StopRequested
)
