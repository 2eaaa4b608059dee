"""Owns what the machine asks for: every output of ``step`` as a frozen value. The service executes them in order."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.calibrate import RecordingCheck, Step
from appliance.instrument.machine.choices import Choices
from appliance.instrument.machine.states import Device
from appliance.measure import Exposure


@dataclass(frozen=True, slots=True)
class GoLive:
    """Cameras free-running for the live views. ``light``: the projector may shine. ``lasers``: they may be on.

    What is False must be off. Sent again whenever a device came or went; idempotent.
    """

    light: bool
    lasers: bool
    exposure: Exposure


@dataclass(frozen=True, slots=True)
class StopLive:
    """End the live views; the projector dark, the lasers off."""


@dataclass(frozen=True, slots=True)
class LightsOff:
    """Projector dark and lasers off now, in whatever state: light is no longer permitted."""


@dataclass(frozen=True, slots=True)
class Arm:
    """Make ready for one sequence: lasers off and proven off, cameras flushed and waiting.

    Answer Armed or CaptureFailed.
    """

    number: int
    period_px: int
    exposure: Exposure
    second: bool = False
    """True for the second sequence of the scan in hand, whose first one stays where it is."""
    object: int | None = None
    """Number of the object that the scan belongs to."""


@dataclass(frozen=True, slots=True)
class Capture:
    """Record what was armed; answer CaptureFinished or CaptureFailed of this number. Includes its own light."""

    number: int


@dataclass(frozen=True, slots=True)
class AbortCapture:
    """Let go what was armed and end a sequence at the next vertical blank, dark. Its answer is no longer awaited."""

    number: int


@dataclass(frozen=True, slots=True)
class StoreRaw:
    """Make the raw frames durable in a hidden folder, those of a second sequence beside the first one's; answer
    RawStored or SaveFailed."""

    number: int


@dataclass(frozen=True, slots=True)
class StartReconstruction:
    """Reconstruct a sequence.

    Answer News, the last of which is a FullCloud, a PatternIdentity with a fault, or a ReconstructionFailure; of a
    second sequence a Bracket or a ReconstructionFailure.
    """

    number: int


@dataclass(frozen=True, slots=True)
class CancelReconstruction:
    """The result is no longer wanted; a worker that hangs may be replaced."""

    number: int


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish the scan with whatever cloud there is (its raw frames first, if that failed before); idempotent.

    Answer Saved or SaveFailed.
    """

    number: int


@dataclass(frozen=True, slots=True)
class Reject:
    """Move the scan to the rejected ones; answer Rejected or SaveFailed."""

    number: int
    reason: str


@dataclass(frozen=True, slots=True)
class CheckRecording:
    """Look for the step's artefact in a scan whose raw frames are stored; answer TrialExamined or CalibrationFailed."""

    number: int
    step: Step


@dataclass(frozen=True, slots=True)
class AcceptRecording:
    """Publish the scan, then enter it into the session; answer SessionChanged or SaveFailed of this number."""

    number: int
    check: RecordingCheck


@dataclass(frozen=True, slots=True)
class SolveCalibration:
    """Adjust to the session's recordings; answer CalibrationProgressed, then SessionChanged or CalibrationFailed."""


@dataclass(frozen=True, slots=True)
class UseSolved:
    """Put what was solved in use and keep the file of before; answer SessionChanged or CalibrationFailed."""


@dataclass(frozen=True, slots=True)
class RestoreKeptCalibration:
    """Put the kept file in use again, byte for byte; answer SessionChanged or CalibrationFailed."""


@dataclass(frozen=True, slots=True)
class BeginSession:
    """Put the session away and begin a new one; answer SessionChanged or CalibrationFailed."""


@dataclass(frozen=True, slots=True)
class CancelCalibration:
    """End what is being examined or solved; its answer is no longer awaited."""


@dataclass(frozen=True, slots=True)
class RememberChoices:
    """Write the choices down, for the next start."""

    choices: Choices


@dataclass(frozen=True, slots=True)
class SwitchTransfer:
    """Scans may be taken off from now on, or not any more; while they may, answer TransferTold."""

    to_on: bool


@dataclass(frozen=True, slots=True)
class UsePeriod:
    """Patterns, frame memory and worker for another fringe period; a scan armed meanwhile waits for it."""

    period_px: int


@dataclass(frozen=True, slots=True)
class UseWater:
    """The next scan is measured in this water."""

    salinity_psu: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class ListGallery:
    """Answer ScansListed."""


@dataclass(frozen=True, slots=True)
class ShowGalleryScan:
    """Load what the gallery shows of a scan; the latest wish counts."""

    scan_id: str


@dataclass(frozen=True, slots=True)
class ReopenDevice:
    """Close and open one device: its images do not follow the patterns. ``None``: both cameras."""

    device: Device | None


@dataclass(frozen=True, slots=True)
class Quit:
    """Finish what is being written, close the devices, end the process. ``power_off``: and switch off."""

    power_off: bool


Effect = (
    GoLive
    | StopLive
    | LightsOff
    | Arm
    | Capture
    | AbortCapture
    | StoreRaw
    | StartReconstruction
    | CancelReconstruction
    | Publish
    | Reject
    | CheckRecording
    | AcceptRecording
    | SolveCalibration
    | UseSolved
    | RestoreKeptCalibration
    | BeginSession
    | CancelCalibration
    | RememberChoices
    | SwitchTransfer
    | UsePeriod
    | UseWater
    | ListGallery
    | ShowGalleryScan
    | ReopenDevice
    | Quit
)
