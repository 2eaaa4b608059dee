"""Owns everything the instrument knows about itself at one moment, as one frozen value.

Nothing here decides; ``appliance.machine.step`` does. Times are ns of the host's monotonic clock, as last told by a
``Tick``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from appliance.calibration.guide import Session, Step, Trial
from appliance.capture.exposure import NOMINAL, Exposure
from appliance.capture.fault import Fault
from appliance.capture.ranging import Range
from drivers.api import Key

if TYPE_CHECKING:  # carried from the worker to the screens, never read here: no kernels are needed to decide
    from appliance.reconstruct.quality import CloudSummary


class State(Enum):
    """What the instrument is doing. The names are those of ``docs/protocols/status.md``."""

    BOOT = "BOOT"
    """Opening devices, drawing patterns, sweeping the disk."""
    AIM = "AIM"
    """Live views; the only state with light outside a capture."""
    CAPTURE = "CAPTURE"
    """A sequence is being recorded; ends by itself, by a fault or by its deadline."""
    RECONSTRUCT = "RECONSTRUCT"
    """Frames are on their way to the disk and to the worker; no cloud yet."""
    REVIEW = "REVIEW"
    """A cloud (or why there is none) is shown; the diver keeps or repeats."""
    SAVING = "SAVING"
    """The diver keeps the scan; it is being published."""
    CALIBRATE = "CALIBRATE"
    """The steps of the calibration in water; live views at those that record."""
    SHUTDOWN = "SHUTDOWN"
    """The end; no event leads out of it."""


class Device(Enum):
    """Devices as the rig file names them."""

    CAMERA_LEFT = "camera.left"
    CAMERA_RIGHT = "camera.right"
    BOARD = "board"
    KEYS = "keys"
    PROJECTOR = "projector"
    DISPLAY = "display"


NEEDED_FOR_A_SCAN = (Device.CAMERA_LEFT, Device.CAMERA_RIGHT, Device.BOARD, Device.PROJECTOR)


@dataclass(frozen=True, slots=True)
class Settings:
    """What the machine is told once. Deadlines are generous: they end a hang, they do not pace the work."""

    period_px: int = 16
    exposure: Exposure = NOMINAL
    """At power-on."""
    boot_s: float = 60.0
    capture_s: float = 5.0
    reconstruct_s: float = 60.0
    saving_s: float = 60.0
    examine_s: float = 60.0
    solve_s: float = 300.0
    case_warm_c: float = 50.0
    case_hot_c: float = 60.0
    projector_warm_c: float = 65.0
    projector_hot_c: float = 75.0
    supply_low_v: float | None = None


@dataclass(frozen=True, slots=True)
class ScanInHand:
    """The recorded scan the diver has not decided on, or that is being saved."""

    number: int
    """Of its Capture effect; events about it carry the same."""
    exposure: Exposure
    """It was recorded with."""
    proposal: Exposure | None = None
    """What its judge of light would expose the next one with."""
    warnings: tuple[Fault, ...] = ()
    """Verdicts that do not forbid keeping it (moved, too bright)."""
    coarse: CloudSummary | None = None
    full: CloudSummary | None = None
    failed: Fault | None = None
    """Why there will be no cloud now; the raw frames can be kept all the same."""
    raw_durable: bool = False
    publishing: bool = False
    turn: int = 0
    """How the diver turned the view: steps to the right, negative to the left."""

    @property
    def settled(self) -> bool:
        """Nothing more will come from the worker."""
        return self.full is not None or self.failed is not None


class NoticeKind(Enum):
    """Why a notice is shown; it decides its wording."""

    FAILURE = "failure"
    """The capture or the scan failed."""
    REFUSAL = "refusal"
    """SCAN was pressed and refused."""
    NEWS = "news"
    """Something happened by itself."""


@dataclass(frozen=True, slots=True)
class Notice:
    """One message over the screen, gone with the next key."""

    fault: Fault
    kind: NoticeKind


class Task(Enum):
    """What a step of the calibration waits for."""

    STORE = "STORE"
    """The frames are on their way to the disk."""
    EXAMINE = "EXAMINE"
    """The artefact is looked for."""
    ACCEPT = "ACCEPT"
    """The recording is entered into the session."""
    SOLVE = "SOLVE"
    SWITCH = "SWITCH"
    """Another calibration is put in use, or a new session begun."""


@dataclass(frozen=True, slots=True)
class Calibrating:
    """Where the diver is among the steps of the calibration. What was achieved is in the session."""

    step: Step
    task: Task | None = None
    number: int | None = None
    """Of the Capture effect whose recording is stored, examined or accepted."""
    progress: float | None = None
    """Of the task, 0..1; ``None`` where nobody knows."""
    latest: Trial | None = None
    """The latest recording, until the next key."""
    failed: str | None = None
    """Why the latest task came to nothing, until the next key."""


@dataclass(frozen=True, slots=True)
class Machine:
    """The whole of the instrument's state."""

    settings: Settings
    state: State
    since_ns: int
    """When ``state`` was entered."""
    now_ns: int
    deadline_ns: int | None = None
    """When ``state`` ends at the latest; ``None`` where the diver decides."""
    up: frozenset[Device] = frozenset()
    lost: Mapping[Device, Fault] = field(default_factory=dict, hash=False)
    """A device in neither ``up`` nor ``lost`` has not been heard of."""
    conditions: tuple[Fault, ...] = ()
    """What is wrong as long as it lasts, besides lost devices; one per code and device."""
    notice: Notice | None = None
    captures: int = 0
    """Number of the latest Capture effect."""
    retries: int = 0
    """Silent repetitions of the current capture."""
    exposure: Exposure = NOMINAL
    """Of the next scan and of the live views, until the diver changes it."""
    scan: ScanInHand | None = None
    stuck: frozenset[Key] = frozenset()
    back_used: bool = False
    """The latest press of BACK ended something; holding it on must not switch off as well."""
    board_resets: int = 0
    leak_votes: int = 0
    """Consecutive heartbeats that reported a leak."""
    lasers_off_since_ns: int | None = None
    """Since when the lasers should be off; ``None`` while they may be on."""
    range: Range | None = None
    """Where the object is, as long as the lasers are on; ``None``: unknown."""
    scans: int = 0
    last_scan: str | None = None
    scans_left: int | None = None
    just_saved: str | None = None
    """Scan to confirm as SAVED on the screen, until the next key."""
    stopping: bool = False
    """Quit once the save is through."""
    session: Session = field(default_factory=Session)
    """The calibration under way, or the last one, as it lies on the disk."""
    calibrating: Calibrating | None = None
    """In CALIBRATE, and in a CAPTURE for one of its steps."""


def boot(now_ns: int, settings: Settings | None = None) -> Machine:
    """The machine at power-on."""
    settings = settings or Settings()
    return Machine(
        settings=settings,
        state=State.BOOT,
        exposure=settings.exposure,
        since_ns=now_ns,
        now_ns=now_ns,
        deadline_ns=now_ns + seconds_ns(settings.boot_s),
        lasers_off_since_ns=now_ns,
    )


def seconds_ns(duration_s: float) -> int:
    """Seconds as whole ns."""
    return round(duration_s * 1e9)
