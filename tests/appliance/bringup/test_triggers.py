"""What an armed sequence says about triggers, from counts and times alone."""

from __future__ import annotations

import pytest

from appliance.bringup.finding import Finding
from appliance.bringup.triggers import PULSES, FiredFrames, judge_triggers

PERIOD_NS = 16_666_667.0


def frames(count: int, every: float = 1.0, clock: bool = True) -> FiredFrames:
    return FiredFrames(tuple(round(k * every * PERIOD_NS) + 5 if clock else None for k in range(count)))


def left(one: FiredFrames, pulses: int = PULSES) -> Finding:
    found = {
        finding.name: finding for finding in judge_triggers(pulses, {"left": one, "right": frames(PULSES)}, PERIOD_NS)
    }
    assert found["camera.right"].ok, "each camera is judged by itself"
    return found["camera.left"]


@pytest.mark.parametrize(
    ("seen", "said", "remedy"),
    [
        (frames(0), "does not see its line", "trigger_source"),
        (frames(32, 2.0), "every second trigger is ignored", "TriggerOverlap ReadOut"),
        (frames(31, 2.0), "every second trigger is ignored", "DeviceLinkThroughputLimitMode off"),
        (frames(33, 2.0, clock=False), "every second trigger is ignored", "shorten the exposure"),
        (frames(32), "some triggers are lost", "loose line"),
        (frames(12, 2.0), "some triggers are lost", "loose line"),
        (frames(60), "some triggers are lost", "loose line"),
        (frames(65), "exposes without being asked", "TriggerMode"),
        (FiredFrames((*frames(63).times_ns, round(70 * PERIOD_NS))), "two are 8.00 periods apart", "noise on the line"),
        (FiredFrames(frames(12).times_ns, ("truncated",)), "one arrived truncated", "USB cable"),
    ],
)
def test_each_pattern_of_frames_is_named_with_what_to_do(seen: FiredFrames, said: str, remedy: str) -> None:
    found = left(seen)
    assert not found.ok
    assert said in found.said
    assert remedy in found.remedy


def test_a_frame_a_pulse_is_good_with_and_without_a_clock() -> None:
    assert left(frames(PULSES)).ok
    assert left(frames(PULSES, clock=False)).ok
    assert left(frames(PULSES, 1.05)).ok
    times = list(frames(PULSES).times_ns)
    times[20] = None
    assert left(FiredFrames(tuple(times))).ok, "a stamp that is missing is no frame that came late"


def test_pulses_that_the_board_did_not_fire_are_its_own_fault() -> None:
    found = judge_triggers(12, {"left": frames(12)}, PERIOD_NS)
    assert [one.ok for one in found] == [False, False]
    assert "vertical sync" in found[0].remedy
