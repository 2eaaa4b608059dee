"""Correspondence against maps in closed form: where the right point lies, its derivatives, and where there is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from appliance.reconstruct.match import RightMaps, fill_inverse_map, match_row, right_maps
from appliance.reconstruct.scratch import (
    BEND_RIGHT,
    MODULATION_RIGHT,
    RIGHT_SHARE,
    SIZE,
    SLOPE,
    U_START,
    UP,
    UQ,
    V_START,
    VP,
    VQ,
    P,
    Q,
    U,
    V,
)

WIDTH, HEIGHT = 160, 120
PROJECTOR = (512, 384)
Surface = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def sheared(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 40.0 + 2.5 * u + 0.3 * v, 30.0 - 0.2 * u + 2.2 * v


def bent(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, q = sheared(u, v)
    return p + 0.004 * (u - 80.0) ** 2 - 0.002 * (v - 60.0) ** 2, q + 0.003 * (v - 60.0) ** 2 + 0.001 * (u - 80.0) ** 2


def maps_of(
    surface: Surface, holes: tuple[slice, slice] | None = None, projector: tuple[int, int] = PROJECTOR
) -> RightMaps:
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    p, q = surface(u, v)
    if holes is not None:
        p[holes], q[holes] = np.nan, np.nan
    modulation = (100 + (u + 2 * v) % 100).astype(np.uint8)
    right = right_maps(p.astype(np.float32), q.astype(np.float32), modulation, *projector)
    fill_inverse_map(right, 1)
    return right


class Row:
    """A scratch row with the coordinates of right points (n,), matched; ``above``: the row matched before it."""

    def __init__(
        self, right: RightMaps, surface: Surface, u: np.ndarray, v: np.ndarray, above: Row | None = None
    ) -> None:
        self.n = len(u)
        self.s = np.full(SIZE, np.nan, np.float32)
        self[P], self[Q] = surface(u, v)
        before = self.s if above is None else above.s
        match_row(right, before, self.s, self.s, self.n, above is not None, np.empty(self.n, np.int32))

    def __getitem__(self, place: int) -> np.ndarray:
        values: np.ndarray = self.s[place : place + self.n].astype(float)
        return values

    def __setitem__(self, place: int, values: np.ndarray) -> None:
        self.s[place : place + self.n] = values

    @property
    def matched(self) -> np.ndarray:
        found: np.ndarray = np.isfinite(self[U])
        return found


def somewhere(seed: int, n: int = 70) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(8.0, WIDTH - 9.0, n), rng.uniform(8.0, HEIGHT - 9.0, n)


@pytest.mark.parametrize(("surface", "within_px"), [(sheared, 2e-4), (bent, 4e-3)])
def test_a_point_is_found_where_its_coordinates_are(surface: Surface, within_px: float) -> None:
    u, v = somewhere(1)
    row = Row(maps_of(surface), surface, u, v)
    assert row.matched.all()
    assert np.abs(row[U] - u).max() < within_px
    assert np.abs(row[V] - v).max() < within_px


def test_the_row_above_leads_to_the_same_points() -> None:
    right = maps_of(bent)
    u, v = np.linspace(12.3, 140.7, 70), np.linspace(40.0, 60.0, 70)
    first = Row(right, bent, u, v)
    for step in (0.3, 1.0, 2.4):
        below = Row(right, bent, u + 0.4 * step, v + step, first)
        alone = Row(right, bent, u + 0.4 * step, v + step)
        assert below.matched.all()
        assert np.abs(below[U] - (u + 0.4 * step)).max() < 4e-3
        np.testing.assert_allclose(below[U], alone[U], atol=1e-3)
        np.testing.assert_allclose(below[V], alone[V], atol=1e-3)


def nearest_pixel_was_read(row: Row) -> bool:
    """Whether the short way over the whole row chose each point's pixel; what it misses is found one by one, slowly."""
    found: bool = (np.abs(row[U_START] - row[U]) < 0.76).all() and (np.abs(row[V_START] - row[V]) < 0.76).all()
    return found


def test_on_a_smooth_surface_the_inverse_map_leads_the_short_way_to_every_point() -> None:
    def wide(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 40.0 + 0.6 * u + 0.05 * v, 100.0 - 0.02 * u + 0.7 * v

    v, u = np.mgrid[0:40, 0:1600].astype(float)
    p, q = (x.astype(np.float32) for x in wide(u, v))
    right = right_maps(p, q, np.full(p.shape, 150, np.uint8), 1024, 768)
    fill_inverse_map(right, 1)
    row = Row(right, wide, np.linspace(12.3, 1580.7, 400), np.linspace(6.2, 32.7, 400))
    assert row.matched.all()
    assert nearest_pixel_was_read(row)


def test_the_row_above_is_enough_to_know_where_to_look() -> None:
    right = maps_of(bent)
    u, v = np.linspace(12.3, 140.7, 70), np.linspace(40.0, 60.0, 70)
    first = Row(right, bent, u, v)
    right.inverse[:, :] = 0
    for step in (0.3, 1.0, 2.4):
        below = Row(right, bent, u + 0.4 * step, v + step, first)
        assert below.matched.all()
        assert nearest_pixel_was_read(below)


def test_a_node_that_only_a_hole_meets_knows_a_pixel_beside_the_hole() -> None:
    right = maps_of(sheared, (slice(48, 62), slice(66, 90)))
    # Node 12 · 20 px, 7 · 20 px: all the pixels that would round to it are missing.
    y, x = divmod(int(right.inverse[7 + 1, 12 + 1]), 65536)
    assert (x, y) != (0, 0)
    assert abs(right.p_px[y, x] - 240.0) <= 30.2
    assert abs(right.q_px[y, x] - 140.0) <= 30.2


def test_the_derivatives_are_those_of_the_inverse_map() -> None:
    u, v = somewhere(2)
    row = Row(maps_of(sheared), sheared, u, v)
    inverse = np.linalg.inv(np.array([[2.5, 0.3], [-0.2, 2.2]]))
    # du = UP dp − UQ dq, dv = VQ dq − VP dp
    np.testing.assert_allclose(row[UP], inverse[0, 0], rtol=1e-4)
    np.testing.assert_allclose(row[UQ], -inverse[0, 1], rtol=1e-3)
    np.testing.assert_allclose(row[VQ], inverse[1, 1], rtol=1e-4)
    np.testing.assert_allclose(row[VP], -inverse[1, 0], rtol=1e-3)
    np.testing.assert_allclose(row[SLOPE], 2.5, rtol=1e-4)


def test_bend_modulation_and_share_of_noise_are_those_of_the_nearest_pixel() -> None:
    u, v = somewhere(3)
    right = maps_of(bent)
    row = Row(right, bent, u, v)
    nu, nv = np.rint(u).astype(int), np.rint(v).astype(int)
    np.testing.assert_allclose(row[BEND_RIGHT], 0.5 * (0.008 - 0.004), atol=2e-4)
    du, dv = u - nu, v - nv
    sure = (np.abs(du) < 0.48) & (np.abs(dv) < 0.48) & row.matched
    assert sure.sum() > 50
    np.testing.assert_array_equal(row[MODULATION_RIGHT][sure], 0.5 * right.modulation_half_dn[nv, nu][sure])
    weights = [1 - du**2 - dv**2, (du**2 + du) / 2, (du**2 - du) / 2, (dv**2 + dv) / 2, (dv**2 - dv) / 2]
    share = sum(w**2 for w in weights)
    np.testing.assert_allclose(row[RIGHT_SHARE][sure], share[sure], atol=0.005)


def test_beside_a_hole_one_neighbour_is_enough_and_in_it_there_is_none() -> None:
    right = maps_of(sheared, (slice(50, 60), slice(70, 90)))
    inside = Row(right, sheared, np.linspace(73.0, 86.0, 14), np.full(14, 55.0))
    assert not inside.matched.any()
    for u, v in ((69.2, 55.3), (90.3, 54.7), (80.2, 49.1), (79.7, 60.2)):
        row = Row(right, sheared, np.array([u]), np.array([v]))
        assert row.matched.all(), (u, v)
        assert row[U][0] == pytest.approx(u, abs=1e-3)
        assert row[V][0] == pytest.approx(v, abs=1e-3)
        np.testing.assert_allclose([row[UP][0], row[UQ][0], row[SLOPE][0]], [0.39568, 0.05396, 2.5], rtol=2e-3)
        np.testing.assert_allclose([row[VQ][0], row[VP][0]], [0.44964, -0.03597], rtol=2e-3)
        nearest = right.modulation_half_dn[round(v), round(u)]
        assert row[MODULATION_RIGHT][0] == pytest.approx(0.5 * float(nearest))
        assert np.isnan(row[BEND_RIGHT][0]), "nobody knows how the surface bends there"


def test_a_lone_pixel_without_neighbours_is_no_match() -> None:
    right = maps_of(sheared, (slice(40, 80), slice(60, 100)))
    v, u = 60, 80
    right.p_px[v, u], right.q_px[v, u] = sheared(np.array(80.0), np.array(60.0))
    assert not Row(right, sheared, np.array([80.1]), np.array([60.0])).matched.any()


def test_across_a_step_and_beyond_the_image_there_is_no_match() -> None:
    def steps(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, q = sheared(u, v)
        return p + np.where(u > 80.5, 120.0, 0.0), q

    right = maps_of(steps, projector=(640, 384))
    hidden_p, hidden_q = sheared(np.full(9, 80.5), np.linspace(30.0, 80.0, 9))
    row = Row(right, lambda u, v: (hidden_p + 60.0, hidden_q), np.zeros(9), np.zeros(9))
    assert not row.matched.any()
    outside = Row(right, sheared, np.array([-3.0, 50.0, 50.0]), np.array([50.0, -4.0, HEIGHT + 3.0]))
    assert not outside.matched.any()
    near = Row(right, steps, np.array([76.2, 85.3]), np.array([60.0, 60.0]))
    np.testing.assert_allclose(near[U], [76.2, 85.3], atol=2e-3)


def test_what_is_too_steep_or_has_no_area_is_no_surface() -> None:
    def steep(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 40.0 + 2.5 * u, 30.0 + 2.2 * v

    right = maps_of(steep)
    assert right.max_derivative_sum_px == pytest.approx(100.0), "ten for 1600 px, more for smaller images"
    for limit, found in ((4.8, True), (4.6, False)):
        limited = right._replace(max_derivative_sum_px=np.float32(limit))
        assert Row(limited, steep, *somewhere(4)).matched.all() == found
        assert Row(limited, steep, *somewhere(4)).matched.any() == found
    line = maps_of(lambda u, v: (40.0 + 2.5 * u, 200.0 + 1e-6 * v))
    assert not Row(line, lambda u, v: (40.0 + 2.5 * u, 200.0 + 0.0 * v), *somewhere(5)).matched.any()


def test_without_a_coordinate_there_is_no_match_and_the_others_have_theirs() -> None:
    u, v = somewhere(6, 140)

    def gaps(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, q = sheared(u, v)
        p[::3], q[::3] = np.nan, np.nan
        return p, q

    row = Row(maps_of(sheared), gaps, u, v)
    assert np.isnan(row[U][::3]).all()
    keep = np.arange(140) % 3 != 0
    assert np.abs(row[U] - u)[keep].max() < 2e-4


@pytest.mark.parametrize("stride", [1, 3])
def test_the_inverse_map_knows_a_pixel_near_every_node_of_the_surface(stride: int) -> None:
    right = maps_of(sheared)
    fill_inverse_map(right, stride)
    node_px = 20
    assert right.nodes_per_px == pytest.approx(1 / node_px)
    assert right.inverse.shape == (384 // node_px + 4, 512 // node_px + 4)
    # Node (i, j) serves coordinates that round to (i − 1, j − 1) · node; an empty one asks those beside it.
    j, i = (a.ravel() for a in np.mgrid[0 : right.inverse.shape[0], 0 : right.inverse.shape[1]])
    asked = np.stack([(i - 1.0) * node_px - 40.0, (j - 1.0) * node_px - 30.0], -1)
    at = asked @ np.linalg.inv(np.array([[2.5, 0.3], [-0.2, 2.2]])).T
    there = (at[:, 0] > 2) & (at[:, 0] < WIDTH - 3) & (at[:, 1] > 2) & (at[:, 1] < HEIGHT - 3)
    assert there.sum() > 150
    i, j = i[there], j[there]
    assert (right.inverse[j, i] != 0).all()
    y, x = np.divmod(right.inverse[j, i].astype(int), 65536)
    assert x.min() >= 1
    assert y.min() >= 1
    assert x.max() <= WIDTH - 2
    assert y.max() <= HEIGHT - 2
    away_p = right.p_px[y, x] - (i - 1.0) * node_px
    away_q = right.q_px[y, x] - (j - 1.0) * node_px
    assert np.abs(away_p).max() <= 1.51 * node_px
    assert np.abs(away_q).max() <= 1.51 * node_px
    own = (np.abs(away_p) <= 0.5 * node_px) & (np.abs(away_q) <= 0.5 * node_px)
    assert own.mean() > 0.7


def test_a_large_image_has_nodes_two_pattern_px_apart() -> None:
    maps = np.zeros((4, 1600), np.float32)
    right = right_maps(maps, maps, np.zeros((4, 1600), np.uint8), 1024, 768)
    assert right.nodes_per_px == 0.5
    assert right.inverse.shape == (388, 516)
    assert right.max_derivative_sum_px == 10.0
