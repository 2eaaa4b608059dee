"""Which bright spots in a pair of pictures are taken for dots: spots drawn where the simulator's optics sees given places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.ranging.beams import PointerBeam
from appliance.instrument.ranging.dots import Lane, contrast_of
from appliance.instrument.ranging.ranger import Dots, Images, Ranger
from hw_sim.truth import TrueRig, draw_truth, project
from tests.support.truth import WATER, left_to_rig, true_calibration

Array = NDArray[np.float64]
SURE = ((0.01, 0.0, 0.0, 0.0), (0.0, 0.01, 0.0, 0.0), (0.0, 0.0, 1e-9, 0.0), (0.0, 0.0, 0.0, 1e-9))
"""Of a beam that many dots have taught: 0.1 mm."""
BEAMS = (PointerBeam(30.0, (-60.0, 10.0, 0.085, -0.01), SURE), PointerBeam(30.0, (60.0, 10.0, -0.085, -0.01), SURE))
HEIGHT_DN = 200.0


class Bench:
    """A rig whose calibration is the truth, and pictures of spots as it sees them."""

    def __init__(self, width_px: int) -> None:
        self.truth: TrueRig = draw_truth("modelled", 3, width_px, width_px * 3 // 4, WATER.index)
        self.rig = true_calibration(self.truth).rig
        self.frame = Ranger(self.rig, WATER.index, BEAMS).frame
        self.step = width_px // 400

    def ranger(self, *, beams: tuple[PointerBeam, PointerBeam] = BEAMS, measured: bool = True) -> Ranger:
        return Ranger(self.rig, WATER.index, beams, measured)

    def seen(self, place_mm: Array) -> tuple[Array, Array]:
        """Pixels of a place of the instrument's frame in the left and the right picture."""
        there = left_to_rig(self.truth, self.frame.to_left(place_mm)[None])
        return project(self.truth, "left", there)[0], project(self.truth, "right", there)[0]

    def picture(self, *spots: tuple[Array, float], ground_dn: float = 0.0) -> NDArray[np.uint8]:
        light = np.full((300 * self.step, 400 * self.step), ground_dn)
        for uv, height_dn in spots:
            x, y = (
                np.exp(-0.5 * ((np.arange(n) - at) / (1.5 * self.step)) ** 2)
                for n, at in zip(light.shape[::-1], uv, strict=True)
            )
            light += height_dn * np.outer(y, x)
        return np.asarray(np.clip(np.rint(light), 0, 255), np.uint8)

    def pair(self, *dots: tuple[Array, float, float]) -> Images:
        """Places with the height of their spots in the left and the right picture."""
        at = [(self.seen(place), heights) for place, *heights in dots]
        left, right = (self.picture(*((uv[k], heights[k]) for uv, heights in at if heights[k])) for k in (0, 1))
        return left, right


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(400)


def on(pointer: int, z_mm: float, *, off_mm: tuple[float, float] = (0.0, 0.0)) -> Array:
    """A place on a beam, or beside it."""
    return np.asarray(BEAMS[pointer].at(np.array(z_mm)) + np.array([*off_mm, 0.0]))


def after(ranger: Ranger, *pairs: Images) -> Dots:
    found = Dots(None, None)
    for pair in pairs:
        found = ranger.find(pair)
    return found


@pytest.mark.parametrize(("width_px", "z_mm"), [(400, 360.0), (400, 500.0), (400, 700.0), (1600, 500.0)])
def test_a_dot_is_where_both_cameras_see_it_and_the_nearer_the_more_certain(width_px: int, z_mm: float) -> None:
    """Uncertain by the spots' centres, 0.12 px of 400 each, by how flat their rays cross; and by 0.3 mm of its own. Pictures of full
    size are looked at in a quarter of it."""
    bench = Bench(width_px)
    found = bench.ranger().find(bench.pair((on(0, z_mm), HEIGHT_DN, HEIGHT_DN)))
    assert found.right is None
    assert found.left is not None
    assert found.left.position_mm == pytest.approx(tuple(on(0, z_mm)), abs=0.25)
    assert found.left.cameras == 2
    assert HEIGHT_DN / 3 < found.left.contrast_dn < HEIGHT_DN
    half_base_mm = 0.5 * float(np.linalg.norm(bench.rig.right.translation_mm))
    way_mm = float(np.hypot(z_mm, half_base_mm - 30.0))
    sine = 2.0 * half_base_mm * z_mm / (z_mm**2 + half_base_mm**2)
    f_px = bench.truth.left.f_px[0] * WATER.index / bench.step
    expected = np.hypot(np.sqrt(2.0) * 0.12 * way_mm / f_px / sine, 0.3)
    assert 0.93 * expected < found.left.sigma_mm < 1.02 * expected, "the way begins at the port, not at the centre"


def passing(bench: Bench, gap_mm: float) -> Images:
    """A spot whose rays pass each other by so much."""
    half = np.array([0.0, 0.5 * gap_mm, 0.0])
    left, right = bench.seen(on(0, 450.0) + half)[0], bench.seen(on(0, 450.0) - half)[1]
    return bench.picture((left, HEIGHT_DN)), bench.picture((right, HEIGHT_DN))


@pytest.mark.parametrize("measured", [True, False])
def test_rays_that_pass_each_other_come_from_two_things_by_the_drawing_from_8_mm_on(
    measured: bool, bench: Bench
) -> None:
    ranger = bench.ranger() if measured else bench.ranger(beams=(broad(0, 5.0), BEAMS[1]), measured=False)
    for gap_mm, met in ((0.45, True), (0.85, False), (-0.85, False)) if measured else ((6.0, True), (10.0, False)):
        found = ranger.find(passing(bench, gap_mm)).left
        assert (found is not None and found.cameras == 2) == met, gap_mm


def test_a_dot_beside_its_beam_is_cut_by_an_edge_and_its_depth_less_certain(bench: Bench) -> None:
    """Where a surface is as steep as 60°, 1.5 mm across the beam are 2.6 mm of depth."""
    on_it, beside = (
        bench.ranger().find(bench.pair((on(0, 500.0, off_mm=(0.0, off)), HEIGHT_DN, HEIGHT_DN))).left
        for off in (0.0, 1.5)
    )
    assert on_it is not None
    assert beside is not None
    extra_mm = np.sqrt(beside.sigma_mm**2 - on_it.sigma_mm**2)
    assert extra_mm == pytest.approx(1.5 * np.tan(np.radians(60.0)), rel=0.1)


Spot = tuple[int, float, float, float, float]
"""Pointer, depth, mm beside its beam, height in the left and in the right picture."""


@pytest.mark.parametrize(
    ("spots", "cameras"),
    [
        # At least a fifth of its contrast in the other camera.
        ([(1, 480.0, 0.0, 200.0, 60.0)], (0, 2)), ([(1, 480.0, 0.0, 60.0, 200.0)], (0, 2)),
        ([(1, 480.0, 0.0, 200.0, 30.0)], (0, 0)), ([(1, 480.0, 0.0, 30.0, 200.0)], (0, 0)),
        # Beside the beam by 3.5 standard deviations: 0.5 mm of the dot, 0.2 mm of the calibration and 0.1 mm of the beam.
        ([(0, 500.0, 1.6, 200.0, 200.0)], (2, 0)), ([(0, 500.0, -1.6, 200.0, 200.0)], (2, 0)),
        ([(0, 500.0, 2.4, 200.0, 200.0)], (0, 0)), ([(0, 500.0, -2.4, 200.0, 200.0)], (0, 0)),
        # Two places that are nearly as clear make both doubtful.
        ([(1, 440.0, 0.0, 200.0, 200.0), (1, 560.0, 0.0, 70.0, 70.0)], (0, 2)),
        ([(1, 440.0, 0.0, 200.0, 200.0), (1, 560.0, 0.0, 130.0, 130.0)], (0, 0)),
        # Nearer or farther than the instrument looks.
        ([(0, 330.0, 0.0, 200.0, 200.0)], (0, 0)), ([(0, 356.0, 0.0, 200.0, 200.0)], (2, 0)),
        ([(0, 712.0, 0.0, 200.0, 200.0)], (2, 0)), ([(0, 745.0, 0.0, 200.0, 200.0)], (0, 0)),
        # What one camera sees is believed at once beside the other pointer's, with two fifths of its contrast and on the same surface.
        ([(0, 500.0, 0.0, 0.0, 105.0), (1, 490.0, 0.0, 200.0, 200.0)], (1, 2)),
        ([(0, 500.0, 0.0, 0.0, 62.0), (1, 490.0, 0.0, 200.0, 200.0)], (0, 2)),
        ([(0, 450.0, 0.0, 0.0, 200.0), (1, 490.0, 0.0, 200.0, 200.0)], (1, 2)),
        ([(0, 436.0, 0.0, 0.0, 200.0), (1, 490.0, 0.0, 200.0, 200.0)], (0, 2)),
        # A faint one, of a contrast of 19, bears out one of 20, and none of 13.
        ([(0, 500.0, 0.0, 0.0, 35.0), (1, 490.0, 0.0, 33.0, 33.0)], (1, 2)),
        ([(0, 500.0, 0.0, 0.0, 23.0), (1, 490.0, 0.0, 33.0, 33.0)], (0, 2)),
    ],
)  # fmt: skip
def test_which_spots_are_dots_by_how_many_cameras(bench: Bench, spots: list[Spot], cameras: tuple[int, int]) -> None:
    """Only what both cameras saw teaches a beam."""
    pair = bench.pair(*((on(k, z_mm, off_mm=(0.0, off)), left, right) for k, z_mm, off, left, right in spots))
    ranger = bench.ranger()
    found = ranger.find(pair)
    dots = found.left, found.right
    assert tuple(0 if dot is None else dot.cameras for dot in dots) == cameras
    for pointer, z_mm, *_ in spots[:1]:
        dot = dots[pointer]
        assert dot is None or dot.position_mm[2] == pytest.approx(z_mm, abs=0.5 * 3 ** (dot.cameras == 1))
    ranger.learn(found)
    assert [beam.learned for beam in ranger.beams] == [int(seen == 2) for seen in cameras]
    assert bench.ranger().find(pair, (False, True)).left is None, "a pointer that is not lit is not looked for"


@pytest.mark.parametrize(("pointer", "z_mm"), [(0, 450.0), (1, 520.0)])
def test_a_dot_that_one_camera_sees_is_where_its_ray_meets_the_beam(bench: Bench, pointer: int, z_mm: float) -> None:
    """Each pointer's dot in the other side's camera. It is as uncertain as the beam across the ray, by how flat both cross."""
    heights = (HEIGHT_DN, 0.0) if pointer == 1 else (0.0, HEIGHT_DN)
    pair = bench.pair((on(pointer, z_mm), *heights))
    ranger = bench.ranger()
    assert after(ranger, pair, pair, pair) == Dots(None, None), "not before it has stayed for four pairs"
    found = ranger.find(pair)
    dot = (found.left, found.right)[pointer]
    assert dot is not None
    assert dot.cameras == 1
    assert dot.position_mm == pytest.approx(tuple(on(pointer, z_mm)), abs=0.1)
    eye_mm = bench.frame.from_left(np.zeros(3) if pointer == 1 else np.array(bench.rig.right.translation_mm))
    ray, beam = on(pointer, z_mm) - eye_mm, on(pointer, 600.0) - on(pointer, 400.0)
    sine = np.linalg.norm(np.cross(ray, beam)) / np.linalg.norm(ray) / np.linalg.norm(beam)
    centre_mm = 0.12 * np.linalg.norm(ray) / (bench.truth.left.f_px[0] * WATER.index)
    across_mm = np.sqrt(0.1**2 + 1e-9 * (z_mm - 30.0) ** 2 + 0.2**2 + 0.5**2 + centre_mm**2)
    assert dot.sigma_mm == pytest.approx(across_mm / sine, rel=0.06)


def test_what_one_camera_sees_alone_is_bright_does_not_jump_and_needs_a_calibration(bench: Bench) -> None:
    for height_dn, step_mm, measured, believed in (
        (110.0, 0.0, True, True), (78.0, 0.0, True, False),  # 50 grey values of contrast
        (HEIGHT_DN, 6.0, True, True), (HEIGHT_DN, 11.0, True, False), (HEIGHT_DN, -11.0, True, False), (HEIGHT_DN, 0.0, False, False),
    ):  # fmt: skip
        pairs = [bench.pair((on(1, 490.0 + step_mm * k), height_dn, 0.0)) for k in range(5)]
        assert (after(bench.ranger(measured=measured), *pairs).right is not None) == believed, (height_dn, step_mm)
    # Gone is forgotten.
    ranger, pair, nothing = bench.ranger(), bench.pair((on(1, 490.0), HEIGHT_DN, 0.0)), bench.pair()
    assert after(ranger, pair, pair, pair, nothing, pair, pair, pair).right is None
    assert after(ranger, pair).right is not None
    other = bench.pair((on(1, 490.0), 0.0, HEIGHT_DN))
    assert after(ranger, other).right is None, "another camera's spot is another spot"


@pytest.mark.parametrize(("height_dn", "believed"), [(27.0, False), (48.0, True)])
def test_by_the_drawing_a_dot_is_clear_and_teaches_no_beam(bench: Bench, height_dn: float, believed: bool) -> None:
    """20 grey values of contrast: rays meet nearly everywhere then."""
    pair = bench.pair((on(0, 490.0), height_dn, height_dn))
    contrast = float(contrast_of(pair[0]).max())
    assert 11.0 < contrast < 19.0 if not believed else 22.0 < contrast < 38.0
    for measured in (False, True):
        ranger = bench.ranger(measured=measured)
        assert (ranger.find(pair).left is not None) == (believed or measured), "a measured calibration knows better"
        ranger.measure(pair)
        assert [beam.learned for beam in ranger.beams] == [int(measured), 0]


def test_a_beam_that_was_learned_elsewhere_is_looked_for_there(bench: Bench) -> None:
    """A beam drawn 4 mm beside where it is: after some dots the other place on the beam is looked at, and the old one is not."""
    ranger = bench.ranger(beams=(replace(broad(0, 2.0), line=(-60.0, 14.0, 0.085, -0.01)), BEAMS[1]))
    for z_mm in (450.0, 470.0, 490.0, 510.0):
        ranger.measure(bench.pair((on(0, z_mm), HEIGHT_DN, HEIGHT_DN)))
    assert ranger.beams[0].learned == 4
    assert np.linalg.norm(ranger.beams[0].at(np.array(480.0)) - on(0, 480.0)) < 0.5
    assert ranger.find(bench.pair((on(0, 480.0, off_mm=(0.0, 9.0)), HEIGHT_DN, HEIGHT_DN))).left is None


def broad(pointer: int, sd_mm: float) -> PointerBeam:
    """A beam that is known so badly."""
    variances = np.diag([sd_mm**2, sd_mm**2, 1e-7, 1e-7])
    return replace(BEAMS[pointer], covariance=tuple(tuple(row) for row in variances.tolist()))


def test_the_less_certain_a_beam_is_the_farther_beside_it_its_dot_is_looked_for(bench: Bench) -> None:
    """3.5 standard deviations of 3 mm, and 2 px."""
    for side, off_mm, inside in ((0, 9.0, True), (1, -9.0, True), (0, -15.5, False), (1, 15.5, False)):
        camera = (bench.rig.left, bench.rig.right)[side]
        uv = bench.seen(on(0, 500.0, off_mm=(0.0, off_mm)))[side]
        found = Lane(camera, bench.frame, WATER.index, broad(0, 3.0)).candidates(bench.picture((uv, HEIGHT_DN)))
        assert bool(found) == inside, (side, off_mm)
        assert not inside or (found[0].u_px, found[0].v_px) == pytest.approx(tuple(uv), abs=0.05)


def test_a_dot_is_looked_for_where_its_surroundings_are_in_the_picture(bench: Bench) -> None:
    """8 px from the border on, a ring of 6 px and what smooths it; and not fainter than 7 grey values on one px."""
    lane = Lane(bench.rig.left, bench.frame, WATER.index, broad(0, 300.0))

    def spot(u: int, v: int, height_dn: float) -> NDArray[np.uint8]:
        return bench.picture((np.array([u, v]), height_dn), ground_dn=3.0)

    heights = [float(one) for one in np.arange(10.0, 16.0, 0.1)]
    faint_dn = next(one for one in heights if np.count_nonzero(contrast_of(spot(200, 150, one)) >= 7.0) == 1)
    for u, v, looked_at in (
        (8, 150, True), (7, 150, False), (391, 150, True), (392, 150, False),
        (200, 8, True), (200, 7, False), (200, 291, True), (200, 292, False),
    ):  # fmt: skip
        assert bool(lane.candidates(spot(u, v, faint_dn))) == looked_at, (u, v)
        assert not lane.candidates(spot(u, v, faint_dn - 1.0))


def test_of_many_bright_spots_the_four_clearest_are_candidates_the_clearest_first(bench: Bench) -> None:
    lane = Lane(bench.rig.left, bench.frame, WATER.index, broad(0, 300.0))
    heights = (60.0, 150.0, 90.0, 30.0, 120.0, 180.0)
    picture = bench.picture(*((np.array([60.0 + 55.0 * k, 150.0]), height) for k, height in enumerate(heights)))
    assert [round(one.u_px) for one in lane.candidates(picture)] == [335, 115, 280, 170]
    beside = Lane(bench.rig.left, bench.frame, WATER.index, replace(BEAMS[0], line=(-2000.0, 10.0, 0.085, -0.01)))
    assert beside.candidates(picture) == [], "a beam that passes beside the picture"


def test_the_contrast_of_a_spot_is_its_height_over_the_brightest_around_it_after_smoothing() -> None:
    """A Gaussian of sigma 1.5 px, smoothed by 1.2 px, against itself 5.4 px away. A streak that ends in it, and another spot as near as
    four sigmas, make it none; one twice as far away does not."""
    y, x = np.mgrid[:61, :61] - 30.0
    spot = 100.0 * np.exp(-(x**2 + y**2) / (2.0 * 1.5**2))
    wide = 1.5**2 + 1.2**2
    expected = 100.0 * 1.5**2 / wide * (1.0 - np.exp(-(5.4**2) / (2.0 * wide)))
    for ground in (0.0, 50.0):
        contrast = contrast_of(ground + spot)
        assert int(np.argmax(contrast)) == 30 * 61 + 30
        assert float(contrast[30, 30]) == pytest.approx(expected, rel=0.02)
    streak = 100.0 * np.exp(-(y**2) / (2.0 * 1.5**2)) * (x > 0)
    far, near = (100.0 * np.exp(-((x - away) ** 2 + y**2) / (2.0 * 1.5**2)) for away in (13.0, 6.0))
    assert contrast_of(spot + far)[30, 30] > 50.0
    for other in (streak, near):
        assert contrast_of(np.maximum(spot, other))[30, 30] < 5.0


def test_a_bright_line_at_any_angle_is_no_dot_anywhere_on_it() -> None:
    """A scratch, an edge of a tile, a beam's streak that goes on."""
    y, x = np.mgrid[:61, :61] - 30.0
    for turn in np.radians([0.0, 30.0, 45.0, 105.0]):
        line = 200.0 * np.exp(-((x * np.sin(turn) - y * np.cos(turn)) ** 2) / 2.0)
        assert contrast_of(line)[20:41, 20:41].max() < 12.0


@pytest.mark.parametrize(("ground_dn", "z_mm"), [(0.0, 467.0), (60.0, 495.5)])
def test_a_spots_centre_is_found_to_a_few_hundredths_of_a_px(bench: Bench, ground_dn: float, z_mm: float) -> None:
    """By where the dot is: the image of its place is where the spots were drawn. A neighbour does not move it."""
    at = bench.seen(on(0, z_mm))
    ranger = bench.ranger()
    left, right = (bench.picture((uv, 150.0), (uv + 5.7, 50.0), ground_dn=ground_dn) for uv in at)
    dot = ranger.find((left, right)).left
    assert dot is not None
    for side in (0, 1):
        assert ranger.pixel_of(side, dot) == pytest.approx(tuple(at[side]), abs=0.05)
