"""Warnings of the live views: they come with the third image that says so, go with the third that does not, and with the view."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.config import load_rig
from appliance.instrument import design_of, drawn_light_of
from appliance.machine import events as on
from appliance.scan.fault import FaultCode
from appliance.service.aiming import DEVICE, AimingController
from drivers.native import MonotonicClock
from tests.appliance.capture.test_aiming import BLACK_DN, picture

RIG = load_rig(Path("hw_sim/rigs/small.toml"))
CALIBRATION, LIGHT = design_of(RIG), drawn_light_of(RIG)
EVEN = replace(LIGHT, codes=np.full_like(LIGHT.codes, 255))
"""Light without dark lanes, as of a rig without lasers."""
BRIGHT, DARK = picture(100.0), picture(0.0)


class At:
    """A clock that stands where it is put."""

    def __init__(self) -> None:
        self.ns = 0

    def now_ns(self) -> int:
        return self.ns

    def sleep_s(self, duration_s: float) -> None:
        self.ns += round(1e9 * duration_s)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        raise AssertionError("live images are judged without waiting")


@pytest.fixture
def desk() -> Iterator[tuple[AimingController, At]]:
    clock = At()
    with AimingController(clock, 0.1, BLACK_DN, EVEN) as made:
        assert made.live(True, CALIBRATION, 1.333) == []
        clock.ns = 1_000_000_000
        yield made, clock


def seen(desk: AimingController, number: int, image: NDArray[np.uint8]) -> list[on.Event]:
    """What is told once the image was looked at."""
    desk.see("left", number, image)
    until = MonotonicClock().now_ns() + 10_000_000_000
    while desk.busy:
        assert MonotonicClock().now_ns() < until
        time.sleep(0.001)
    return desk.poll()


def raised(events: list[on.Event]) -> list[FaultCode]:
    return [event.fault.code for event in events if isinstance(event, on.ConditionRaised)]


def cleared(events: list[on.Event]) -> list[FaultCode]:
    return [event.code for event in events if isinstance(event, on.ConditionCleared)]


def test_a_warning_needs_three_images_and_so_does_its_end(desk: tuple[AimingController, At]) -> None:
    aiming, _ = desk
    told = [raised(seen(aiming, number, DARK)) for number in range(1, 4)]
    assert told == [[], [], [FaultCode.AIM_DARK]]
    gone = [cleared(seen(aiming, number, BRIGHT)) for number in range(4, 8)]
    assert gone == [[], [], [FaultCode.AIM_DARK], []]
    assert [raised(seen(aiming, number, DARK)) for number in range(8, 12)] == [[], [], [FaultCode.AIM_DARK], []]


def test_one_dark_image_among_bright_ones_is_no_warning(desk: tuple[AimingController, At]) -> None:
    aiming, _ = desk
    images = [DARK, DARK, BRIGHT, DARK, DARK, BRIGHT]
    assert [seen(aiming, number, image) for number, image in enumerate(images, 1)] == [[]] * len(images)


def test_a_warning_ends_with_the_live_view_and_names_its_witness(desk: tuple[AimingController, At]) -> None:
    aiming, _ = desk
    events = [event for number in range(1, 4) for event in seen(aiming, number, DARK)]
    assert [event.fault.device for event in events if isinstance(event, on.ConditionRaised)] == [DEVICE]
    assert aiming.stop() == [on.ConditionCleared(FaultCode.AIM_DARK, DEVICE)]
    assert aiming.stop() == []


def test_without_the_projectors_light_and_before_it_settled_nothing_is_judged() -> None:
    clock = At()
    with AimingController(clock, 0.1, BLACK_DN, EVEN) as aiming:
        aiming.live(True, CALIBRATION, 1.333)
        assert [raised(seen(aiming, number, DARK)) for number in range(1, 5)] == [[]] * 4
        aiming.live(False, CALIBRATION, 1.333)
        clock.ns = 1_000_000_000
        assert [raised(seen(aiming, number, DARK)) for number in range(5, 9)] == [[]] * 4


@pytest.mark.parametrize(("step_px", "expected"), [(6.0, []), (18.0, [FaultCode.AIM_FAST])])
def test_hands_that_a_scan_cannot_follow_are_warned_of(
    desk: tuple[AimingController, At], step_px: float, expected: list[FaultCode]
) -> None:
    """A px of 400 is 0.64 mm in the middle of the volume: 10 images a second move by 38 and by 115 mm/s."""
    aiming, _ = desk
    images = [picture(100.0, shift_px=(step_px * (number % 2), 0.0), seed=number) for number in range(5)]
    assert [code for number, image in enumerate(images, 1) for code in raised(seen(aiming, number, image))] == expected


@pytest.mark.parametrize(("live_s", "settle_ns"), [(0.05, 300_000_000), (0.2, 600_000_000)])
def test_images_count_from_three_tenths_of_a_second_or_three_images_on(live_s: float, settle_ns: int) -> None:
    clock = At()
    with AimingController(clock, live_s, BLACK_DN, EVEN) as aiming:
        aiming.live(True, CALIBRATION, 1.333)
        for clock.ns, counts in ((settle_ns - 1, False), (settle_ns, True)):
            aiming.see("right", 1, DARK)
            assert not aiming.busy, "the left camera alone"
            told = [code for number in range(1, 4) for code in raised(seen(aiming, number, DARK))]
            assert told == ([FaultCode.AIM_DARK] if counts else [])


@pytest.mark.parametrize(("apart", "expected"), [(3, [FaultCode.AIM_FAST]), (4, [])])
def test_motion_is_told_from_images_with_two_missing_between_and_no_more(
    desk: tuple[AimingController, At], apart: int, expected: list[FaultCode]
) -> None:
    aiming, _ = desk
    images = [picture(100.0, shift_px=(40.0 * (number % 2), 0.0), seed=number) for number in range(5)]
    numbers = range(20, 20 + 5 * apart, apart)
    told = [code for number, image in zip(numbers, images, strict=True) for code in raised(seen(aiming, number, image))]
    assert told == expected
