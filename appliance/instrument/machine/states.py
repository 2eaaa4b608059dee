"""State of the machine as frozen values.

    State       what the instrument is doing; the names are promised in ``docs/protocols/status.md``
    Machine     a ``State`` and all other values that decisions depend on
    Settings    limits and deadlines, given once
    Transfer    whether a desk can fetch scans, at which address, and the number of keys; another program
                serves, and its status is copied here
    Failure     why a task of the calibration failed: a kind that the screen has words for, and details for the log

The other classes are parts of ``Machine``. Decisions are made in ``appliance.instrument.machine.step``. Times are ns of
the host's monotonic clock, as given by the latest ``Tick``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from appliance.calibrate import RecordingCheck, Session, Step
from appliance.instrument.machine.choices import Choices, Offers
from appliance.instrument.machine.words import Label
from appliance.instrument.ranging.reach import Range, Reach
from appliance.measure import (
    PERIODS_PX,
    STANDARD,
    CloudSummary,
    Exposure,
    Fault,
    Guidance,
    Overlap,
    WorkingVolume,
    build_sequence,
)
from drivers.api import Key


class Serving(Enum):
    """State of the program that serves scans to a desk."""

    STARTING = "starting"
    """Requested, without a report so far."""
    ON = "on"
    FAILED = "failed"
    """It cannot serve; the journal has the reason."""


@dataclass(frozen=True, slots=True)
class Transfer:
    """State of the scan transfer, as the serving program reports it."""

    serving: Serving = Serving.STARTING
    address: str | None = None
    """Address to type at the desk; ``None``: no cable, or none assigned yet."""
    keys: int | None = None
    """Number of enrolled keys; ``None``: not known."""


TRANSFER_UNKNOWN = Transfer()
"""State of the scan transfer before the first report."""


class FailureKind(Enum):
    """Kind of a failure, which decides the diver's remedy."""

    RECORDING = "recording"
    """A recording, or the artefact in it, cannot be used."""
    CERTIFICATE = "certificate"
    """The ball bar's certificate is not stated."""
    CAMERAS = "cameras"
    """The recordings are of other cameras."""
    NO_SOLUTION = "no solution"
    """Each recording can be used, but no calibration fits all of them."""
    FILES = "files"
    """A file of the session, or a calibration, is damaged, missing or does not fit."""
    DISK = "disk"
    """The disk refused."""
    BROKEN_OFF = "broken off"
    """The computation ended without a result."""
    NO_ANSWER = "no answer"
    """No answer came in time."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of a task."""

    kind: FailureKind
    detail: str
    """Details for the log and for the technician: English, with names and values. Never on the screen."""
    step_name: str = ""
    """Name of the step that failed; empty: none in particular."""


class State(Enum):
    """State of the instrument. The names are those of ``docs/protocols/status.md``."""

    BOOT = "BOOT"
    """Opening devices: each is tried once."""
    SELF_TEST = "SELF_TEST"
    """Each device and part with its result; ends by itself unless a fault forbids scans."""
    AIM = "AIM"
    """Live views; with CALIBRATE the only state with light outside a capture."""
    MENU = "MENU"
    """The menu is open: choices, page by page."""
    GALLERY = "GALLERY"
    """The scans on the disk, the newest first."""
    ARMED = "ARMED"
    """Lasers are proven off and cameras made ready for a sequence; nothing shines."""
    CAPTURE = "CAPTURE"
    """A sequence is being recorded; ends by itself, by a fault or by its deadline."""
    CHECK = "CHECK"
    """Every witness of the ledger agrees; the images are being checked for the right patterns."""
    RECONSTRUCT = "RECONSTRUCT"
    """The patterns are right; no cloud yet."""
    REVIEW = "REVIEW"
    """A cloud is shown, or the reason why there is none; the diver keeps or repeats the scan."""
    SAVING = "SAVING"
    """The diver keeps the scan; it is being published."""
    CALIBRATE = "CALIBRATE"
    """The steps of the calibration in water; live views at those that record."""
    COOLING = "COOLING"
    """Too hot to shine; ends when it has cooled down, or when the diver leaves for a dark AIM."""
    SAFE = "SAFE"
    """A leak, or another fault that forbids light: dark, recorded frames are saved, and a remedy is shown."""
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


class Part(Enum):
    """Parts that the self-test checks besides devices; named as on the screen."""

    STORAGE = "storage"
    CALIBRATION = "calibration"
    WORKER = "worker"


@dataclass(frozen=True, slots=True)
class PartResult:
    """Result of the self-test for a part that is no device."""

    part: Part
    passed: bool
    detail: Label = ""


NEEDED_FOR_A_SCAN = (Device.CAMERA_LEFT, Device.CAMERA_RIGHT, Device.BOARD, Device.PROJECTOR)


@dataclass(frozen=True, slots=True)
class TemperatureLimits:
    """Temperature limits of one place, °C."""

    warm_c: float
    """Temperature from which a warning is shown, and the light is switched off sooner."""
    hot_c: float
    """Temperature from which all light is off."""
    off_c: float
    """Temperature from which the instrument switches itself off."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants of the machine, given once.

    Deadlines are generous: they end a hang, they do not pace the work.
    """

    choices: Choices = field(default_factory=Choices)
    """Choices at power-on."""
    offers: Offers = field(default_factory=Offers)
    boot_s: float = 60.0
    self_test_s: float = 45.0
    """Time after which a part of the self-test without a result counts as failed."""
    busy_s: float = 10.0
    """Additional time for a part that reports progress, counted from the report."""
    passed_s: float = 1.0
    """Time for which a self-test without faults is shown."""
    limited_s: float = 3.0
    """Time for which a self-test is shown whose faults limit scans but do not forbid them."""
    keyless_s: float = 10.0
    """Time for which a self-test is shown whose faults forbid scans, if no key works to go on."""
    arm_s: float = 45.0
    """Longer than pending writes to the disk, and drawing new patterns."""
    capture_margin_s: float = 5.0
    """Time beyond the length of the sequence: to find the vertical blank, and to wait for missing frames."""
    refresh_hz: float = 60.0
    frames: Mapping[int, int] = field(
        default_factory=lambda: {period_px: len(build_sequence(period_px)) for period_px in PERIODS_PX}, hash=False
    )
    """Number of frames of a sequence, by its period in px."""
    reconstruct_s: float = 60.0
    saving_s: float = 60.0
    examine_s: float = 60.0
    solve_s: float = 300.0
    # A mapping has no hash; left out, the frozen value that holds it still has one.
    temperatures: Mapping[str, TemperatureLimits] = field(
        default_factory=lambda: {
            "case": TemperatureLimits(50.0, 60.0, 68.0),
            "projector": TemperatureLimits(65.0, 75.0, 85.0),
        },
        hash=False,
    )
    dark_s: float = 180.0
    """Time without a key after which live views go on without the projector's light."""
    dark_warm_s: float = 30.0
    """The same time where it is warm."""
    supply_low_v: float | None = None
    supply_off_s: float = 30.0
    """Time of low supply after which the instrument saves and switches off."""
    ask_off_s: float = 20.0
    """Time for which the question whether to switch off waits for an answer."""
    insist_s: float = 10.0
    """Time for which SCAN outside the working volume waits to be pressed again."""
    volume: WorkingVolume = STANDARD
    """Working volume of the housing."""

    def light_s(self, period_px: int) -> float:
        """Return the time for which a sequence shines."""
        return self.frames.get(period_px, max(self.frames.values(), default=0)) / self.refresh_hz

    def capture_s(self, period_px: int) -> float:
        """Return the time limit of a capture: its frames and a margin."""
        return (
            self.frames.get(period_px, max(self.frames.values(), default=0)) / self.refresh_hz + self.capture_margin_s
        )


@dataclass(frozen=True, slots=True)
class ScanInHand:
    """The recorded scan that awaits the diver's decision, or that is being saved."""

    number: int
    """Number of the scan's Capture effect; events about it carry the same."""
    exposure: Exposure
    """Exposure of the first sequence."""
    proposal: Exposure | None = None
    """Exposure that the judge of light proposes for the next scan."""
    second: Exposure | None = None
    """Exposure of a second sequence, for parts that are too bright or too dark in this one."""
    adding: int | None = None
    """Number of the Arm effect of the second sequence, while it is recorded and merged.

    If that fails, this scan stays as it is.
    """
    added: Exposure | None = None
    """Exposure of the second sequence, once it is merged."""
    warnings: tuple[Fault, ...] = ()
    """Faults that do not forbid keeping the scan (moved, too bright)."""
    coarse: CloudSummary | None = None
    full: CloudSummary | None = None
    failed: Fault | None = None
    """Reason why there will be no cloud now; the raw frames can be kept all the same."""
    raw_durable: bool = False
    is_kept: bool = False
    """The diver keeps it, or it is saved unasked because the instrument must end."""
    publishing: bool = False
    failures: int = 0
    """Number of failed writes since the last key."""
    retry_ns: int | None = None
    """Time of the next automatic try."""
    turn_steps: int = 0
    """Turn of the view by the diver: steps to the right, negative to the left."""

    @property
    def settled(self) -> bool:
        """True if the worker has no more results to send."""
        return self.full is not None or self.failed is not None


class NoticeKind(Enum):
    """Reason of a notice; it decides the wording."""

    FAILURE = "failure"
    """The capture or the scan failed."""
    NOT_ADDED = "not added"
    """The second exposure failed; the scan in hand is unchanged."""
    REFUSAL = "refusal"
    """SCAN was pressed and refused."""
    NEWS = "news"
    """An event that the diver did not cause."""


@dataclass(frozen=True, slots=True)
class Notice:
    """One message over the screen, gone with the next key."""

    fault: Fault
    kind: NoticeKind
    readable_until_ns: int = 0
    """Time until which it stays even if its reason goes: long enough to be read."""


class Task(Enum):
    """Task of the service that a step of the calibration waits for."""

    STORE = "STORE"
    """The frames are being written to the disk."""
    EXAMINE = "EXAMINE"
    """The artefact is being searched for in the frames."""
    ACCEPT = "ACCEPT"
    """The recording is being entered into the session."""
    SOLVE = "SOLVE"
    SWITCH = "SWITCH"
    """Another calibration is being put in use, or a new session begun."""


@dataclass(frozen=True, slots=True)
class Calibrating:
    """Position of the diver among the steps of the calibration; the results are in the session."""

    step: Step
    task: Task | None = None
    number: int | None = None
    """Number of the Capture effect whose recording is stored, examined or accepted."""
    progress: float | None = None
    """Progress of the task, 0..1; ``None``: not known."""
    latest: RecordingCheck | None = None
    """Check of the latest recording, until the next key."""
    failed: Failure | None = None
    """Failure of the latest task, until the next key."""


class Page(Enum):
    """One page of the menu."""

    MAIN = "MAIN"
    WATER = "WATER"
    TRANSFER = "TRANSFER"
    ABOUT = "ABOUT"


class Answer(Enum):
    """Answers to the question whether to switch off, in the order of the screen: the harmless one first."""

    STAY_ON = "STAY ON"
    SWITCH_OFF = "SWITCH OFF"


@dataclass(frozen=True, slots=True)
class OffQuestion:
    """The question whether the diver really wants to switch off."""

    answer: Answer
    """The selected answer."""
    until_ns: int
    """Time at which the question ends without an answer, and the instrument stays on."""


@dataclass(frozen=True, slots=True)
class Menu:
    """Position of the diver in the menu."""

    page: Page = Page.MAIN
    row: int = 0
    draft: Choices | None = None
    """Choices with the value that is being changed. SCAN applies them, BACK discards them."""


@dataclass(frozen=True, slots=True)
class Gallery:
    """Position of the diver in the gallery."""

    scans: tuple[str, ...] | None = None
    """Numbers of the scans, the newest first; ``None`` until the disk was read."""
    index: int = 0

    @property
    def scan_id(self) -> str | None:
        """The shown scan."""
        return self.scans[self.index] if self.scans else None


@dataclass(frozen=True, slots=True)
class Thermal:
    """History of temperatures and light, for ``appliance.instrument.machine.thermal``."""

    heard_ns: Mapping[str, int] = field(default_factory=dict, hash=False)
    """Time of each sensor's latest value; of a sensor without any, the time of the first heartbeat."""
    trend: Mapping[str, tuple[tuple[int, float], ...]] = field(default_factory=dict, hash=False)
    """(ns, °C) of the last minute, by place."""
    is_lit: bool = False
    """True while the live views are illuminated."""
    ration_s: float = 20.0
    """Remaining light while it is rationed."""
    spent: bool = False
    """True if too little of the ration is left for aiming."""


class Ending(Enum):
    """Action after the save in progress has ended."""

    STOP = "stop"
    """The service ends."""
    POWER_OFF = "power off"


@dataclass(frozen=True, slots=True)
class Machine:
    """State of the instrument, and all values that its decisions depend on."""

    settings: Settings
    state: State
    since_ns: int
    """Time at which ``state`` was entered."""
    now_ns: int
    deadline_ns: int | None = None
    """Time at which ``state`` ends at the latest; ``None`` where the diver decides."""
    up: frozenset[Device] = frozenset()
    lost: Mapping[Device, Fault] = field(default_factory=dict, hash=False)
    """Faults of lost devices. A device in neither ``up`` nor ``lost`` was not tried yet."""
    conditions: tuple[Fault, ...] = ()
    """Conditions besides lost devices; one per code and device."""
    acknowledged: tuple[Fault, ...] = ()
    """Conditions as the diver acknowledged them; one per code and device."""
    notice: Notice | None = None
    captures: int = 0
    """Number of the latest Capture effect."""
    retries: int = 0
    """Silent repetitions of the current capture."""
    choices: Choices = field(default_factory=Choices)
    """Choices for the next scan and the live views, until the diver changes them."""
    parts: Mapping[Part, PartResult] = field(default_factory=dict, hash=False)
    """Results of the self-test; a part that is missing has no result yet."""
    menu: Menu | None = None
    """The menu in MENU, and in a GALLERY that was entered from there."""
    gallery: Gallery | None = None
    insists_until_ns: int | None = None
    """Time until which SCAN records outside the working volume, since it was pressed there before."""
    cooling_left: bool = False
    """The diver left COOLING although it is still hot."""
    scan: ScanInHand | None = None
    overlap_of: int | None = None
    """Number of the Capture effect whose overlap is shown: the latest scan's, unless it was rejected."""
    overlap: Overlap | None = None
    """Overlap of that scan with the one before, until the next capture begins; ``None``: not known."""
    guidance: Guidance | None = None
    """Guidance to the next view, while the diver aims with an object; ``None``: none, or too old."""
    guided_ns: int = 0
    """Time of the image behind ``guidance``."""
    stuck: frozenset[Key] = frozenset()
    back_from: State | None = None
    """State in which BACK was pressed last: a key held on into another state has no effect there."""
    back_spent: bool = False
    """True if the latest press of BACK has had its effect: holding it on has no other."""
    add_offered: bool = False
    """True if a second exposure was offered when DOWN was pressed last: otherwise holding it adds none."""
    off_question: OffQuestion | None = None
    """Question over BOOT, SELF_TEST, AIM, MENU and SAFE; while it is shown, the keys answer it."""
    last_key_ns: int | None = None
    """Time of the latest press of a key."""
    board_resets: int = 0
    thermal: Thermal = field(default_factory=Thermal)
    leak_votes: int = 0
    """Consecutive heartbeats that reported a leak."""
    lasers_off_since_ns: int | None = None
    """Time since which the lasers should be off; ``None`` while they may be on."""
    range: Range | None = None
    """Distance of the object, as long as the lasers are on; ``None``: unknown."""
    reach: Reach = Reach.UNKNOWN
    """Advice about the distance, with hysteresis."""
    scans: int = 0
    last_scan: str | None = None
    scans_left: int | None = None
    objects_used: int | None = None
    """Largest object number of the scans on the disk; ``None`` until the disk was read."""
    transfer: Transfer = TRANSFER_UNKNOWN
    """State of the scan transfer, while it is switched on."""
    just_saved: str | None = None
    """Scan to confirm as SAVED on the screen, until the next key."""
    stopping: Ending | None = None
    """Action after the save in progress."""
    off_ns: int | None = None
    """Time at which the instrument switches off by itself, unless the cause ends before."""
    ended_by: Fault | None = None
    """Fault that forced the end; ``None``: the diver wanted it."""
    session: Session = field(default_factory=Session)
    """The current calibration session, or the last one, as it is on the disk."""
    calibrating: Calibrating | None = None
    """Position in CALIBRATE, and in ARMED and CAPTURE for one of its steps."""

    @property
    def exposure(self) -> Exposure:
        """Exposure of the next scan and of the live views."""
        return self.choices.exposure


def boot(now_ns: int, settings: Settings | None = None) -> Machine:
    """Return the machine at power-on."""
    settings = settings or Settings()
    return Machine(
        settings=settings,
        state=State.BOOT,
        choices=settings.choices,
        since_ns=now_ns,
        now_ns=now_ns,
        deadline_ns=now_ns + seconds_ns(settings.boot_s),
        # The lasers are off so far: one that conducts after LASER_SETTLE_S is a fault.
        lasers_off_since_ns=now_ns,
    )


def seconds_ns(duration_s: float) -> int:
    """Convert seconds to integer ns."""
    return round(duration_s * 1e9)
