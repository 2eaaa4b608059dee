"""Ways into every state, through events only, and the set of all events: what the machine's tests share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, get_args

from hypothesis import strategies as st

from appliance.calibrate.guide import HELD, USED, AdjustmentSummary, LengthCheck, RecordingCheck, Session, Step
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine import keys
from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.states import (
    Device,
    Failure,
    FailureKind,
    Machine,
    Part,
    PartResult,
    Serving,
    State,
    Transfer,
    boot,
)
from appliance.instrument.machine.step import step
from appliance.instrument.machine.words import worded
from appliance.instrument.ranging.reach import Range
from appliance.measure.cloud import CloudSummary
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import LOST, NO_OVERLAP, UNKNOWN, Guidance, Overlap
from appliance.measure.light.exposure import Exposure
from appliance.measure.news import LiveGuidance, News, SequenceFact, WorkProgress
from appliance.measure.verdict import SPOILS_SCAN
from drivers.api import BoardBooted, Key, KeyFreed, KeyLongPress, KeyPress, KeyStuck, LaserState, Telemetry
from tests.support import news
from tests.support.typed import built

SECOND_NS = 1_000_000_000
SERVED = Transfer(Serving.ON, "192.168.1.7", 2)
SUMMARY = CloudSummary(1000, coverage_percent=70.0, distance_mm=500.0, noise_mm=0.03, gap_mm=0.02)
HOT = Fault(FaultCode.HOT, "case 61 °C, limit 60 °C", {"temperature_c": 61.0}, "case")
MISSING = Fault(FaultCode.FRAME_MISSING, "left frame 9", {"received": 23, "expected": 24})


def run(machine: Machine, *events: on.Event) -> Machine:
    for event in events:
        machine, _ = step(machine, event)
    return machine


def after(machine: Machine, *events: on.Event) -> tuple[Machine, list[do.Effect]]:
    effects: list[do.Effect] = []
    for event in events:
        machine, wanted = step(machine, event)
        effects += wanted
    return machine, effects


def labels(machine: Machine) -> Mapping[Key, str]:
    """What is written beside each key, in English as the status file has it."""
    return {key: worded(label) for key, label in keys.labels(machine).items()}


UPS = tuple(on.DeviceUp(device) for device in Device)
PARTS = tuple(PartResult(part, True) for part in Part)


def self_testing() -> Machine:
    return run(boot(0), *UPS, on.BootFinished(), *PARTS, on.StorageCounted(0, None, 100))


def aim() -> Machine:
    return run(self_testing(), on.Tick(SECOND_NS))


def in_menu(*keys: Key) -> Machine:
    return run(aim(), KeyPress(Key.UP, 0), *(KeyPress(key, 0) for key in keys))


def in_gallery() -> Machine:
    return run(aim(), KeyPress(Key.DOWN, 0), on.ScansListed(("000003", "000002", "000001")))


def armed() -> Machine:
    return run(aim(), KeyPress(Key.SCAN, 0))


def capturing() -> Machine:
    return run(armed(), on.Armed(1))


def checking() -> Machine:
    return run(capturing(), on.CaptureFinished(1))


def reconstructing() -> Machine:
    return run(checking(), news.right(1))


def reviewing() -> Machine:
    return run(reconstructing(), on.RawStored(1), news.coarse(1, SUMMARY), news.full(1, SUMMARY))


def saving() -> Machine:
    return run(reviewing(), KeyPress(Key.SCAN, 0))


TO_CALIBRATION = (Key.DOWN, Key.DOWN, Key.DOWN, Key.SCAN)


def calibrating() -> Machine:
    return in_menu(*TO_CALIBRATION)


def trial_in_work() -> Machine:
    """The frames of M1 are stored, and the bar is looked for."""
    return run(calibrating(), KeyPress(Key.SCAN, 0), on.Armed(1), on.CaptureFinished(1), on.RawStored(1))


def good(step: Step) -> RecordingCheck:
    return RecordingCheck(step, None, 0.03, 4000, "bar 150.1 mm", "000001")


RECORDED = Session(tuple(good(step) for step in USED))
SOLVED = Session(RECORDED.trials, AdjustmentSummary("bundle", 0.03, (), "abc"))
VERIFIED = Session((*RECORDED.trials, good(Step.VERIFY)), SOLVED.solved, LengthCheck(0.004, 0.0002, 0.00003))
IN_USE = Session(VERIFIED.trials, VERIFIED.solved, VERIFIED.verified, True, "0001.json")
SESSIONS = (Session(), Session((good(Step.M1),)), RECORDED, SOLVED, VERIFIED, IN_USE)


def calibrating_at(session: Session) -> Machine:
    presses = [KeyPress(key, 0) for key in (Key.UP, *TO_CALIBRATION)]
    return run(aim(), session, *presses)


HOLD_BACK = (KeyPress(Key.BACK, 0), KeyLongPress(Key.BACK, 0))


def asked(start: Machine) -> Machine:
    return run(start, *HOLD_BACK)


def about_to_switch_off(start: Machine) -> Machine:
    return run(asked(start), KeyPress(Key.DOWN, 0))


def ended() -> Machine:
    return run(about_to_switch_off(aim()), KeyPress(Key.SCAN, 0))


def cooling() -> Machine:
    return run(aim(), on.ConditionRaised(HOT))


def safe() -> Machine:
    return run(aim(), heartbeat(leak=True), heartbeat(leak=True))


def safe_with_a_scan() -> Machine:
    return run(reconstructing(), heartbeat(leak=True), heartbeat(leak=True))


def refused_by_the_disk() -> Machine:
    return run(saving(), on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO")))


def self_test_without_a_camera() -> Machine:
    lost = on.DeviceDown(Device.CAMERA_LEFT, "not found")
    return run(boot(0), *UPS, lost, on.BootFinished(), *PARTS, on.StorageCounted(0, None, 100))


def reviewing_a_part() -> Machine:
    """The coarse cloud is there, and the full one is awaited."""
    return run(reconstructing(), news.coarse(1, SUMMARY))


def kept_before_the_cloud() -> Machine:
    return run(reviewing_a_part(), KeyPress(Key.SCAN, 0))


def hot_while_aiming() -> Machine:
    return run(cooling(), KeyPress(Key.BACK, 0))


def gallery_from_the_menu() -> Machine:
    return run(in_menu(*(Key.DOWN,) * 5, Key.SCAN), on.ScansListed(("000002", "000001")))


def outside_the_volume() -> Machine:
    """SCAN was pressed 700 mm away; pressed again it records."""
    return run(aim(), on.RangeMeasured(Range(700.0, 0.0, 0.5, 2)), KeyPress(Key.SCAN, 0))


WAYS: dict[State, Callable[[], Machine]] = {
    State.BOOT: lambda: boot(0),
    State.SELF_TEST: self_testing,
    State.AIM: aim,
    State.MENU: in_menu,
    State.GALLERY: in_gallery,
    State.ARMED: armed,
    State.CAPTURE: capturing,
    State.CHECK: checking,
    State.RECONSTRUCT: reconstructing,
    State.REVIEW: reviewing,
    State.SAVING: saving,
    State.CALIBRATE: calibrating,
    State.COOLING: cooling,
    State.SAFE: safe,
    State.SHUTDOWN: ended,
}


def heartbeat(
    *,
    left_on: bool = False,
    right_on: bool = False,
    temperature_case_c: float | None = None,
    temperature_projector_c: float | None = None,
    **more: Any,
) -> Telemetry:
    lasers = LaserState(left_on, right_on)
    return Telemetry(0, 0, 0, lasers, temperature_projector_c, temperature_case_c, **more)


def cost(code: FaultCode) -> tuple[object, ...]:
    rule = RULES[code]
    costs = rule.stops_capture, rule.forbids_light, rule.blocks_scan, code in SPOILS_SCAN, rule.doubts_lengths
    return *costs, rule.severity, rule.passing


OF_EACH_COST = tuple({cost(code): code for code in FaultCode}.values())
"""A fault of each kind by what it costs."""
EVERY_EVENT: list[on.Event] = [
    on.Tick(1),
    on.Tick(10_000 * SECOND_NS),
    *(KeyPress(key, 0) for key in Key),
    *(KeyLongPress(key, 0) for key in Key),
    *(KeyStuck(key) for key in Key),
    *(KeyFreed(key) for key in Key),
    *(on.DeviceUp(device) for device in Device),
    *(on.DeviceDown(device, "unplugged") for device in Device),
    on.DeviceDown(Device.CAMERA_LEFT, "480 Mbit/s", FaultCode.CAMERA_SLOW_LINK),
    BoardBooted("1.0", "B1", "POWER"),
    heartbeat(leak=True, left_on=True, temperature_case_c=99.0),
    heartbeat(),
    *(on.ConditionRaised(Fault(code)) for code in FaultCode),
    *(on.ConditionCleared(code) for code in OF_EACH_COST),
    on.FaultReported(Fault(FaultCode.RESTARTED)),
    on.StorageCounted(1, "000001", 0),
    *(news.overlap(number, overlap) for number in (0, 1) for overlap in (UNKNOWN, NO_OVERLAP, Overlap(0.62))),
    *(LiveGuidance(guidance, 1) for guidance in (None, LOST, Guidance(Overlap(0.62), (1.0, 0.0)))),
    on.ObjectsCounted(0),
    on.ObjectsCounted(7),
    SERVED,
    on.BootFinished(),
    *(PartResult(part, passed) for part in Part for passed in (True, False)),
    *(on.PartBusy(part) for part in Part),
    *(on.Armed(number) for number in (0, 1, 2)),
    *(on.CaptureFinished(number) for number in (0, 1, 2)),
    on.CaptureFailed(0, MISSING),
    *(on.CaptureFailed(1, Fault(code)) for code in FaultCode),
    on.RawStored(1),
    news.right(1),
    news.coarse(1, SUMMARY),
    news.full(1, SUMMARY),
    news.judged(1, (MISSING,)),
    news.judged(1, (), Exposure(8_000)),
    news.judged(1, (), None, Exposure(3_200)),
    news.full(1, SUMMARY, MISSING),
    News(1, WorkProgress("light")),
    news.merged(1, SUMMARY),
    news.not_merged(1, Fault(FaultCode.MOVED)),
    news.wrong(1, Fault(FaultCode.PATTERN_WRONG)),
    *(news.failed(1, Fault(code)) for code in OF_EACH_COST),
    on.Saved(1, "000001"),
    on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO")),
    *(on.TrialExamined(1, good(step)) for step in HELD),
    *(session for session in SESSIONS),
    on.CalibrationProgressed(0.5),
    Failure(FailureKind.RECORDING, "no bar"),
    on.RangeMeasured(Range(500.0, 2.0, 0.3, 2)),
    on.ScansListed(()),
    on.ScansListed(("000002", "000001")),
    on.StopRequested(),
]

STARTS: tuple[Callable[[], Machine], ...] = (
    *WAYS.values(),
    trial_in_work,
    safe_with_a_scan,
    refused_by_the_disk,
    self_test_without_a_camera,
    reviewing_a_part,
    kept_before_the_cloud,
    hot_while_aiming,
    gallery_from_the_menu,
    outside_the_volume,
    lambda: in_menu(Key.SCAN),
    lambda: in_menu(Key.DOWN, Key.DOWN, Key.DOWN),
    lambda: in_menu(*(Key.DOWN,) * 5),
    lambda: in_menu(*(Key.DOWN,) * 4, Key.SCAN),
    lambda: run(
        aim(), on.ObjectsCounted(2), *(KeyPress(key, 0) for key in (Key.UP, *(Key.DOWN,) * 4, Key.SCAN, Key.UP))
    ),
    lambda: run(in_menu(*(Key.DOWN,) * 6, Key.SCAN, Key.SCAN, Key.UP, Key.SCAN), SERVED),
    lambda: in_menu(*(Key.DOWN,) * 9, Key.SCAN),
    lambda: in_menu(*(Key.DOWN,) * 9, Key.SCAN, Key.DOWN),
    lambda: asked(aim()),
    lambda: about_to_switch_off(aim()),
    lambda: about_to_switch_off(boot(0)),
    lambda: about_to_switch_off(self_testing()),
    lambda: about_to_switch_off(safe()),
    lambda: in_menu(Key.DOWN, Key.DOWN, Key.SCAN, Key.DOWN, Key.SCAN),
    *(partial(calibrating_at, session) for session in SESSIONS),
)


def kind(event: on.Event) -> type[object]:
    """The class of an event; of news, that of the fact."""
    return type(event.fact) if isinstance(event, News) else type(event)


KINDS = ({*get_args(on.Event)} - {News}) | {*get_args(SequenceFact)}
EVENTS: st.SearchStrategy[on.Event] = st.one_of(
    *(
        st.sampled_from([event for event in EVERY_EVENT if kind(event) is one])
        for one in sorted(KINDS, key=lambda one: one.__name__)
    ),
    built(on.Tick, st.integers(0, 200).map(lambda s: s * SECOND_NS)),
    built(
        heartbeat,
        left_on=st.booleans(),
        leak=st.sampled_from([None, False, True]),
        temperature_case_c=st.one_of(st.none(), st.floats(-10, 120)),
        temperature_projector_c=st.one_of(st.none(), st.floats(-10, 120)),
        humidity_percent=st.sampled_from([None, 40.0, 95.0]),
        supply_v=st.sampled_from([None, 3.0, 9.5, 12.0]),
    ),
)
"""Every kind of event as often as any other."""
START: st.SearchStrategy[Machine] = st.sampled_from(STARTS).map(lambda way: way())
WALKS = st.lists(EVENTS, max_size=25)
