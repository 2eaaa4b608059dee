"""What is asked of board, pad and vertical sync, and for how long: on devices that say what the test wants, at a clock of steps."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from appliance.instrument.capture.ledger import SyncError
from appliance.workshop import board as board_module
from appliance.workshop import vsync
from appliance.workshop.pad import _Listener
from drivers import api
from tests.appliance.workshop.scripted import PERIOD_NS, BenchBoard, BenchPad, named, workplace
from tests.drivers.clock import SteppedClock

OFF, LEFT, RIGHT = api.LaserState(False, False), api.LaserState(True, False), api.LaserState(False, True)


def beat(time_us: int, **more: Any) -> api.Telemetry:
    return api.Telemetry(0, time_us, 0, OFF, **more)


@pytest.mark.parametrize(("side", "on"), [("left", LEFT), ("right", RIGHT)])
def test_a_laser_is_read_back_once_its_current_has_settled_and_is_off_at_the_end(side: str, on: api.LaserState) -> None:
    clock = SteppedClock()
    board: Any = BenchBoard(clock)
    board.lag_s = 0.05
    assert board_module._laser(board, side, clock) == (OFF, on, OFF)
    assert board.commands[-1] == ("lasers", False, False)
    board.lag_s = 0.051
    assert board_module._laser(board, side, clock) == (OFF, OFF, on), "one that is slower is not"

    def fail(command: tuple[Any, ...]) -> None:
        if command == ("lasers", side == "left", side == "right"):
            raise api.DeviceGone("board", "unplugged", "")

    board.when = fail
    with pytest.raises(api.DeviceGone):
        board_module._laser(board, side, clock)
    assert board.commands[-1] == ("lasers", False, False), "whatever happens"


@pytest.mark.parametrize(
    ("events", "pressed", "held_s", "took_s"),
    [
        # Half a second after its release; what comes later is another finger's.
        (((1.0, api.KeyPress(api.Key.UP, 0)), (1.2, api.KeyRelease(api.Key.UP, 0, 0.2)), (1.6, api.KeyPress(api.Key.UP, 0)),
          (1.69, api.KeyRelease(api.Key.UP, 0, 0.05)), (9.0, api.KeyPress(api.Key.DOWN, 0))), ("up", "up"), 0.05, (1.7, 2.3)),
        (((1.2, api.KeyRelease(api.Key.UP, 0, 0.2)), (1.96, api.KeyPress(api.Key.UP, 0))), (), 0.2, (1.2, 2.0)),
        # Another key in its place ends the wait, and its time is not the wanted one's.
        (((3.0, api.KeyPress(api.Key.DOWN, 0)), (3.1, api.KeyRelease(api.Key.DOWN, 0, 0.1))), ("down",), None, (3.1, 4.0)),
        # Patience is 45 seconds, and no longer for a late release.
        ((), (), None, (45.0, 45.0)),
        (((44.9, api.KeyRelease(api.Key.UP, 0, 0.1)),), (), 0.1, (44.9, 45.3)),
        # A faulty coil is waited for no longer, another one's is.
        (((1.0, api.KeyStuck(api.Key.UP)),), (), None, (1.0, 1.0)),
        (((1.0, api.KeyStuck(api.Key.DOWN)), (2.0, api.KeysLost("silent"))), (), None, (45.0, 45.0)),
    ],
)  # fmt: skip
def test_a_key_is_heard_until_half_a_second_after_its_release(
    events: tuple[tuple[float, Any], ...], pressed: tuple[str, ...], held_s: float | None, took_s: tuple[float, float]
) -> None:
    clock = SteppedClock()
    pad, listener = BenchPad(clock), _Listener(clock)
    for time_s, event in events:
        pad.events.at_s(time_s, event)
    begun_ns = clock.now_ns()
    tried = listener.hear(pad, api.Key.UP)
    assert (tried.pressed, tried.held_s) == (pressed, held_s)
    assert took_s[0] <= (clock.now_ns() - begun_ns) / 1e9 <= took_s[1]
    assert listener.faulty == {event.key for _, event in events if isinstance(event, api.KeyStuck)}
    assert listener.silences == sum(isinstance(event, api.KeysLost) for _, event in events)


class FlippingProjector:
    """A projector whose flips are the board's own syncs, a vertical blank later each."""

    def __init__(self, clock: SteppedClock) -> None:
        self.clock = clock
        self.shown: list[int] = []

    def load(self, frames: Any) -> None:
        """Take what is shown."""

    def show(self, index: int) -> api.Flip:
        self.shown.append(index)
        blank = int(self.clock.now_ns() / PERIOD_NS) + 1
        self.clock.advance_s((blank * PERIOD_NS + 1e6 - self.clock.now_ns()) / 1e9)
        return api.Flip(index, blank, round(blank * PERIOD_NS))


@pytest.mark.parametrize(("dark_after_s", "seen"), [(0.5, True), (2.6, True), (2.8, False), (None, False)])
def test_syncs_that_end_are_told_by_their_last_one(dark_after_s: float | None, seen: bool) -> None:
    clock = SteppedClock()
    board = BenchBoard(clock)
    begun_ns = clock.now_ns()
    board.dark_from_ns = None if dark_after_s is None else begun_ns + round(dark_after_s * 1e9)
    found_ms = vsync._stop_time_ms(board, clock)
    took_s = (clock.now_ns() - begun_ns) / 1e9
    if seen and dark_after_s is not None:
        assert found_ms == pytest.approx(1000.0 * dark_after_s, abs=17.0)
        assert 0.3 < took_s - (found_ms or 0.0) / 1000.0 < 0.33
        assert len(board.commands) == pytest.approx(100 * took_s, abs=2), "each hundredth of a second"
    else:
        assert found_ms is None
        assert took_s == pytest.approx(3.0, abs=0.011)


def test_syncs_of_three_seconds_are_stamped_once_each_however_often_they_are_asked_for() -> None:
    clock = SteppedClock()
    stamps = vsync._stamps(cast("Any", BenchBoard(clock)), clock, 0.4 * PERIOD_NS / 1e9)
    assert len(stamps) == pytest.approx(3.0 * 60.0, abs=1.5)
    counts, times_us = np.diff(np.array(stamps), axis=0).T
    assert (counts == 1).all()
    assert np.abs(times_us - PERIOD_NS / 1000.0).max() < 1.5


def test_a_flip_is_tried_three_times_until_its_sync_is_found() -> None:
    clock = SteppedClock()
    board, projector = BenchBoard(clock), cast("Any", FlippingProjector(clock))
    board.late_us = dict.fromkeys(range(20), 8_000)
    assert vsync._sync_of_flip(board, projector, PERIOD_NS).count == projector.shown.count(0) + 60
    assert len(projector.shown) == 3
    board.late_us = dict.fromkeys(range(1000), 8_000)
    with pytest.raises(SyncError):
        vsync._sync_of_flip(board, projector, PERIOD_NS)
    assert len(projector.shown) == 6


@pytest.mark.parametrize("lacking", ["first", "last", "both"])
def test_without_the_kernels_count_blanks_are_counted_by_time(lacking: str) -> None:
    first, last = api.Flip(0, 7, 1_000), api.Flip(0, 107, 1_000 + round(50.4 * PERIOD_NS))
    assert vsync._blanks(first, last, PERIOD_NS) == 100
    first = first if lacking == "last" else replace(first, sequence=None)
    last = last if lacking == "first" else replace(last, sequence=None)
    assert vsync._blanks(first, last, PERIOD_NS) == 50


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
    assert (found["sensor.SUPPLY"].said, found["sensor.SUPPLY"].limits) == ("12 V", "11..60 V")
    assert person.said == [board_module.EYES]
    # Nothing lights before it was said.
    assert board.commands[:2] == [("stop",), ("lasers", False, False)]
    board.events.at_s(0.1, api.BoardBooted("1.4", "KF-B", "BROWNOUT"))
    board.counters = SimpleNamespace(lost_reports=2, damaged_lines=3)
    at = replace(at, rig=replace(at.rig, board=replace(at.rig.board, firmware="2.0")))
    found = named(board_module._findings(at, board))
    assert list(found)[:3] == ["firmware", "restarts", "identity"]
    assert not found["restarts"].ok
    assert "2 reports lost, 3 lines damaged" in found["heartbeats"].said
    quiet: Any = BenchBoard(clock)
    assert not named(board_module._findings(at, quiet))["sensor.SUPPLY"].ok
