"""Owns what the machine asks for: every output of ``step`` as a frozen value. The service executes them in order."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from appliance.calibrate import RecordingCheck, Step
from appliance.instrument.machine.choices import Choices
from appliance.instrument.machine.states import Device
from appliance.measure import Exposure


class Wish(Enum):
    """Wishes that need nothing more to be said of them."""

    DARK = "dark"
    """End the live views; projector dark and lasers off now, in whatever state."""
    ABORT_CAPTURE = "abort capture"
    """Let go what was armed and end a sequence at the next vertical blank, dark. Its answer is no longer awaited."""
    RECONSTRUCT = "reconstruct"
    """Reconstruct the sequence recorded last. Answer News, the last of which is a FullCloud, a PatternIdentity with a
    fault, or a ReconstructionFailure; of a second sequence a Bracket or a ReconstructionFailure."""
    CANCEL_RECONSTRUCTION = "cancel reconstruction"
    """The result is no longer wanted; a worker that hangs may be replaced."""
    SOLVE_CALIBRATION = "solve calibration"
    """Adjust to the session's recordings; answer CalibrationProgressed, then the Session or a Failure."""
    USE_SOLVED = "use solved"
    """Put what was solved in use and keep the file of before; answer the Session or a Failure, as the next two."""
    RESTORE_KEPT = "restore kept"
    """Put the kept file in use again, byte for byte."""
    BEGIN_SESSION = "begin session"
    """Put the session away and begin a new one."""
    CANCEL_CALIBRATION = "cancel calibration"
    """End what is being examined or solved; its answer is no longer awaited."""
    LIST_GALLERY = "list gallery"
    """Answer ScansListed."""


@dataclass(frozen=True, slots=True)
class GoLive:
    """Cameras free-running for the live views. ``light``: the projector may shine. ``lasers``: they may be on.

    What is False must be off. Sent again whenever a device came or went; idempotent.
    """

    light: bool
    lasers: bool
    exposure: Exposure


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
class StoreRaw:
    """Make the raw frames durable in a hidden folder, those of a second sequence beside the first one's; answer
    RawStored or SaveFailed."""

    number: int


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish the scan with whatever cloud there is (its raw frames first, if that failed before); idempotent.

    Answer Saved or SaveFailed.
    """

    number: int


@dataclass(frozen=True, slots=True)
class Reject:
    """Move the scan to the rejected ones; answer that what was NOT_SAVED is cleared, or SaveFailed."""

    number: int
    reason: str


@dataclass(frozen=True, slots=True)
class CheckRecording:
    """Look for the step's artefact in a scan whose raw frames are stored; answer TrialExamined or a Failure."""

    number: int
    step: Step


@dataclass(frozen=True, slots=True)
class AcceptRecording:
    """Publish the scan, then enter it into the session; answer the Session or SaveFailed of this number."""

    number: int
    check: RecordingCheck


@dataclass(frozen=True, slots=True)
class UseChoices:
    """Let what the diver chose take effect, and write it down for the next start: patterns of the period (a scan armed
    meanwhile waits for them), the water of the next scan, and whether scans may be taken off; while they may, answer
    Transfer."""

    before: Choices
    now: Choices


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
    Wish
    | GoLive
    | Arm
    | Capture
    | StoreRaw
    | Publish
    | Reject
    | CheckRecording
    | AcceptRecording
    | UseChoices
    | ShowGalleryScan
    | ReopenDevice
    | Quit
)
