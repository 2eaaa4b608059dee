"""Correspondence against maps in closed form, and its limits: steps, borders, holes, steep, flat and strongly bent maps.

A match is found in one of three ways, which must mean the same: from the inverse map, from the row above, and one by one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from appliance.measure.decode.scratch import (
    BEND_RIGHT,
    PC,
    QC,
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
from appliance.measure.points.match import RightMaps, fill_inverse_map, match_row, right_maps

Surface = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
PROJECTOR = (520, 384)
WAYS = ("inverse map", "row above", "one by one")
NODE_PX = 10
"""Pattern px between nodes: as many px of these small images as a large one has."""


def straight(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 60.0 + 2.5 * u + 0.3 * v, 50.0 - 0.2 * u + 2.2 * v


def maps_of(surface: Surface, width: int = 64, height: int = 48, missing: np.ndarray | None = None) -> RightMaps:
    v, u = np.mgrid[0:height, 0:width].astype(float)
    p, q = (np.where(False if missing is None else missing, np.nan, one).astype(np.float32) for one in surface(u, v))
    nodes = np.zeros((PROJECTOR[1] // NODE_PX + 4, PROJECTOR[0] // NODE_PX + 4), np.uint32)
    right = right_maps(p, q, np.full(p.shape, 100, np.uint8), *PROJECTOR)
    right = right._replace(inverse=nodes, nodes_per_px=np.float32(1.0 / NODE_PX))
    fill_inverse_map(right, 1)
    return right


class Row:
    """Points asked for, (n,), and what the matching wrote for them; ``above`` is a scratch row, None the inverse map."""

    def __init__(self, right: RightMaps, p_px: np.ndarray, q_px: np.ndarray, above: np.ndarray | None = None) -> None:
        self.n = len(p_px)
        self.s = np.full(SIZE, np.nan, np.float32)
        self.s[P : P + self.n], self.s[Q : Q + self.n] = p_px, q_px
        before = self.s if above is None else above
        match_row(right, before, self.s, self.s, self.n, above is not None, np.empty(self.n, np.int32))

    def __getitem__(self, place: int) -> np.ndarray:
        values: np.ndarray = self.s[place : place + self.n].astype(float)
        return values

    @property
    def matched(self) -> list[bool]:
        found: list[bool] = np.isfinite(self[U]).tolist()
        return found


def asked(right: RightMaps, surface: Surface, u: np.ndarray, v: np.ndarray, way: str = "inverse map") -> Row:
    """The points (u, v) of a surface, found in one of three ways."""
    p, q = surface(np.asarray(u, float), np.asarray(v, float))
    if way == "inverse map":
        return Row(right, p, q)
    above = np.full(SIZE, np.nan, np.float32)
    if way == "one by one":  # nothing is known of the row above, so that the short way fails everywhere
        return Row(right, p, q, above)
    for place, values in ((P, p), (Q, q), (U, u), (V, v), (UP, 0.0), (UQ, 0.0), (VQ, 0.0), (VP, 0.0)):
        above[place : place + len(p)] = values
    return Row(right._replace(inverse=np.zeros_like(right.inverse)), p, q, above)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("bends", np.eye(4).tolist())
def test_a_strong_bend_of_either_coordinate_in_either_direction_is_followed(way: str, bends: list[float]) -> None:
    puu, pvv, quu, qvv = 0.05 * np.array(bends)

    def bent(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = u - 12.0, v - 12.0
        p, q = straight(a, b)
        return p + 0.5 * (puu * a * a + pvv * b * b), q + 0.5 * (quu * a * a + qvv * b * b)

    du, dv = (x.ravel() for x in np.meshgrid([-0.45, -0.2, 0.1, 0.4], [-0.4, -0.1, 0.2, 0.45]))
    row = asked(maps_of(bent, 24, 24), bent, 12.0 + du, 13.0 + dv, way)
    # Straight on, they would be 0.5 · 0.45² · 0.05 / 2.2 = 0.0023 px off.
    np.testing.assert_allclose([row[U], row[V]], [12.0 + du, 13.0 + dv], atol=4e-4)
    np.testing.assert_allclose(row[BEND_RIGHT], 0.5 * (puu + pvv), atol=1e-4)
    inverse = np.linalg.inv([[2.5, 0.3 + pvv], [-0.2, 2.2 + qvv]])
    for place, value in ((UP, inverse[0, 0]), (UQ, -inverse[0, 1]), (VQ, inverse[1, 1]), (VP, -inverse[1, 0])):
        np.testing.assert_allclose(row[place], value, atol=1e-3)


@pytest.mark.parametrize(("axis", "sign"), [(0, -1), (1, 1)])
@pytest.mark.parametrize(("off_px", "found"), [(0.7, True), (0.8, False)])
def test_the_row_above_may_be_off_by_three_quarters_of_a_px(axis: int, sign: int, off_px: float, found: bool) -> None:
    """It leads to a pixel that is so far from the point; the inverse map knows nothing."""
    right = maps_of(straight)
    right.inverse[:, :] = 0
    place = np.array([[30.0], [20.0]])
    place[axis] -= sign * off_px
    p, q = straight(place[0], place[1])
    above = np.full(SIZE, np.nan, np.float32)
    above[[P, Q, U, V, UP, UQ, VQ, VP]] = p[0], q[0], 30.0, 20.0, 0.0, 0.0, 0.0, 0.0
    row = Row(right, p, q, above)
    assert (row.matched, row[U_START][0], row[V_START][0]) == ([found], 30.0, 20.0)


@pytest.mark.parametrize(("du", "dv"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_the_inverse_map_leads_four_pixels_and_a_walk_nine_and_three_quarters(du: int, dv: int) -> None:
    right = maps_of(straight)
    for away_px, short, found in ((3.8, True, True), (4.2, False, True), (9.7, False, True), (9.8, False, False)):
        u, v = np.array([32.0 + du * away_px]), np.array([24.0 + dv * away_px])
        right.inverse[:, :] = 24 << 16 | 32
        p, q = straight(u, v)
        row = Row(right, p, q)
        assert row.matched == [found], away_px
        # The short way leaves the coordinates of the pixel it chose; a walk reads them off on its own.
        near = abs(row[PC][0] - p[0]) <= 0.5 * (2.5 + 0.3) and abs(row[QC][0] - q[0]) <= 0.5 * (0.2 + 2.2)
        assert near == short, away_px
        if found:
            assert abs(row[U_START][0] - u[0]) <= 0.75, "the pixel it is read off from"
            assert abs(row[V_START][0] - v[0]) <= 0.75


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("signs", [(1, 1, 1, 1), (-1, 1, 1, 1), (1, -1, 1, 1), (1, 1, -1, 1), (1, 1, 1, -1)])
def test_steepness_is_the_sum_of_all_four_slopes_of_any_sign(way: str, signs: tuple[int, int, int, int]) -> None:
    """A mirrored picture too has its matches."""
    pu, pv, qu, qv = np.array([2.0, 0.4, 0.3, 1.8]) * signs

    def leaning(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 250.0 + pu * (u - 32.0) + pv * (v - 24.0), 190.0 + qu * (u - 32.0) + qv * (v - 24.0)

    u, v = np.array([20.2, 33.4, 45.1]), np.array([15.3, 24.4, 33.1])
    steep, even = (maps_of(leaning)._replace(max_derivative_sum_px=np.float32(limit)) for limit in (4.4, 4.6))
    assert asked(steep, leaning, u, v, way).matched == [False] * 3
    row = asked(even, leaning, u, v, way)
    np.testing.assert_allclose([row[U], row[V]], [u, v], atol=2e-4)


@pytest.mark.parametrize(
    ("x", "y", "right", "down"), [(29, 24, 0.7, 0.2), (40, 24, -0.7, -0.2), (34, 19, 0.2, 0.7), (34, 30, -0.2, -0.7)]
)
def test_beside_a_hole_one_neighbour_is_enough_without_a_bend(x: int, y: int, right: float, down: float) -> None:
    hole = np.zeros((48, 64), bool)
    hole[20:30, 30:40] = True
    maps = maps_of(straight, missing=hole)
    u, v = np.array([x + 0.3 * right]), np.array([y + 0.3 * down])
    row = asked(maps, straight, u, v)
    assert (row[U][0], row[V][0]) == pytest.approx((u[0], v[0]), abs=1e-3)
    found = [row[place][0] for place in (UP, UQ, SLOPE, VQ, VP)]
    np.testing.assert_allclose(found, [0.39568, 0.05396, 2.5, 0.44964, -0.03597], rtol=2e-3)
    assert np.isnan(row[BEND_RIGHT][0])
    assert asked(maps, straight, np.array([35.0]), np.array([25.0])).matched == [False], "in it"


def test_a_lone_pixel_without_neighbours_is_no_match_nor_is_a_place_across_a_step() -> None:
    lone = np.ones((48, 64), bool)
    lone[20, 30] = False
    assert asked(maps_of(straight, missing=lone), straight, np.array([30.1]), np.array([20.0])).matched == [False]

    def steps(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, q = straight(u, v)
        return p + np.where(u > 32.5, 120.0, 0.0), q

    right, near = maps_of(steps), np.array([28.2, 37.3])
    p, q = straight(np.full(9, 32.5), np.linspace(10.0, 38.0, 9))
    assert not any(Row(right, p + 60.0, q).matched)
    np.testing.assert_allclose(asked(right, steps, near, np.array([20.0, 20.0]))[U], near, atol=2e-3)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("mirrored", [1.0, -1.0])
@pytest.mark.parametrize(("area", "found"), [(1.1e-4, True), (0.9e-4, False)])
def test_a_pixel_that_covers_next_to_nothing_is_no_match(way: str, mirrored: float, area: float, found: bool) -> None:
    def flat(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1.0 + mirrored * 0.02 * (u - 32.0), area / 0.02 * v

    right = maps_of(flat)
    right.inverse[:, :] = 24 << 16 | 32
    row = asked(right, flat, np.array([32.2]), np.array([24.1]), way)
    assert row.matched == [found]


def search_from(starts: dict[tuple[int, int], tuple[int, int]]) -> list[bool]:
    """Whether a point at (40.2, 30.1) is found when of the nodes around its own only those at (right, down) know a pixel.

    Pixel (10, 10) is one without neighbours: a walk from it is lost.
    """
    missing = np.zeros((48, 64), bool)
    missing[8:13, 8:13] = True
    missing[10, 10] = False
    right = maps_of(straight, missing=missing)
    right.inverse[:, :] = 0
    p, q = straight(np.array([40.2]), np.array([30.1]))
    i, j = int(p[0] / NODE_PX + 1.5), int(q[0] / NODE_PX + 1.5)
    for (a, b), (x, y) in starts.items():
        right.inverse[j + b, i + a] = y << 16 | x
    return Row(right, p, q, np.full(SIZE, np.nan, np.float32)).matched


GOOD, LOST = (39, 31), (10, 10)
HERE, RIGHT, LEFT, BELOW, ABOVE = (0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)


@pytest.mark.parametrize("side", [RIGHT, LEFT, BELOW, ABOVE])
def test_what_is_lost_from_its_own_node_is_tried_once_more_from_a_neighbouring_one(side: tuple[int, int]) -> None:
    assert search_from({HERE: GOOD}) == [True]
    assert search_from({HERE: LOST}) == [False]
    assert search_from({HERE: LOST, side: GOOD}) == [True]
    assert search_from({side: GOOD}) == [True], "its own node knows nothing"
    assert search_from({(2 * side[0], 2 * side[1]): GOOD}) == [False], "only the nearest neighbours are asked"


def test_a_search_is_given_up_after_two_walks() -> None:
    assert search_from({HERE: LOST, RIGHT: LOST, LEFT: GOOD}) == [True], "the same pixel is not tried again"
    assert search_from({RIGHT: LOST, LEFT: GOOD}) == [True]
    assert search_from({HERE: LOST, RIGHT: (9, 9), LEFT: GOOD}) == [False]


@pytest.mark.parametrize(
    ("width_px", "node_px", "limit_px"),
    [(3200, 2, 10.0), (1600, 2, 10.0), (1599, 3, 10.00625), (1000, 4, 16.0), (457, 8, 16000 / 457)],
)
def test_a_smaller_image_has_wider_nodes_and_may_be_steeper(width_px: int, node_px: int, limit_px: float) -> None:
    empty = np.zeros((4, width_px), np.float32)
    right = right_maps(empty, empty, np.zeros((4, width_px), np.uint8), 1024, 768)
    assert float(right.nodes_per_px) == pytest.approx(1.0 / node_px)
    assert right.inverse.shape == (768 // node_px + 4, 1024 // node_px + 4)
    assert float(right.max_derivative_sum_px) == pytest.approx(limit_px)
