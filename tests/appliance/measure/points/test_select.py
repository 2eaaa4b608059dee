"""Which points are chosen: each limit at its value and beside it, each of the eight neighbours, and what is kept of a point."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.scratch import GAP, SIGMA, SIZE, X, Y, Z
from appliance.measure.points.select import PointLimits, append, judge
from appliance.measure.points.table import PointTable

f = np.float32
LIMITS = PointLimits(f(0.25), f(0.5), f(380.0), f(680.0), f(2.0), f(5.0))
N = 5
EPS = 1e-3


def rows() -> list[np.ndarray]:
    """Three scratch rows of a plane at 500 mm whose points are as good as they can be."""
    made = [np.full(SIZE, np.nan, np.float32) for _ in range(3)]
    for row in made:
        row[Z - 1 : Z + N + 1] = 500.0
        row[GAP : GAP + N] = 0.01
        row[SIGMA : SIGMA + N] = 0.02
    return made


def judged(made: list[np.ndarray], limits: PointLimits = LIMITS) -> list[int]:
    good = np.full(8, 7, np.uint8)
    above, row, below = made
    judge.py_func(above, row, below, N, limits, good)
    compiled = np.full(8, 7, np.uint8)
    judge(above, row, below, N, limits, compiled)
    assert good.tolist() == compiled.tolist()
    assert good[N:].tolist() == [7, 7, 7], "nothing behind the row is touched"
    return [int(one) for one in good[:N]]


@pytest.mark.parametrize(
    ("place", "at", "beyond"),
    [(GAP, 0.25, 0.25 + EPS), (SIGMA, 0.5, 0.5 + EPS), (GAP, 0.0, np.nan), (SIGMA, 0.0, np.nan)],
)
def test_a_point_with_a_gap_or_an_error_beyond_its_limit_goes_alone(place: int, at: float, beyond: float) -> None:
    made = rows()
    made[1][place + 2] = at
    assert judged(made) == [1] * N
    made[1][place + 2] = beyond
    assert judged(made) == [1, 1, 0, 1, 1]


@pytest.mark.parametrize(("depth_mm", "inside"), [(380.0, 1), (379.9, 0), (680.0, 1), (680.1, 0), (np.nan, 0)])
def test_a_surface_before_or_behind_the_volume_is_left_out(depth_mm: float, inside: int) -> None:
    made = rows()
    for row in made:
        row[Z - 1 : Z + N + 1] = depth_mm
    assert judged(made) == [inside] * N


@pytest.mark.parametrize("which", [(r, k) for r in range(3) for k in range(3) if (r, k) != (1, 1)])
def test_each_of_the_eight_neighbours_counts_once(which: tuple[int, int]) -> None:
    all_eight, seven = LIMITS._replace(min_neighbours=f(8.0)), LIMITS._replace(min_neighbours=f(7.0))
    for away_mm, near in ((2.0, True), (-2.0, True), (2.1, False), (-2.1, False), (np.nan, False)):
        made = rows()
        made[which[0]][Z + 1 + which[1]] += away_mm
        assert judged(made, all_eight)[2] == int(near), away_mm
        assert judged(made, seven)[2] == 1, "one is missing, not more"


@pytest.mark.parametrize("stride", [1, 3])
@pytest.mark.parametrize("n", [61, 64])
def test_what_is_chosen_is_kept_whole_in_its_place(stride: int, n: int) -> None:
    rng = np.random.default_rng(n)
    good = np.ones((n + 7) // 8 * 8, np.uint8)  # behind the row, what another row has left there
    good[:n] = np.repeat(rng.random(n) < 0.6, 4)[:n]
    row = np.full(SIZE, np.nan, np.float32)
    for place in (X, Y, Z, GAP, SIGMA):
        row[place : place + n] = rng.random(n).astype(np.float32)
    bright, half_dn = (rng.integers(0, 256, n * stride).astype(np.uint8) for _ in range(2))
    points = PointTable(n + 9).points
    points.gap_mm[:] = -1
    count = append.py_func(row, good, bright, half_dn, n, stride, 4000, points, 5)
    chosen = np.flatnonzero(good[:n])
    assert count == 5 + len(chosen)
    kept = slice(5, count)
    np.testing.assert_array_equal(points.xyz_mm[kept], np.stack([row[a + chosen] for a in (X, Y, Z)], -1))
    for found, wanted in (
        (points.gap_mm, row[GAP + chosen]), (points.sigma_mm, row[SIGMA + chosen]), (points.pixel, 4000 + chosen * stride),
        (points.intensity, bright[chosen * stride]), (points.modulation_half_dn, half_dn[chosen * stride]),
    ):  # fmt: skip
        np.testing.assert_array_equal(found[kept], wanted)
    assert (np.delete(points.gap_mm, kept) == -1).all()
