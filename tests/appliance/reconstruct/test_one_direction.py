"""Points of one direction: against a dense walk through exactly traced rays, and what is refused where there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.optics.epipolar import CurveError, epipolar_curves
from appliance.reconstruct.one_direction import (
    NoPoint,
    OneDirectionError,
    OneDirectionLimits,
    UncheckedPoints,
    match_along_curves,
)
from tests.support import dense_walk
from tests.support.dense_walk import Bench, Sheet, Sphere, Surfaces

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
BENCHES: dict[str, tuple[Callable[[], Bench], tuple[float, float]]] = {
    "as drawn": (dense_walk.as_drawn, (490.0, 555.0)),
    "as built": (dense_walk.as_built, (490.0, 555.0)),
    "in air": (dense_walk.in_air, (700.0, 920.0)),
    "stacked, fringes of rows": (dense_walk.stacked, (490.0, 555.0)),
}
BALL = Sphere((4.0, -3.0, 720.0), 205.0)
FAR_BALL = Sphere((4.0, -3.0, 1080.0), 290.0)


def ball(name: str) -> Surfaces:
    return (FAR_BALL if name == "in air" else BALL,)


def truth(surfaces: Surfaces, bench: Bench) -> NDArray[np.float64]:
    """The point that each left pixel sees, (h, w, 3)."""
    camera = bench.rig.left
    seen = dense_walk.first_hit(surfaces, camera, bench.index, dense_walk.pixels(camera))
    return seen.reshape(camera.height_px, camera.width_px, 3)


def off_um(points: UncheckedPoints, true_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances of the points found from the true ones of their pixels."""
    return np.asarray(1000.0 * np.linalg.norm(points.points_mm[points.mask] - true_mm[points.mask], axis=-1))


@pytest.mark.parametrize("name", BENCHES)
def test_points_are_those_of_a_dense_walk_through_exact_rays(name: str) -> None:
    make, z_mm = BENCHES[name]
    bench, surfaces = make(), ball(name)
    left, right = dense_walk.maps(surfaces, bench)
    found = match_along_curves(left, right, bench.rig, bench.index, z_mm)
    assert found.unchecked
    assert found.mask.sum() > 0.4 * np.isfinite(left).sum()
    # An image correction is asked by substitution: each step of such a walk takes ten times as long.
    asked = 8 if name == "as built" else 20
    v, u = (places[:: max(1, places.size // asked)] for places in np.nonzero(np.isfinite(left)))
    depths = dense_walk.walk(
        surfaces, bench, np.stack([u, v], -1).astype(float), left[v, u].astype(float), z_mm, 0.8, 4.0
    )
    both = [(found.points_mm[j, i, 2], depth) for i, j, depth in zip(u, v, depths, strict=True) if found.mask[j, i]]
    assert len(both) > 0.3 * asked
    assert [len(depth) for _, depth in both] == [1] * len(both), "one crossing each"
    assert max(abs(1000.0 * (z - depth[0])) for z, depth in both) < 1.0
    # Of what the walk finds, only what has no neighbours in either image is left out.
    true_mm = truth(surfaces, bench)
    place = bench.rig.right.project(true_mm[v, u], bench.index)
    size = (bench.rig.right.width_px, bench.rig.right.height_px)
    amid = np.all((place > 1.5) & (place < np.asarray(size) - 2.5), axis=-1) & (v > 0) & (u > 0) & (v < 179) & (u < 239)
    assert [bool(depths[k]) for k in np.flatnonzero(amid)] == [bool(one) for one in found.mask[v, u][amid]]
    away = off_um(found, true_mm)
    assert np.quantile(away, 0.999) < 1.0
    assert away.max() < 3.0


def test_right_place_is_where_the_right_camera_sees_the_point() -> None:
    bench = dense_walk.as_built()
    found = match_along_curves(*dense_walk.maps((BALL,), bench), bench.rig, bench.index, (490.0, 555.0))
    seen = bench.rig.right.project(found.points_mm[found.mask].astype(float), bench.index)
    np.testing.assert_allclose(found.right_px[found.mask], seen, atol=3e-3)


def test_nothing_is_made_up_behind_a_bar() -> None:
    """The bar hides some of the wall from the right camera that the left one sees, lit: no point may appear there."""
    bench = dense_walk.as_drawn()
    surfaces = (Sheet((0.0, 0.0, 1.0), 505.0, (-4.0, 3.0)), Sheet((0.05, 0.02, 1.0), 532.0))
    left, right = dense_walk.maps(surfaces, bench)
    found = match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0))
    true_mm = truth(surfaces, bench)
    # Truth: whether the right camera sees the point, and not another one before it.
    flat = true_mm.reshape(-1, 3)
    again = dense_walk.first_hit(surfaces, bench.rig.right, bench.index, bench.rig.right.project(flat, bench.index))
    hidden = (np.linalg.norm(again - flat, axis=-1) > 1e-3).reshape(left.shape) & np.isfinite(left)
    assert hidden.sum() > 500
    assert not (found.mask & hidden).any()
    assert off_um(found, true_mm).max() < 1.0
    inside = np.zeros(left.shape, bool)
    inside[4:-4, 4:-4] = True
    wanted = inside & np.isfinite(left) & ~hidden & (found.reason != NoPoint.OUT_OF_VIEW)
    assert (found.mask & wanted).sum() > 0.93 * wanted.sum(), "but what both see is found"
    assert found.count(NoPoint.STEP) > 500
    assert found.count(NoPoint.NO_CROSSING) > 100


def level(bench: Bench, depth_mm: float = 520.0) -> tuple[Maps, NDArray[np.float64]]:
    wall = (Sheet((0.03, -0.04, 1.0), depth_mm),)
    return dense_walk.maps(wall, bench), truth(wall, bench)


def test_a_smooth_step_between_two_surfaces_makes_no_points() -> None:
    """Coordinates as an unmasked decoder has them: pixels at the edge lie between both surfaces."""
    bench = dense_walk.as_drawn()
    (left, right), true_mm = level(bench)
    before, after = right.copy(), right.copy()
    after[:, 120:] += 30.0
    after[:, 119], after[:, 120] = before[:, 119] + 10.0, before[:, 120] + 20.0
    found = match_along_curves(left, after, bench.rig, bench.index, (490.0, 555.0))
    # Left pixels whose partner would be the columns of the step, by the unbroken map.
    whole = match_along_curves(left, before, bench.rig, bench.index, (490.0, 555.0))
    at_step = np.abs(whole.right_px[..., 0] - 119.5) < 0.4
    assert at_step.sum() > 100
    assert not found.mask[at_step].any()
    assert set(np.unique(found.reason[at_step])) <= {NoPoint.STEP, NoPoint.NO_CROSSING}
    of_before = found.mask & (whole.right_px[..., 0] < 117.0)
    assert 1000.0 * np.abs(found.points_mm - true_mm)[of_before].max() < 1.0


def test_a_dark_room_about_the_thing_does_not_let_its_edges_pass() -> None:
    """Pixels without a coordinate have the noise of hardly any light, and most of the image may be such."""
    bench = dense_walk.as_drawn()
    (left, right), _ = level(bench)
    right[:, 120:] += 30.0
    right[:, 119:121] -= np.array([-10.0, 10.0], np.float32)
    right[:, :80], right[:, 160:] = np.nan, np.nan
    noise = np.where(np.isfinite(right), np.float32(0.01), np.float32(45.0))
    assert np.isnan(right).mean() > 0.6
    lit = match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0), (0.01, 0.01))
    found = match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0), (0.01, noise))
    assert lit.count(NoPoint.STEP) > 500
    np.testing.assert_array_equal(found.reason, lit.reason)


def test_holes_in_either_image_are_named() -> None:
    bench = dense_walk.as_drawn()
    (left, right), true_mm = level(bench)
    left[60:90, 100:130] = np.nan
    right[80:110, 60:90] = np.nan
    found = match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0))
    assert (found.reason[60:90, 100:130] == NoPoint.NO_PHASE).all()
    partner = bench.rig.right.project(true_mm.reshape(-1, 3), bench.index).reshape(*left.shape, 2)
    in_hole = (np.abs(partner - [74.5, 94.5]) < 13.5).all(-1) & np.isfinite(left)
    assert in_hole.sum() > 300
    assert (found.reason[in_hole] == NoPoint.NO_CROSSING).all()
    assert off_um(found, true_mm).max() < 1.0
    assert np.isnan(found.points_mm[~found.mask]).all()
    assert np.isnan(found.right_px[~found.mask]).all()


def test_two_crossings_are_refused_unless_depths_tell_them_apart() -> None:
    """The fringes of the right image go back again half way across: each coordinate is there twice."""
    bench = dense_walk.as_drawn()
    (left, right), true_mm = level(bench)
    twice = right.copy()
    twice[:, 120:] = right[:, 119::-1]
    both = match_along_curves(left, twice, bench.rig, bench.index, (440.0, 640.0))
    near_middle = np.zeros(left.shape, bool)
    near_middle[20:160, 80:105] = True
    near_middle &= np.isfinite(
        match_along_curves(left, right, bench.rig, bench.index, (440.0, 640.0)).points_mm[..., 2]
    )
    assert near_middle.sum() > 1000
    assert (both.reason[near_middle] == NoPoint.SEVERAL).mean() > 0.9
    # The curve runs from right to left as the depth grows, so that nearer depths are the true half's mirror image.
    told = match_along_curves(left, twice, bench.rig, bench.index, (515.0, 530.0))
    found = told.mask & (np.abs(told.points_mm[..., 2] - true_mm[..., 2]) < 0.001)
    assert found[near_middle].mean() > 0.9


@pytest.mark.parametrize("name", ["as drawn", "stacked, fringes of rows"])
def test_fringes_along_the_curves_are_refused_with_the_angle(name: str) -> None:
    bench = BENCHES[name][0]()
    other = replace(bench, axis=1 - bench.axis)
    left, right = dense_walk.maps(ball(name), other)
    with pytest.raises(OneDirectionError, match=r"angle between them is \d\.\d°, at least 10° .* the other direction"):
        match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0))


def test_fringes_that_turn_along_the_curve_leave_a_gap_there() -> None:
    bench = dense_walk.as_drawn()
    (left, right), _ = level(bench)
    # Coordinates that grow downwards in a part of either image: only there fringes lie along the curve.
    v = np.arange(180)[:, None] * np.float32(0.6) + np.float32(600.0)
    left[:, 150:190], right[:, 150:190] = v, v + np.float32(0.002) * np.arange(40)
    found = match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0))
    assert found.angle_deg > 80.0
    assert not found.mask[:, 150:190].any()
    assert found.count(NoPoint.GRAZING) > 500


def test_expected_error_is_the_scatter_of_points() -> None:
    bench = dense_walk.as_drawn()
    (left, right), true_mm = level(bench)
    rng = np.random.default_rng(4)
    noise = np.full(left.shape, 0.03, np.float32)
    noise[90:] = 0.09
    noisy = [
        (one + sigma * rng.standard_normal(one.shape)).astype(np.float32)
        for one, sigma in ((left, noise), (right, 0.05))
    ]
    found = match_along_curves(noisy[0], noisy[1], bench.rig, bench.index, (490.0, 555.0), (noise, 0.05))
    assert found.mask.sum() > 0.97 * match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0)).mask.sum()
    along = np.sign((found.points_mm - true_mm)[..., 2]) * np.linalg.norm(found.points_mm - true_mm, axis=-1)
    for half in (slice(0, 90), slice(90, None)):
        ratio = along[half] / found.sigma_mm[half]
        assert float(np.nanstd(ratio)) == pytest.approx(1.0, abs=0.03)
        assert abs(float(np.nanmean(ratio))) < 0.05
    assert np.isnan(found.sigma_mm[~found.mask]).all()


def test_a_scattered_coordinate_makes_a_lonely_point_and_a_large_error_none() -> None:
    bench = dense_walk.as_drawn()
    (left, right), _ = level(bench)
    left[100, 100] += 3.0
    limits = OneDirectionLimits(max_sigma_mm=0.03)
    found = match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0), limits=limits)
    assert found.reason[100, 100] == NoPoint.LONELY
    assert found.mask[102, 100]
    assert not match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0), (0.2, 0.2), limits).mask.any()
    assert match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0), (0.01, 0.01), limits).mask.any()


def test_what_cannot_be_searched_is_refused_in_words() -> None:
    bench = dense_walk.as_drawn()
    (left, right), _ = level(bench)
    with pytest.raises(OneDirectionError, match=r"right coordinates are 239x180 px, .* right camera has 240x180"):
        match_along_curves(left, right[:, 1:], bench.rig, bench.index, (490.0, 555.0))
    with pytest.raises(OneDirectionError, match="left image has no coordinate"):
        match_along_curves(np.full_like(left, np.nan), right, bench.rig, bench.index, (490.0, 555.0))
    with pytest.raises(OneDirectionError, match="noise is a map"):
        match_along_curves(left, right, bench.rig, bench.index, (490.0, 555.0), (np.ones((3, 4), np.float32), 0.1))
    for z_mm, words in (
        ((555.0, 490.0), "no range"),
        ((0.0, 490.0), "no range"),
        ((20.0, 600.0), "begin farther away"),
        ((5000.0, 6000.0), "sees nothing between 5000 and 6000"),
    ):
        with pytest.raises(CurveError, match=words):
            match_along_curves(left, right, bench.rig, bench.index, z_mm)


@pytest.mark.parametrize(("name", "z_mm"), [("as built", (380.0, 680.0)), ("in air", (300.0, 3000.0))])
def test_curves_are_where_the_right_camera_sees_the_rays_points(name: str, z_mm: tuple[float, float]) -> None:
    bench = BENCHES[name][0]()
    curves = epipolar_curves(bench.rig, bench.index, z_mm)
    assert curves.error_px < 3e-4
    rows, columns = curves.nodes.shape[:2]
    across_px, down_px = curves.spacing_px
    checked = 0
    for j, i in ((0, 0), (rows // 2, columns // 3), (rows // 2, columns // 2), (rows - 1, columns - 1)):
        low, high = curves.seen[j, i]
        if low > high:
            continue
        s = np.linspace(low, high, 40)
        z = curves.depth_mm(s)
        x0, y0, sx, sy = curves.nodes[j, i, :4]
        origin, direction = bench.rig.left.rays(np.array([i * across_px, j * down_px]), bench.index)
        points = origin + direction * ((z - origin[2]) / direction[2])[:, None]
        np.testing.assert_allclose(np.stack([x0 + sx * z, y0 + sy * z, z], -1), points, atol=1e-9)
        terms = curves.nodes[j, i, 4:].reshape(2, -1)
        place = np.stack([np.polynomial.polynomial.polyval(s, one) for one in terms], -1)
        exact = bench.rig.right.project(points, bench.index)
        inside = np.all((exact > 0.0) & (exact < 240.0), axis=-1)
        checked += int(inside.sum())
        np.testing.assert_allclose(place[inside], exact[inside], atol=3e-3)
    assert checked > 10


def test_a_lens_that_folds_far_points_back_into_its_image_does_not_see_them() -> None:
    bench = dense_walk.in_air()
    lens = replace(bench.rig.right.lens, distortion=(-0.9, 0.0, 0.0, 0.0, 0.0))
    rig = replace(bench.rig, right=replace(bench.rig.right, lens=lens))
    curves = epipolar_curves(rig, 1.0, (120.0, 900.0))
    s_of_fold = curves.seen[..., 0]
    # At 120 mm the ray's point lies 60° off the right camera's axis; r (1 − 0.9 r²) turns back at r = 0.61, 31°.
    assert np.isfinite(s_of_fold).all()
    assert (s_of_fold > -0.9).all()
