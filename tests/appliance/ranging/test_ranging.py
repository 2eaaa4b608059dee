"""Distance and tilt from the laser dots in what the simulated cameras see, against where the beams truly end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.config import load_rig
from appliance.instrument import live_light_of, pointers_of
from appliance.patterns.sequence import BRIGHT_CODE
from appliance.ranging.witness import SURELY_A_DOT_DN, shines_in_the_dark
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.water.medium import Water, turbid
from tests.support.pointed import RIG_FILE, Instrument, hide, instrument, live_pair, true_dots, truth_of
from tests.support.truth import rig_to_left

LIGHT = live_light_of(load_rig(RIG_FILE))
BLACK, WHITE = np.zeros_like(LIGHT), np.full_like(LIGHT, BRIGHT_CODE)
BOTH, NONE = (True, True), (False, False)


@pytest.fixture(scope="module")
def taught() -> Instrument:
    """A realistic rig of 400 px that has seen four planes."""
    return instrument(7, 400)


def plane(z_mm: float, turn_deg: float = 0.0, **more: Any) -> Scene:
    return replace(Scene(object="plane", pose=(0.0, 0.0, z_mm, 4.0, turn_deg, 0.0)), **more)


@pytest.mark.parametrize(
    ("z_mm", "turn_deg", "texture", "water"),
    [(405.0, -20.0, "none", Water()), (595.0, 15.0, "checker", turbid(2.0))],
)
def test_distance_and_tilt_of_a_plane(
    taught: Instrument, z_mm: float, turn_deg: float, texture: str, water: Water
) -> None:
    renderer = Renderer(taught.truth, plane(z_mm, turn_deg, texture=texture, water=water))
    measured = taught.ranger.range_of(taught.ranger.find(live_pair(renderer, BOTH, 3, LIGHT)))
    true_mm, true_deg = truth_of(taught, true_dots(renderer, taught.truth, 0.0))
    assert measured is not None
    assert measured.dots == 2
    assert measured.distance_mm == pytest.approx(true_mm, abs=1.0)
    assert measured.tilt_deg == pytest.approx(true_deg, abs=2.0)


def test_an_instrument_that_never_saw_its_dots_measures_at_once_and_learns_its_beams() -> None:
    fresh = instrument(11, 400, taught=False)
    errors, spread = [], []
    for k, z_mm in enumerate((430.0, 490.0, 560.0)):
        renderer = Renderer(fresh.truth, plane(z_mm))
        measured = fresh.ranger.measure(live_pair(renderer, BOTH, k, LIGHT))
        true_mm, _ = truth_of(fresh, true_dots(renderer, fresh.truth, 0.0))
        assert measured is not None
        assert true_mm is not None
        errors.append(abs(measured.distance_mm - true_mm))
        spread.append(float(fresh.ranger.beams[0].sd_mm(np.array(500.0))))
    assert max(errors) < 1.0
    assert spread[-1] < 0.5 < 1.5 < float(pointers_of(load_rig(RIG_FILE)).beams()[0].sd_mm(np.array(500.0)))  # type: ignore[union-attr]
    for beam, laser in zip(fresh.ranger.beams, fresh.truth.lasers, strict=True):
        place = np.array(laser.origin_mm) + 470.0 * np.array(laser.direction)
        true = fresh.ranger.frame.from_left(rig_to_left(fresh.truth, place[None]))[0]
        assert np.linalg.norm(beam.at(true[2]) - true) < 0.5


@pytest.mark.parametrize(("name", "ambient"), [("stones", 0.4)])
def test_with_the_lasers_off_nothing_is_taken_for_a_laser_and_no_place_is_told_where_nothing_is(
    taught: Instrument, name: str, ambient: float
) -> None:
    """A pebble that lies where a beam would end may look like a faint dot; it is at least where it seems."""
    renderer = Renderer(taught.truth, Scene(object=name, texture="strong", ambient=ambient))
    found = taught.ranger.find(live_pair(renderer, NONE, 5, LIGHT))
    places = true_dots(renderer, taught.truth, 0.0)
    for dot, place in zip((found.left, found.right), places, strict=True):
        if dot is not None:
            assert place is not None
            assert dot.place_mm[2] == pytest.approx(truth_of(taught, [place, None])[0], abs=2.0)
            assert dot.contrast_dn < SURELY_A_DOT_DN


def bar_in_the_beam(taught: Instrument, pointer: int, z_mm: float, off_mm: float, **more: Any) -> Scene:
    """A lying ball bar whose middle line one pointer's beam passes ``off_mm`` below."""
    laser = taught.truth.lasers[pointer]
    along = (z_mm - laser.origin_mm[2]) / laser.direction[2]
    y = laser.origin_mm[1] + along * laser.direction[1]
    return Scene(object="ballbar", pose=(0.0, y - off_mm, z_mm, 0.0, 0.0, 0.0), **more)


@pytest.mark.parametrize("off_mm", [-5.4, 4.5])
def test_the_distance_of_a_thin_bar_is_told_even_where_its_edge_cuts_the_dot_and_is_right_within_what_is_said(
    taught: Instrument, off_mm: float
) -> None:
    """A bar of 10 mm: at 5.4 mm from its middle line the axis of the beam passes by, and a third of its light does not."""
    renderer = Renderer(taught.truth, bar_in_the_beam(taught, 0, 470.0, off_mm))
    found = taught.ranger.find(live_pair(renderer, (True, False), 3, LIGHT))
    measured = taught.ranger.range_of(found)
    assert measured is not None
    true_mm, _ = truth_of(taught, [true_dots(renderer, taught.truth, 0.0)[0], None])
    assert true_mm is not None
    assert measured.sigma_mm < 3.0
    assert abs(measured.distance_mm - true_mm) < 2.5 * measured.sigma_mm


def test_a_bright_dot_that_only_one_camera_sees_is_believed_without_another_one_when_it_stays(
    taught: Instrument,
) -> None:
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


@pytest.mark.parametrize(
    ("lasers", "named", "ambient"),
    [((True, False), ("left",), 0.4), (NONE, (), 0.4)],
)
def test_a_laser_that_shines_in_a_sequence_is_named_and_print_in_daylight_is_not(
    taught: Instrument, lasers: tuple[bool, bool], named: tuple[str, ...], ambient: float
) -> None:
    renderer = Renderer(taught.truth, Scene(object="plane", texture="checker", ambient=ambient))
    bright, dark = (live_pair(renderer, lasers, 3, light) for light in (WHITE, BLACK))
    assert shines_in_the_dark(taught.ranger, bright, dark) == named
