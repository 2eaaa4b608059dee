"""The lasers' course on live images: seen dark first, read back, heard of, and compared with what was there before."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.machine import events as on
from appliance.instrument.ranging.beams import PointerBeam, Pointers, RigFrame
from appliance.instrument.ranging.ranger import Dot, Dots
from appliance.instrument.service.ranging import RangingController, _Measurement
from appliance.instrument.service.remembered import BeamsFile
from appliance.measure.fault import FaultCode
from drivers.api import LaserState
from drivers.native import MonotonicClock
from hw_sim.truth import draw_truth
from tests.drivers.clock import SteppedClock
from tests.support.truth import true_calibration

POINTERS = Pointers((150.0, 0.0, 0.0), (0.0, 0.0, 520.0), 0.5)
CALIBRATION = true_calibration(draw_truth("modelled", 1, 400, 300, 1.333))
DARK = {side: np.full((300, 400), 4, np.uint8) for side in ("left", "right")}
BRIGHT = {side: np.full((300, 400), 90, np.uint8) for side in ("left", "right")}
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
    return [event for dots in pairs for event in ranging._judge(_Measurement(0, lit, dots, None))]


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
    assert cleared(ranging.heard(ON)) == [(FaultCode.LASER_FAILED, f"laser.{side}") for side in ("left", "right")]


@pytest.mark.parametrize(
    ("before_dn", "after_dn", "cameras", "ignored"),
    [(15.0, 22.5, 2, True), (15.0, 22.6, 2, False), (14.9, 15.0, 2, False), (40.0, 40.0, 1, False)],
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


@pytest.mark.parametrize(("shining", "gone"), [(dot(15.0), False), (dot(14.9), True), (dot(40.0, 1), True)])
def test_ten_pairs_without_a_dot_show_that_the_laser_went_off(
    ranging: RangingController, shining: Dots, gone: bool
) -> None:
    ranging.live(False, CALIBRATION, 1.333)
    assert cleared(judged(ranging, False, shining, *[NONE] * 8)) == []
    told = cleared(judged(ranging, False, NONE))
    assert told == ([(FaultCode.LASER_ON, "images")] if gone else [])
    assert cleared(judged(ranging, False, NONE)) == ([] if gone else [(FaultCode.LASER_ON, "images")])


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


class SilentBeams(BeamsFile):
    """Beams on a disk that does not answer before it is told to."""

    def __init__(self, root: Path) -> None:
        super().__init__(root, POINTERS)
        self.answers = threading.Event()

    def read(self, calibration_hash: str) -> tuple[PointerBeam, PointerBeam]:
        assert self.answers.wait(60.0)
        return super().read(calibration_hash)


def test_a_disk_that_does_not_answer_ends_neither_scan_nor_service(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    memory = SilentBeams(tmp_path)
    with RangingController(POINTERS, CALIBRATION, 1.333, MonotonicClock(), 0.1, memory) as ranging:
        assert ranging.shining(BRIGHT, DARK) is None
        assert "search for laser dots in the dark frame: no answer within 3 s" in caplog.text
        memory.answers.set()


def test_a_distance_of_more_than_a_second_ago_is_shown_no_longer(
    ranging: RangingController, clock: SteppedClock
) -> None:
    def until(enough: Callable[[], object], images: dict[str, NDArray[np.uint8]] | None = None) -> None:
        end_s = time.monotonic() + 20.0
        while not enough():
            assert time.monotonic() < end_s
            for side, image in (images or {}).items():
                ranging.see(side, image)
            time.sleep(0.02)

    clock.advance_s(1.0)
    until(lambda: ranging.poll() is not None and ranging.wants_lasers, BRIGHT)
    ranging.switched_on(ON)
    clock.advance_s(1.0)
    for side, image in _with_a_dot().items():
        ranging.see(side, image)
    told: list[on.Event] = []
    until(lambda: told.extend(ranging.poll()) or told)  # type: ignore[func-returns-value]
    (shown,) = told
    assert isinstance(shown, on.RangeMeasured)
    assert shown.range is not None
    clock.advance_s(1.0)
    assert ranging.poll() == []
    clock.advance_s(1e-9)
    assert ranging.poll() == [on.RangeMeasured(None)]


def _with_a_dot() -> dict[str, NDArray[np.uint8]]:
    """Images of both cameras with the left pointer's dot on something 430 mm away."""
    v, u = np.mgrid[:300, :400]
    rig, found = CALIBRATION.rig, {}
    place = RigFrame.of(rig).to_left(POINTERS.beams()[0].at(np.array(430.0)))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        at_u, at_v = camera.project(place, 1.333).tolist()
        dot = 120.0 * np.exp(-((u - at_u) ** 2 + (v - at_v) ** 2) / (2.0 * 1.5**2))
        found[side] = (BRIGHT[side] + dot).astype(np.uint8)
    return found
