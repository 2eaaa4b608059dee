"""Deviations of points from a nominal surface along its normals, positive outside, with sigma.

The nearest triangle is libigl's (MPL-2.0, a tree of boxes around the triangles). Where the points' own normals are
given, triangles that face away by more than a right angle do not count: the far side of a thin plate is not what was
measured. An edge faces as its pseudonormal does, for each of its triangles. libigl cannot leave triangles out
for a single point, so the few whose nearest place faces away are searched again from farther out along their normals,
the shortest distance first, until a triangle faces them; from just above that place they are then projected onto the
surface until they stay.

Points beside an open border of the surface have no counterpart on it and no deviation. Symbols in the kernels: p the
point, a, b and c the corners, q the nearest place on the triangle (C. Ericson, "Real-Time Collision Detection", 5.1.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.base import needed, one_line
from appliance.desk.surface.nominal import Nominal

LIMIT_MM = 5.0
PERCENTILES = (0.5, 2.5, 16.0, 50.0, 84.0, 97.5, 99.5)
BESIDE_MM = 0.05
"""Distance sideways from an open border above which a point has no counterpart on the surface."""
_BLOCK = 100_000
_FARTHER_OUT = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
"""Distances along a point's normal, as shares of the limit, from which a triangle that faces it is searched."""
_PROJECTIONS = 4
"""Number of projections of a point onto its side of the surface: each leaves a share of the remaining distance that is
the height over the radius."""
_ABOVE_MM = 1e-3
"""Height above the surface from which its own side is the nearest."""


@dataclass(frozen=True, slots=True)
class DeviationSummary:
    """Deviations of the points within the limit in numbers, mm; ``None`` if there are no such points."""

    points: int
    beyond: int
    """Number of points farther from the surface than the limit, or without a triangle that faces them."""
    beside: int
    """Number of points within the limit that lie beside an open border of the surface."""
    limit_mm: float
    mean_mm: float | None
    sd_mm: float | None
    rms_mm: float | None
    least_mm: float | None
    most_mm: float | None
    percentiles_mm: tuple[tuple[float, float], ...]
    """Pairs of percent and mm."""
    within_2_sigma_percent: float | None
    """Share of the points that lie no farther from the surface than twice their sigma: some 95 on a perfect object."""


@dataclass(frozen=True, slots=True, eq=False)
class Deviation:
    """Signed distances of points, in their order."""

    deviation_mm: NDArray[np.float32]
    """(n,) float32, positive outside; NaN beyond the limit and beside an open border."""
    sigma_mm: NDArray[np.float32]
    """(n,) float32: that of the points."""
    summary: DeviationSummary
    face: NDArray[np.int64]
    """(n,): nearest triangle of each point; -1 for none within the limit."""

    def with_sigma(self, sigma_mm: NDArray[np.float32]) -> Deviation:
        """Return the same deviations with another sigma (n,) of the points."""
        summary = _summary(self.deviation_mm, sigma_mm, self.summary.limit_mm, self.summary.beside)
        return Deviation(self.deviation_mm, sigma_mm, summary, self.face)

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class NearestPlaces:
    """Nearest places on a surface, one for each of n points."""

    face: NDArray[np.int64]
    """(n,): triangle that the place lies on."""
    place_mm: NDArray[np.float64]
    """(n, 3), in the frame of the surface."""
    signed_mm: NDArray[np.float64]
    """(n,): distance, positive outside; infinite where no triangle faces the point within the limit."""
    beside: NDArray[np.bool_]
    """(n,): the place lies on an open border, and the point beside it."""


@dataclass(frozen=True, slots=True, eq=False)
class NominalTree:
    """A nominal surface with a tree for nearest places."""

    nominal: Nominal
    _tree: Any

    @classmethod
    def of(cls, nominal: Nominal) -> NominalTree:
        """Return the tree of a nominal surface. Raises MissingLibraryError where libigl is absent."""
        igl = needed("igl", "libigl", "a comparison")
        tree = igl.AABB()
        tree.init(nominal.vertices_mm, nominal.faces)
        return cls(nominal, tree)

    def nearest(
        self, points_mm: NDArray[np.float64], normals: NDArray[np.float64] | None = None, limit_mm: float = np.inf
    ) -> NearestPlaces:
        """Return the nearest places of points (n, 3).

        ``normals`` (n, 3), NaN where unknown: triangles that face away from a point's normal do not count; ``None``: all
        do. ``limit_mm``: limit of the search.
        """
        points = np.ascontiguousarray(points_mm, np.float64)
        face = self._nearest_face(points)
        place, signed, beside, out = self._at(points, face)
        if normals is not None:
            # NaN compares as false: a point without a normal takes any triangle.
            away = np.flatnonzero((normals * out).sum(1) < 0.0)
            face[away] = self._facing(points[away], normals[away], limit_mm)
            place[away], signed[away], beside[away], _ = self._at(points[away], face[away])
            signed[face < 0] = np.inf
            beside[face < 0] = False
        return NearestPlaces(face, place, signed, beside)

    def _facing(self, points: NDArray[np.float64], normals: NDArray[np.float64], limit_mm: float) -> NDArray[np.int64]:
        """Return the triangle (n,) below each point's own side of the surface; -1 for none within the limit."""
        face_of_point, rows = np.full(len(points), -1), np.arange(len(points))
        places, outs = np.empty_like(points), np.empty_like(points)
        # Without a limit take the usual one, so that the search ends.
        farthest_mm = limit_mm if np.isfinite(limit_mm) else LIMIT_MM
        for share in _FARTHER_OUT:
            origins = points[rows] + share * farthest_mm * normals[rows]
            face = self._nearest_face(origins)
            place, _, _, out = self._at(origins, face)
            faces_it = (normals[rows] * out).sum(1) >= 0.0
            facing_rows = rows[faces_it]
            face_of_point[facing_rows], places[facing_rows], outs[facing_rows] = (
                face[faces_it],
                place[faces_it],
                out[faces_it],
            )
            rows = rows[~faces_it]
        rows = np.flatnonzero(face_of_point >= 0)
        for _ in range(_PROJECTIONS):
            out = outs[rows] / np.maximum(np.linalg.norm(outs[rows], axis=1), 1e-12)[:, None]
            up_mm = ((places[rows] - points[rows]) * out).sum(1) + _ABOVE_MM
            origins = points[rows] + up_mm[:, None] * out
            face = self._nearest_face(origins)
            place, _, _, out = self._at(origins, face)
            has_moved = (face != face_of_point[rows]) & ((normals[rows] * out).sum(1) >= 0.0)
            rows = rows[has_moved]
            face_of_point[rows], places[rows], outs[rows] = face[has_moved], place[has_moved], out[has_moved]
        return face_of_point

    def _at(
        self, points: NDArray[np.float64], face: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
        """Return nearest places (n, 3) on triangles (n,), signed distances, border flags, and pseudonormals.

        The triangle -1 stands for the last one.
        """
        nominal, n = self.nominal, len(points)
        results = np.empty((n, 3)), np.empty(n), np.empty(n, np.bool_), np.empty((n, 3))
        _on_faces(
            points, face, nominal.faces, nominal.vertices_mm, nominal.face_normals, nominal.edge_normals,
            nominal.corner_normals, nominal.open_edges, nominal.open_corners, *results,
        )  # fmt: skip
        return results

    def _nearest_face(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the triangle (n,) nearest to each of the points (n, 3), of any orientation."""
        if not len(points):
            return np.zeros(0, np.int64)
        _, face, _ = self._tree.squared_distance(self.nominal.vertices_mm, self.nominal.faces, points)
        # A single point comes back without its axis.
        return np.atleast_1d(face).astype(np.int64)


def deviations(
    points_mm: NDArray[Any],
    sigma_mm: NDArray[np.float32],
    nominal: Nominal | NominalTree,
    normals: NDArray[Any] | None = None,
    limit_mm: float = LIMIT_MM,
) -> Deviation:
    """Return the deviations of points (n, 3) in the frame of ``nominal``.

    ``sigma_mm`` (n,) is along the normal. ``normals``: (n, 3), those of the points; NaN where unknown. Points beyond
    ``limit_mm`` or beside an open border are counted and have no deviation. Raises ValueError for a limit that is not
    above 0, MissingLibraryError where libigl is absent.
    """
    if not limit_mm > 0.0:
        raise ValueError(f"limit_mm is {limit_mm}; it must be above 0")
    tree = nominal if isinstance(nominal, NominalTree) else NominalTree.of(nominal)
    deviation, face, beside = np.full(len(points_mm), np.nan, np.float32), np.full(len(points_mm), -1), 0
    for start in range(0, len(points_mm), _BLOCK):
        rows = slice(start, start + _BLOCK)
        facing = None if normals is None else normals[rows].astype(np.float64)
        nearest = tree.nearest(points_mm[rows].astype(np.float64), facing, limit_mm)
        within = np.abs(nearest.signed_mm) <= limit_mm
        deviation[rows] = np.where(within & ~nearest.beside, nearest.signed_mm, np.nan)
        face[rows] = np.where(within, nearest.face, -1)
        beside += int(np.count_nonzero(within & nearest.beside))
    return Deviation(deviation, sigma_mm, _summary(deviation, sigma_mm, limit_mm, beside), face)


def spread_over(nominal: Nominal, count: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return ``count`` places (n, 3) spread evenly over the surface, and the triangle of each.

    Each stands for the same area; within a triangle they follow the sequence R2 (M. Roberts, 2018), which leaves no
    large gaps.
    """
    a, b, c = (nominal.vertices_mm[nominal.faces[:, k]] for k in range(3))
    area_sum = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    number = np.arange(count)
    face = np.searchsorted(area_sum, (number + 0.5) / count * area_sum[-1])
    v, w = (number[:, None] * np.array([0.7548776662466927, 0.5698402909980532]) % 1.0).T
    # The half of the square that lies beyond the triangle is folded back.
    v, w = np.where(v + w > 1.0, (1.0 - v, 1.0 - w), (v, w))
    places = a[face] + v[:, None] * (b - a)[face] + w[:, None] * (c - a)[face]
    return places, face


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _on_faces(
    points: NDArray[np.float64],
    face: NDArray[np.int64],
    faces: NDArray[np.int64],
    vertices: NDArray[np.float64],
    face_normals: NDArray[np.float64],
    edge_normals: NDArray[np.float64],
    corner_normals: NDArray[np.float64],
    open_edges: NDArray[np.bool_],
    open_corners: NDArray[np.bool_],
    nearest: NDArray[np.float64],
    signed: NDArray[np.float64],
    beside: NDArray[np.bool_],
    out: NDArray[np.float64],
) -> None:
    """Write nearest place of each point on its triangle, signed distance, border flag and pseudonormal.

    The flag is true beside an open border; the pseudonormal is that of the place, common to the neighbours of an edge.
    """
    corners, pa, pb, pc, q = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(points)):
        triangle = face[n]
        normal = face_normals[triangle]
        # p from each corner.
        for axis in range(3):
            for k in range(3):
                corners[k, axis] = vertices[faces[triangle, k], axis]
            pa[axis] = points[n, axis] - corners[0, axis]
            pb[axis] = points[n, axis] - corners[1, axis]
            pc[axis] = points[n, axis] - corners[2, axis]
        place = _on_triangle(pa, pb, pc, corners, q)
        # Its square, and the part along the triangle's normal.
        offset = points[n] - q
        square = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
        along = offset[0] * normal[0] + offset[1] * normal[1] + offset[2] * normal[2]
        # Inside, on one of three edges (1, 2, 3), or at one of three corners (4, 5, 6).
        if place == 0:
            up, border = normal, False
        elif place < 4:
            up, border = edge_normals[triangle, place - 1], open_edges[triangle, place - 1]
        else:
            up, border = corner_normals[faces[triangle, place - 4]], open_corners[faces[triangle, place - 4]]
        side = offset[0] * up[0] + offset[1] * up[1] + offset[2] * up[2]
        # Distance to the border within the triangle's plane: side² = |offset|² - (offset · normal)².
        beside[n] = border and square - along * along > BESIDE_MM * BESIDE_MM
        nearest[n], out[n] = q, up
        # On the plane itself counts as outside.
        signed[n] = -np.sqrt(square) if side < 0.0 else np.sqrt(square)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _on_triangle(
    pa: NDArray[np.float64],
    pb: NDArray[np.float64],
    pc: NDArray[np.float64],
    corners: NDArray[np.float64],
    q: NDArray[np.float64],
) -> int:
    """Write the nearest place on the triangle to ``q``, where pa, pb and pc are p less the corners.

    The result is the kind of place: 0 on the face, 1 to 3 on the edges ab, bc, ca, 4 to 6 at the corners.
    """
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
    total = va + vb + vc
    q[:] = a + vb / total * ab + vc / total * ac
    return 0


def _summary(
    deviation: NDArray[np.float32], sigma: NDArray[np.float32], limit_mm: float, beside: int
) -> DeviationSummary:
    has_deviation = np.isfinite(deviation)
    near = deviation[has_deviation].astype(np.float64)
    beyond = len(deviation) - len(near) - beside
    if not len(near):
        return DeviationSummary(len(deviation), beyond, beside, limit_mm, None, None, None, None, None, (), None)
    within = np.abs(near) <= 2.0 * sigma[has_deviation]
    return DeviationSummary(
        points=len(deviation),
        beyond=beyond,
        beside=beside,
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
