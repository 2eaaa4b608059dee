"""From power-on to the end, whatever happens: what is awaited and how long, warmth and light, a low supply, water, and switching off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine import safety
from appliance.instrument.machine.conditions import cleared, device_down, device_up, has, judge
from appliance.instrument.machine.leading import alerts
from appliance.instrument.machine.saving import RETRIES
from appliance.instrument.machine.states import (
    Answer,
    Device,
    Ending,
    Machine,
    Part,
    PartResult,
    Settings,
    State,
    Thermal,
    boot,
)
from appliance.instrument.machine.step import step
from appliance.instrument.machine.thermal import RATION_S, gather_light, may_aim_lit, remaining_s, slope_c_per_s, spend
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import NOMINAL
from drivers.api import Key, KeyFreed, KeyLongPress, KeyStuck
from tests.appliance.instrument.machine import walks as at
from tests.appliance.instrument.machine.courses import (
    BACK,
    DOWN,
    EIO,
    LEAK,
    SCAN,
    STOP,
    UP,
    Then,
    codes,
    course,
    raised,
    seen,
    shown,
    wait,
    warm,
)
from tests.appliance.instrument.machine.walks import (
    HOLD_BACK,
    PARTS,
    SECOND_NS,
    UPS,
    after,
    aim,
    asked,
    heartbeat,
    labels,
    run,
)

C, S = FaultCode, State
DARK, LIT = do.GoLive(False, True, NOMINAL), do.GoLive(True, True, NOMINAL)
LOW = raised(C.SUPPLY_LOW, "9.8 V", supply_v=9.8)
SAVED = on.Saved(1, "000001")
OFF, STOPPED = do.Quit(power_off=True), do.Quit(power_off=False)


def begun() -> Machine:
    return run(boot(0), *UPS, on.BootFinished(), *PARTS)


def without_a_worker() -> Machine:
    return run(boot(0), *UPS, on.BootFinished(), *PARTS[:-1])


def without_a_calibration() -> Machine:
    return run(boot(0), *UPS, on.BootFinished(), *(PartResult(part, part is not Part.CALIBRATION) for part in Part))


def without_keys() -> Machine:
    lost = (Device.KEYS, Device.BOARD)
    downs = (on.DeviceDown(device, "not found") for device in lost)
    ups = (on.DeviceUp(device) for device in Device if device not in lost)
    return run(boot(0), *ups, *downs, on.BootFinished(), *PARTS)


def supplied() -> Machine:
    return run(boot(0, Settings(supply_low_v=10.0)), *UPS, on.BootFinished(), *PARTS, on.Tick(SECOND_NS))


def hot() -> Machine:
    return run(aim(), warm(60.0))


def kept_off() -> Machine:
    return run(at.saving(), STOP)


@pytest.mark.parametrize(
    ("start", "events", "facts"),
    [
        # The start.
        course("a good self-test is long enough to be seen", begun, wait(0.999), state=S.SELF_TEST),
        course("and passes by itself", begun, wait(1.0), state=S.AIM),
        course("a result is awaited", without_a_worker, wait(44.0), state=S.SELF_TEST),
        course("silence is failure, and scans go without a worker", without_a_worker, wait(45.0), wait(4.0), state=S.AIM),
        course("whoever gets on is waited for", without_a_worker, *(wait(2.0), on.PartBusy(Part.WORKER)) * 60, state=S.SELF_TEST),
        course("and not when it falls silent", without_a_worker, *(wait(2.0), on.PartBusy(Part.WORKER)) * 60, wait(10.0), wait(4.0), state=S.AIM),
        course("what forbids scans stays", at.self_test_without_a_camera, wait(500.0), state=S.SELF_TEST, on_scan="GO ON"),
        course("until OK", at.self_test_without_a_camera, SCAN, state=S.AIM),
        course("or until it works", at.self_test_without_a_camera, on.DeviceUp(Device.CAMERA_LEFT), wait(1.0), state=S.AIM),
        course("what limits is shown for three seconds", without_a_calibration, wait(2.0), state=S.SELF_TEST),
        course("no longer", without_a_calibration, wait(3.0), state=S.AIM),
        course("without keys nobody is asked", without_keys, wait(9.0), state=S.SELF_TEST),
        course("for ever", without_keys, wait(10.0), state=S.AIM),
        course("devices that nobody heard of refuse a scan", lambda: boot(0), on.DeviceUp(Device.KEYS), *(wait(60.0),) * 3, SCAN, SCAN,
               state=S.AIM, first=("LEFT CAM LOST", "SCAN REFUSED")),
        # Water.
        course("one wet heartbeat is no leak", at.reviewing, LEAK[0], heartbeat(leak=False), LEAK[0], shown=[]),
        course("a leak lasts", at.safe, heartbeat(leak=False), heartbeat(leak=False), on.ConditionCleared(C.LEAK), BACK, state=S.SAFE,
               codes=[C.LEAK]),
        course("it can be switched off", at.safe, *HOLD_BACK, DOWN, SCAN, effects=[OFF]),
        course("after the save", lambda: run(at.reviewing(), *LEAK), *HOLD_BACK, DOWN, SCAN, state=S.SAFE, effects=[]),
        course("at once then", lambda: run(at.reviewing(), *LEAK), *HOLD_BACK, DOWN, SCAN, SAVED, effects=[OFF]),
        course("stopped in the dark", at.safe, STOP, state=S.SHUTDOWN),
        # A low supply.
        course("without a limit no supply is low", aim, heartbeat(supply_v=3.0), shown=[]),
        course("below its limit it is told and refuses", supplied, heartbeat(supply_v=9.5), SCAN, state=S.AIM,
               shown=[("SUPPLY LOW 9.5V", "SCAN REFUSED")]),
        course("it is borne", aim, LOW, wait(29.0), effects=[]),
        course("for half a minute", aim, LOW, wait(30.0), effects=[do.Wish.DARK, OFF]),
        course("recovered it is forgotten", aim, LOW, on.ConditionCleared(C.SUPPLY_LOW), wait(300.0), state=S.AIM),
        course("and borne as long anew", aim, LOW, wait(20.0), on.ConditionCleared(C.SUPPLY_LOW), LOW, wait(29.9), state=S.AIM),
        course("what is in hand is saved before", at.reviewing, LOW, wait(30.0), state=S.SAVING, effects=[do.Publish(1)]),
        course("what is being saved as well", at.saving, LOW, wait(30.0), state=S.SAVING, effects=[]),
        course("then it is off", at.reviewing, LOW, wait(30.0), SAVED, effects=[OFF]),
        course("too much heat is not borne although a low supply is", aim, LOW, warm(68.0), state=S.SHUTDOWN, among=OFF),
        # Warmth.
        course("warm is told", aim, warm(51.0), shown=[("WARM 51 °C", "LET IT COOL SOON")]),
        course("hot is dark", aim, warm(60.0), state=S.COOLING, effects=[do.Wish.DARK]),
        course("for SCAN as well", hot, SCAN, state=S.COOLING),
        course("a silent sensor changes nothing", hot, heartbeat(), state=S.COOLING),
        course("until three degrees below the limit", hot, warm(57.5), state=S.COOLING),
        course("then it goes on by itself", hot, warm(56.9), state=S.AIM, effects=[LIT]),
        course("whoever leaves it sees dark pictures", hot, BACK, state=S.AIM, effects=[do.GoLive(False, False, NOMINAL)]),
        course("once is enough", hot, BACK, warm(61.5), state=S.AIM),
        course("SCAN leads back", hot, BACK, SCAN, state=S.COOLING),
        course("a scan in hand is decided on before", at.reviewing, warm(61.0), state=S.REVIEW),
        course("it cools after it", at.reviewing, warm(61.0), SCAN, SAVED, state=S.COOLING),
        course("too hot switches off", aim, warm(68.0), state=S.SHUTDOWN, among=OFF),
        course("and keeps what nobody was asked about", at.reviewing, warm(68.0), effects=[do.Wish.DARK, do.Publish(1)]),
        course("before it does", at.reviewing, warm(68.0), SAVED, effects=[OFF]),
        *(course(f"a projector of {c} degrees", aim, warm(20.0, c), codes=found) for c, found in (
            (64.9, []), (65.0, [C.WARM]), (74.9, [C.WARM]), (75.0, [C.HOT, C.WARM]),
        )),
        course("a projector below its last limit", aim, warm(20.0, 84.9), state=S.COOLING),
        course("at it", aim, warm(20.0, 85.0), state=S.SHUTDOWN),
        course("hot and silent", hot, wait(6.0), heartbeat(), state=S.COOLING, codes=[C.HOT, C.WARM, C.TEMPERATURE_UNKNOWN]),
        course("nobody knows better for five minutes", hot, wait(299.9), heartbeat(), state=S.COOLING),
        course("and then it is believed to have cooled", hot, wait(300.0), heartbeat(), state=S.AIM),
        course("a sensor that answers is believed", hot, wait(300.0), heartbeat(), warm(40.0), codes=[]),
        # Light.
        course("light rests three minutes after the latest key", aim, warm(20.0), BACK, wait(179.999), effects=[]),
        course("not a moment later", aim, warm(20.0), BACK, wait(180.0), effects=[DARK]),
        course("half a minute where it is warm", aim, warm(51.0), BACK, wait(29.999), effects=[]),
        course("nor there", aim, warm(51.0), BACK, wait(30.0), effects=[DARK]),
        course("the key that wakes it means what it says", aim, wait(181.0), UP, state=S.MENU),
        course("and it is lit again", aim, wait(181.0), UP, BACK, effects=[LIT]),
        # A stuck key.
        course("a stuck key is told as long as it lasts", aim, KeyStuck(Key.SCAN), codes=[C.KEY_STUCK]),
        course("until it is freed", aim, KeyStuck(Key.SCAN), KeyFreed(Key.SCAN), UP, state=S.MENU, codes=[]),
        course("another key stands in", aim, KeyStuck(Key.SCAN), UP, state=S.ARMED),
        course("of SCAN alone", aim, KeyStuck(Key.BACK), UP, state=S.MENU),
        course("pressed again it is loose", aim, KeyStuck(Key.SCAN), SCAN, stuck=frozenset()),
        # Switching off is asked.
        course("a second hold that was meant for another screen", at.capturing, *HOLD_BACK, *HOLD_BACK, *HOLD_BACK, state=S.AIM),
        course("the press that leaves the question does not ask again", lambda: asked(aim()), *HOLD_BACK, asked=False),
        course("the next one does", lambda: asked(aim()), *HOLD_BACK, *HOLD_BACK, asked=True),
        course("it is asked over a message", at.capturing, on.CaptureFailed(1, at.MISSING), *HOLD_BACK, DOWN, SCAN, effects=[do.Wish.DARK, OFF]),
        course("without an answer for 20 s", lambda: at.about_to_switch_off(aim()), wait(19.9), asked=True),
        course("it stays on", lambda: at.about_to_switch_off(aim()), wait(20.0), state=S.AIM, asked=False),
        course("the start goes on meanwhile", lambda: asked(at.self_testing()), wait(1.0), state=S.AIM, asked=True),
        course("water takes the question away", lambda: asked(aim()), *LEAK, state=S.SAFE, asked=False),
        course("also while it starts", lambda: asked(boot(0)), *LEAK, asked=False),
        course("what BACK held means elsewhere is not asked", at.reviewing, *HOLD_BACK, asked=False),
        course("nor in the menu", at.in_menu, *HOLD_BACK, asked=False),
        course("BACK answers the question and not a message", lambda: asked(aim()), raised(C.UNCALIBRATED), BACK, asked=False, acknowledged=()),
        course("the menu asks the same", lambda: at.in_menu(*(Key.DOWN,) * 9, Key.SCAN), labels=labels(asked(aim()))),
        course("and goes on there", lambda: at.in_menu(*(Key.DOWN,) * 9, Key.SCAN), SCAN, state=S.MENU, menu=at.in_menu(*(Key.DOWN,) * 9).menu),
        course("also by BACK held", lambda: at.in_menu(*(Key.DOWN,) * 9, Key.SCAN), *HOLD_BACK, state=S.MENU),
        course("the stand-in of BACK asks", aim, KeyStuck(Key.BACK), DOWN, DOWN, KeyLongPress(Key.DOWN, 0),
               labels={Key.SCAN: "OK", Key.DOWN: "BACK", Key.UP: "▼"}),
        course("and the other key selects", aim, KeyStuck(Key.BACK), DOWN, DOWN, KeyLongPress(Key.DOWN, 0), UP, SCAN, state=S.SHUTDOWN),
        course("a disk that refuses at the end is tried again", kept_off, *(on.SaveFailed(1, EIO), wait(6.0)) * RETRIES, effects=[do.Publish(1)]),
        course("and does not keep it on", kept_off, *(on.SaveFailed(1, EIO), wait(6.0)) * RETRIES, on.SaveFailed(1, EIO), among=STOPPED),
    ],
)  # fmt: skip
def test_an_instrument_takes_its_course(
    start: Callable[[], Machine], events: tuple[Then, ...], facts: dict[str, object]
) -> None:
    assert seen(start, events, facts) == facts


@pytest.mark.parametrize(
    ("way", "limit_s"),
    [
        (lambda: boot(0), 60.0), (without_a_worker, 45.0), (at.armed, 45.0), (at.capturing, 24 / 60 + 5.0), (at.checking, 60.0),
        (at.reconstructing, 60.0), (at.saving, 60.0), (at.trial_in_work, 60.0),
        (lambda: run(at.calibrating_at(at.RECORDED), SCAN), 300.0), (lambda: run(at.calibrating_at(at.VERIFIED), SCAN), 60.0),
    ],
)  # fmt: skip
def test_what_does_not_answer_is_given_up_at_its_limit(way: Callable[[], Machine], limit_s: float) -> None:
    machine = way()
    waits = run(machine, on.Tick(machine.now_ns + round((limit_s - 0.001) * SECOND_NS)))
    assert (waits.state, waits.calibrating) == (machine.state, machine.calibrating)
    assert waits.deadline_ns is not None
    over = run(machine, on.Tick(machine.now_ns + round(limit_s * SECOND_NS)))
    assert (over.state, over.calibrating, over.parts) != (machine.state, machine.calibrating, machine.parts)
    if machine.state in (S.ARMED, S.CAPTURE):
        assert (codes(over)[0], f"{limit_s:.1f} s" in alerts(over)[0].detail) == (C.CAPTURE_TIMEOUT, True)


def test_a_self_test_has_its_own_time_and_a_part_that_is_busy_late_ten_seconds_more() -> None:
    def passed_by(machine: Machine, *ticks_s: float) -> bool | None:
        found = run(machine, *(on.Tick(round(s * SECOND_NS)) for s in ticks_s)).parts.get(Part.WORKER)
        return None if found is None else found.passed

    slow = run(boot(0), *UPS, *PARTS[:-1], on.Tick(60 * SECOND_NS))
    early = run(without_a_worker(), on.Tick(2 * SECOND_NS), on.PartBusy(Part.WORKER))
    late = run(without_a_worker(), on.Tick(44 * SECOND_NS), on.PartBusy(Part.WORKER))
    for machine, end_s in ((slow, 105.0), (early, 45.0), (late, 54.0), (run(early, on.PartBusy(Part.STORAGE)), 45.0)):
        assert (passed_by(machine, end_s - 1e-9), passed_by(machine, end_s)) == (None, False), end_s


def test_a_sequence_shines_for_its_frames_at_sixty_a_second() -> None:
    for period_px, frames in ((16, 24), (32, 22), (64, 20), (48, 24)):  # of an unknown one the longest
        assert Settings().light_s(period_px) == pytest.approx(frames / 60)
        assert Settings().capture_s(period_px) == pytest.approx(frames / 60 + 5.0)


def test_a_new_machine_is_dark_and_has_a_whole_ration_of_light_and_after_the_end_nothing_is_forced() -> None:
    machine = boot(5)
    assert machine.thermal == Thermal({}, {}, False, 20.0, False)
    assert (machine.now_ns, machine.since_ns, machine.lasers_off_since_ns) == (5, 5, 5)
    assert (machine.captures, machine.retries, machine.leak_votes) == (0, 0, 0)
    assert (machine.scans, machine.last_scan, machine.scans_left) == (0, None, None)
    ended, _ = safety.stop(at.safe(), Ending.POWER_OFF)
    assert ended.state is S.SHUTDOWN
    assert safety.forced(ended) == step(ended, SCAN) == (ended, ())


@pytest.mark.parametrize(
    ("volts", "low"),
    [
        ((10.0,), False), ((9.99,), True), ((10.2,), False), ((9.99, 10.29), True), ((9.99, 10.3), False), ((9.99, 10.31, 10.2), False),
        ((9.99, None), True), ((None,), False),
    ],
)  # fmt: skip
def test_a_low_supply_is_over_only_well_above_the_limit(volts: tuple[float | None, ...], low: bool) -> None:
    machine = supplied()
    for supply_v in volts:
        machine = judge(machine, heartbeat(supply_v=supply_v))
    assert has(machine, C.SUPPLY_LOW) == low


@pytest.mark.parametrize(
    ("heartbeats", "believed"),
    [
        ((True,), False), ((True, True), True), ((True, False, True), False), ((True, None, True), False),
        ((True, True, False, False), True),
    ],
)  # fmt: skip
def test_water_is_believed_when_two_heartbeats_in_a_row_report_it_and_then_for_ever(
    heartbeats: tuple[bool | None, ...], believed: bool
) -> None:
    machine = aim()
    for leak in heartbeats:
        machine = judge(machine, heartbeat(leak=leak))
    assert has(machine, C.LEAK) == has(cleared(machine, C.LEAK), C.LEAK) == believed


@pytest.mark.parametrize(
    ("left", "right", "said"),
    [(True, False, "left laser"), (False, True, "right laser"), (True, True, "left and right")],
)
def test_a_laser_that_conducts_is_reported_a_second_after_it_was_switched_off(
    left: bool, right: bool, said: str
) -> None:
    machine, beat = aim(), heartbeat(left_on=left, right_on=right)
    for since_s, told in ((0.99, False), (1.0, True)):
        found = judge(replace(machine, lasers_off_since_ns=machine.now_ns - int(since_s * SECOND_NS)), beat)
        assert [said in fault.detail for fault in found.conditions if fault.code is C.LASER_ON] == [True] * told
        assert not has(judge(found, heartbeat()), C.LASER_ON)
    assert not has(judge(replace(machine, lasers_off_since_ns=None), beat), C.LASER_ON)


def test_a_device_is_up_or_lost_never_both() -> None:
    down = device_down(aim(), Device.BOARD, "unplugged", None)
    back = device_up(down, Device.BOARD)
    assert (Device.BOARD in down.up, down.lost[Device.BOARD].detail) == (False, "unplugged")
    assert (Device.BOARD in back.up, Device.BOARD in back.lost) == (True, False)


def test_the_time_it_will_still_take_follows_from_how_it_cools() -> None:
    for per_s in (0.1, 0.0):
        machine, case_c = run(aim(), warm(62.0)), 62.0
        assert remaining_s(machine) is None, "nobody knows at first"
        for _ in range(40):
            case_c -= per_s / 2.0
            machine = run(machine, on.Tick(machine.now_ns + SECOND_NS // 2), warm(case_c))
        wanted = pytest.approx((case_c - 57.0) / per_s, rel=0.05) if per_s else None
        assert remaining_s(machine) == wanted, "what does not cool promises nothing"


def test_a_trend_is_remembered_every_five_seconds_and_for_a_minute() -> None:
    machine = aim()
    for k in range(120):
        machine = run(machine, on.Tick(machine.now_ns + SECOND_NS), warm(30.0 + 1e-3 * k))
    times_s = [(time_ns - machine.now_ns) / SECOND_NS for time_ns, _ in machine.thermal.trend["case"]]
    assert all(then - before == pytest.approx(5.0) for before, then in pairwise(times_s))
    assert 12 <= len(times_s) <= 13
    assert -65.0 < times_s[0] <= -55.0


def test_a_straight_line_is_fitted_to_what_was_measured() -> None:
    def line(slope: float, seconds: tuple[float, ...]) -> tuple[tuple[int, float], ...]:
        return tuple((int(7e9 + s * 1e9), 40.0 + slope * s) for s in seconds)

    assert slope_c_per_s(line(-0.05, (0.0, 5.0, 12.0, 30.0))) == pytest.approx(-0.05)
    assert slope_c_per_s(((0, 1.0), (SECOND_NS, 2.0), (2 * SECOND_NS, 6.0))) == pytest.approx(2.5)
    assert slope_c_per_s(line(1.0, (0.0, 5.0))) is None, "two points make any line"
    assert slope_c_per_s(((5, 1.0), (5, 2.0), (5, 3.0))) is None


@pytest.mark.parametrize(
    ("projector_per_s", "celsius", "wanted_s"),
    [(0.02, (63.0, 63.0), 300.0), (0.0019, (63.0, 63.0), None), (0.0021, (66.0,), 3600.0), (0.02, (), None)],
)
def test_the_estimate_is_the_slowest_places_and_never_more_than_an_hour(
    projector_per_s: float, celsius: tuple[float, ...], wanted_s: float | None
) -> None:
    rates = {"projector": projector_per_s, "case": 0.1}
    trend = {place: tuple((int(5e9 * k), 65.0 - per_s * 5 * k) for k in range(8)) for place, per_s in rates.items()}
    hot_places = tuple(
        Fault(C.HOT, "hot", {"temperature_c": c, "below_c": 57.0}, place)
        for c, place in zip(celsius, rates, strict=False)
    )
    machine = replace(aim(), conditions=hot_places, thermal=Thermal(trend=trend))
    assert remaining_s(machine) == (None if wanted_s is None else pytest.approx(wanted_s))


@pytest.mark.parametrize(("code", "limit_c"), [(C.WARM, 50.0), (C.HOT, 60.0)])
def test_a_band_begins_at_its_limit_and_ends_three_degrees_below(code: FaultCode, limit_c: float) -> None:
    ways: tuple[tuple[tuple[float, ...], bool], ...] = (
        ((-0.01,), False), ((0.0,), True), ((0.0, -2.99), True), ((0.0, -3.0), False), ((0.0, -3.0, -0.01), False)
    )  # fmt: skip
    for offs_c, told in ways:
        assert has(run(aim(), *(warm(limit_c + off_c) for off_c in offs_c)), code, "case") == told


def test_a_sensor_may_be_silent_for_five_seconds() -> None:
    for silent_s, told in ((4.9, False), (5.0, True)):
        machine = run(aim(), warm(51.0))
        machine = run(machine, on.Tick(machine.now_ns + round(silent_s * SECOND_NS)), heartbeat())
        assert (C.TEMPERATURE_UNKNOWN in codes(machine)) == told


def unsensed(**thermal: float | bool) -> Machine:
    machine = run(aim(), heartbeat(), on.Tick(7 * SECOND_NS), heartbeat())
    return replace(machine, thermal=replace(machine.thermal, **thermal))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("before_s", "lit", "seconds", "after_s"),
    [
        (20.0, False, 3600.0, 20.0),  # no more than a minute's light is gathered
        (20.0, True, 30.0, 0.0 + 20.0 - 30.0 + 10.0),
        (0.0, False, 15.0, 5.0),
        (9.0, True, 6.0, 5.0),
        (9.0, True, 60.0, 0.0),
        (9.0, True, -1.0, 9.0),  # time does not run backwards
    ],
)
def test_light_gathers_by_a_third_of_the_time_and_is_spent_by_two_thirds(
    before_s: float, lit: bool, seconds: float, after_s: float
) -> None:
    machine = unsensed(ration_s=before_s, is_lit=lit)
    then = replace(machine, now_ns=machine.now_ns + round(seconds * SECOND_NS))
    assert gather_light(then, machine.now_ns).thermal.ration_s == pytest.approx(after_s)
    assert [spend(unsensed(ration_s=9.0), s).thermal.ration_s for s in (2.5, 30.0)] == [6.5, 0.0]


def test_aiming_goes_dark_at_the_reserve_and_is_lit_again_only_with_something_in_hand() -> None:
    def lit(ration_s: float, spent: bool) -> bool:
        machine = unsensed(ration_s=ration_s, spent=spent, is_lit=False)
        return may_aim_lit(gather_light(machine, machine.now_ns))

    assert [lit(s, spent=False) for s in (5.0, 5.1, 7.9)] == [False, True, True]
    assert [lit(s, spent=True) for s in (5.1, 7.9, 8.0)] == [False, False, True]


def test_a_scan_without_light_left_is_refused_with_that_reason() -> None:
    machine = run(unsensed(ration_s=0.1), SCAN)
    assert (machine.state, shown(machine)) == (S.AIM, [("TEMP ?", "SCAN REFUSED")])
    for _ in range(9):
        machine = run(machine, on.Tick(machine.now_ns + SECOND_NS))
    assert run(machine, SCAN).state is S.ARMED


@pytest.mark.parametrize(("seconds", "presses"), [(170, 0), (120, 240)])
def test_without_a_sensor_light_is_rationed_whatever_the_diver_does(seconds: int, presses: int) -> None:
    """Who presses SCAN again and again, 0.1 s a step."""
    machine = unsensed()
    lit, light_s, scans = True, 0.0, 0
    for tick in range(10 * seconds):
        events: list[on.Event] = [on.Tick(machine.now_ns + SECOND_NS // 10)]
        if presses and tick % (10 * seconds // presses) == 0:
            events += [SCAN]
        if machine.state is S.ARMED:
            events += [on.Armed(machine.captures), on.CaptureFinished(machine.captures)]
        if machine.state is S.CHECK:
            events += HOLD_BACK
        machine, effects = after(machine, *events)
        for effect in effects:
            lit = effect.light if isinstance(effect, do.GoLive) else lit and effect is not do.Wish.DARK
            if isinstance(effect, do.Capture):
                light_s, scans = light_s + 24 / 60, scans + 1
        light_s += 0.1 if lit else 0.0
    assert light_s <= RATION_S * (1.0 + seconds / 60.0) + 1.0
    assert light_s > 0.6 * RATION_S * seconds / 60.0, "rationed, not forbidden"
    assert scans >= presses // 3, "aiming leaves light for scans"


@pytest.mark.parametrize("way", [lambda: boot(0), at.self_testing, aim, at.safe])
def test_back_held_asks_stay_on_is_selected_and_the_second_answer_switches_off(way: Callable[[], Machine]) -> None:
    machine, effects = after(way(), *HOLD_BACK)
    assert (machine.state, effects) == (way().state, [])
    assert machine.off_question is not None
    assert machine.off_question.answer is Answer.STAY_ON
    assert labels(machine) == {Key.SCAN: "OK", Key.BACK: "BACK", Key.DOWN: "▼"}
    stays, effects = after(machine, SCAN)
    assert (stays.state, stays.off_question, effects) == (way().state, None, [])
    assert after(machine, DOWN, SCAN)[1][-1] == OFF
