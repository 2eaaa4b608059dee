"""What a key does, and what it must not do while something else is under way."""

from __future__ import annotations

from itertools import pairwise

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.states import Machine, State, boot
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.walks import (
    RECORDED,
    SECOND_NS,
    SUMMARY,
    after,
    aim,
    calibrating_at,
    heartbeat,
    reconstructing,
    reviewing,
    run,
)

LEAK = (heartbeat(leak=True), heartbeat(leak=True))


def test_while_an_adjustment_is_solved_only_back_does_something() -> None:
    solving, effects = after(calibrating_at(RECORDED), on.KeyPressed(Key.SCAN))
    assert do.SolveCalibration() in effects
    assert solving.calibrating is not None
    for key in (Key.UP, Key.DOWN, Key.SCAN):
        assert after(solving, on.KeyPressed(key)) == (solving, []), key
    assert run(solving, on.KeyPressed(Key.BACK)).state is State.AIM


def test_in_safe_a_save_that_the_disk_refused_is_tried_again_by_scan_and_one_under_way_is_not_begun_twice() -> None:
    machine = run(reconstructing(), *LEAK)
    assert machine.state is State.SAFE
    assert after(machine, on.KeyPressed(Key.SCAN))[1] == [], "its cloud is still awaited"
    machine, effects = after(machine, on.CoarseReady(1, SUMMARY), on.FullReady(1, SUMMARY))
    assert effects == [do.Publish(1)]
    assert after(machine, on.KeyPressed(Key.SCAN)) == (machine, [])
    machine = run(machine, on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO")))
    _, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.Publish(1)]


def test_up_turns_the_cloud_and_down_never_does() -> None:
    def turn(*keys: Key) -> int:
        machine = run(reviewing(), *(on.KeyPressed(key) for key in keys))
        assert machine.scan is not None
        return machine.scan.turn

    assert turn() == 0
    assert turn(Key.UP) == 1
    assert turn(Key.UP, Key.UP) == 2
    assert turn(Key.DOWN) == 0
    assert turn(Key.UP, Key.DOWN) == 1


def test_before_anything_was_counted_there_is_no_scan() -> None:
    assert (boot(0).scans, boot(0).last_scan, boot(0).scans_left) == (0, None, None)


@pytest.mark.parametrize("step_s", [0.5, 1.0])
def test_a_trend_is_remembered_every_five_seconds_and_for_a_minute(step_s: float) -> None:
    machine: Machine = aim()
    for k in range(int(120 / step_s)):
        machine = run(
            machine, on.Tick(machine.now_ns + int(step_s * SECOND_NS)), heartbeat(temperature_case_c=30.0 + 1e-3 * k)
        )
    times_s = [(time_ns - machine.now_ns) / SECOND_NS for time_ns, _ in machine.thermal.trend["case"]]
    assert all(later - earlier == pytest.approx(5.0) for earlier, later in pairwise(times_s))
    assert 12 <= len(times_s) <= 13
    assert -65.0 < times_s[0] <= -55.0
