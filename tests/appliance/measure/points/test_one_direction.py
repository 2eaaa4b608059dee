"""Points of one direction: against a dense walk through exactly traced rays, and what is refused where there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.light.epipolar import CurveError
from appliance.measure.points.one_direction import NoPoint, OneDirectionError, UncheckedPoints, match_along_curves
from tests.support import dense_walk
from tests.support.dense_walk import Bench, Sheet, Sphere, Surfaces

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
BENCHES: dict[str, Callable[[], Bench]] = {"as built": dense_walk.as_built, "stacked": dense_walk.stacked}
"""Side by side and with an image correction; above each other and with fringes of rows."""
DEPTHS_MM = 490.0, 555.0
BALL: Surfaces = (Sphere((4.0, -3.0, 720.0), 205.0),)


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
    bench, surfaces = BENCHES[name](), BALL
    left, right = dense_walk.maps(surfaces, bench)
    found = match_along_curves(left, right, bench.rig, bench.index, DEPTHS_MM)
    assert found.unchecked
    assert found.mask.sum() > 0.4 * np.isfinite(left).sum()
    # An image correction is asked by substitution: each step of such a walk takes ten times as long.
    asked = 4 if name == "as built" else 8
    v, u = (places[:: max(1, places.size // asked)] for places in np.nonzero(np.isfinite(left)))
    uv = np.stack([u, v], -1).astype(float)
    depths = dense_walk.walk(surfaces, bench, uv, left[v, u].astype(float), DEPTHS_MM, 0.8, 4.0)
    both = [(found.points_mm[j, i, 2], depth) for i, j, depth in zip(u, v, depths, strict=True) if found.mask[j, i]]
    assert len(both) > 0.3 * asked
    assert [len(depth) for _, depth in both] == [1] * len(both), "one crossing each"
    assert max(abs(1000.0 * (z - depth[0])) for z, depth in both) < 1.0
    away = off_um(found, truth(surfaces, bench))
    assert np.quantile(away, 0.999) < 1.0
    assert away.max() < 3.0


def test_nothing_is_made_up_behind_a_bar() -> None:
    """The bar hides some of the wall from the right camera that the left one sees, lit: no point may appear there."""
    bench = dense_walk.as_drawn()
    surfaces = (Sheet((0.0, 0.0, 1.0), 505.0, (-4.0, 3.0)), Sheet((0.05, 0.02, 1.0), 532.0))
    left, right = dense_walk.maps(surfaces, bench)
    found = match_along_curves(left, right, bench.rig, bench.index, DEPTHS_MM)
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


def test_two_crossings_are_refused_unless_depths_tell_them_apart() -> None:
    """The fringes of the right image go back again half way across: each coordinate is there twice."""
    bench = dense_walk.as_drawn()
    (left, right), true_mm = level(bench)
    twice = right.copy()
    twice[:, 120:] = right[:, 119::-1]
    once, both = (match_along_curves(left, one, bench.rig, bench.index, (440.0, 640.0)) for one in (right, twice))
    near_middle = np.zeros(left.shape, bool)
    near_middle[20:160, 80:105] = True
    near_middle &= once.mask
    assert near_middle.sum() > 1000
    assert (both.reason[near_middle] == NoPoint.SEVERAL).mean() > 0.9
    # The curve runs from right to left as the depth grows, so that nearer depths are the true half's mirror image.
    told = match_along_curves(left, twice, bench.rig, bench.index, (515.0, 530.0))
    found = told.mask & (np.abs(told.points_mm[..., 2] - true_mm[..., 2]) < 0.001)
    assert found[near_middle].mean() > 0.9


@pytest.mark.parametrize("name", BENCHES)
def test_fringes_along_the_curves_are_refused_with_the_angle(name: str) -> None:
    bench = BENCHES[name]()
    other = replace(bench, axis=1 - bench.axis)
    left, right = dense_walk.maps(BALL, other)
    with pytest.raises(OneDirectionError, match=r"angle between them is \d\.\d°, at least 10° .* the other direction"):
        match_along_curves(left, right, bench.rig, bench.index, DEPTHS_MM)


def test_what_cannot_be_searched_is_refused_in_words() -> None:
    bench = dense_walk.as_drawn()
    (left, right), _ = level(bench)
    ones = np.ones((3, 4), np.float32)
    for seen, noise, words in (
        ((left, right[:, 1:]), (0.1, 0.1), r"right coordinates are 239x180 px, .* right camera has 240x180"),
        ((np.full_like(left, np.nan), right), (0.1, 0.1), "left image has no coordinate"),
        ((left, right), (ones, 0.1), "noise is a map"),
    ):
        with pytest.raises(OneDirectionError, match=words):
            match_along_curves(*seen, bench.rig, bench.index, DEPTHS_MM, noise)
    for z_mm, words in (
        ((555.0, 490.0), "no range"), ((0.0, 490.0), "no range"), ((20.0, 600.0), "begin farther away"),
        ((5000.0, 6000.0), "sees nothing between 5000 and 6000"),
    ):  # fmt: skip
        with pytest.raises(CurveError, match=words):
            match_along_curves(left, right, bench.rig, bench.index, z_mm)
