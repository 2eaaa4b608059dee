"""The lasers' course on live images: seen dark first, read back, heard of, and compared with what was there before."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from appliance.machine import events as on
from appliance.ranging.measure import Dot, Dots
from appliance.scan.fault import FaultCode
from appliance.service.ranging import RangingController, _Measured
from drivers.api import LaserState
from tests.appliance.service.test_shining import BRIGHT, CALIBRATION, POINTERS
from tests.drivers.clock import SteppedClock

NONE = Dots(None, None)
OFF, ON = LaserState(False, False), LaserState(True, True)


def dot(contrast_dn: float, cameras: int = 2) -> Dots:
    """The left pointer's alone."""
    return Dots(Dot((0.0, 0.0, 500.0), 0.1, contrast_dn, cameras), None)


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


@pytest.fixture
def ranging(clock: SteppedClock) -> Iterator[RangingController]:
    with RangingController(POINTERS, CALIBRATION, 1.333, clock, 0.05) as made:
        made.live(True, CALIBRATION, 1.333)
        yield made


def judged(ranging: RangingController, lit: bool, *pairs: Dots) -> list[on.Event]:
    """What is told of pairs that were measured so."""
    return [event for dots in pairs for event in ranging._judge(_Measured(0, lit, dots, None))]


def raised(events: list[on.Event]) -> list[tuple[FaultCode, str | None]]:
    return [(event.fault.code, event.fault.device) for event in events if isinstance(event, on.ConditionRaised)]


def cleared(events: list[on.Event]) -> list[tuple[FaultCode, str | None]]:
    return [(event.code, event.device) for event in events if isinstance(event, on.ConditionCleared)]


def test_lasers_are_wanted_after_two_dark_pairs_and_until_they_are_on(ranging: RangingController) -> None:
    wants = []
    for _ in range(2):
        judged(ranging, False, NONE)
        wants.append(ranging.wants_lasers)
    assert ranging.switched_on(ON) == []
    assert [*wants, ranging.wants_lasers] == [False, True, False]
    ranging.live(False, CALIBRATION, 1.333)
    judged(ranging, False, NONE, NONE)
    assert not ranging.wants_lasers, "nobody asked for them"


def test_a_laser_that_does_not_conduct_is_told_once_and_taken_back(
    ranging: RangingController, clock: SteppedClock
) -> None:
    assert ranging.heard(OFF) == [], "they are off"
    assert raised(ranging.switched_on(LaserState(True, False))) == [(FaultCode.LASER_FAILED, "laser.right")]
    clock.advance_s(0.999_999)
    assert ranging.heard(OFF) == [], "it may be from before they were on"
    clock.advance_s(0.000_001)
    assert raised(ranging.heard(LaserState(False, False))) == [(FaultCode.LASER_FAILED, "laser.left")]
    assert ranging.heard(OFF) == []
    both = [(FaultCode.LASER_FAILED, "laser.left"), (FaultCode.LASER_FAILED, "laser.right")]
    assert cleared(ranging.heard(ON)) == both


@pytest.mark.parametrize(
    ("before_dn", "after_dn", "cameras", "ignored"),
    [
        (15.0, 22.5, 2, True),
        (15.0, 22.6, 2, False),
        (14.9, 15.0, 2, False),
        (40.0, 40.0, 1, False),
    ],
)
def test_a_dot_that_is_no_brighter_with_the_lasers_on_is_a_laser_that_was_on(
    ranging: RangingController, before_dn: float, after_dn: float, cameras: int, ignored: bool
) -> None:
    judged(ranging, False, dot(before_dn, cameras), dot(before_dn, cameras))
    ranging.switched_on(ON)
    assert raised(judged(ranging, True, dot(after_dn, cameras))) == [], "one pair proves nothing"
    told = raised(judged(ranging, True, dot(after_dn, cameras)))
    assert told == ([(FaultCode.LASER_ON, "images")] if ignored else [])
    assert raised(judged(ranging, True, dot(after_dn, cameras))) == [], "asked once in a live view"


def test_only_the_latest_two_dark_pairs_count_and_both_must_agree(ranging: RangingController) -> None:
    judged(ranging, False, dot(40.0), dot(40.0), NONE)
    ranging.switched_on(ON)
    assert raised(judged(ranging, True, dot(40.0), dot(40.0))) == []


@pytest.mark.parametrize(("shining", "gone"), [(dot(15.0), False), (dot(14.9), True), (dot(40.0, 1), True)])
def test_ten_pairs_without_a_dot_show_that_the_laser_went_off(
    ranging: RangingController, shining: Dots, gone: bool
) -> None:
    ranging.live(False, CALIBRATION, 1.333)
    assert cleared(judged(ranging, False, shining, *[NONE] * 8)) == []
    told = cleared(judged(ranging, False, NONE))
    assert told == ([(FaultCode.LASER_ON, "images")] if gone else [])
    assert cleared(judged(ranging, False, NONE)) == ([] if gone else [(FaultCode.LASER_ON, "images")])


def test_while_lasers_may_be_on_dark_pairs_prove_nothing(ranging: RangingController) -> None:
    assert judged(ranging, False, *[NONE] * 12) == []


@pytest.mark.parametrize(("live_s", "settle_s", "pair_s"), [(0.05, 0.2, 0.05), (0.2, 0.4, 0.1)])
def test_a_pair_is_of_one_moment_and_from_after_the_light_settled(
    live_s: float, settle_s: float, pair_s: float
) -> None:
    def taken(first_s: float, apart_s: float) -> bool:
        clock = SteppedClock()
        with RangingController(POINTERS, CALIBRATION, 1.333, clock, live_s) as ranging:
            ranging.live(True, CALIBRATION, 1.333)
            clock.advance_s(first_s)
            ranging.see("left", BRIGHT["left"])
            clock.advance_s(apart_s)
            ranging.see("right", BRIGHT["right"])
            return ranging._work is not None

    assert not taken(settle_s - 1e-6, 0.0)
    assert taken(settle_s, pair_s)
    assert not taken(settle_s, pair_s + 1e-6)


def test_a_rig_without_lasers_measures_nothing(clock: SteppedClock) -> None:
    with RangingController(None, CALIBRATION, 1.333, clock, 0.05) as ranging:
        ranging.live(True, CALIBRATION, 1.333)
        clock.advance_s(1.0)
        for side, image in BRIGHT.items():
            ranging.see(side, image)
        assert ranging._work is None
        assert ranging.shining(BRIGHT, {}) is None
        judged(ranging, False, NONE, NONE)
        assert not ranging.wants_lasers
