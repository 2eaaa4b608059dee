"""What is asked of board, pad and vertical sync, and for how long: on devices that say what the test wants, at a clock of steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from appliance.bringup.finding import Finding
from appliance.bringup.vsync_check import FLIPS
from appliance.capture.sync import SyncError
from appliance.service.bringup import board as board_module
from appliance.service.bringup import pad as pad_module
from appliance.service.bringup import vsync
from appliance.service.bringup.pad import _Listener
from appliance.service.bringup.workplace import refusal
from drivers.api import (
    BoardBooted,
    DeviceGone,
    Flip,
    Key,
    KeyPress,
    KeyRelease,
    KeysLost,
    KeyStuck,
    LaserState,
    Telemetry,
)
from drivers.board.board import BoardRefused
from tests.appliance.service.bringup.scripted import (
    PERIOD_NS,
    BenchBoard,
    BenchPad,
    workplace,
)
from tests.drivers.clock import SteppedClock

OFF, LEFT, RIGHT = LaserState(False, False), LaserState(True, False), LaserState(False, True)


def beat(time_us: int, **more: Any) -> Telemetry:
    return Telemetry(0, time_us, 0, OFF, **more)


# ------------------------------------------------------------------------------------------ board


@pytest.mark.parametrize(("side", "on"), [("left", LEFT), ("right", RIGHT)])
def test_a_laser_is_read_back_once_its_current_has_settled_and_is_off_at_the_end(side: str, on: LaserState) -> None:
    clock = SteppedClock()
    board = BenchBoard(clock)
    board.lag_s = 0.05
    assert board_module._laser(board, side, clock) == (OFF, on, OFF)  # type: ignore[arg-type]
    assert board.commands[-1] == ("lasers", False, False)
    board.lag_s = 0.051
    assert board_module._laser(board, side, clock) == (OFF, OFF, on), "one that is slower is not"  # type: ignore[arg-type]


def test_a_laser_is_switched_off_whatever_happens() -> None:
    clock = SteppedClock()
    board = BenchBoard(clock)

    def fail(command: tuple[Any, ...]) -> None:
        if command == ("lasers", True, False):
            raise DeviceGone("board", "unplugged", "")

    board.when = fail
    with pytest.raises(DeviceGone):
        board_module._laser(board, "left", clock)  # type: ignore[arg-type]
    assert board.commands[-1] == ("lasers", False, False)


def test_a_board_is_listened_to_for_twenty_seconds_and_its_clock_is_asked_now_and_then() -> None:
    at, _, told = workplace()
    clock: Any = at.wires.clock
    board = BenchBoard(clock)
    for k in range(1, 60):
        board.events.at_s(0.5 * k, beat(500_000 * k, supply_v=12.0 + k))
    begun_ns = clock.now_ns()
    beats, readings, boots, last = board_module._listened(board, at)  # type: ignore[arg-type]
    assert (clock.now_ns() - begun_ns) / 1e9 == pytest.approx(20.0, abs=0.11)
    assert beats == [500_000 * k for k in range(1, len(beats) + 1)]
    assert len(beats) in (39, 40)
    assert last is not None
    assert last.supply_v == 12.0 + len(beats)
    assert boots == []
    sent_s = [(one.host_sent_ns - begun_ns) / 1e9 for one in readings]
    assert sent_s[0] == 0.0
    steps = [b - a for a, b in pairwise(sent_s)]
    assert 0.4 < min(steps) <= max(steps) <= 0.6
    assert sent_s[-1] > 19.0
    assert told.all[0] == ("listening to the board", 0.0)
    assert told.all[-1][1] == pytest.approx(0.99, abs=0.01)


def test_a_quiet_board_is_asked_each_tenth_of_a_second() -> None:
    at, _, told = workplace()
    beats, _, _, last = board_module._listened(BenchBoard(at.wires.clock), at)  # type: ignore[arg-type]
    assert (beats, last) == ([], None)
    assert len(told.all) == 200


def test_a_restart_is_told_and_what_was_heard_before_it_is_forgotten() -> None:
    at, _, _ = workplace()
    clock: Any = at.wires.clock
    board = BenchBoard(clock)
    begun_ns = clock.now_ns()
    for k in (1, 2):
        board.events.at_s(0.5 * k, beat(900_000_000 + k))
    board.events.at_s(10.0, BoardBooted("1.4", "KF-B", "BROWNOUT"))
    board.events.at_s(10.5, beat(500_000))
    beats, readings, boots, _ = board_module._listened(board, at)  # type: ignore[arg-type]
    assert (beats, boots) == ([500_000], ["BROWNOUT"])
    assert readings[0].host_sent_ns - begun_ns >= 10e9


def test_each_sensor_is_the_heartbeats_own() -> None:
    last = beat(
        0, temperature_projector_c=1.0, temperature_case_c=2.0, temperature_board_c=3.0, leak=True, humidity_percent=4.0,
        supply_v=5.0,
    )  # fmt: skip
    wanted = {"TPROJ": 1.0, "TCASE": 2.0, "TBOARD": 3.0, "LEAK": 1.0, "HUM": 4.0, "SUPPLY": 5.0}
    assert board_module._sensors(last) == wanted
    assert board_module._sensors(beat(0)) == dict.fromkeys(wanted)


def test_a_firmware_that_the_rig_file_does_not_want_is_told() -> None:
    at, _, _ = workplace()
    assert board_module._firmware(at, "1.4") == []
    for wanted, told in (("1.4", []), ("1.5", ["firmware 1.4; the rig file wants 1.5"])):
        other = replace(at, rig=replace(at.rig, board=replace(at.rig.board, firmware=wanted)))
        found = board_module._firmware(other, "1.4")
        assert [one.said for one in found] == told
        assert not any(one.ok for one in found)


def test_a_device_that_is_not_there_is_a_finding() -> None:
    found = refusal(DeviceGone("board", "no such port", "Check the cable"))
    assert (found.name, found.ok, found.said, found.remedy) == ("board", False, "no such port", "Check the cable")


# -------------------------------------------------------------------------------------------- pad


def heard(*events: tuple[float, Any], wanted: Key = Key.UP) -> tuple[Any, _Listener, float]:
    """What a listener makes of events at their times, itself, and how long it took."""
    clock = SteppedClock()
    pad, listener = BenchPad(clock), _Listener(clock)
    for time_s, event in events:
        pad.events.at_s(time_s, event)
    begun_ns = clock.now_ns()
    return listener.hear(pad, wanted), listener, (clock.now_ns() - begun_ns) / 1e9


def test_a_key_is_heard_until_half_a_second_after_its_release() -> None:
    tried, _, took_s = heard(
        (1.0, KeyPress(Key.UP, 0)), (1.2, KeyRelease(Key.UP, 0, 0.2)), (1.6, KeyPress(Key.UP, 0)),
        (1.69, KeyRelease(Key.UP, 0, 0.05)), (9.0, KeyPress(Key.DOWN, 0)),
    )  # fmt: skip
    assert (tried.key, tried.pressed, tried.released, tried.held_s) == ("up", ("up", "up"), ("up", "up"), 0.05)
    assert 1.7 <= took_s < 2.0
    tried, _, _ = heard((1.2, KeyRelease(Key.UP, 0, 0.2)), (1.96, KeyPress(Key.UP, 0)))
    assert tried.pressed == (), "what comes later is another finger's"


def test_another_key_in_its_place_ends_the_wait_and_its_time_is_not_the_wanted_ones() -> None:
    tried, _, took_s = heard((3.0, KeyPress(Key.DOWN, 0)), (3.1, KeyRelease(Key.DOWN, 0, 0.1)))
    assert (tried.pressed, tried.released, tried.held_s) == (("down",), ("down",), None)
    assert took_s < 4.0


def test_patience_is_45_seconds() -> None:
    assert heard()[2] == 45.0
    assert heard((44.9, KeyPress(Key.UP, 0)))[0].pressed == ("up",)
    assert heard((44.9, KeyRelease(Key.UP, 0, 0.1)))[2] < 45.3, "a late release does not make it longer"


def test_a_faulty_coil_is_kept_and_waited_for_no_longer() -> None:
    _, listener, took_s = heard((1.0, KeyStuck(Key.UP)))
    assert listener.faulty == {Key.UP}
    assert took_s == 1.0
    _, listener, took_s = heard((1.0, KeyStuck(Key.DOWN)), (2.0, KeysLost("silent")))
    assert (listener.faulty, listener.silences, took_s) == ({Key.DOWN}, 1, 45.0)


# ------------------------------------------------------------------------------------------ vsync


class FlippingProjector:
    """A projector whose flips are the board's own syncs, a vertical blank later each."""

    def __init__(self, clock: SteppedClock) -> None:
        self.clock = clock
        self.shown: list[int] = []
        self.loaded: list[Any] = []
        self.away_ns = 0

    def load(self, frames: Any) -> None:
        self.loaded.append(frames)

    def show(self, index: int) -> Flip:
        self.shown.append(index)
        blank = int(self.clock.now_ns() / PERIOD_NS) + 1
        self.clock.advance_s((blank * PERIOD_NS + 1e6 - self.clock.now_ns()) / 1e9)
        return Flip(index, blank, round(blank * PERIOD_NS) + self.away_ns)


def synced() -> tuple[SteppedClock, BenchBoard, Any]:
    clock = SteppedClock()
    return clock, BenchBoard(clock), FlippingProjector(clock)


def test_syncs_are_stamped_for_three_seconds_each_once() -> None:
    clock, board, _ = synced()
    begun_ns = clock.now_ns()
    stamps = vsync._stamps(board, clock, 0.4 * PERIOD_NS / 1e9)
    assert (clock.now_ns() - begun_ns) / 1e9 == pytest.approx(3.0, abs=0.01)
    assert [number for number, _ in stamps] == list(range(60, 240))
    assert {b[1] - a[1] for a, b in pairwise(stamps)} == {16_666, 16_667}


def refusing(code: int) -> Callable[[tuple[Any, ...]], None]:
    def refuse(command: tuple[Any, ...]) -> None:
        if command == ("vsync",):
            raise BoardRefused("board", "no", "", code)

    return refuse


def test_a_board_without_syncs_has_no_stamps_and_any_other_refusal_is_one() -> None:
    clock, board, _ = synced()
    board.when = refusing(4)
    assert vsync._stamps(board, clock, 0.1) == []
    begun_ns = clock.now_ns()
    assert vsync._stopped(board, clock) == 0.0
    assert clock.now_ns() == begun_ns, "no sync is an end at once"
    board.when = refusing(3)
    with pytest.raises(BoardRefused):
        vsync._stamps(board, clock, 0.1)


@pytest.mark.parametrize(("dark_after_s", "seen"), [(0.5, True), (2.6, True), (2.8, False), (None, False)])
def test_syncs_that_end_are_told_by_their_last_one(dark_after_s: float | None, seen: bool) -> None:
    clock, board, _ = synced()
    begun_ns = clock.now_ns()
    board.dark_from_ns = None if dark_after_s is None else begun_ns + round(dark_after_s * 1e9)
    found_ms = vsync._stopped(board, clock)
    took_s = (clock.now_ns() - begun_ns) / 1e9
    if seen and dark_after_s is not None:
        assert found_ms == pytest.approx(1000.0 * dark_after_s, abs=17.0)
        assert 0.3 < took_s - (found_ms or 0.0) / 1000.0 < 0.33
        assert len(board.commands) == pytest.approx(100 * took_s, abs=2), "each hundredth of a second"
    else:
        assert found_ms is None
        assert took_s == pytest.approx(3.0, abs=0.011)


def test_a_flip_is_tried_three_times_until_its_sync_is_found() -> None:
    _, board, projector = synced()
    board.late_us = dict.fromkeys(range(20), 8_000)
    assert vsync._matched(board, projector, PERIOD_NS).count == projector.shown.count(0) + 60
    assert len(projector.shown) == 3
    board.late_us = dict.fromkeys(range(1000), 8_000)
    with pytest.raises(SyncError):
        vsync._matched(board, projector, PERIOD_NS)
    assert len(projector.shown) == 6


def test_six_hundred_flips_are_counted() -> None:
    at, _, told = workplace()
    clock: Any = at.wires.clock
    projector: Any = FlippingProjector(clock)
    first, last = vsync._counted(BenchBoard(clock), projector, at, PERIOD_NS)
    assert last.count - first.count == FLIPS == 600
    assert vsync._blanks(first.flip, last.flip, PERIOD_NS) == 600
    assert set(projector.shown) == {0, 1}
    assert all(a != b for a, b in pairwise(projector.shown[1:-1])), "each is another picture"
    assert told.all == [("flips", k / 600.0) for k in range(0, 600, 60)]


@pytest.mark.parametrize("lacking", ["first", "last", "both"])
def test_without_the_kernels_count_blanks_are_counted_by_time(lacking: str) -> None:
    first, last = Flip(0, 7, 1_000), Flip(0, 107, 1_000 + round(50.4 * PERIOD_NS))
    assert vsync._blanks(first, last, PERIOD_NS) == 100
    first = first if lacking == "last" else replace(first, sequence=None)
    last = last if lacking == "first" else replace(last, sequence=None)
    assert vsync._blanks(first, last, PERIOD_NS) == 50


# ------------------------------------------------------------------------------------ whole steps


def named(findings: tuple[Finding, ...]) -> dict[str, Finding]:
    return {one.name: one for one in findings}


def test_a_good_board_is_good_in_everything_and_what_is_not_is_told_first() -> None:
    clock = SteppedClock()
    at, person, _ = workplace(clock)
    at = replace(at, rig=replace(at.rig, limits=replace(at.rig.limits, supply_low_v=11.0)))
    board: Any = BenchBoard(clock)
    for k in range(1, 60):
        board.events.at_s(0.5 * k, beat(500_000 * k, supply_v=12.0))
    found = named(board_module._findings(at, board))
    assert all(one.ok for one in found.values()), found
    assert list(found)[:5] == ["identity", "heartbeats", "clock", "laser.left", "laser.right"]
    assert found["identity"].said == "board KF-B-1, firmware 1.4"
    assert found["sensor.SUPPLY"].said == "12 V"
    assert found["sensor.SUPPLY"].limits == "11..60 V"
    assert person.said == [board_module.EYES]
    # Nothing lights before it was said.
    assert board.commands[:2] == [("stop",), ("lasers", False, False)]
    board.events.at_s(0.1, BoardBooted("1.4", "KF-B", "BROWNOUT"))
    board.counters = SimpleNamespace(lost_reports=2, damaged_lines=3)
    at = replace(at, rig=replace(at.rig, board=replace(at.rig.board, firmware="2.0")))
    found = named(board_module._findings(at, board))
    assert list(found)[:3] == ["firmware", "restarts", "identity"]
    assert "BROWNOUT" in found["restarts"].said
    assert not found["restarts"].ok
    assert "2 reports lost, 3 lines damaged" in found["heartbeats"].said
    quiet: Any = BenchBoard(clock)
    assert "does not answer" in named(board_module._findings(at, quiet))["sensor.SUPPLY"].said


def test_each_key_is_asked_for_by_its_name_until_it_is_heard_or_faulty() -> None:
    at, person, _ = workplace()
    clock: Any = at.wires.clock
    pad: Any = BenchPad(clock)

    def press(what: str) -> None:
        key = Key(what.split()[1].lower())
        if key is Key.DOWN:
            pad.events.at_s(1.0, KeyStuck(key))
        elif (key is Key.BACK and "3 of 3" in what) or key in (Key.SCAN, Key.UP):
            pad.events.at_s(1.0, KeyPress(key, 0))
            pad.events.at_s(1.2, KeyRelease(key, 0, 0.2))

    person.hand = press
    found = named(pad_module._findings(at, pad))
    assert {name for name, one in found.items() if not one.ok} == {"key.down", "coils", "reports"}
    assert "1 reports lost, 2 garbled, silent 0 times" in found["reports"].said
    assert person.said == [
        "press SCAN once and let it go",
        "press BACK once and let it go",
        "press BACK once and let it go (asked again, 2 of 3: it was not seen)",
        "press BACK once and let it go (asked again, 3 of 3: it was not seen)",
        "press UP once and let it go",
        "press DOWN once and let it go",
    ]


class OneOutput:
    """A projector's output, after which the board sees no more."""

    def __init__(self, board: BenchBoard, projector: FlippingProjector) -> None:
        self.board, self.projector = board, projector

    def open_projector(self) -> FlippingProjector:
        return self.projector

    def close_projector(self) -> None:
        self.board.dark_from_ns = self.board.clock.now_ns() + 25_000_000


def tapped(prepare: Callable[[BenchBoard, FlippingProjector], None]) -> tuple[dict[str, Finding], Any]:
    at, _, _ = workplace()
    clock: Any = at.wires.clock
    board, projector = BenchBoard(clock), FlippingProjector(clock)
    prepare(board, projector)
    outputs: Any = OneOutput(board, projector)
    begun_ns = clock.now_ns()
    found = named(vsync._findings(at, board, outputs))
    board.commands.insert(0, (clock.now_ns() - begun_ns,))
    return found, outputs


def test_the_tap_of_a_good_projector_counts_every_blank_and_ends_with_the_picture() -> None:
    begun_ns = SteppedClock().now_ns()
    found, outputs = tapped(lambda _board, projector: setattr(projector, "away_ns", 300_000))
    assert all(one.ok for one in found.values()), found
    assert "600 syncs in 600 blanks" in found["count"].said
    assert found["edge"].numbers["phase_us"] == pytest.approx(-300.0, abs=1.0)
    assert found["stop"].numbers["stopped_after_ms"] == pytest.approx(17.0, abs=10.0)
    ((loaded,),) = (outputs.projector.loaded,)
    assert [one.shape for one in loaded] == [(768, 1024)] * 2
    assert not any(one.any() for one in loaded)
    # A splitter is given two seconds before the first stamp counts.
    assert outputs.board.first_asked_ns - begun_ns == pytest.approx(2.0e9, abs=20e6)
    assert outputs.board.commands[1] == ("stop",)


def test_a_board_that_sees_nothing_leads_to_the_tap_and_one_that_sees_another_picture_to_the_converter() -> None:
    found, _ = tapped(lambda board, _: setattr(board, "when", refusing(4)))
    assert list(found) == ["rate", "jitter"]
    assert not found["rate"].ok
    # 8 ms after the flips, all of them.
    found, _ = tapped(lambda _, projector: setattr(projector, "away_ns", 8_000_000))
    assert list(found) == ["rate", "jitter", "count"]
    assert found["rate"].ok
    assert not found["count"].ok
    assert "converter" in found["count"].remedy


def test_a_count_of_32_bits_goes_round_between_the_flips() -> None:
    found, _ = tapped(lambda board, _: setattr(board, "first", (1 << 32) - 600))
    assert "600 syncs in 600 blanks" in found["count"].said
