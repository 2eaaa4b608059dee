"""Owns how far points lie from a nominal surface, along its normals: outside is positive, and each with its sigma.

The nearest triangle is found by samples: triangles are halved at their longest edge until none is long, and the middles of the
pieces go into a k-d tree. If s is the longest way from a middle to a corner of its piece, the middles that belong to the nearest triangle lie no
farther than that triangle's distance and s. So once the k nearest middles reach farther than the best distance among their
triangles and s, that one is the nearest there is; where they do not, four times as many are asked for.

Where the points' own normals are given, triangles that face away by more than a right angle do not count: the far side of a thin
plate is not what was measured. Symbols in the kernels: p the point, a, b and c the corners, q the nearest place on the triangle (C. Ericson,
"Real-Time Collision Detection", 5.1.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.one_line import one_line
from appliance.surface.nominal import Nominal

LIMIT_MM = 5.0
PERCENTILES = (0.5, 2.5, 16.0, 50.0, 84.0, 97.5, 99.5)
_SAMPLES = 300_000
_FIRST_ASKED, _MORE = 6, 4
_BLOCK = 100_000


@dataclass(frozen=True, slots=True)
class DeviationSummary:
    """Deviations in numbers, mm; of those points that lie within the limit. ``None`` where there are none."""

    points: int
    beyond: int
    """Points that lie farther from the surface than the limit, or that see nothing of it that faces them."""
    limit_mm: float
    mean_mm: float | None
    sd_mm: float | None
    rms_mm: float | None
    least_mm: float | None
    most_mm: float | None
    percentiles_mm: tuple[tuple[float, float], ...]
    """Pairs of percent and mm."""
    within_2_sigma_percent: float | None
    """Share of the points that lie no farther from the surface than twice their own sigma: some 95 if it is as nominal."""


@dataclass(frozen=True, slots=True, eq=False)
class Deviation:
    """Signed distances of points, in their order."""

    deviation_mm: NDArray[np.float32]
    """(n,) float32, positive outside; NaN beyond the limit."""
    sigma_mm: NDArray[np.float32]
    """(n,) float32: that of the points."""
    summary: DeviationSummary

    __repr__ = one_line


def deviations(
    points_mm: NDArray[np.float32],
    sigma_mm: NDArray[np.float32],
    nominal: Nominal,
    normals: NDArray[np.float32] | None = None,
    limit_mm: float = LIMIT_MM,
) -> Deviation:
    """Return how far points (n, 3), in the frame of ``nominal``, lie from it; ``sigma_mm`` (n,) along the normal.

    ``normals``: (n, 3), those of the points; NaN where unknown. Points beyond ``limit_mm`` are counted and have no deviation. Raises
    ValueError for a limit that is not above 0.
    """
    if not limit_mm > 0.0:
        raise ValueError(f"limit_mm is {limit_mm}; it must be above 0")
    samples, face_of, reach_mm = sampled(nominal)
    tree = cKDTree(samples)
    points = np.ascontiguousarray(points_mm, np.float64)
    facing = np.full((len(points), 3), np.nan) if normals is None else np.ascontiguousarray(normals, np.float64)
    found = np.full(len(points), np.nan)
    for start in range(0, len(points), _BLOCK):
        _search(
            points,
            facing,
            np.arange(start, min(start + _BLOCK, len(points))),
            nominal,
            tree,
            face_of,
            reach_mm,
            limit_mm,
            found,
        )
    deviation = found.astype(np.float32)
    return Deviation(deviation, sigma_mm, _summary(deviation, sigma_mm, limit_mm))


def _search(
    points: NDArray[np.float64],
    facing: NDArray[np.float64],
    left: NDArray[np.int64],
    nominal: Nominal,
    tree: cKDTree,
    face_of: NDArray[np.int64],
    reach_mm: float,
    limit_mm: float,
    found: NDArray[np.float64],
) -> None:
    """Write the deviations of the points ``left`` to ``found``."""
    count = _FIRST_ASKED
    corners = nominal.vertices_mm[nominal.faces]
    while len(left):
        count = min(count, len(face_of))
        far, sample = tree.query(points[left], np.arange(1, count + 1), distance_upper_bound=limit_mm + reach_mm)
        distance, signed = np.empty(len(left)), np.empty(len(left))
        _nearest(
            points[left], facing[left], sample, face_of, nominal.faces, corners, nominal.face_normals,
            nominal.edge_normals, nominal.corner_normals, distance, signed,
        )  # fmt: skip
        # Infinite: there are no more samples that could matter.
        proven = (far[:, -1] > distance + reach_mm) | np.isinf(far[:, -1]) | (count == len(face_of))
        done = left[proven]
        found[done] = np.where(distance[proven] <= limit_mm, signed[proven], np.nan)
        left = left[~proven]
        count *= _MORE


def sampled(nominal: Nominal) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
    """Return middles of pieces of the triangles, the face of each, and the longest way from a middle to a corner."""
    corners = nominal.vertices_mm[nominal.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    longest_mm = 2.0 * np.sqrt(area / _SAMPLES)
    face = np.arange(len(corners))
    whole, of_whole = [], []
    while len(corners):
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        long = sides.max(axis=1) > longest_mm
        whole.append(corners[~long])
        of_whole.append(face[~long])
        corners, face, first = corners[long], face[long], sides[long].argmax(axis=1)
        # Turned so that the longest edge goes from a to b, and halved there: a-m-c and m-b-c.
        a, b, c = (corners[np.arange(len(corners)), (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        face = np.concatenate([face, face])
    pieces = np.concatenate(whole)
    middles = pieces.mean(axis=1)
    reach = np.linalg.norm(pieces - middles[:, None], axis=2).max()
    return middles, np.concatenate(of_whole), float(reach)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _nearest(
    points: NDArray[np.float64],
    facing: NDArray[np.float64],
    sample: NDArray[np.int64],
    face_of: NDArray[np.int64],
    faces: NDArray[np.int64],
    corners: NDArray[np.float64],
    face_normals: NDArray[np.float64],
    edge_normals: NDArray[np.float64],
    corner_normals: NDArray[np.float64],
    distance: NDArray[np.float64],
    signed: NDArray[np.float64],
) -> None:
    """Write the distance of each point to the nearest of its triangles, and the same with its sign; infinite where it has none."""
    pa, pb, pc, q = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(points)):
        best, best_sign, last = np.inf, 1.0, -1
        # Nearest samples first, so that the best triangle is mostly the first.
        for k in range(sample.shape[1]):
            if sample[n, k] >= len(face_of):
                break
            one = face_of[sample[n, k]]
            # Neighbouring samples are mostly of the same triangle.
            if one == last:
                continue
            last = one
            normal = face_normals[one]
            # NaN compares as false: a point without a normal takes any triangle.
            if facing[n, 0] * normal[0] + facing[n, 1] * normal[1] + facing[n, 2] * normal[2] < 0.0:
                continue
            # p from each corner.
            for axis in range(3):
                pa[axis] = points[n, axis] - corners[one, 0, axis]
                pb[axis] = points[n, axis] - corners[one, 1, axis]
                pc[axis] = points[n, axis] - corners[one, 2, axis]
            place = _on_triangle(pa, pb, pc, corners[one], q)
            to = points[n] - q
            square = to[0] * to[0] + to[1] * to[1] + to[2] * to[2]
            if square >= best:
                continue
            best = square
            # Inside, on one of three edges (1, 2, 3), or at one of three corners (4, 5, 6).
            if place == 0:
                side = to[0] * normal[0] + to[1] * normal[1] + to[2] * normal[2]
            elif place < 4:
                edge = edge_normals[one, place - 1]
                side = to[0] * edge[0] + to[1] * edge[1] + to[2] * edge[2]
            else:
                corner = corner_normals[faces[one, place - 4]]
                side = to[0] * corner[0] + to[1] * corner[1] + to[2] * corner[2]
            # On the plane itself counts as outside.
            best_sign = -1.0 if side < 0.0 else 1.0
        distance[n] = np.sqrt(best)
        signed[n] = best_sign * distance[n]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _on_triangle(
    pa: NDArray[np.float64],
    pb: NDArray[np.float64],
    pc: NDArray[np.float64],
    corners: NDArray[np.float64],
    q: NDArray[np.float64],
) -> int:
    """Write the place on the triangle that is nearest to p to ``q``, where pa, pb and pc are p less the corners; return what
    it lies on: 0 the face, 1 to 3 the edges ab, bc, ca, 4 to 6 the corners."""
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac = b - a, c - a
    # Projections of p on both edges from a, seen from each corner.
    d1, d2 = ab[0] * pa[0] + ab[1] * pa[1] + ab[2] * pa[2], ac[0] * pa[0] + ac[1] * pa[1] + ac[2] * pa[2]
    # Behind both edges: the corner itself.
    if d1 <= 0.0 and d2 <= 0.0:
        q[:] = a
        return 4
    d3, d4 = ab[0] * pb[0] + ab[1] * pb[1] + ab[2] * pb[2], ac[0] * pb[0] + ac[1] * pb[1] + ac[2] * pb[2]
    if d3 >= 0.0 and d4 <= d3:
        q[:] = b
        return 5
    # Barycentric coordinates up to a factor: vc ≤ 0 lies beyond the edge ab, and so on.
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        q[:] = a + d1 / (d1 - d3) * ab
        return 1
    d5, d6 = ab[0] * pc[0] + ab[1] * pc[1] + ab[2] * pc[2], ac[0] * pc[0] + ac[1] * pc[1] + ac[2] * pc[2]
    if d6 >= 0.0 and d5 <= d6:
        q[:] = c
        return 6
    # The same for the edge ca, and then for bc.
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        q[:] = a + d2 / (d2 - d6) * ac
        return 3
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        q[:] = b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
        return 2
    # Within: a + v ab + w ac.
    whole = va + vb + vc
    q[:] = a + vb / whole * ab + vc / whole * ac
    return 0


def _summary(deviation: NDArray[np.float32], sigma: NDArray[np.float32], limit_mm: float) -> DeviationSummary:
    there = np.isfinite(deviation)
    near = deviation[there].astype(np.float64)
    beyond = len(deviation) - len(near)
    if not len(near):
        return DeviationSummary(len(deviation), beyond, limit_mm, None, None, None, None, None, (), None)
    within = np.abs(near) <= 2.0 * sigma[there]
    return DeviationSummary(
        points=len(deviation),
        beyond=beyond,
        limit_mm=limit_mm,
        mean_mm=float(near.mean()),
        sd_mm=float(near.std()),
        rms_mm=float(np.sqrt(np.mean(near**2))),
        least_mm=float(near.min()),
        most_mm=float(near.max()),
        percentiles_mm=tuple(
            (percent, float(value))
            for percent, value in zip(PERCENTILES, np.percentile(near, PERCENTILES), strict=True)
        ),
        within_2_sigma_percent=100.0 * float(within.mean()),
    )
