"""Owns the state of the machine: everything the instrument knows about itself at one moment, as frozen values.

    State       what the instrument is doing; the names are promised in ``docs/protocols/status.md``
    Machine     the whole: a ``State``, and all that is remembered beside it
    Settings    limits and deadlines that the machine is given once
    others      parts of ``Machine``: the scan in hand, notice, menu, gallery, calibration, temperatures, and
    Transfer    whether scans can be fetched from a desk, at which address, and with how many keys; the diver switches
                it on in the menu, another program serves, and its status is copied here
    Failure     why a task of the calibration failed: a kind that the screen has words for, and details for the log

Nothing here decides; ``appliance.instrument.machine.step`` does. Times are ns of the host's monotonic clock, as given by
the latest ``Tick``.
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
    """States of the program that serves."""

    STARTING = "starting"
    """It was asked for and has not told anything yet."""
    ON = "on"
    FAILED = "failed"
    """It cannot serve; the journal says why."""


@dataclass(frozen=True, slots=True)
class Transfer:
    """The transfer as the program that serves tells it."""

    serving: Serving = Serving.STARTING
    address: str | None = None
    """Address to type at the desk; ``None``: no cable, or none was given yet."""
    keys: int | None = None
    """Number of keys that are enrolled; ``None``: not known."""


NOT_TOLD = Transfer()
"""The transfer as it is known before anything was told."""


class FailureKind(Enum):
    """Kind of a failure, to tell the diver; it decides what he can do."""

    RECORDING = "recording"
    """A recording, or the artefact in it, cannot be used."""
    CERTIFICATE = "certificate"
    """The ball bar's certificate is not stated."""
    CAMERAS = "cameras"
    """The recordings are of other cameras."""
    NO_SOLUTION = "no solution"
    """Each recording can be used, and no calibration fits all of them."""
    FILES = "files"
    """A file of the session, or a calibration, is damaged, missing or does not fit."""
    DISK = "disk"
    """The disk refused."""
    BROKEN_OFF = "broken off"
    """The computation ended without an answer."""
    NO_ANSWER = "no answer"
    """Nobody answered in time."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Failure of a task."""

    kind: FailureKind
    detail: str
    """Details for the log, and for who repairs it: English, with names and values. Never on the screen."""
    about: str = ""
    """The step that it is about; empty: none in particular."""


class State(Enum):
    """State of the instrument. The names are those of ``docs/protocols/status.md``."""

    BOOT = "BOOT"
    """Opening devices: each is tried once."""
    SELF_TEST = "SELF_TEST"
    """Each device and part with its result; ends by itself unless something forbids scans."""
    AIM = "AIM"
    """Live views; with CALIBRATE the only state with light outside a capture."""
    MENU = "MENU"
    """The menu is open: what can be chosen, page by page."""
    GALLERY = "GALLERY"
    """The scans on the disk, the newest first."""
    ARMED = "ARMED"
    """Lasers are proven off and cameras made ready for a sequence; nothing shines."""
    CAPTURE = "CAPTURE"
    """A sequence is being recorded; ends by itself, by a fault or by its deadline."""
    CHECK = "CHECK"
    """Every witness of the ledger agrees; whether the images show the right patterns is being looked at."""
    RECONSTRUCT = "RECONSTRUCT"
    """The patterns are right; no cloud yet."""
    REVIEW = "REVIEW"
    """A cloud (or why there is none) is shown; the diver keeps or repeats."""
    SAVING = "SAVING"
    """The diver keeps the scan; it is being published."""
    CALIBRATE = "CALIBRATE"
    """The steps of the calibration in water; live views at those that record."""
    COOLING = "COOLING"
    """Too hot to shine; left by itself when it has cooled down, or by the diver for a dark AIM."""
    SAFE = "SAFE"
    """A leak, or another fault that forbids light: dark, what was recorded is saved, and what to do is shown."""
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
    """Parts that the self-test looks at besides devices; named as on the screen."""

    STORAGE = "storage"
    CALIBRATION = "calibration"
    WORKER = "worker"


@dataclass(frozen=True, slots=True)
class PartTested:
    """Result of the self-test for a part that is no device."""

    part: Part
    passed: bool
    detail: Label = ""


NEEDED_FOR_A_SCAN = (Device.CAMERA_LEFT, Device.CAMERA_RIGHT, Device.BOARD, Device.PROJECTOR)


@dataclass(frozen=True, slots=True)
class TemperatureLimits:
    """Temperature limits of one place, °C."""

    warm_c: float
    """Temperature from which a warning is shown, and light rests sooner."""
    hot_c: float
    """Temperature from which nothing shines."""
    off_c: float
    """Temperature from which the instrument switches itself off."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants that the machine is given once. Deadlines are generous: they end a hang, they do not pace the work."""

    choices: Choices = field(default_factory=Choices)
    """Choices at power-on."""
    offers: Offers = field(default_factory=Offers)
    boot_s: float = 60.0
    self_test_s: float = 45.0
    """Time after which a part of the self-test without a result counts as failed."""
    busy_s: float = 10.0
    """Additional time for a part that was seen to get on, from then."""
    passed_s: float = 1.0
    """Time for which a self-test is shown that found nothing wrong."""
    limited_s: float = 3.0
    """Time for which a self-test is shown that found what limits but does not forbid scans."""
    keyless_s: float = 10.0
    """Time for which a self-test is shown that found what forbids scans, where no key works to go on."""
    arm_s: float = 45.0
    """Longer than what may still be on its way to the disk, and patterns that are drawn anew."""
    capture_margin_s: float = 5.0
    """Time beyond the length of the sequence: to find the vertical blank, to wait for frames that do not come."""
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
    """Time without a key after which they do so where it is warm."""
    supply_low_v: float | None = None
    supply_off_s: float = 30.0
    """Time for which a low supply is borne before the instrument switches off in good order."""
    ask_off_s: float = 20.0
    """Time for which the question whether to switch off waits for an answer."""
    insist_s: float = 10.0
    """Time for which SCAN outside the measuring volume waits to be pressed again."""
    volume: WorkingVolume = STANDARD
    """Range in which the housing measures."""

    def light_s(self, period_px: int) -> float:
        """Return for how long a sequence shines."""
        return self.frames.get(period_px, max(self.frames.values(), default=0)) / self.refresh_hz

    def capture_s(self, period_px: int) -> float:
        """Return the time within which a capture ends, whatever happens: its frames and a margin."""
        return (
            self.frames.get(period_px, max(self.frames.values(), default=0)) / self.refresh_hz + self.capture_margin_s
        )


@dataclass(frozen=True, slots=True)
class ScanInHand:
    """The recorded scan the diver has not decided on, or that is being saved."""

    number: int
    """Number of the scan's Capture effect; events about it carry the same."""
    exposure: Exposure
    """Exposure that it was recorded with."""
    proposal: Exposure | None = None
    """Exposure that its judge of light proposes for the next one."""
    second: Exposure | None = None
    """Exposure of a second sequence that would show what this one cannot: too bright in parts, and too dark."""
    adding: int | None = None
    """Number of the Arm effect of that second sequence, while it is recorded and merged; whatever fails, this scan
    stays."""
    added: Exposure | None = None
    """The second sequence's, once the scan is of both."""
    warnings: tuple[Fault, ...] = ()
    """Verdicts that do not forbid keeping it (moved, too bright)."""
    coarse: CloudSummary | None = None
    full: CloudSummary | None = None
    failed: Fault | None = None
    """Reason why there will be no cloud now; the raw frames can be kept all the same."""
    raw_durable: bool = False
    kept: bool = False
    """The diver wants it, or it is saved unasked because the instrument must end."""
    publishing: bool = False
    failures: int = 0
    """Number of the disk's refusals since the last key."""
    retry_ns: int | None = None
    """Time to try again without being asked."""
    turn: int = 0
    """Turn of the view by the diver: steps to the right, negative to the left."""

    @property
    def settled(self) -> bool:
        """True if nothing more will come from the worker."""
        return self.full is not None or self.failed is not None


class NoticeKind(Enum):
    """Reasons of a notice; they decide its wording."""

    FAILURE = "failure"
    """The capture or the scan failed."""
    NOT_ADDED = "not added"
    """Nothing came of the second exposure; the scan in hand is as it was."""
    REFUSAL = "refusal"
    """SCAN was pressed and refused."""
    NEWS = "news"
    """Something happened by itself."""


@dataclass(frozen=True, slots=True)
class Notice:
    """One message over the screen, gone with the next key."""

    fault: Fault
    kind: NoticeKind
    readable_until_ns: int = 0
    """Time until which it stays even if its reason goes: long enough to be read."""


class Task(Enum):
    """Task that a step of the calibration waits for."""

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
    """Position of the diver among the steps of the calibration. What was achieved is in the session."""

    step: Step
    task: Task | None = None
    number: int | None = None
    """Number of the Capture effect whose recording is stored, examined or accepted."""
    progress: float | None = None
    """Progress of the task, 0..1; ``None`` where nobody knows."""
    latest: RecordingCheck | None = None
    """The latest recording, until the next key."""
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
    """The diver wants to switch off, and is asked whether that is meant."""

    answer: Answer
    """The one that is selected."""
    until_ns: int
    """Time at which, without an answer, it stays on."""


@dataclass(frozen=True, slots=True)
class Menu:
    """Position of the diver in the menu."""

    page: Page = Page.MAIN
    row: int = 0
    draft: Choices | None = None
    """Choices as they would be, while a value is being changed. Taken by SCAN, forgotten by BACK."""


@dataclass(frozen=True, slots=True)
class Gallery:
    """Scan that is looked at."""

    scans: tuple[str, ...] | None = None
    """Numbers of the scans, the newest first; ``None`` until the disk has told."""
    index: int = 0

    @property
    def scan_id(self) -> str | None:
        """The one that is shown."""
        return self.scans[self.index] if self.scans else None


@dataclass(frozen=True, slots=True)
class Thermal:
    """Memory of temperatures and light; ``appliance.instrument.machine.thermal`` reads and writes it."""

    heard_ns: Mapping[str, int] = field(default_factory=dict, hash=False)
    """Time at which each sensor spoke last; from the first heartbeat on for one that never did."""
    trend: Mapping[str, tuple[tuple[int, float], ...]] = field(default_factory=dict, hash=False)
    """(ns, °C) of the last minute, by place."""
    lit: bool = False
    """The live views are lit."""
    ration_s: float = 20.0
    """Light that is left where it is rationed."""
    spent: bool = False
    """Too little is left for aiming."""


class Ending(Enum):
    """End that follows once the save in progress is through."""

    STOP = "stop"
    """The service ends."""
    POWER_OFF = "power off"


@dataclass(frozen=True, slots=True)
class Machine:
    """The whole of the instrument's state."""

    settings: Settings
    state: State
    since_ns: int
    """Time at which ``state`` was entered."""
    now_ns: int
    deadline_ns: int | None = None
    """Time at which ``state`` ends at the latest; ``None`` where the diver decides."""
    up: frozenset[Device] = frozenset()
    lost: Mapping[Device, Fault] = field(default_factory=dict, hash=False)
    """A device in neither ``up`` nor ``lost`` has not been heard of."""
    conditions: tuple[Fault, ...] = ()
    """Faults that last, besides lost devices; one per code and device."""
    seen: tuple[Fault, ...] = ()
    """Lasting faults as the diver acknowledged them; one per code and device."""
    notice: Notice | None = None
    captures: int = 0
    """Number of the latest Capture effect."""
    retries: int = 0
    """Silent repetitions of the current capture."""
    choices: Choices = field(default_factory=Choices)
    """Choices for the next scan and the live views, until the diver changes them."""
    parts: Mapping[Part, PartTested] = field(default_factory=dict, hash=False)
    """Results of the self-test; a part that is missing has not been heard of."""
    menu: Menu | None = None
    """Menu in MENU, and in a GALLERY that was entered from there."""
    gallery: Gallery | None = None
    insists_until_ns: int | None = None
    """SCAN was pressed outside the measuring volume; pressed again before then, it records."""
    cooling_left: bool = False
    """The diver left COOLING although it is still hot."""
    scan: ScanInHand | None = None
    overlap_of: int | None = None
    """Number of the Capture effect whose overlap is shown: the latest scan's, unless it was rejected."""
    overlap: Overlap | None = None
    """Its overlap with the scan before, until the next one is begun; ``None``: nothing was said of it."""
    guidance: Guidance | None = None
    """Guidance to the next view, while the diver aims with an object; ``None``: there is none, or it is too old."""
    guided_ns: int = 0
    """Time at which what it says was seen."""
    stuck: frozenset[Key] = frozenset()
    back_from: State | None = None
    """State in which the latest press of BACK began: held on into another state, it means nothing there."""
    back_spent: bool = False
    """The latest press of BACK has had its effect: held on, it means nothing more."""
    add_offered: bool = False
    """A second exposure was offered when DOWN went down last: held on from anywhere else, it adds nothing."""
    off_question: OffQuestion | None = None
    """Question over BOOT, SELF_TEST, AIM, MENU and SAFE; while it is shown, the keys answer it."""
    last_key_ns: int | None = None
    """Time at which a key was pressed last."""
    board_resets: int = 0
    thermal: Thermal = field(default_factory=Thermal)
    leak_votes: int = 0
    """Consecutive heartbeats that reported a leak."""
    lasers_off_since_ns: int | None = None
    """Time since which the lasers should be off; ``None`` while they may be on."""
    range: Range | None = None
    """Distance of the object, as long as the lasers are on; ``None``: unknown."""
    reach: Reach = Reach.UNKNOWN
    """The word for it, which does not flicker."""
    scans: int = 0
    last_scan: str | None = None
    scans_left: int | None = None
    objects_used: int | None = None
    """Largest number of an object that scans on the disk carry; ``None`` until the disk has told."""
    transfer: Transfer = NOT_TOLD
    """The transfer of scans to a desk, while it is switched on."""
    just_saved: str | None = None
    """Scan to confirm as SAVED on the screen, until the next key."""
    stopping: Ending | None = None
    """Quit once the save is through."""
    off_ns: int | None = None
    """Time at which the instrument switches off by itself, unless what forces it ends before."""
    ended_by: Fault | None = None
    """Fault that forced it to switch off; ``None``: the diver wanted it."""
    session: Session = field(default_factory=Session)
    """The calibration under way, or the last one, as it lies on the disk."""
    calibrating: Calibrating | None = None
    """Calibration in CALIBRATE, and in ARMED and CAPTURE for one of its steps."""

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
        # Nobody has asked for lasers yet: one that conducts although this has settled is a fault.
        lasers_off_since_ns=now_ns,
    )


def seconds_ns(duration_s: float) -> int:
    """Return seconds as whole ns."""
    return round(duration_s * 1e9)
