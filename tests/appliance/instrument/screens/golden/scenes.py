"""Owns the list of scenes: every screen in the states that a diver meets, and how it looks at its fullest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from appliance.calibrate.guide import USED, AdjustmentSummary, LengthCheck, RecordingCheck, Refusal, Session, Step
from appliance.instrument.machine.alerts import RULES, Alert, alert_of
from appliance.instrument.machine.leading import GuidanceText, OverlapText
from appliance.instrument.machine.states import Calibrating, Failure, FailureKind, State, Task
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.ranging.reach import Reach
from appliance.instrument.screens import views
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import Move
from appliance.measure.verdict import Grade
from drivers.api import Key
from tests.appliance.instrument.screens.golden import seabed

NUMBERS = {
    "error_percent": 0.6, "received": 23.0, "expected": 24.0, "shift_px": 1.8, "coverage_percent": 38.0, "temperature_c": 61.0,
    "supply_v": 10.4, "distance_mm": 421.0, "sight_m": 1.6,
}  # fmt: skip
OF_CODE = {
    FaultCode.WARM: {"temperature_c": 52.0},
    FaultCode.TOO_HOT: {"temperature_c": 85.0},
    FaultCode.TOO_FAR: {"distance_mm": 588.0},
}
"""Numbers that fit an alert better."""


class Scene(NamedTuple):
    view: views.AnyView
    time_s: float


def alert(code: FaultCode, device: str | None = None) -> Alert:
    """As the machine would show it, with typical numbers."""
    return alert_of(Fault(code, "said for the log", {**NUMBERS, **OF_CODE.get(code, {})}, device))


def keys(**words: Label) -> views.KeyLabels:
    return MappingProxyType({Key(name): word for name, word in words.items()})


WARM = replace(alert(FaultCode.WARM), headline="WARM 52 °C", german=("WARM 52 °C", "BALD ABKÜHLEN LASSEN"))
LOST = alert(FaultCode.CAMERA_LOST, "camera.right")
LEAK = alert(FaultCode.LEAK)
_NAMES = ("camera.left", "camera.right", "board", "keys", "projector", "display", "storage", "calibration", "worker")
_AIM_KEYS = keys(scan=Text.SCAN, back=Text.HOLD_OFF, up=Text.MENU, down=Text.GALLERY)
_REVIEW_KEYS = keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN)
AIM = views.AimView(
    left=seabed.live(False), right=seabed.live(True), scans_taken=12, scans_left=41, temperature_c=34.0,
    exposure="12 ms", water=Text.SALT, gauge=views.Gauge(503.0, -4.0, Reach.OK), marks=seabed.marks(),
    keys=_AIM_KEYS,
)  # fmt: skip
NO_OVERLAP = OverlapText((Text.NO_OVERLAP, Text.GO_BACK), warns=True)
GO_BACK = GuidanceText((Text.OVERLAP, "25 %"), Text.TURN_BACK, Move.GO_BACK, (-0.95, 0.31))
GO_ON = GuidanceText((Text.OVERLAP, "80 %"), Text.GO_ON, Move.GO_ON, (0.6, -0.8))
_POINTS = seabed.cloud()
REVIEW = views.ReviewView(
    points_mm=_POINTS, values=_POINTS[:, 2], coarse=False, grade=Grade.GOOD, points=1_312_409,
    coverage_percent=87.0, noise_mm=0.028, distance_mm=503.0, duration_s=2.8, keys=_REVIEW_KEYS,
)  # fmt: skip
STORED = views.StoredScan(
    "000012", preview=seabed.preview(), grade=Grade.GOOD, points=1_312_409, coverage_percent=87.0, noise_mm=0.028, distance_mm=503.0,
    captured_at="2026-11-21 14:07",
)  # fmt: skip
GALLERY = views.GalleryView(scan=STORED, index=0, count=12, keys=keys(back=Text.BACK, down=Text.OLDER))
MAIN_ROWS = (
    views.MenuRow(Text.EXPOSURE, "12 ms"), views.MenuRow(Text.FRINGES, Text.FINE), views.MenuRow(Text.WATER, (Text.SALT, "12.5 °C")), views.MenuRow(Text.CALIBRATE),
    views.MenuRow(Text.OBJECT, "3"), views.MenuRow(Text.GALLERY), views.MenuRow(Text.TRANSFER, Text.OFF), views.MenuRow(Text.LANGUAGE, Text.ENGLISH),
    views.MenuRow(Text.ABOUT), views.MenuRow(Text.POWER_OFF),
)  # fmt: skip
_MENU_KEYS = keys(scan=Text.OPEN, back=Text.BACK, up=Text.ARROW_UP, down=Text.ARROW_DOWN)
_TRIALS = tuple(RecordingCheck(step, None, 0.031, 2140) for step in USED)
_SOLVED = AdjustmentSummary("bundle, spline", 0.034, (), "abc")


def _tested(failed: Mapping[str, Alert | Text], waiting: int = 0) -> tuple[views.DeviceLine, ...]:
    known = _NAMES[: len(_NAMES) - waiting]
    return (
        *(views.DeviceLine(name, name not in failed, failed.get(name, "")) for name in known),
        *(views.DeviceLine(name, None) for name in _NAMES[len(known) :]),
    )  # fmt: skip


def _calibrate(at: Calibrating, session: Session | None = None, **words: Label) -> views.CalibrateView:
    given = keys(**(words or {"scan": Text.SCAN, "back": Text.BACK, "down": Text.BAR_UPRIGHT}))
    live = seabed.live(False)
    gauge = views.Gauge(None, None, Reach.UNKNOWN) if at.latest is None else views.Gauge(508.0, None, Reach.OK)
    return views.CalibrateView(
        position=at, session=session or Session(), left=live, right=live, gauge=gauge, marks=seabed.marks(), keys=given
    )


_UNCALIBRATED = replace(alert(FaultCode.UNCALIBRATED), lasts=True)
_OFF, _BACK, _REDO = keys(back=Text.HOLD_OFF), keys(back=Text.BACK), keys(back=Text.HOLD_REDO)
_VIEWS: dict[str, views.AnyView] = {
    "boot": views.SelfTestView(devices=_tested({}, 5), version="0.1.0", opened=False, keys=_OFF),
    "self-test": views.SelfTestView(devices=_tested({}), version="0.1.0", finished=True, passed=True, keys=_OFF),
    "self-test-failed": views.SelfTestView(
        devices=_tested({"camera.right": LOST, "calibration": Text.NOT_MEASURED}),
        version="0.1.0", finished=True, passed=False, keys=keys(scan=Text.GO_ON, back=Text.HOLD_OFF),
    ),
    "aim": AIM,
    "aim-closer": replace(AIM, gauge=views.Gauge(588.0, 17.0, Reach.CLOSER), exposure="8 ms", water=Text.FRESH, overlap=NO_OVERLAP),
    "aim-insist": replace(
        AIM, gauge=views.Gauge(421.0, None, Reach.BACK), guidance=GuidanceText((Text.OVERLAP, "50 %"), None), object=3,
        alerts=(replace(alert(FaultCode.TOO_NEAR), headline="NEAR 421 mm", german=("NAH 421 mm", "ZURÜCK, ODER NOCHMAL DRÜCKEN")),),
        keys=keys(scan=Text.ANYWAY, back=Text.HOLD_OFF, up=Text.MENU, down=Text.GALLERY),
    ),
    "aim-no-dots": replace(
        AIM, gauge=views.Gauge(None, None, Reach.UNKNOWN), temperature_c=None, scans_left=None, exposure=None, guidance=GO_BACK, object=3
    ),
    "aim-warning": replace(
        AIM, right=None, gauge=None, marks=None, scan_allowed=False, alerts=(LOST, WARM), guidance=GO_ON, object=3
    ),
    "aim-torch": replace(AIM, alerts=(alert(FaultCode.AIM_LIGHT),), object=12),
    "aim-acknowledge": replace(
        AIM, alerts=(_UNCALIBRATED,), keys=keys(scan=Text.SCAN, back=Text.SEEN, up=Text.MENU, down=Text.GALLERY)
    ),
    "aim-mark": replace(AIM, alerts=(replace(_UNCALIBRATED, is_acknowledged=True),)),
    "aim-many-alerts": replace(
        AIM, scan_allowed=False,
        alerts=(alert(FaultCode.HOT), LOST, *map(alert, (FaultCode.BOARD_LOST, FaultCode.UNCALIBRATED, FaultCode.STORAGE_FULL))),
    ),
    "armed": views.ProgressView(state=State.ARMED, keys=keys(back=Text.STOP)),
    "capture": views.ProgressView(state=State.CAPTURE, keys=keys(back=Text.STOP)),
    "check": views.ProgressView(state=State.CHECK, keys=_REDO),
    "reconstruct": views.ProgressView(state=State.RECONSTRUCT, keys=_REDO),
    "review": replace(
        REVIEW, overlap=OverlapText((Text.OVERLAP, "62 %")),
        keys=keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN, down=(Text.HOLD_ADD, "3.2 ms")),
    ),
    "review-coarse": replace(REVIEW, coarse=True, grade=Grade.USABLE, points=20_412, noise_mm=0.071),
    "review-next-scan": replace(
        REVIEW, grade=Grade.USABLE, alerts=(alert(FaultCode.TOO_BRIGHT),), next_scan="10 ms",
        keys=keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN, down=(Text.EXPOSE, "12 ms")),
    ),
    "review-doubtful": replace(REVIEW, lengths_doubtful=True, alerts=(replace(_UNCALIBRATED, is_acknowledged=True),)),
    "review-moved": replace(
        REVIEW, grade=Grade.BAD, alerts=(alert(FaultCode.MOVED),), overlap=NO_OVERLAP,
        keys=keys(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN, down=(Text.EXPOSE, "8 ms")),
    ),
    "review-no-points": replace(
        REVIEW, points_mm=_POINTS[:0], values=_POINTS[:0, 2], points=0, coverage_percent=None, noise_mm=None, distance_mm=None, duration_s=None,
        grade=Grade.BAD, alerts=(alert(FaultCode.RECONSTRUCTION_FAILED), alert(FaultCode.TOO_DARK)),
    ),
    "saving": views.SavingView(scan_id="000012", saved=False),
    "saved": views.SavingView(scan_id="000012", saved=True),
    "menu": views.MenuView(title=Text.MENU, rows=MAIN_ROWS, selected=2, keys=_MENU_KEYS),
    "menu-changing": views.MenuView(
        title=Text.MENU, rows=tuple(views.MenuRow(row.text, ("4", Text.NEW)) if row.text is Text.OBJECT else row for row in MAIN_ROWS),
        selected=4, changing=True, keys=keys(scan=Text.OK, back=Text.CANCEL, up=Text.ARROW_UP, down=Text.ARROW_DOWN),
    ),
    "menu-alert": views.MenuView(title=Text.MENU, rows=MAIN_ROWS, selected=3, alerts=(LOST, WARM), keys=_MENU_KEYS),
    "menu-transfer": views.MenuView(
        title=Text.TRANSFER, selected=0, keys=keys(scan=Text.CHANGE, back=Text.BACK, down=Text.ARROW_DOWN),
        rows=(
            views.MenuRow(Text.TRANSFER, Text.ON), views.MenuRow(Text.ADDRESS, "169.254.113.27"), views.MenuRow(Text.TRANSFER_KEYS, Text.PLUG_STICK_IN),
        ),
    ),
    "menu-about": views.MenuView(
        title=Text.ABOUT, selected=0, keys=keys(back=Text.BACK, down=Text.ARROW_DOWN),
        rows=(
            views.MenuRow(Text.VERSION, "0.1.0"), views.MenuRow(Text.SERIAL_NUMBER, "KF-0001"), views.MenuRow(Text.CALIBRATED, "2026-11-02"),
            views.MenuRow(Text.SALINITY, "34.5 psu"), views.MenuRow(Text.DISK, ("12", Text.TAKEN, "· 41", Text.LEFT_OVER)),
        ),
    ),
    "menu-power-off": views.MenuView(
        title=Text.POWER_OFF_ASKED, selected=0, rows=(views.MenuRow(Text.STAY_ON), views.MenuRow(Text.SWITCH_OFF)),
        keys=keys(scan=Text.OK, back=Text.BACK, down=Text.ARROW_DOWN),
    ),
    "gallery": GALLERY,
    "gallery-damaged": replace(
        GALLERY, scan=views.StoredScan("000009", damaged=True), index=3, keys=keys(back=Text.BACK, up=Text.NEWER, down=Text.OLDER),
    ),
    "gallery-empty": views.GalleryView(keys=_BACK),
    "calibrate-bar": _calibrate(Calibrating(Step.M1, latest=RecordingCheck(Step.M1, Refusal.TILT_MORE, 12.0))),
    "calibrate-plane": _calibrate(
        Calibrating(Step.M3, latest=_TRIALS[2]), Session(_TRIALS[:3]),
        scan=Text.REDO, back=Text.BACK, up=Text.BAR_UPRIGHT, down=Text.PLANE_FAR,
    ),
    "calibrate-solve": _calibrate(Calibrating(Step.SOLVE, Task.SOLVE, progress=0.55), Session(_TRIALS), back=Text.BACK),
    "calibrate-failed": _calibrate(
        Calibrating(Step.SOLVE, failed=Failure(FailureKind.RECORDING, "M1, scan 000012: no ball on the right; record M1 again", "M1")),
        Session(_TRIALS), back=Text.BACK,
    ),
    "calibrate-result": _calibrate(
        Calibrating(Step.RESULT), Session(_TRIALS, _SOLVED, LengthCheck(0.0031, -0.0002, 0.00004)),
        scan=Text.KEEP, back=Text.BACK, up=Text.VERIFY, down=Text.HOLD_NEW,
    ),
    "calibrate-checked": _calibrate(
        Calibrating(Step.RESULT), Session((), None, LengthCheck(0.0062, None, 0.0001)),
        back=Text.BACK, up=Text.VERIFY, down=Text.HOLD_NEW,
    ),
    "cooling": views.CoolingView(temperature_c=61.0, limit_c=55.0, remaining_s=118.0, keys=_BACK),
    "cooling-alert": views.CoolingView(temperature_c=61.0, limit_c=55.0, remaining_s=None, alerts=(alert(FaultCode.HOT), LOST), keys=_BACK),
    "safe": views.SafeView(alert=LEAK, saved=True, keys=_OFF),
    "safe-saving": views.SafeView(alert=LEAK, saved=False, keys=_OFF),
    "safe-alert": views.SafeView(alert=LEAK, saved=True, alerts=(LEAK, LOST, WARM), keys=_OFF),
    "shutdown": views.ShutdownView(),
    "shutdown-forced": views.ShutdownView(reason=alert(FaultCode.SUPPLY_LOW), saving=True),
}  # fmt: skip
_TIMES_S = {
    **dict.fromkeys(("boot", "self-test", "self-test-failed"), 0.7), "reconstruct": 0.9, "review": 1.2, "review-doubtful": 1.2,
    **dict.fromkeys(("review-coarse", "review-next-scan", "review-moved", "safe-saving"), 0.4), "saving": 0.6,
}  # fmt: skip
SCENES = {name: Scene(view, _TIMES_S.get(name, 0.0)) for name, view in _VIEWS.items()}

ALERTS = {code.value: alert(code, "camera.left" if "side}" in rule.headline.english else None) for code, rule in RULES.items()}  # fmt: skip
"""Every alert there is, with typical numbers."""
