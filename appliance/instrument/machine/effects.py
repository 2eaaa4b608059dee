"""Effects of the machine: every output of ``step`` as a frozen value, for the service to execute."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from appliance.calibrate import RecordingCheck, Step
from appliance.instrument.machine.choices import Choices
from appliance.instrument.machine.states import Device
from appliance.measure import Exposure


class Wish(Enum):
    """Effects without arguments."""

    DARK = "dark"
    """End the live views; projector dark and lasers off now, in any state."""
    ABORT_CAPTURE = "abort capture"
    """Disarm, or end a sequence at the next vertical blank, dark. Its answer is no longer awaited."""
    RECONSTRUCT = "reconstruct"
    """Reconstruct the sequence recorded last.

    Answer: News, the last of which is a FullCloud, a PatternIdentity with a fault, or a ReconstructionFailure; for a
    second sequence a Bracket or a ReconstructionFailure.
    """
    CANCEL_RECONSTRUCTION = "cancel reconstruction"
    """The result is no longer needed; a worker that hangs may be replaced."""
    SOLVE_CALIBRATION = "solve calibration"
    """Adjust to the session's recordings; answer CalibrationProgressed, then the Session or a Failure."""
    USE_SOLVED = "use solved"
    """Put the solved calibration in use and keep the former file; answer the Session or a Failure, as the next two."""
    RESTORE_KEPT = "restore kept"
    """Put the kept file in use again, byte for byte."""
    BEGIN_SESSION = "begin session"
    """Put the session away and begin a new one."""
    CANCEL_CALIBRATION = "cancel calibration"
    """End the examination or the adjustment; its answer is no longer awaited."""
    LIST_GALLERY = "list gallery"
    """Answer ScansListed."""


@dataclass(frozen=True, slots=True)
class GoLive:
    """Let the cameras run free for the live views.

    ``light``: the projector may shine. ``lasers``: they may be on. A value of False means off. Idempotent; sent again
    whenever a device came or went.
    """

    light: bool
    lasers: bool
    exposure: Exposure


@dataclass(frozen=True, slots=True)
class Arm:
    """Prepare one sequence: lasers off and proven off, cameras flushed and waiting.

    Answer Armed or CaptureFailed.
    """

    number: int
    period_px: int
    exposure: Exposure
    second: bool = False
    """True for the second sequence of the scan in hand, whose first one stays in memory."""
    object: int | None = None
    """Number of the object that the scan belongs to."""


@dataclass(frozen=True, slots=True)
class Capture:
    """Record the armed sequence, with its light; answer CaptureFinished or CaptureFailed of this number."""

    number: int


@dataclass(frozen=True, slots=True)
class StoreRaw:
    """Make the raw frames durable in a hidden folder; answer RawStored or SaveFailed.

    Those of a second sequence go beside the first one's.
    """

    number: int


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish the scan with its cloud, if any (its raw frames first, if that failed before); idempotent.

    Answer Saved or SaveFailed.
    """

    number: int


@dataclass(frozen=True, slots=True)
class Reject:
    """Move the scan to the rejected ones; answer that NOT_SAVED is cleared, or SaveFailed."""

    number: int
    reason: str


@dataclass(frozen=True, slots=True)
class CheckRecording:
    """Search the step's artefact in a scan whose raw frames are stored; answer TrialExamined or a Failure."""

    number: int
    step: Step


@dataclass(frozen=True, slots=True)
class AcceptRecording:
    """Publish the scan, then enter it into the session; answer the Session or SaveFailed of this number."""

    number: int
    check: RecordingCheck


@dataclass(frozen=True, slots=True)
class UseChoices:
    """Apply the diver's choices, and store them for the next start.

    They are the patterns of the period (a scan armed meanwhile waits for them), the water of the next scan, and whether
    a desk may fetch scans; while it may, answer Transfer.
    """

    before: Choices
    now: Choices


@dataclass(frozen=True, slots=True)
class ShowGalleryScan:
    """Load a scan for the gallery; a later request replaces it."""

    scan_id: str


@dataclass(frozen=True, slots=True)
class ReopenDevice:
    """Close and open one device, since its images do not follow the patterns. ``None``: both cameras."""

    device: Device | None


@dataclass(frozen=True, slots=True)
class Quit:
    """Finish pending writes, close the devices, end the process. ``power_off``: and switch off."""

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
