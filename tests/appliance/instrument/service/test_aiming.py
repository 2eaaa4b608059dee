"""Warnings of the live views: when they come and go, and water that hides and a torch on the object, told from live pictures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.capture.aiming import WIDTH_PX, LiveImage, Shade, measure_image
from appliance.instrument.machine import events as on
from appliance.instrument.service.aiming import DEVICE, AimingController
from appliance.instrument.service.settings import drawn_light_of
from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import NOMINAL
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument
from drivers.native import MonotonicClock
from hw_sim.light.daylight import Daylight
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water, turbid
from tests.appliance.instrument.capture.test_aiming import BLACK_DN, picture
from tests.drivers.clock import SteppedClock

RIG = load_rig(Path("hw_sim/rigs/small.toml"))
CALIBRATION, LIGHT = Instrument(RIG).design(), drawn_light_of(RIG)
EVEN = replace(LIGHT, codes=np.full_like(LIGHT.codes, 255))
"""Light without dark lanes, as of a rig without lasers."""
BRIGHT, DARK = picture(100.0), picture(0.0)


@pytest.fixture
def desk() -> Iterator[tuple[AimingController, SteppedClock]]:
    clock = SteppedClock(0)
    with AimingController(clock, 0.1, BLACK_DN, EVEN) as made:
        assert made.live(True, CALIBRATION, 1.333) == []
        clock.advance_s(1.0)
        yield made, clock


def seen(desk: AimingController, number: int, image: NDArray[np.uint8]) -> list[on.Event]:
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


def test_a_warning_needs_three_images_and_so_does_its_end(desk: tuple[AimingController, SteppedClock]) -> None:
    aiming, _ = desk
    told = [raised(seen(aiming, number, DARK)) for number in range(1, 4)]
    assert told == [[], [], [FaultCode.AIM_DARK]]
    gone = [cleared(seen(aiming, number, BRIGHT)) for number in range(4, 8)]
    assert gone == [[], [], [FaultCode.AIM_DARK], []]
    assert [raised(seen(aiming, number, DARK)) for number in range(8, 12)] == [[], [], [FaultCode.AIM_DARK], []]


def test_one_dark_image_among_bright_ones_is_no_warning(desk: tuple[AimingController, SteppedClock]) -> None:
    aiming, _ = desk
    images = [DARK, DARK, BRIGHT, DARK, DARK, BRIGHT]
    assert [seen(aiming, number, image) for number, image in enumerate(images, 1)] == [[]] * len(images)


def test_a_warning_ends_with_the_live_view_and_names_its_witness(desk: tuple[AimingController, SteppedClock]) -> None:
    aiming, _ = desk
    events = [event for number in range(1, 4) for event in seen(aiming, number, DARK)]
    assert [event.fault.device for event in events if isinstance(event, on.ConditionRaised)] == [DEVICE]
    assert aiming.stop() == [on.ConditionCleared(FaultCode.AIM_DARK, DEVICE)]
    assert aiming.stop() == []


def test_without_the_projectors_light_and_before_it_settled_nothing_is_judged() -> None:
    clock = SteppedClock(0)
    with AimingController(clock, 0.1, BLACK_DN, EVEN) as aiming:
        aiming.live(True, CALIBRATION, 1.333)
        assert [raised(seen(aiming, number, DARK)) for number in range(1, 5)] == [[]] * 4
        aiming.live(False, CALIBRATION, 1.333)
        clock.advance_s(1.0)
        assert [raised(seen(aiming, number, DARK)) for number in range(5, 9)] == [[]] * 4


@pytest.mark.parametrize(("step_px", "expected"), [(6.0, []), (18.0, [FaultCode.AIM_FAST])])
def test_hands_that_a_scan_cannot_follow_are_warned_of(
    desk: tuple[AimingController, SteppedClock], step_px: float, expected: list[FaultCode]
) -> None:
    """A px of 400 is 0.64 mm in the middle of the volume: 10 images a second move by 38 and by 115 mm/s."""
    aiming, _ = desk
    images = [picture(100.0, shift_px=(step_px * (number % 2), 0.0), seed=number) for number in range(5)]
    assert [code for number, image in enumerate(images, 1) for code in raised(seen(aiming, number, image))] == expected


@pytest.mark.parametrize(("live_s", "settle_ns"), [(0.05, 300_000_000), (0.2, 600_000_000)])
def test_images_count_from_three_tenths_of_a_second_or_three_images_on(live_s: float, settle_ns: int) -> None:
    clock = SteppedClock(0)
    with AimingController(clock, live_s, BLACK_DN, EVEN) as aiming:
        aiming.live(True, CALIBRATION, 1.333)
        for later_ns, counts in ((settle_ns - 1, False), (1, True)):
            clock.advance_s(1e-9 * later_ns)
            aiming.see("right", 1, DARK)
            assert not aiming.busy, "the left camera alone"
            told = [code for number in range(1, 4) for code in raised(seen(aiming, number, DARK))]
            assert told == ([FaultCode.AIM_DARK] if counts else [])


@pytest.mark.parametrize(("apart", "expected"), [(3, [FaultCode.AIM_FAST]), (4, [])])
def test_motion_is_told_from_images_with_two_missing_between_and_no_more(
    desk: tuple[AimingController, SteppedClock], apart: int, expected: list[FaultCode]
) -> None:
    aiming, _ = desk
    images = [picture(100.0, shift_px=(40.0 * (number % 2), 0.0), seed=number) for number in range(5)]
    numbers = range(20, 20 + 5 * apart, apart)
    told = [code for number, image in zip(numbers, images, strict=True) for code in raised(seen(aiming, number, image))]
    assert told == expected


SIZE = (RIG.camera.left.width_px, RIG.camera.left.height_px)
SHADE = LIGHT.shade(Instrument(RIG).design().rig, Water().index, WIDTH_PX)
MILKY = Water(attenuation_per_m=3.0, backscatter=0.35)


def pictured(scene: Scene) -> LiveImage:
    renderer = Renderer(draw_truth("realistic", 3, *SIZE, scene.water.index), scene)
    exposure_s = NOMINAL.time_us / 1e6
    lit = [LightSlice(LIGHT.codes, exposure_s)]
    return measure_image(
        renderer.expose("left", lit, 0.0, exposure_s, NOMINAL.gain_db, (True, True), 1),
        RIG.camera.left.black_level_dn,
        SHADE,
    )


@pytest.mark.parametrize(
    ("scene", "code"),
    [
        (Scene(object="stones", water=MILKY), FaultCode.AIM_TURBID),  # nearly black, with some contrast left
        (Scene(object="pipe", daylight=Daylight(torch=3.0)), FaultCode.AIM_LIGHT),  # half of the picture is white
        *((Scene(object=name, pose=(0.0, 0.0, z_mm, 0.0, 8.0, 0.0), water=water), None) for name, water, z_mm in (
            ("ballbar", turbid(2.0), 520.0), ("main", turbid(2.0), 500.0), ("shell", turbid(0.4), 545.0))),
    ],
)  # fmt: skip
def test_water_that_hides_and_a_torch_are_told_before_the_scan_and_an_ordinary_scene_is_not(
    scene: Scene, code: FaultCode | None
) -> None:
    fault = pictured(scene).fault(1.0)
    assert (None if fault is None else fault.code) is code


def test_the_shade_is_where_the_projector_throws_no_light_at_any_distance() -> None:
    assert SHADE is not None
    assert SHADE.shape == (150, WIDTH_PX)
    shade = pictured(Scene(object="plane", pose=(0.0, 0.0, 555.0, 0.0, 0.0, 0.0), ambient=0.0)).shade
    assert shade is not None
    assert shade.bright_dn < 20.0, "while the plane around it is white"
    assert LIGHT.shade(Instrument(RIG).design().rig, Water().index, 20) is None, "too few pixels"


SMALL: NDArray[np.uint8] = np.zeros((1, 1), np.uint8)


@pytest.mark.parametrize(
    ("even", "bright", "glow", "saturated", "longer", "code"),
    [
        (2.0, 127.0, 250.0, 0.0, 1.0, None),
        (2.0, 128.0, 250.0, 0.0, 1.0, FaultCode.AIM_LIGHT),
        (2.0, 39.0, 250.0, 0.06, 1.0, None),
        (2.0, 41.0, 250.0, 0.06, 1.0, FaultCode.AIM_LIGHT),
        (2.0, 41.0, 250.0, 0.04, 1.0, None),
        (2.0, 79.0, 250.0, 0.06, 2.0, None),
        (2.0, 81.0, 250.0, 0.06, 2.0, FaultCode.AIM_LIGHT),
        (2.0, 41.0, 250.0, 0.06, 0.2, FaultCode.AIM_LIGHT),
        (2.0, 241.0, 250.0, 0.5, 30.0, FaultCode.AIM_LIGHT),
        (21.0, 30.0, 100.0, 0.0, 1.0, None),
        (23.0, 30.0, 100.0, 0.0, 1.0, FaultCode.AIM_TURBID),
        (23.0, 30.0, 100.0, 0.06, 1.0, None),
        (4.9, 6.0, 10.0, 0.0, 1.0, None),
    ],
)
def test_the_limits_of_light_in_the_shade(
    even: float, bright: float, glow: float, saturated: float, longer: float, code: FaultCode | None
) -> None:
    fault = LiveImage(SMALL, 50.0, glow, Shade(even, bright), saturated).fault(longer)
    assert (None if fault is None else fault.code) is code
