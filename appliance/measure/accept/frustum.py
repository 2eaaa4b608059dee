"""The search for the frustum of a square pyramid in a cloud: its faces as planes, and its corners.

Points near an edge are not used, since pixels there see two faces. A corner is the intersection of three planes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from appliance.measure.accept.plane import Plane, orthogonal_plane
from appliance.measure.accept.points import (
    Array,
    FitPoints,
    Indices,
    NotFound,
    PointSource,
    finite_rows,
    thinned,
    without_outliers,
)

CELL_MM = 2.0
PATCH_MM = 5.0
ALIGNED_COS = 0.97
"""Least cosine (14°) between the normals of a patch and of its face; faces differ by more than 30°."""
AGREES_MM = 0.6
BELONGS_MM = 1.5
"""Largest distance of a face's points from it; it removes no outliers, see ``ball_bar``."""
EDGE_MM = 3.0
"""Distance from another face below which points are not used."""
LEAST_PATCHES = 40
MOST_PLANES = 8
PARALLEL_COS = 0.998
INCLINED_COS = (0.3, 0.9)
"""Cosines between the top and a side: 25° to 73°."""
ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """One face: its plane and its points."""

    plane: Plane
    used: FitPoints


@dataclass(frozen=True, slots=True, eq=False)
class Frustum:
    """A frustum: top, plate and the four sides, in order around the top."""

    top: Face
    plate: Face
    sides: tuple[Face, Face, Face, Face]
    top_corners_mm: Array
    """(4, 3); corner k lies between sides k and k+1."""
    base_corners_mm: Array
    """(4, 3), in the same order, where the sides meet the plate."""

    @property
    def lengths_mm(self) -> Mapping[str, tuple[float, ...]]:
        """Lengths by name: four edges ``top``, four ``base``, four ``slanted`` between them, and ``height``."""

        def around(corners: Array) -> tuple[float, ...]:
            return tuple(float(v) for v in np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))

        slanted = np.linalg.norm(self.base_corners_mm - self.top_corners_mm, axis=1)
        height = float(np.mean(np.abs(self.plate.plane.distance_mm(self.top_corners_mm))))
        return {
            "top": around(self.top_corners_mm),
            "base": around(self.base_corners_mm),
            "slanted": tuple(float(v) for v in slanted),
            "height": (height,),
        }


def find_frustum(cloud: PointSource) -> Frustum | NotFound:
    """Return the frustum in a cloud that shows its top, its plate and all four sides. Deterministic."""
    rows = finite_rows(cloud.points_mm)
    if rows.size < 1000:
        return NotFound(
            f"the cloud has only {rows.size} points; bring the frustum into the light, at the working "
            "distance, or check that the calibration is of this instrument"
        )
    points = cloud.points_mm[rows].astype(np.float64)
    planes = _planes(points[thinned(points, CELL_MM)])
    chosen = _arranged(planes)
    if isinstance(chosen, NotFound):
        return chosen
    faces = _faces(cloud, rows, points, chosen)
    if faces is None:
        return NotFound("a face of the frustum has too few points; turn it so that all faces are lit and seen")
    top, plate, *sides = faces
    a, b, c, d = sides
    turns = [(sides[k].plane, sides[(k + 1) % 4].plane) for k in range(4)]
    return Frustum(
        top,
        plate,
        (a, b, c, d),
        np.array([_intersection(top.plane, *pair) for pair in turns]),
        np.array([_intersection(plate.plane, *pair) for pair in turns]),
    )


def _planes(points: Array) -> list[tuple[Plane, int]]:
    """Return the largest planes of the thinned points with their numbers of patches; largest first."""
    normals, flat = _patches(points)
    remaining = np.flatnonzero(flat)
    planes: list[tuple[Plane, int]] = []
    while remaining.size >= LEAST_PATCHES and len(planes) < MOST_PLANES:
        best = remaining[:0]
        # Some sixty seeds are enough: a face has hundreds of patches, each of which gives the same plane.
        for k in remaining[:: max(1, remaining.size // 60)]:
            best = max(best, _agreeing(points, normals, remaining, points[k], normals[k]), key=len)
        for _ in range(ROUNDS):
            if best.size < LEAST_PATCHES:
                return planes
            plane = orthogonal_plane(points[best])
            best = _agreeing(points, normals, remaining, np.array(plane.centre_mm), np.array(plane.normal))
        planes.append((orthogonal_plane(points[best]), int(best.size)))
        remaining = np.setdiff1d(remaining, best)
    return planes


def _patches(points: Array) -> tuple[Array, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """Return unit normals (n, 3), away from the instrument, of patches around points, and which are flat."""
    from scipy.spatial import cKDTree  # half a second that a start of the service does not need

    n = len(points)
    pairs = cKDTree(points).query_pairs(PATCH_MM, output_type="ndarray")
    middle = np.concatenate([pairs[:, 0], pairs[:, 1]])
    to = points[np.concatenate([pairs[:, 1], pairs[:, 0]])] - points[middle]
    count = 1 + np.bincount(middle, minlength=n)  # the point itself belongs to its patch
    mean = np.column_stack([np.bincount(middle, part, n) for part in to.T]) / count[:, None]
    scatter = np.empty((n, 3, 3))
    for i in range(3):
        for j in range(3):
            scatter[:, i, j] = np.bincount(middle, to[:, i] * to[:, j], n) - count * mean[:, i] * mean[:, j]
    values, vectors = np.linalg.eigh(scatter)
    normals = vectors[:, :, 0] * np.where(np.sum(vectors[:, :, 0] * points, 1) > 0.0, 1.0, -1.0)[:, None]
    return normals, (count >= 8) & (values[:, 0] < count * 0.3**2)  # over an edge it is a millimetre


def _agreeing(points: Array, normals: Array, among: Indices, point: Array, normal: Array) -> Indices:
    near = np.abs((points[among] - point) @ normal) < AGREES_MM
    return among[near & (normals[among] @ normal > ALIGNED_COS)]


def _arranged(planes: list[tuple[Plane, int]]) -> list[Plane] | NotFound:
    """Return top, plate, and the sides in order around the top."""
    normals = np.array([plane.normal for plane, _ in planes]).reshape(-1, 3)
    cos = normals @ normals.T
    pairs = [
        (planes[i][1] + planes[j][1], i, j)
        for i in range(len(planes))
        for j in range(i + 1, len(planes))
        if cos[i, j] > PARALLEL_COS and ((cos[i] > INCLINED_COS[0]) & (cos[i] < INCLINED_COS[1])).sum() >= 3
    ]
    if not pairs:
        return NotFound("top and plate of the frustum were not both found; turn its top towards the instrument")
    _, i, j = max(pairs)
    top, plate = sorted((i, j), key=lambda k: float(planes[k][0].distance_mm(np.zeros((1, 3)))[0]), reverse=True)
    sides = [k for k in range(len(planes)) if INCLINED_COS[0] < cos[top, k] < INCLINED_COS[1]][:4]
    if len(sides) < 4:
        return NotFound(
            f"only {len(sides)} of the frustum's four sides were found; turn it so that all are lit and seen"
        )
    base = planes[top][0]
    # In order around the top: neighbours in this list share an edge, and corner k lies between k and k+1.
    sides.sort(key=lambda k: float(np.arctan2(normals[k] @ base.axis_y, normals[k] @ base.axis_x)))
    return [planes[k][0] for k in (top, plate, *sides)]


def _faces(cloud: PointSource, rows: Indices, points: Array, planes: list[Plane]) -> list[Face] | None:
    keep: list[Indices] = []
    gone: list[Indices] = []
    for _ in range(ROUNDS):
        distance = np.abs(np.column_stack([plane.distance_mm(points) for plane in planes]))
        keep, gone = [], []
        for k in range(len(planes)):
            # Points and faces depend on each other. Near an edge a pixel sees two faces, and its point is not used.
            other_distance = np.delete(distance, k, axis=1).min(axis=1)
            mine = np.flatnonzero(
                (distance[:, k] < BELONGS_MM) & (other_distance > EDGE_MM) & _inside(points, planes, k)
            )
            if mine.size < LEAST_PATCHES:
                return None
            good = without_outliers(distance[mine, k])
            keep.append(mine[good])
            gone.append(mine[~good])
        planes = [orthogonal_plane(points[mine]) for mine in keep]
    return [
        Face(
            plane,
            FitPoints(rows[mine], cloud.pixel[rows[mine]], plane.distance_mm(points[mine]), rows[out]),
        )
        for plane, mine, out in zip(planes, keep, gone, strict=True)
    ]


def _inside(points: Array, planes: list[Plane], k: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which points lie on the face's part of its plane, inside of its neighbours."""
    top, plate, sides = planes[0], planes[1], planes[2:]
    if k == 0:  # within all sides: behind each of their planes, seen from outside
        return np.asarray(np.all([side.distance_mm(points) > 0.0 for side in sides], axis=0))
    if k == 1:  # the plate: outside of at least one side
        return np.asarray(np.any([side.distance_mm(points) < 0.0 for side in sides], axis=0))
    other_sides = [side for n, side in enumerate(sides) if n != k - 2]
    between = (top.distance_mm(points) > 0.0) & (plate.distance_mm(points) < 0.0)
    return np.asarray(between & np.all([side.distance_mm(points) > 0.0 for side in other_sides], axis=0))


def _intersection(a: Plane, b: Plane, c: Plane) -> Array:
    normals = np.array([a.normal, b.normal, c.normal])
    offsets = np.einsum("ij,ij->i", normals, np.array([a.centre_mm, b.centre_mm, c.centre_mm]))
    return np.asarray(np.linalg.solve(normals, offsets))
