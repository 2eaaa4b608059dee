"""Which bright spots in a pair of pictures are taken for dots: spots drawn where the simulator's optics sees given places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.ranging.beams import PointerBeam
from appliance.ranging.dots import Lane, contrast_of
from appliance.ranging.measure import Dots, Images, Ranger
from hw_sim.truth import TrueRig, draw_truth, project
from tests.support.truth import WATER, left_to_rig, true_calibration

Array = NDArray[np.float64]
SIDES = ("left", "right")
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
        self._lattice = np.mgrid[: width_px * 3 // 4, :width_px]
        self.step = width_px // 400

    def ranger(self, *, beams: tuple[PointerBeam, PointerBeam] = BEAMS, measured: bool = True) -> Ranger:
        return Ranger(self.rig, WATER.index, beams, measured)

    def seen(self, place_mm: Array) -> tuple[Array, Array]:
        """Pixels of a place of the instrument's frame in the left and the right picture."""
        there = left_to_rig(self.truth, self.frame.to_left(place_mm)[None])
        return project(self.truth, "left", there)[0], project(self.truth, "right", there)[0]

    def picture(self, *spots: tuple[Array, float], ground_dn: float = 0.0) -> NDArray[np.uint8]:
        y, x = self._lattice
        light = np.full(x.shape, ground_dn)
        for (u, v), height_dn in spots:
            light += height_dn * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * (1.5 * self.step) ** 2))
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


@pytest.mark.parametrize("width_px", [400, 1600])
@pytest.mark.parametrize("z_mm", [360.0, 440.0, 500.0, 600.0, 700.0])
def test_a_dot_is_where_both_cameras_see_it(width_px: int, z_mm: float) -> None:
    """Also in pictures of full size, which are looked at in a quarter of it."""
    bench = Bench(width_px)
    found = bench.ranger().find(bench.pair((on(0, z_mm), HEIGHT_DN, HEIGHT_DN)))
    assert found.left is not None
    assert found.right is None
    assert found.left.place_mm == pytest.approx(tuple(on(0, z_mm)), abs=0.25)
    assert found.left.cameras == 2
    assert 0.3 < found.left.sigma_mm < 1.2
    assert HEIGHT_DN / 3 < found.left.contrast_dn < HEIGHT_DN


def test_of_a_nearer_dot_the_depth_is_more_certain(bench: Bench) -> None:
    """Its uncertainty is that of the spots' centres, 0.12 px each, by how flat their rays cross; and 0.3 mm of its own."""
    middle_mm, half_base_mm = 30.0, 0.5 * float(np.linalg.norm(bench.rig.right.translation_mm))
    sigma = {}
    for z_mm in (400.0, 650.0):
        dot = bench.ranger().find(bench.pair((on(0, z_mm), HEIGHT_DN, HEIGHT_DN))).left
        assert dot is not None
        f_px = bench.truth.left.f_px[0] * WATER.index
        way_mm = float(np.hypot(z_mm, half_base_mm - middle_mm))
        sine = 2.0 * half_base_mm * z_mm / (z_mm**2 + half_base_mm**2)
        expected = np.hypot(np.sqrt(2.0) * 0.12 * way_mm / f_px / sine, 0.3)
        assert 0.95 * expected < dot.sigma_mm < 1.01 * expected, "the way begins at the port, not at the centre"
        sigma[z_mm] = dot.sigma_mm
    assert sigma[650.0] > 1.3 * sigma[400.0]


def test_only_the_pointers_that_are_lit_are_looked_for(bench: Bench) -> None:
    pair = bench.pair((on(0, 480.0), 200.0, 200.0), (on(1, 500.0), 200.0, 200.0))
    both = bench.ranger().find(pair)
    assert both.left is not None
    assert both.right is not None
    assert both.right.place_mm == pytest.approx(tuple(on(1, 500.0)), abs=0.25)
    one = bench.ranger().find(pair, (False, True))
    assert (one.left is None, one.right is None) == (True, False)


@pytest.mark.parametrize(("other_dn", "met"), [(60.0, True), (30.0, False)])
@pytest.mark.parametrize("side", [0, 1])
def test_a_dot_has_at_least_a_fifth_of_its_contrast_in_the_other_camera(
    bench: Bench, side: int, other_dn: float, met: bool
) -> None:
    heights = (HEIGHT_DN, other_dn) if side == 0 else (other_dn, HEIGHT_DN)
    found = bench.ranger().find(bench.pair((on(1, 480.0), *heights)))
    assert (found.right is not None and found.right.cameras == 2) == met


@pytest.mark.parametrize(("gap_mm", "met"), [(0.0, True), (0.45, True), (0.85, False), (-0.85, False)])
def test_rays_that_pass_each_other_come_from_two_things(bench: Bench, gap_mm: float, met: bool) -> None:
    place = on(0, 450.0)
    left, _ = bench.seen(place + np.array([0.0, 0.5 * gap_mm, 0.0]))
    _, right = bench.seen(place - np.array([0.0, 0.5 * gap_mm, 0.0]))
    pair = bench.picture((left, HEIGHT_DN)), bench.picture((right, HEIGHT_DN))
    found = bench.ranger().find(pair).left
    assert (found is not None and found.cameras == 2) == met


@pytest.mark.parametrize(("off_mm", "met"), [(0.0, True), (1.6, True), (-1.6, True), (2.4, False), (-2.4, False)])
def test_a_spot_beside_a_beam_that_is_known_is_no_dot_of_it(bench: Bench, off_mm: float, met: bool) -> None:
    """3.5 standard deviations: 0.5 mm of the dot, 0.2 mm of the calibration and 0.1 mm of the beam."""
    found = bench.ranger().find(bench.pair((on(0, 500.0, off_mm=(0.0, off_mm)), HEIGHT_DN, HEIGHT_DN))).left
    assert (found is not None) == met


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


@pytest.mark.parametrize(("second_dn", "told"), [(70.0, True), (130.0, False)])
def test_two_places_that_are_nearly_as_clear_make_both_doubtful(bench: Bench, second_dn: float, told: bool) -> None:
    pair = bench.pair((on(1, 440.0), HEIGHT_DN, HEIGHT_DN), (on(1, 560.0), second_dn, second_dn))
    found = bench.ranger().find(pair).right
    assert (found is not None) == told
    if found is not None:
        assert found.place_mm[2] == pytest.approx(440.0, abs=0.5)


@pytest.mark.parametrize(("z_mm", "looked_for"), [(330.0, False), (356.0, True), (712.0, True), (745.0, False)])
def test_nothing_is_a_dot_that_is_nearer_or_farther_than_the_instrument_looks(
    bench: Bench, z_mm: float, looked_for: bool
) -> None:
    found = bench.ranger().find(bench.pair((on(0, z_mm), HEIGHT_DN, HEIGHT_DN))).left
    assert (found is not None) == looked_for


# ------------------------------------------------------------------------------------------- one camera alone


@pytest.mark.parametrize("pointer", [0, 1])
@pytest.mark.parametrize("z_mm", [450.0, 520.0])
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
    assert dot.place_mm == pytest.approx(tuple(on(pointer, z_mm)), abs=0.1)
    eye_mm = bench.frame.from_left(np.zeros(3) if pointer == 1 else np.array(bench.rig.right.translation_mm))
    ray, beam = on(pointer, z_mm) - eye_mm, on(pointer, 600.0) - on(pointer, 400.0)
    sine = np.linalg.norm(np.cross(ray, beam)) / np.linalg.norm(ray) / np.linalg.norm(beam)
    centre_mm = 0.12 * np.linalg.norm(ray) / (bench.truth.left.f_px[0] * WATER.index)
    across_mm = np.sqrt(0.1**2 + 1e-9 * (z_mm - 30.0) ** 2 + 0.2**2 + 0.5**2 + centre_mm**2)
    assert dot.sigma_mm == pytest.approx(across_mm / sine, rel=0.06)


@pytest.mark.parametrize(("height_dn", "believed"), [(110.0, True), (78.0, False)])
def test_what_one_camera_sees_alone_has_to_be_bright(bench: Bench, height_dn: float, believed: bool) -> None:
    """50 grey values of contrast."""
    pair = bench.pair((on(1, 490.0), height_dn, 0.0))
    contrast = float(contrast_of(pair[0]).max())
    assert 40.0 < contrast < 49.0 if not believed else 55.0 < contrast < 95.0
    assert (after(bench.ranger(), *5 * [pair]).right is not None) == believed


@pytest.mark.parametrize(
    ("step_mm", "believed"), [(0.0, True), (6.0, True), (-6.0, True), (11.0, False), (-11.0, False)]
)
def test_what_one_camera_sees_alone_does_not_jump(bench: Bench, step_mm: float, believed: bool) -> None:
    pairs = [bench.pair((on(1, 490.0 + step_mm * k), HEIGHT_DN, 0.0)) for k in range(5)]
    assert (after(bench.ranger(), *pairs).right is not None) == believed


def test_what_one_camera_sees_alone_is_forgotten_as_soon_as_it_is_gone(bench: Bench) -> None:
    ranger, pair, nothing = bench.ranger(), bench.pair((on(1, 490.0), HEIGHT_DN, 0.0)), bench.pair()
    assert after(ranger, pair, pair, pair, nothing, pair, pair, pair).right is None
    assert after(ranger, pair).right is not None
    other = bench.pair((on(1, 490.0), 0.0, HEIGHT_DN))
    assert after(ranger, other).right is None, "another camera's spot is another spot"


def test_what_one_camera_sees_alone_is_not_believed_before_the_first_calibration(bench: Bench) -> None:
    pair = bench.pair((on(1, 490.0), HEIGHT_DN, 0.0))
    assert after(bench.ranger(measured=False), *5 * [pair]).right is None


@pytest.mark.parametrize(
    ("left_dn", "z_mm", "believed"),
    [(105.0, 500.0, True), (62.0, 500.0, False), (200.0, 450.0, True), (200.0, 520.0, True), (200.0, 436.0, False)],
)
def test_a_dot_that_one_camera_sees_is_believed_at_once_beside_the_other_pointers_on_the_same_surface(
    bench: Bench, left_dn: float, z_mm: float, believed: bool
) -> None:
    """With two fifths of its contrast, and not farther before or behind it than beside it."""
    across_mm = float(on(1, 490.0)[0] - on(0, z_mm)[0])
    assert (abs(z_mm - 490.0) < across_mm) == (z_mm != 436.0)
    found = bench.ranger().find(bench.pair((on(0, z_mm), 0.0, left_dn), (on(1, 490.0), HEIGHT_DN, HEIGHT_DN)))
    assert found.right is not None
    assert (found.left is not None) == believed


def test_a_faint_spot_is_not_borne_out_by_another_faint_one(bench: Bench) -> None:
    """By a contrast of 13 grey values it is not, by one of 20 it is; the other's is 19."""
    for left_dn, believed in ((23.0, False), (35.0, True)):
        found = bench.ranger().find(bench.pair((on(0, 500.0), 0.0, left_dn), (on(1, 490.0), 33.0, 33.0)))
        assert found.right is not None
        assert (found.left is not None) == believed


# --------------------------------------------------------------------------------------- without a calibration


@pytest.mark.parametrize(("height_dn", "believed"), [(27.0, False), (48.0, True)])
def test_by_the_drawing_a_dot_has_to_be_clear(bench: Bench, height_dn: float, believed: bool) -> None:
    """20 grey values of contrast: rays meet nearly everywhere then."""
    pair = bench.pair((on(0, 490.0), height_dn, height_dn))
    contrast = float(contrast_of(pair[0]).max())
    assert 11.0 < contrast < 19.0 if not believed else 22.0 < contrast < 38.0
    assert (bench.ranger(measured=False).find(pair).left is not None) == believed
    assert bench.ranger().find(pair).left is not None, "a measured calibration knows better"


@pytest.mark.parametrize(("gap_mm", "met"), [(6.0, True), (10.0, False)])
def test_by_the_drawing_rays_may_pass_each_other_by_8_mm(bench: Bench, gap_mm: float, met: bool) -> None:
    place = on(0, 450.0)
    left, _ = bench.seen(place + np.array([0.0, 0.5 * gap_mm, 0.0]))
    _, right = bench.seen(place - np.array([0.0, 0.5 * gap_mm, 0.0]))
    pair = bench.picture((left, HEIGHT_DN)), bench.picture((right, HEIGHT_DN))
    broad = (
        replace(BEAMS[0], covariance=tuple(tuple(row) for row in np.diag([25.0, 25.0, 0.0, 0.0]).tolist())),
        BEAMS[1],
    )
    assert (bench.ranger(beams=broad, measured=False).find(pair).left is not None) == met


def test_by_the_drawing_no_dot_teaches_a_beam(bench: Bench) -> None:
    pair = bench.pair((on(0, 490.0), HEIGHT_DN, HEIGHT_DN))
    for measured, learned in ((False, 0), (True, 1)):
        ranger = bench.ranger(measured=measured)
        ranger.measure(pair)
        assert [beam.learned for beam in ranger.beams] == [learned, 0]


def test_only_what_both_cameras_saw_teaches_a_beam(bench: Bench) -> None:
    ranger = bench.ranger()
    pair = bench.pair((on(0, 500.0), 0.0, HEIGHT_DN), (on(1, 490.0), HEIGHT_DN, HEIGHT_DN))
    found = ranger.find(pair)
    assert found.left is not None
    ranger.learn(found)
    assert [beam.learned for beam in ranger.beams] == [0, 1]


def test_a_beam_that_was_learned_elsewhere_is_looked_for_there(bench: Bench) -> None:
    """A beam drawn 4 mm beside where it is: after one dot the other place on the beam is looked at, and the old one is not."""
    off = (replace(BEAMS[0], line=(-60.0, 14.0, 0.085, -0.01), covariance=tuple(tuple(row) for row in np.diag([4.0, 4.0, 1e-7, 1e-7]).tolist())), BEAMS[1])  # fmt: skip
    ranger = bench.ranger(beams=off)
    for z_mm in (450.0, 470.0, 490.0, 510.0):
        ranger.measure(bench.pair((on(0, z_mm), HEIGHT_DN, HEIGHT_DN)))
    assert ranger.beams[0].learned == 4
    assert np.linalg.norm(ranger.beams[0].at(np.array(480.0)) - on(0, 480.0)) < 0.5
    assert ranger.find(bench.pair((on(0, 480.0, off_mm=(0.0, 9.0)), HEIGHT_DN, HEIGHT_DN))).left is None


# ------------------------------------------------------------------------------------------------- the picture


def broad(pointer: int, sd_mm: float) -> PointerBeam:
    """A beam that is known so badly."""
    variances = np.diag([sd_mm**2, sd_mm**2, 0.0, 0.0])
    return replace(BEAMS[pointer], covariance=tuple(tuple(row) for row in variances.tolist()))


@pytest.mark.parametrize(("off_mm", "inside"), [(9.0, True), (-9.0, True), (15.5, False), (-15.5, False)])
@pytest.mark.parametrize("side", [0, 1])
def test_the_less_certain_a_beam_is_the_farther_beside_it_its_dot_is_looked_for(
    bench: Bench, side: int, off_mm: float, inside: bool
) -> None:
    """3.5 standard deviations of 3 mm, and 2 px."""
    camera = (bench.rig.left, bench.rig.right)[side]
    lane = Lane(camera, bench.frame, WATER.index, broad(0, 3.0))
    uv = bench.seen(on(0, 500.0, off_mm=(0.0, off_mm)))[side]
    found = lane.candidates(bench.picture((uv, HEIGHT_DN)))
    assert bool(found) == inside
    if inside:
        assert (found[0].u_px, found[0].v_px) == pytest.approx(tuple(uv), abs=0.05)


def faint_spot(bench: Bench, u: float, v: float) -> NDArray[np.uint8]:
    """A spot of which one px alone is bright enough to be a dot."""
    for height_dn in np.arange(10.0, 16.0, 0.1):
        picture = bench.picture((np.array([u, v]), float(height_dn)), ground_dn=3.0)
        if np.count_nonzero(contrast_of(picture) >= 7.0) == 1:
            return picture
    raise AssertionError("there is such a height")


@pytest.mark.parametrize(
    ("u", "v", "looked_at"),
    [
        (200, 150, True),
        (8, 150, True),
        (7, 150, False),
        (391, 150, True),
        (392, 150, False),
        (200, 8, True),
        (200, 7, False),
        (200, 291, True),
        (200, 292, False),
    ],
)
def test_a_dot_is_looked_for_where_its_surroundings_are_in_the_picture(
    bench: Bench, u: int, v: int, looked_at: bool
) -> None:
    """8 px from the border on: a ring of 6 px, and what smooths it."""
    lane = Lane(bench.rig.left, bench.frame, WATER.index, broad(0, 300.0))
    assert bool(lane.candidates(faint_spot(bench, u, v))) == looked_at


@pytest.mark.parametrize(("height_dn", "seen"), [(11.5, False), (13.5, True)])
def test_what_is_fainter_than_7_grey_values_is_no_dot(bench: Bench, height_dn: float, seen: bool) -> None:
    lane = Lane(bench.rig.left, bench.frame, WATER.index, BEAMS[0])
    uv = np.rint(bench.seen(on(0, 480.0))[0])
    picture = bench.picture((uv, height_dn))
    assert 5.5 < contrast_of(picture).max() < 7.0 if not seen else 7.0 < contrast_of(picture).max() < 9.0
    assert bool(lane.candidates(picture)) == seen


def test_of_many_bright_spots_the_four_clearest_are_candidates_the_clearest_first(bench: Bench) -> None:
    lane = Lane(bench.rig.left, bench.frame, WATER.index, broad(0, 300.0))
    heights = (60.0, 150.0, 90.0, 30.0, 120.0, 180.0)
    spots = [(np.array([60.0 + 55.0 * k, 150.0]), height) for k, height in enumerate(heights)]
    found = lane.candidates(bench.picture(*spots))
    assert [round(one.u_px) for one in found] == [335, 115, 280, 170]
    assert [one.contrast_dn for one in found] == sorted((one.contrast_dn for one in found), reverse=True)


def test_a_beam_that_passes_beside_the_picture_has_no_dot_in_it(bench: Bench) -> None:
    beside = replace(BEAMS[0], line=(-2000.0, 10.0, 0.085, -0.01))
    lane = Lane(bench.rig.left, bench.frame, WATER.index, beside)
    assert lane.candidates(bench.picture((np.array([200.0, 150.0]), 200.0))) == []


def test_the_contrast_of_a_spot_is_its_height_over_the_brightest_around_it_after_smoothing() -> None:
    """A Gaussian of sigma 1.5 px, smoothed by 1.2 px, against itself 5.4 px away."""
    y, x = np.mgrid[:41, :41] - 20.0
    for ground in (0.0, 50.0):
        spot = ground + 100.0 * np.exp(-(x**2 + y**2) / (2.0 * 1.5**2))
        wide = 1.5**2 + 1.2**2
        expected = 100.0 * 1.5**2 / wide * (1.0 - np.exp(-(5.4**2) / (2.0 * wide)))
        contrast = contrast_of(spot)
        assert int(np.argmax(contrast)) == 20 * 41 + 20
        assert float(contrast[20, 20]) == pytest.approx(expected, rel=0.02)


def test_what_is_as_bright_four_sigmas_away_is_no_dot() -> None:
    """A stripe, an edge, and a streak that ends in the spot; a spot with another one twice as far away is one."""
    y, x = np.mgrid[:61, :61] - 30.0
    spot = 100.0 * np.exp(-(x**2 + y**2) / (2.0 * 1.5**2))
    streak = 100.0 * np.exp(-(y**2) / (2.0 * 1.5**2)) * (x > 0)
    far = 100.0 * np.exp(-((x - 13.0) ** 2 + y**2) / (2.0 * 1.5**2))
    near = 100.0 * np.exp(-((x - 6.0) ** 2 + y**2) / (2.0 * 1.5**2))
    assert contrast_of(spot + far)[30, 30] > 50.0
    for other in (streak, near):
        assert contrast_of(np.maximum(spot, other))[30, 30] < 5.0


@pytest.mark.parametrize("ground_dn", [0.0, 60.0])
@pytest.mark.parametrize("z_mm", [467.0, 481.0, 495.5, 512.0])
def test_a_spots_centre_is_found_to_a_few_hundredths_of_a_px_on_any_ground(
    bench: Bench, ground_dn: float, z_mm: float
) -> None:
    """By where the dot is: the image of its place is where the spots were drawn."""
    at = bench.seen(on(0, z_mm))
    ranger = bench.ranger()
    left, right = (bench.picture((uv, 150.0), ground_dn=ground_dn) for uv in at)
    dot = ranger.find((left, right)).left
    assert dot is not None
    for side in (0, 1):
        assert ranger.pixel_of(side, dot) == pytest.approx(tuple(at[side]), abs=0.03)
