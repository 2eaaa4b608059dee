"""Distance and tilt from the laser dots in what the simulated cameras see, against where the beams truly end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.capture.ranging_measure import Ranger
from appliance.capture.ranging_witness import SURELY_A_DOT_DN, shines_in_the_dark
from appliance.config import load_rig
from appliance.patterns.sequence import BRIGHT_CODE
from appliance.service.instrument import live_light_of, pointers_of
from bench.ranging.scenes import hide, live_pair, true_dots
from bench.ranging.study import RIG_FILE, Instrument, instrument, truth_of
from hw_sim.optics.points import project
from hw_sim.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water import Water, turbid
from tests.support.truth import WATER, complete_calibration, rig_to_left

LIGHT = live_light_of(load_rig(RIG_FILE))
BLACK, WHITE = np.zeros_like(LIGHT), np.full_like(LIGHT, BRIGHT_CODE)
BOTH, NONE = (True, True), (False, False)


@pytest.fixture(scope="module")
def taught() -> Instrument:
    """A realistic rig of 400 px that has seen four planes."""
    return instrument(7, 400)


def plane(z_mm: float, turn_deg: float = 0.0, **more: Any) -> Scene:
    return replace(Scene(object="plane", pose=(0.0, 0.0, z_mm, 4.0, turn_deg, 0.0)), **more)


@pytest.mark.parametrize("water", [Water(), turbid(1.0), turbid(2.0)], ids=["clear", "1 per m", "2 per m"])
@pytest.mark.parametrize(("z_mm", "turn_deg", "texture"), [(405.0, -20.0, "none"), (500.0, 0.0, "checker"), (595.0, 15.0, "strong")])  # fmt: skip
def test_distance_and_tilt_of_a_plane(
    taught: Instrument, water: Water, z_mm: float, turn_deg: float, texture: str
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
    for k, z_mm in enumerate((430.0, 480.0, 530.0, 580.0)):
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


@pytest.mark.parametrize("name", ["plane", "board", "stones", "shell"])
@pytest.mark.parametrize("ambient", [0.02, 0.4])
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


def test_a_dot_hidden_from_one_camera_still_counts(taught: Instrument) -> None:
    renderer = Renderer(taught.truth, plane(510.0, 10.0))
    dots = true_dots(renderer, taught.truth, 0.0)
    left, right = live_pair(renderer, BOTH, 3, LIGHT)
    assert dots[0] is not None
    found = taught.ranger.find((hide(left, taught.truth, "left", dots[0]), right))
    assert found.left is not None
    assert found.right is not None
    assert (found.left.cameras, found.right.cameras) == (1, 2)
    true = taught.ranger.frame.from_left(rig_to_left(taught.truth, dots[0][None]))[0]
    assert found.left.place_mm[2] == pytest.approx(true[2], abs=3.0 * found.left.sigma_mm)


def test_with_one_laser_the_distance_is_that_of_its_dot_and_there_is_no_tilt(taught: Instrument) -> None:
    renderer = Renderer(taught.truth, plane(510.0, 10.0))
    measured = taught.ranger.range_of(taught.ranger.find(live_pair(renderer, (False, True), 3, LIGHT)))
    dot = true_dots(renderer, taught.truth, 0.0)[1]
    assert dot is not None
    assert measured is not None
    assert (measured.dots, measured.tilt_deg) == (1, None)
    assert measured.distance_mm == pytest.approx(truth_of(taught, [None, dot])[0], abs=1.0)


def test_where_the_beams_meet_nothing_there_is_no_distance(taught: Instrument) -> None:
    renderer = Renderer(taught.truth, plane(1500.0, water=Water(backscatter=0.2)))
    assert taught.ranger.measure(live_pair(renderer, BOTH, 3, LIGHT)) is None


@pytest.mark.long
def test_full_size_images_give_the_same_distance() -> None:
    truth = draw_truth("modelled", 3, 1600, 1200, WATER.index)
    pointers = pointers_of(load_rig(RIG_FILE))
    assert pointers is not None
    one = Instrument(truth, Ranger(complete_calibration(truth).rig, WATER.index, pointers.beams()))
    renderer = Renderer(truth, plane(520.0, 12.0, texture="checker"))
    measured = one.ranger.measure(live_pair(renderer, BOTH, 3, LIGHT))
    true_mm, true_deg = truth_of(one, true_dots(renderer, truth, 0.0))
    assert measured is not None
    assert measured.distance_mm == pytest.approx(true_mm, abs=0.5)
    assert measured.tilt_deg == pytest.approx(true_deg, abs=1.0)


@pytest.mark.parametrize(("lasers", "named"), [((True, False), ("left",)), ((False, True), ("right",)), (NONE, ())])
@pytest.mark.parametrize("ambient", [0.02, 0.4])
def test_a_laser_that_shines_in_a_sequence_is_named_and_print_in_daylight_is_not(
    taught: Instrument, lasers: tuple[bool, bool], named: tuple[str, ...], ambient: float
) -> None:
    renderer = Renderer(taught.truth, Scene(object="plane", texture="checker", ambient=ambient))
    bright, dark = (live_pair(renderer, lasers, 3, light) for light in (WHITE, BLACK))
    assert shines_in_the_dark(taught.ranger, bright, dark) == named


def test_the_live_light_is_dark_wherever_a_beam_of_a_real_instrument_can_end() -> None:
    assert np.mean(LIGHT == 0) < 0.1, "and light elsewhere"
    for seed in range(30):
        truth = draw_truth("realistic", seed, 400, 300, WATER.index)
        for laser in truth.lasers:
            way = np.array(laser.origin_mm) + np.linspace(340.0, 640.0, 20)[:, None] * np.array(laser.direction)
            u, v = np.rint(project(truth, "projector", way)).astype(int).T
            assert (LIGHT[v, u] == 0).all()
