"""Distance and tilt from the laser dots in what the simulated cameras see, against where the beams truly end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.config import load_rig
from appliance.instrument import design_of, live_light_of, pointers_of
from appliance.patterns.sequence import BRIGHT_CODE
from appliance.ranging.measure import Ranger
from appliance.ranging.reach import Range
from appliance.ranging.witness import SURELY_A_DOT_DN, shines_in_the_dark
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, project
from hw_sim.water.medium import Water, turbid
from tests.support.pointed import RIG_FILE, Instrument, hide, instrument, live_pair, true_dots, truth_of
from tests.support.truth import WATER, complete_calibration, rig_to_left

SMALL_RIG_FILE = Path("hw_sim/rigs/small.toml")
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


def bar_in_the_beam(taught: Instrument, pointer: int, z_mm: float, off_mm: float, **more: Any) -> Scene:
    """A lying ball bar whose middle line one pointer's beam passes ``off_mm`` below."""
    laser = taught.truth.lasers[pointer]
    along = (z_mm - laser.origin_mm[2]) / laser.direction[2]
    y = laser.origin_mm[1] + along * laser.direction[1]
    return Scene(object="ballbar", pose=(0.0, y - off_mm, z_mm, 0.0, 0.0, 0.0), **more)


@pytest.mark.parametrize("off_mm", [-5.4, -4.5, -3.0, 0.0, 3.0, 4.5, 5.4])
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


def test_what_is_said_of_a_distance_is_less_certain_where_an_edge_cuts_the_dot(taught: Instrument) -> None:
    whole, cut = (
        taught.ranger.range_of(
            taught.ranger.find(
                live_pair(Renderer(taught.truth, bar_in_the_beam(taught, 0, 470.0, off_mm)), (True, False), 3, LIGHT)
            )
        )
        for off_mm in (0.0, 5.4)
    )
    assert whole is not None
    assert cut is not None
    assert cut.sigma_mm > 2.0 * whole.sigma_mm


def told_after(taught: Instrument, *pairs: tuple[np.ndarray, np.ndarray]) -> Range | None:
    """What is told of the last of some pairs, after a pair of nothing."""
    nothing = np.zeros((300, 400), np.uint8)
    told = None
    for pair in ((nothing, nothing), *pairs):
        told = taught.ranger.range_of(taught.ranger.find(pair))
    return told


def test_a_bright_dot_that_only_one_camera_sees_is_believed_without_another_one_when_it_stays(
    taught: Instrument,
) -> None:
    renderer = Renderer(taught.truth, bar_in_the_beam(taught, 1, 500.0, 0.0))
    dot = true_dots(renderer, taught.truth, 0.0)[1]
    assert dot is not None
    left, right = live_pair(renderer, (False, True), 3, LIGHT)
    pair = left, hide(right, taught.truth, "right", dot)
    assert told_after(taught, pair, pair, pair) is None
    measured = told_after(taught, pair, pair, pair, pair)
    assert measured is not None
    true_mm, _ = truth_of(taught, [None, dot])
    assert measured.distance_mm == pytest.approx(true_mm, abs=2.5 * measured.sigma_mm)
    assert measured.sigma_mm > 1.0


@pytest.mark.parametrize("z_mm", [335.0, 420.0, 560.0])
def test_a_bright_speck_in_the_water_that_one_camera_sees_on_a_beams_way_is_no_dot(
    taught: Instrument, z_mm: float
) -> None:
    """Both cameras see it, and it lies on the beam's way in one picture only: it is beside the beam."""
    black = np.zeros((300, 400), np.uint8)
    laser = taught.truth.lasers[1]
    behind = np.array(laser.origin_mm) + 470.0 * np.array(laser.direction)
    eye_mm = np.array(taught.truth.eye("left").t_mm)
    speck_mm = eye_mm + (behind - eye_mm) * z_mm / behind[2]
    seen = [spotted(black, *project(taught.truth, side, speck_mm[None])[0]) for side in ("left", "right")]
    assert told_after(taught, *4 * [(seen[0], black)]) is not None, "as bright as a dot is"
    assert told_after(taught, *4 * [(seen[0], seen[1])]) is None


def test_one_spot_in_one_picture_that_can_be_either_pointers_dot_is_neither(taught: Instrument) -> None:
    """The left camera sees the right pointer's dot at 500 mm where another pointer's would be at 450 mm."""
    laser, frame = taught.truth.lasers[1], taught.ranger.frame
    dot = np.array(laser.origin_mm) + 470.0 * np.array(laser.direction)
    eye_mm = np.array(taught.truth.eye("left").t_mm)
    nearer = frame.from_left(rig_to_left(taught.truth, (eye_mm + (dot - eye_mm) * 450.0 / dot[2])[None]))[0]
    own = taught.ranger.beams[1]
    other = replace(own, z0_mm=float(nearer[2]), line=(float(nearer[0]), float(nearer[1]), 0.0, 0.0))
    far = replace(own, line=(-300.0, 0.0, 0.0, 0.0))
    black = np.zeros((300, 400), np.uint8)
    spot = spotted(black, *project(taught.truth, "left", dot[None])[0])
    rig = complete_calibration(taught.truth).rig
    for beside, told in ((far, True), (other, False)):
        ranger = Ranger(rig, WATER.index, (beside, own))
        measured = [ranger.range_of(ranger.find((spot, black))) for _ in range(4)]
        assert (measured[-1] is not None) == told


def spotted(image: np.ndarray, u: float, v: float) -> np.ndarray:
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.asarray(np.minimum(255.0, image + 200.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 5.0)), np.uint8)


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


def test_the_marks_in_the_live_pictures_are_where_the_dots_are_seen_at_500_mm(taught: Instrument) -> None:
    """By the simulator's own beams and rays; within 1.5 px of 400, a fifth of the ring that is drawn."""
    marks = taught.ranger.marks()
    for side, tracks in (("left", marks.left), ("right", marks.right)):
        assert len(tracks) == 2
        for track, laser in zip(tracks, taught.truth.lasers, strict=True):
            origin, beam = np.array(laser.origin_mm), np.array(laser.direction)
            for mark, z_mm in ((track.near, 440.0), (track.middle, 500.0), (track.far, 560.0)):
                way = origin + np.arange(300.0, 700.0, 0.5)[:, None] * beam
                depth_mm = taught.ranger.frame.from_left(rig_to_left(taught.truth, way))[:, 2]
                seen = project(taught.truth, side, way[np.argmin(np.abs(depth_mm - z_mm))][None])[0]
                assert (400 * mark[0] - 0.5, 300 * mark[1] - 0.5) == pytest.approx(tuple(seen), abs=1.5)


def test_a_dot_that_would_lie_beside_a_picture_has_no_mark_in_it(taught: Instrument) -> None:
    beside = replace(taught.ranger.beams[1], line=(400.0, 0.0, 0.0, 0.0))
    rig = complete_calibration(taught.truth).rig
    marks = Ranger(rig, WATER.index, (taught.ranger.beams[0], beside)).marks()
    assert (len(marks.left), len(marks.right)) == (1, 1)


def test_before_the_first_calibration_one_dot_is_not_taken_for_the_other_and_the_distance_is_right_within_what_is_said() -> (
    None
):
    """Both dots are in one row of both pictures, and rays of the drawing meet nearly everywhere."""
    rig = load_rig(SMALL_RIG_FILE)
    pointers, calibration = pointers_of(rig), design_of(rig)
    assert pointers is not None
    size = calibration.rig.left.width_px, calibration.rig.left.height_px
    for seed, z_mm in ((3, 420.0), (5, 510.0), (6, 600.0)):
        truth = draw_truth("realistic", seed, *size, WATER.index)
        ranger = Ranger(calibration.rig, WATER.index, pointers.beams(), measured=False)
        measured = ranger.range_of(ranger.find(live_pair(Renderer(truth, plane(z_mm)), BOTH, 3, LIGHT)))
        assert measured is not None
        assert measured.dots == 2
        assert abs(measured.distance_mm - z_mm) < 2.5 * measured.sigma_mm
        assert measured.sigma_mm < 15.0
