"""Owns the list of scenes: every screen in the states that a diver meets, and how it looks at its fullest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from appliance.calibration.guide import USED, AdjustmentSummary, RecordingCheck, Refusal, Session, Step, Verified
from appliance.machine.alerts import RULES, Alert, alert_of
from appliance.machine.failure import Failure, FailureKind
from appliance.machine.guiding import GuidanceSaid
from appliance.machine.overlaps import OverlapSaid
from appliance.machine.states import Calibrating, Task
from appliance.machine.words import Label, Text
from appliance.ranging.reach import Reach
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.grade import Grade
from appliance.scan.guidance import Move
from appliance.screens.views import (
    AimView,
    AnyView,
    ArmedView,
    BootView,
    CalibrateView,
    CaptureView,
    CheckView,
    CoolingView,
    DeviceLine,
    DeviceResult,
    GalleryView,
    Gauge,
    KeyLabels,
    MenuRow,
    MenuView,
    ReconstructView,
    ReviewView,
    SafeView,
    SavingView,
    SelfTestView,
    ShutdownView,
)
from drivers.api import Key
from tests.appliance.screens.golden import seabed

NUMBERS = {
    "error_percent": 0.6,
    "received": 23.0, "expected": 24.0, "shift_px": 1.8, "coverage_percent": 38.0, "temperature_c": 61.0,
    "supply_v": 10.4, "distance_mm": 421.0, "sight_m": 1.6,
}  # fmt: skip


OF_CODE = {
    FaultCode.WARM: {"temperature_c": 52.0},
    FaultCode.TOO_HOT: {"temperature_c": 85.0},
    FaultCode.TOO_FAR: {"distance_mm": 588.0},
}
"""Numbers that fit an alert better."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A view, when it is drawn, and what the gallery page says of it."""

    view: AnyView
    says: str
    time_s: float = 0.0


def alert(code: FaultCode, device: str | None = None) -> Alert:
    """As the machine would show it, with typical numbers."""
    return alert_of(Fault(code, "said for the log", {**NUMBERS, **OF_CODE.get(code, {})}, device))


def keys(**words: Label) -> KeyLabels:
    return MappingProxyType({Key(name): word for name, word in words.items()})


WARM = replace(alert(FaultCode.WARM), headline="WARM 52 °C", german=("WARM 52 °C", "BALD ABKÜHLEN LASSEN"))
LOST = alert(FaultCode.CAMERA_LOST, "camera.right")
LEAK = alert(FaultCode.LEAK)
MOVED = alert(FaultCode.MOVED)
_NAMES = ("camera.left", "camera.right", "board", "keys", "projector", "display", "storage", "calibration", "worker")
_AIM_KEYS = keys(scan=Text.SCAN, back=Text.HOLD_OFF, up=Text.MENU, down=Text.GALLERY)
_REVIEW_KEYS = keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN)
AIM = AimView(
    left=seabed.live(False), right=seabed.live(True), scans_taken=12, scans_left=41, temperature_c=34.0,
    exposure="12 ms", water=Text.SALT, gauge=Gauge(503.0, -4.0, Reach.OK), marks=seabed.marks(),
    keys=_AIM_KEYS,
)  # fmt: skip
NO_OVERLAP = OverlapSaid((Text.NO_OVERLAP, Text.GO_BACK), warns=True)
GO_BACK = GuidanceSaid((Text.OVERLAP, "25 %"), Text.TURN_BACK, Move.GO_BACK, (-0.95, 0.31))
GO_ON = GuidanceSaid((Text.OVERLAP, "80 %"), Text.GO_ON, Move.GO_ON, (0.6, -0.8))
_POINTS = seabed.cloud()
REVIEW = ReviewView(
    points_mm=_POINTS, values=_POINTS[:, 2], coarse=False, grade=Grade.GOOD, points=1_312_409,
    coverage_percent=87.0, noise_mm=0.028, distance_mm=503.0, duration_s=2.8, keys=_REVIEW_KEYS,
)  # fmt: skip
NO_POINTS = replace(
    REVIEW, points_mm=_POINTS[:0], values=_POINTS[:0, 2], points=0, coverage_percent=None, noise_mm=None,
    distance_mm=None, duration_s=None, grade=Grade.BAD,
)  # fmt: skip
GALLERY = GalleryView(
    scan_id="000012", index=0, count=12, preview=seabed.preview(), grade=Grade.GOOD, points=1_312_409, coverage_percent=87.0,
    noise_mm=0.028, distance_mm=503.0, taken="2026-11-21 14:07", keys=keys(back=Text.BACK, down=Text.OLDER),
)  # fmt: skip
MAIN_ROWS = (
    MenuRow(Text.EXPOSURE, "12 ms"),
    MenuRow(Text.FRINGES, Text.FINE),
    MenuRow(Text.WATER, (Text.SALT, "12.5 °C")),
    MenuRow(Text.CALIBRATE),
    MenuRow(Text.OBJECT, "3"),
    MenuRow(Text.GALLERY),
    MenuRow(Text.TRANSFER, Text.OFF),
    MenuRow(Text.LANGUAGE, Text.ENGLISH),
    MenuRow(Text.ABOUT),
    MenuRow(Text.POWER_OFF),
)
_MENU_KEYS = keys(scan=Text.OPEN, back=Text.BACK, up=Text.ARROW_UP, down=Text.ARROW_DOWN)
_TRIALS = tuple(RecordingCheck(step, None, 0.031, 2140) for step in USED)
_SOLVED = AdjustmentSummary("bundle, spline", 0.034, (), "abc")
_CHECKED = Session((), None, Verified(0.0062, None, 0.0001))
_BETTER = Session(_TRIALS, _SOLVED, Verified(0.0031, -0.0002, 0.00004))


def _tested(failed: Mapping[str, Alert | Text], waiting: int = 0) -> tuple[DeviceLine, ...]:
    known = [
        DeviceLine(name, DeviceResult.FAILED if name in failed else DeviceResult.WORKS, failed.get(name, ""))
        for name in _NAMES[: len(_NAMES) - waiting]
    ]
    return (*known, *(DeviceLine(name, DeviceResult.WAITING) for name in _NAMES[len(_NAMES) - waiting :]))


def _calibrate(at: Calibrating, session: Session | None = None, **words: Label) -> CalibrateView:
    given = keys(**(words or {"scan": Text.SCAN, "back": Text.BACK, "down": Text.BAR_UPRIGHT}))
    live = seabed.live(False)
    gauge = Gauge(None, None, Reach.UNKNOWN) if at.latest is None else Gauge(508.0, None, Reach.OK)
    return CalibrateView(
        at=at, session=session or Session(), left=live, right=live, gauge=gauge, marks=seabed.marks(), keys=given
    )


SCENES: Mapping[str, Scene] = MappingProxyType(
    {
        "boot": Scene(
            BootView(devices=_tested({}, 5), version="0.1.0", keys=keys(back=Text.HOLD_OFF)),
            "Start: devices answer one after the other.", 0.7,
        ),
        "self-test": Scene(
            SelfTestView(
                devices=_tested({}), version="0.1.0", finished=True, passed=True, keys=keys(back=Text.HOLD_OFF)
            ),
            "Everything works; the aim screen follows by itself.", 0.7,
        ),
        "self-test-failed": Scene(
            SelfTestView(
                devices=_tested(
                    {"camera.right": alert(FaultCode.CAMERA_LOST, "camera.right"), "calibration": Text.NOT_MEASURED}
                ),
                version="0.1.0",
                finished=True, passed=False, keys=keys(scan=Text.GO_ON, back=Text.HOLD_OFF),
            ),
            "What failed is named, and waits to be read.", 0.7,
        ),
        "aim": Scene(AIM, "Both live pictures; the laser dots give distance and tilt."),
        "aim-closer": Scene(
            replace(AIM, gauge=Gauge(588.0, 17.0, Reach.CLOSER), exposure="8 ms", water=Text.FRESH, overlap=NO_OVERLAP),
            "Too far away, and slanted; the scan that was kept last has nothing in common with the one before.",
        ),
        "aim-insist": Scene(
            replace(
                AIM, gauge=Gauge(421.0, None, Reach.BACK), guidance=GuidanceSaid((Text.OVERLAP, "50 %"), None), object=3,
                alerts=(replace(alert(FaultCode.TOO_NEAR), headline="NEAR 421 mm", german=("NAH 421 mm", "ZURÜCK, ODER NOCHMAL DRÜCKEN")),),
                keys=keys(scan=Text.ANYWAY, back=Text.HOLD_OFF, up=Text.MENU, down=Text.GALLERY),
            ),
            "SCAN was pressed outside the volume: once more records all the same. The distance leads; the overlap is told, and nobody is told to scan.",
        ),
        "aim-no-dots": Scene(
            replace(AIM, gauge=Gauge(None, None, Reach.UNKNOWN), temperature_c=None, scans_left=None, exposure=None, guidance=GO_BACK, object=3),
            "No dot is seen, no sensor answers: unknown is a dash, never a zero. A scan from here would have 25 % in common with the one that was kept; the arrow "
            "shows the way to more.",
        ),
        "aim-warning": Scene(
            replace(AIM, right=None, gauge=None, marks=None, scan_allowed=False, alerts=(LOST, WARM), guidance=GO_ON, object=3),
            "A camera is lost: its picture and the distance are gone, SCAN is dim, the band says what to do. Most has been scanned: the arrow shows the way on.",
        ),
        "aim-torch": Scene(
            replace(AIM, alerts=(alert(FaultCode.AIM_LIGHT),), object=12),
            "What a scan would fail for, as the live picture shows it: here a torch, which must go, whatever the exposure. It comes and goes by itself, and nothing jumps. "
            "An object runs: scans belong to it until it is ended in the menu.",
        ),
        "aim-acknowledge": Scene(
            replace(
                AIM, alerts=(replace(alert(FaultCode.UNCALIBRATED), lasts=True),),
                keys=keys(scan=Text.SCAN, back=Text.SEEN, up=Text.MENU, down=Text.GALLERY),
            ),
            "A warning that lasts has room of its own, and goes with BACK …",
        ),
        "aim-mark": Scene(
            replace(AIM, alerts=(replace(alert(FaultCode.UNCALIBRATED), lasts=True, seen=True),)),
            "… to a small mark, on this screen and on every other.",
        ),
        "aim-many-alerts": Scene(
            replace(
                AIM, scan_allowed=False,
                alerts=(
                    alert(FaultCode.HOT), LOST, alert(FaultCode.BOARD_LOST), alert(FaultCode.UNCALIBRATED),
                    alert(FaultCode.STORAGE_FULL),
                ),
            ),
            "The gravest flashes in red; the others are named above it.",
        ),
        "armed": Scene(ArmedView(keys=keys(back=Text.STOP)), "Lasers are proven off before any pattern is shown."),
        "capture": Scene(CaptureView(keys=keys(back=Text.STOP)), "The sequence is recorded. Drawn before its first pattern, and not again before its last one."),
        "check": Scene(CheckView(keys=keys(back=Text.HOLD_REDO)), "Whether every frame shows its pattern; the diver may move."),
        "reconstruct": Scene(ReconstructView(keys=keys(back=Text.HOLD_REDO)), "Points are computed.", 0.9),
        "review": Scene(
            replace(
                REVIEW, overlap=OverlapSaid((Text.OVERLAP, "62 %")),
                keys=keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN, down=(Text.HOLD_ADD, "3.2 ms")),
            ),
            "The cloud by depth, gently turning, or turned by the diver; the verdict and its numbers, and above them the overlap with the scan before. "
            "DOWN held adds a second exposure of the same view, for what this one could not show.",
            1.2,
        ),
        "review-coarse": Scene(
            replace(REVIEW, coarse=True, grade=Grade.USABLE, points=20_412, noise_mm=0.071), "A coarse cloud comes first.", 0.4
        ),
        "review-next-scan": Scene(
            replace(
                REVIEW, grade=Grade.USABLE, alerts=(alert(FaultCode.TOO_BRIGHT),), next_scan="10 ms",
                keys=keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN, down=(Text.EXPOSE, "12 ms")),
            ),
            "DOWN has taken the proposed exposure for the next scan; once more takes it back.", 0.4,
        ),
        "review-doubtful": Scene(
            replace(REVIEW, lengths_doubtful=True, alerts=(replace(alert(FaultCode.UNCALIBRATED), lasts=True, seen=True),)),
            "A good scan of an instrument that is not calibrated: no grade stands alone. The warning was acknowledged; its mark stays.",
            1.2,
        ),
        "review-moved": Scene(
            replace(
                REVIEW, grade=Grade.BAD, alerts=(MOVED,), overlap=NO_OVERLAP, keys=keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN, down=(Text.EXPOSE, "8 ms"))
            ),
            "A scan that moved is never called good; and nothing joins this one to the scan before.", 0.4,
        ),
        "review-no-points": Scene(
            replace(NO_POINTS, alerts=(alert(FaultCode.RECONSTRUCTION_FAILED), alert(FaultCode.TOO_DARK))),
            "No cloud: the raw frames can be kept.",
        ),
        "saving": Scene(SavingView(scan_id="000012", saved=False), "On its way to the disk.", 0.6),
        "saved": Scene(SavingView(scan_id="000012", saved=True), "Shown after the last byte is durable, not before."),
        "menu": Scene(
            MenuView(title=Text.MENU, rows=MAIN_ROWS, selected=2, keys=_MENU_KEYS), "What can be chosen."
        ),
        "menu-changing": Scene(
            MenuView(
                title=Text.MENU,
                rows=tuple(MenuRow(row.text, ("4", Text.NEW)) if row.text is Text.OBJECT else row for row in MAIN_ROWS),
                selected=4, changing=True,
                keys=keys(scan=Text.OK, back=Text.CANCEL, up=Text.ARROW_UP, down=Text.ARROW_DOWN),
            ),
            "A value is being changed, and holds once it is taken: scans carry the next object's number from then on.",
        ),
        "menu-alert": Scene(
            MenuView(
                title=Text.MENU,
                rows=MAIN_ROWS,
                selected=3, alerts=(LOST, WARM), keys=_MENU_KEYS,
            ),
            "With an alert the rows stand closer, and a long page goes on above and below.",
        ),
        "menu-transfer": Scene(
            MenuView(
                title=Text.TRANSFER, selected=0, keys=keys(scan=Text.CHANGE, back=Text.BACK, down=Text.ARROW_DOWN),
                rows=(
                    MenuRow(Text.TRANSFER, Text.ON), MenuRow(Text.ADDRESS, "169.254.113.27"),
                    MenuRow(Text.TRANSFER_KEYS, Text.PLUG_STICK_IN),
                ),
            ),
            "Scans may be taken to a desk; nobody has a key yet.",
        ),
        "menu-about": Scene(
            MenuView(
                title=Text.ABOUT, selected=0, keys=keys(back=Text.BACK, down=Text.ARROW_DOWN),
                rows=(
                    MenuRow(Text.VERSION, "0.1.0"), MenuRow(Text.SERIAL_NUMBER, "KF-0001"),
                    MenuRow(Text.CALIBRATED, "2026-11-02"), MenuRow(Text.SALINITY, "34.5 psu"),
                    MenuRow(Text.DISK, ("12", Text.TAKEN, "· 41", Text.LEFT_OVER)),
                ),
            ),
            "What this instrument is.",
        ),
        "menu-power-off": Scene(
            MenuView(
                title=Text.POWER_OFF_ASKED, selected=0, rows=(MenuRow(Text.STAY_ON), MenuRow(Text.SWITCH_OFF)),
                keys=keys(scan=Text.OK, back=Text.BACK, down=Text.ARROW_DOWN),
            ),
            "Asked before every switching off that the diver wants; the answer that does no harm is selected.",
        ),
        "gallery": Scene(GALLERY, "A scan on the disk, with its stored picture."),
        "gallery-damaged": Scene(
            replace(
                GALLERY, scan_id="000009", index=3, preview=None, grade=None, points=None, coverage_percent=None, noise_mm=None,
                distance_mm=None, taken=None, damaged=True, keys=keys(back=Text.BACK, up=Text.NEWER, down=Text.OLDER),
            ),
            "A damaged scan is marked, the others are fine.",
        ),
        "gallery-empty": Scene(GalleryView(keys=keys(back=Text.BACK)), "No scan yet."),
        "calibrate-bar": Scene(
            _calibrate(Calibrating(Step.M1, latest=RecordingCheck(Step.M1, Refusal.TILT_MORE, 12.0))),
            "How to hold the ball bar, and what was wrong with the last recording.",
        ),
        "calibrate-plane": Scene(
            _calibrate(
                Calibrating(Step.M3, latest=_TRIALS[2]), Session(_TRIALS[:3]),
                scan=Text.REDO, back=Text.BACK, up=Text.BAR_UPRIGHT, down=Text.PLANE_FAR,
            ),
            "A recording that fits.",
        ),
        "calibrate-solve": Scene(
            _calibrate(
                Calibrating(Step.SOLVE, Task.SOLVE, progress=0.55), Session(_TRIALS), back=Text.BACK
            ),
            "The adjustment.",
        ),
        "calibrate-failed": Scene(
            _calibrate(
                Calibrating(
                    Step.SOLVE,
                    failed=Failure(FailureKind.RECORDING, "M1, scan 000012: no ball on the right; record M1 again", "M1"),
                ),
                Session(_TRIALS),
                back=Text.BACK,
            ),
            "A task that came to nothing: of which step, and what to do. The log says more, to who repairs it.",
        ),
        "calibrate-result": Scene(
            _calibrate(Calibrating(Step.RESULT), _BETTER, scan=Text.KEEP, back=Text.BACK, up=Text.VERIFY, down=Text.HOLD_NEW),
            "What it gave, against the calibration in use.",
        ),
        "calibrate-checked": Scene(
            _calibrate(Calibrating(Step.RESULT), _CHECKED, back=Text.BACK, up=Text.VERIFY, down=Text.HOLD_NEW),
            "The ball bar alone: the calibration in use is wrong, or the water is.",
        ),
        "cooling": Scene(
            CoolingView(temperature_c=61.0, limit_c=55.0, remaining_s=118.0, keys=keys(back=Text.BACK)),
            "Too hot to shine.",
        ),
        "cooling-alert": Scene(
            CoolingView(
                temperature_c=61.0, limit_c=55.0, remaining_s=None, alerts=(alert(FaultCode.HOT), LOST), keys=keys(back=Text.BACK)
            ),
            "How long is not known; what else is wrong is said as well.",
        ),
        "safe": Scene(SafeView(alert=LEAK, saved=True, keys=keys(back=Text.HOLD_OFF)), "Water came in: no light, ascend."),
        "safe-saving": Scene(
            SafeView(alert=LEAK, saved=False, keys=keys(back=Text.HOLD_OFF)), "The last scan is still being saved.", 0.4
        ),
        "safe-alert": Scene(
            SafeView(alert=LEAK, saved=True, alerts=(LEAK, LOST, WARM), keys=keys(back=Text.HOLD_OFF)),
            "What else is wrong comes second.",
        ),
        "shutdown": Scene(ShutdownView(), "After the diver's wish."),
        "shutdown-forced": Scene(
            ShutdownView(reason=alert(FaultCode.SUPPLY_LOW), saving=True), "Forced by the supply; the save is finished first."
        ),
    }
)  # fmt: skip

ALERTS: Mapping[str, Alert] = MappingProxyType(
    {code.value: alert(code, "camera.left" if "side}" in RULES[code].headline.english else None) for code in RULES}
)
"""Every alert there is, with typical numbers."""
