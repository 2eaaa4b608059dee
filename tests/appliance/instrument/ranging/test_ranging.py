"""Distance and tilt from the laser dots in what the simulated cameras see, against where the beams truly end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from appliance.instrument.ranging.ranger import SURELY_A_DOT_DN, shines_in_the_dark
from appliance.instrument.service.settings import live_light_of
from appliance.measure.light.patterns import BRIGHT_CODE
from appliance.store.config import load_rig
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.water.medium import Water, turbid
from tests.support.pointed import RIG_FILE, Instrument, hide, instrument, live_pair, true_dots, truth_of
from tests.support.truth import rig_to_left

LIGHT = live_light_of(load_rig(RIG_FILE))
BLACK, WHITE = np.zeros_like(LIGHT), np.full_like(LIGHT, BRIGHT_CODE)
BOTH, NONE = (True, True), (False, False)


def plane(z_mm: float, turn_deg: float = 0.0, **more: Any) -> Scene:
    return Scene(object="plane", pose=(0.0, 0.0, z_mm, 4.0, turn_deg, 0.0), **more)


@pytest.fixture(scope="module")
def taught() -> Instrument:
    """A realistic rig of 400 px that never saw its dots measures at once, and learns its beams from three planes."""
    fresh = instrument(7, 400, taught=False)
    assert float(fresh.ranger.beams[0].sd_mm(np.array(500.0))) > 1.5
    for k, z_mm in enumerate((430.0, 490.0, 560.0)):
        renderer = Renderer(fresh.truth, plane(z_mm))
        measured = fresh.ranger.measure(live_pair(renderer, BOTH, k, LIGHT))
        true_mm, _ = truth_of(fresh, true_dots(renderer, fresh.truth, 0.0))
        assert measured is not None
        assert measured.distance_mm == pytest.approx(true_mm, abs=1.0)
    return fresh


def test_beams_are_learned_where_the_lasers_shine(taught: Instrument) -> None:
    for beam, laser in zip(taught.ranger.beams, taught.truth.lasers, strict=True):
        assert float(beam.sd_mm(np.array(500.0))) < 0.5
        place = np.array(laser.origin_mm) + 470.0 * np.array(laser.direction)
        true = taught.ranger.frame.from_left(rig_to_left(taught.truth, place[None]))[0]
        assert np.linalg.norm(beam.at(true[2]) - true) < 0.5


@pytest.mark.parametrize(
    ("z_mm", "turn_deg", "texture", "water"), [(405.0, -20.0, "none", Water()), (595.0, 15.0, "checker", turbid(2.0))]
)
def test_distance_and_tilt(taught: Instrument, z_mm: float, turn_deg: float, texture: str, water: Water) -> None:
    renderer = Renderer(taught.truth, plane(z_mm, turn_deg, texture=texture, water=water))
    measured = taught.ranger.range_of(taught.ranger.find(live_pair(renderer, BOTH, 3, LIGHT)))
    true_mm, true_deg = truth_of(taught, true_dots(renderer, taught.truth, 0.0))
    assert measured is not None
    assert measured.dots == 2
    assert measured.distance_mm == pytest.approx(true_mm, abs=1.0)
    assert measured.tilt_deg == pytest.approx(true_deg, abs=2.0)


def test_with_the_lasers_off_nothing_is_taken_for_a_laser_and_nothing_is_told_of_nothing(taught: Instrument) -> None:
    """A pebble that lies where a beam would end may look like a faint dot; it is at least where it seems."""
    renderer = Renderer(taught.truth, Scene(object="stones", texture="strong", ambient=0.4))
    found = taught.ranger.find(live_pair(renderer, NONE, 5, LIGHT))
    places = true_dots(renderer, taught.truth, 0.0)
    for dot, place in zip((found.left, found.right), places, strict=True):
        if dot is not None:
            assert place is not None
            assert dot.position_mm[2] == pytest.approx(truth_of(taught, [place, None])[0], abs=2.0)
            assert dot.contrast_dn < SURELY_A_DOT_DN


def bar_in_the_beam(taught: Instrument, pointer: int, z_mm: float, off_mm: float) -> Scene:
    """A lying ball bar whose middle line one pointer's beam passes ``off_mm`` below."""
    laser = taught.truth.lasers[pointer]
    along = (z_mm - laser.origin_mm[2]) / laser.direction[2]
    y = laser.origin_mm[1] + along * laser.direction[1]
    return Scene(object="ballbar", pose=(0.0, y - off_mm, z_mm, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("off_mm", [-5.4, 4.5])
def test_the_distance_of_a_thin_bar_is_right_within_what_is_said_also_of_edges(
    taught: Instrument, off_mm: float
) -> None:
    """A bar of 10 mm: at 5.4 mm from its middle line the axis of the beam passes by, and a third of its light does not."""
    renderer = Renderer(taught.truth, bar_in_the_beam(taught, 0, 470.0, off_mm))
    measured = taught.ranger.range_of(taught.ranger.find(live_pair(renderer, (True, False), 3, LIGHT)))
    assert measured is not None
    true_mm, _ = truth_of(taught, [true_dots(renderer, taught.truth, 0.0)[0], None])
    assert measured.sigma_mm < 3.0
    assert measured.distance_mm == pytest.approx(true_mm, abs=2.5 * measured.sigma_mm)


def test_a_bright_dot_that_only_one_camera_sees_is_believed_when_it_stays(taught: Instrument) -> None:
    renderer = Renderer(taught.truth, bar_in_the_beam(taught, 1, 500.0, 0.0))
    dot = true_dots(renderer, taught.truth, 0.0)[1]
    assert dot is not None
    left, right = live_pair(renderer, (False, True), 3, LIGHT)
    pair = left, hide(right, taught.truth, "right", dot)
    nothing = np.zeros_like(left)
    *told, measured = (taught.ranger.range_of(taught.ranger.find(one)) for one in ((nothing, nothing), *4 * [pair]))
    assert told == 4 * [None]
    assert measured is not None
    true_mm, _ = truth_of(taught, [None, dot])
    assert measured.distance_mm == pytest.approx(true_mm, abs=2.5 * measured.sigma_mm)
    assert measured.sigma_mm > 1.0


def test_a_laser_that_shines_in_a_sequence_is_named_and_print_in_daylight_is_not(taught: Instrument) -> None:
    renderer = Renderer(taught.truth, Scene(object="plane", texture="checker", ambient=0.4))
    for lasers, named in (((True, False), ("left",)), (NONE, ())):
        bright, dark = (live_pair(renderer, lasers, 3, light) for light in (WHITE, BLACK))
        assert shines_in_the_dark(taught.ranger, bright, dark) == named
