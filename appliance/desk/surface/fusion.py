"""Fusion: one surface of many placed scans, whose points are averaged by their variances.

* ``fuse``, ``PlacedScan``, ``FusedCloud``: the fusion, its input and its result.
* ``assign``, ``absorb``, ``Discs``, ``CellTable``: how points find the disc of the surface to which they belong.

**Sigma** of a fused point is the standard deviation of its depth along the normal, as ``fuse`` knows it: relative to the points around it, and
what all scans have in common:

    a point in its scan    σ_n² = σ² (cos² θ + sin² θ / 9)     σ along the ray, θ between ray and normal; across the ray a point
                                                              errs by a third of sigma at most (docs/uncertainty.md)
    the scan there         σ_n² + pose_sigma_mm²              the pose is common to all points of a scan
    of all scans           1 / Σ 1 / (σ_n² + pose²)           one term a scan, however many of its pixels are there
    the fused point        √(that + common_mm²)               what all scans have in common: the calibration, the water

Where the joint errors of all poses are known (``appliance.desk.registration.joint``), ``with_places`` makes it the sigma
in the object's frame: it then includes the error of the scan's pose, and the bending of the object there. The shares
are kept, since neighbours have these two in common: a hole's diameter does not depend on them, the distance of two
flanges does.

Pixels of one scan are averaged, which makes the surface smoother; sigma does not take credit for it, since they
share the pose, ripple and part of their noise. So sigma is right where a disc holds about one pixel of a scan, and too
large beyond.

Points without a normal (alone, or at a border) are left out: their side of the surface is unknown.

The surface is made of small discs in a hash table of cells. A disc has a place, a normal and a radius, the spacing. A point belongs to the nearest disc, across the surface, that

    faces the same way       n_p · n_d ≥ ½, so that both sides of a thin plate stay two surfaces,
    is near on it            its ray meets the plane of the disc at most the spacing from the disc,
    and lies as deep         |h| ≤ 4 √(v_p + v_d), at most the depth limit; v: variances along the normal

where h = d · (n_p + n_d) / |n_p + n_d| is the depth of the point over the disc, d the way from the disc to it. The mean
of both normals makes h zero for two points of one sphere, however far apart: a bent surface is not moved inwards (S.
Rusinkiewicz, "A symmetric objective function for ICP", 2019). A point that belongs to none founds a disc of its own.
The place where its ray meets the disc is free of the point's own noise, and of two discs equally far the older is
taken. By the distance across the normal, discs that noise moved in one direction would collect more points than the
others, and the mean of their places would be off by 1.5 µm for noise of 20 µm.

Cells are cubes of twice the reach, so that all discs in reach of a point lie in the eight cells about its nearest
corner. Symbols: u is the ray, m is the number of discs, key a cell's three numbers in one, head the first disc of a
cell, after the next one of the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line, refuse_wrong_fields
from appliance.desk.surface.normals import normals
from appliance.measure import OrganisedCloud

SURE2 = 16.0
"""Square of the number of standard deviations by which points of one surface may differ in depth."""
SAME_SIDE = 0.5
"""Least cosine between the normals of one surface: 60°."""
LEAST_COSINE = 0.2
"""Least cosine between ray and normal with which a ray is followed to a plane: 78°."""
TIE = 0.96
"""Largest ratio of squared distances at which a disc counts as nearer than another."""
EMPTY = np.int64(-1)
_HALF_RANGE = np.int64(1 << 20)
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
"""2⁶⁴ by the golden ratio: neighbouring keys spread over the table (D.

Knuth, The Art of Computer Programming 3, 6.4).
"""


class Discs(NamedTuple):
    """Discs of the surface so far; each array has room for more discs than exist."""

    place_mm: NDArray[np.float32]
    """(room, 3)."""
    normal: NDArray[np.float32]
    """(room, 3), unit vectors."""
    information: NDArray[np.float32]
    """(room,): 1 over the variance along the normal, in 1/mm²."""
    grey: NDArray[np.float32]
    views: NDArray[np.uint16]
    """(room,): number of scans that saw the disc; 0: founded in the scan that is being added."""
    after: NDArray[np.int32]
    slot: NDArray[np.int32]
    """(room,): row in ``Sums`` during one scan, else -1."""


class CellTable(NamedTuple):
    """Hash table with open addressing, a power of two in length and at most half full."""

    key: NDArray[np.int64]
    head: NDArray[np.int32]


class PointsOfScan(NamedTuple):
    """Points of one scan in the object's frame."""

    place_mm: NDArray[np.float32]
    normal: NDArray[np.float32]
    variance_mm2: NDArray[np.float32]
    """(n,): along the normal."""
    grey: NDArray[np.uint8]
    eye_mm: NDArray[np.float64]
    """(3,): the camera's projection centre, from where all rays come."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _key(i: int, j: int, k: int) -> np.int64:
    """Return the three cell indices, each of 21 bits, as one number."""
    return np.int64(
        ((np.int64(i) + _HALF_RANGE) << np.int64(42))
        | ((np.int64(j) + _HALF_RANGE) << np.int64(21))
        | (np.int64(k) + _HALF_RANGE)
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _find(key: NDArray[np.int64], searched: np.int64) -> np.int64:
    """Return the slot of the key ``searched`` in the table, or the empty slot for it."""
    mask = np.uint64(len(key) - 1)
    slot = (np.uint64(searched) * _MULTIPLIER) >> np.uint64(20) & mask
    while key[slot] != searched and key[slot] != EMPTY:
        slot = (slot + np.uint64(1)) & mask
    return np.int64(slot)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def rehash(old: CellTable, new: CellTable) -> None:
    """Enter all cells of ``old`` into ``new``, which is empty."""
    for k in range(len(old.key)):
        if old.key[k] != EMPTY:
            slot = _find(new.key, old.key[k])
            new.key[slot], new.head[slot] = old.key[k], old.head[k]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def assign(
    points: PointsOfScan,
    first: int,
    discs: Discs,
    count: int,
    cells: CellTable,
    cell_count: int,
    spacing_mm: float,
    depth_mm: float,
    owner: NDArray[np.int32],
) -> tuple[int, int, int]:
    """Write the disc of each point from ``first`` on to ``owner``, and found discs where there are none.

    Returns the number of discs, that of cells, and the first point that is still to do: it ends early when the table is half
    full. There must be room for a disc a point.
    """
    cell_mm = 2.0 * np.sqrt(spacing_mm**2 + depth_mm**2)
    max_cells = len(cells.key) // 2 - 8
    for n in range(first, len(owner)):
        # A table more than half full is slow to search; the caller makes a larger one and calls again.
        if cell_count > max_cells:
            return count, cell_count, n
        px, py, pz = float(points.place_mm[n, 0]), float(points.place_mm[n, 1]), float(points.place_mm[n, 2])
        nx, ny, nz = float(points.normal[n, 0]), float(points.normal[n, 1]), float(points.normal[n, 2])
        variance = float(points.variance_mm2[n])
        # u: from the camera to the point.
        ux, uy, uz = px - points.eye_mm[0], py - points.eye_mm[1], pz - points.eye_mm[2]
        norm = 1.0 / np.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux * norm, uy * norm, uz * norm
        # The lowest of the eight cells: the one below the nearest corner in each direction.
        i, j, k = (
            int(np.floor(px / cell_mm - 0.5)),
            int(np.floor(py / cell_mm - 0.5)),
            int(np.floor(pz / cell_mm - 0.5)),
        )
        best, best2 = -1, 0.0
        for corner in range(8):
            slot = _find(cells.key, _key(i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2)))
            if cells.key[slot] == EMPTY:
                continue
            disc = cells.head[slot]
            while disc >= 0:
                dx, dy, dz = px - discs.place_mm[disc, 0], py - discs.place_mm[disc, 1], pz - discs.place_mm[disc, 2]
                ox, oy, oz = discs.normal[disc, 0], discs.normal[disc, 1], discs.normal[disc, 2]
                # Back along the ray to the disc's plane: d − u (d · n) / (u · n); u · n < 0, since both sides face each
                # other.
                along = dx * ox + dy * oy + dz * oz
                back = along / min(ux * ox + uy * oy + uz * oz, -LEAST_COSINE)
                ax, ay, az = dx - back * ux, dy - back * uy, dz - back * uz
                across2 = ax * ax + ay * ay + az * az
                cosine = nx * ox + ny * oy + nz * oz
                # Of equally far discs take the oldest, so that neither noise nor a disc's cell decides.
                nearer = best < 0 or across2 < TIE * best2 or (disc < best and TIE * across2 <= best2)
                if nearer and across2 <= spacing_mm**2 and cosine >= SAME_SIDE:
                    # |n_p + n_d|² = 2 + 2 cos.
                    h = (along + dx * nx + dy * ny + dz * nz) / np.sqrt(2.0 + 2.0 * cosine)
                    if abs(h) <= depth_mm and h * h <= SURE2 * (variance + 1.0 / discs.information[disc]):
                        best, best2 = disc, across2
                disc = discs.after[disc]
        # Found a disc here, as certain as the point.
        if best < 0:
            best = count
            count += 1
            discs.place_mm[best, 0], discs.place_mm[best, 1], discs.place_mm[best, 2] = px, py, pz
            discs.normal[best, 0], discs.normal[best, 1], discs.normal[best, 2] = nx, ny, nz
            discs.information[best] = 1.0 / variance
            discs.views[best], discs.slot[best] = 0, -1
            # Enter it first in its cell, so that the end of the chain need not be searched.
            slot = _find(
                cells.key, _key(int(np.floor(px / cell_mm)), int(np.floor(py / cell_mm)), int(np.floor(pz / cell_mm)))
            )
            if cells.key[slot] == EMPTY:
                cells.key[slot] = _key(
                    int(np.floor(px / cell_mm)), int(np.floor(py / cell_mm)), int(np.floor(pz / cell_mm))
                )
                cells.head[slot] = -1
                cell_count += 1
            discs.after[best] = cells.head[slot]
            cells.head[slot] = best
        owner[n] = best
    return count, cell_count, len(owner)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def absorb(
    points: PointsOfScan, owner: NDArray[np.int32], discs: Discs, sums: NDArray[np.float64], touched: NDArray[np.int32]
) -> None:
    """Move each disc along its normal to the weighted mean of its past and of its points of one scan.

    ``sums`` is (n, 7) zeros, ``touched`` (n,): room for a row a point. A scan counts as one observation of the disc,
    for any number of pixels: averaging does not remove their common errors (the pose, ripple, half of their noise).
    """
    rows = 0
    # Sums over the points of each disc, in rows by order of appearance: one row for every disc would be mostly zeros.
    for n in range(len(owner)):
        disc = owner[n]
        row = discs.slot[disc]
        if row < 0:
            row = rows
            rows += 1
            discs.slot[disc] = row
            touched[row] = disc
        # d from disc to point, m = n_p + n_d.
        dx = float(points.place_mm[n, 0] - discs.place_mm[disc, 0])
        dy = float(points.place_mm[n, 1] - discs.place_mm[disc, 1])
        dz = float(points.place_mm[n, 2] - discs.place_mm[disc, 2])
        mx = float(points.normal[n, 0] + discs.normal[disc, 0])
        my = float(points.normal[n, 1] + discs.normal[disc, 1])
        mz = float(points.normal[n, 2] + discs.normal[disc, 2])
        # Weight 1/σ²; the depth by the mean of both normals, as at the module's head.
        weight = 1.0 / float(points.variance_mm2[n])
        sums[row, 0] += 1.0
        sums[row, 1] += weight
        sums[row, 2] += weight * (dx * mx + dy * my + dz * mz) / np.sqrt(mx * mx + my * my + mz * mz)
        sums[row, 3] += weight * points.normal[n, 0]
        sums[row, 4] += weight * points.normal[n, 1]
        sums[row, 5] += weight * points.normal[n, 2]
        sums[row, 6] += weight * points.grey[n]
    for row in range(rows):
        disc = touched[row]
        # Take the information of one mean pixel, not of all pixels; a new disc has none from before.
        weight = sums[row, 1]
        now = weight / sums[row, 0]
        before = float(discs.information[disc]) if discs.views[disc] > 0 else 0.0
        share = now / (now + before)
        depth = share * sums[row, 2] / weight
        # Kalman's update of a scalar, by the share of the new information.
        ox, oy, oz = float(discs.normal[disc, 0]), float(discs.normal[disc, 1]), float(discs.normal[disc, 2])
        discs.place_mm[disc, 0] += depth * ox
        discs.place_mm[disc, 1] += depth * oy
        discs.place_mm[disc, 2] += depth * oz
        # Normal and grey by the same shares.
        ox = (1.0 - share) * ox + share * sums[row, 3] / weight
        oy = (1.0 - share) * oy + share * sums[row, 4] / weight
        oz = (1.0 - share) * oz + share * sums[row, 5] / weight
        norm = 1.0 / np.sqrt(ox * ox + oy * oy + oz * oz)
        discs.normal[disc, 0], discs.normal[disc, 1], discs.normal[disc, 2] = ox * norm, oy * norm, oz * norm
        grey = float(discs.grey[disc]) if discs.views[disc] > 0 else 0.0
        discs.grey[disc] = (1.0 - share) * grey + share * sums[row, 6] / weight
        discs.information[disc] = now + before
        discs.views[disc] += 1
        discs.slot[disc] = -1


SPACING_MM = 0.25
POSE_SIGMA_MM = 0.03
"""Default standard deviation of a scan pose: that of a registration of scans with texture."""
ACROSS2 = np.float32(1.0 / 9.0)
"""Variance of a point across its ray by that along it, at most (docs/uncertainty.md)."""
LEAST_SIGMA_MM = np.float32(1e-4)
"""Least sigma of a point, since variances are divisors."""
_DEPTH_SPACINGS, _DEPTH_MM = 1.0, 0.4
"""Largest difference in depth of points of one surface: a spacing, but at least 0.4 mm."""
_FIRST_CELLS = 1 << 16
_ROOM_STEP = 1.3


@refuse_wrong_fields
@dataclass(frozen=True, slots=True, eq=False)
class PlacedScan:
    """A scan with its pose: its points p are at rotation · p + translation in the object's frame."""

    cloud: OrganisedCloud
    rotation: NDArray[np.float64]
    """(3, 3) float64."""
    translation_mm: NDArray[np.float64]
    """(3,) float64."""
    pose_sigma_mm: float = POSE_SIGMA_MM
    """Standard deviation that the pose adds to the scan's points, along their normals."""
    name: str = ""
    """The scan's name in its object."""
    covariance: NDArray[np.float64] | None = None
    """(6, 6) float64: of rotation (rad) and shift (mm) about the scan's middle, bending of the object included."""
    middle_mm: NDArray[np.float64] | None = None
    """(3,) float64: the scan's middle, in the object's frame."""

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class SigmaShares:
    """Shares of the points' sigma, each (n,) float32 in mm along the normal.

    Sigma is the root of the sum of their squares.
    """

    beside_mm: NDArray[np.float32]
    """Noise relative to the points around, and poses of overlapping scans."""
    place_mm: NDArray[np.float32]
    """Share of the scan's pose in the object."""
    bending_mm: NDArray[np.float32]
    """Share of the depth error that all scans have in common: it may bend the object without any residual."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedCloud:
    """Points of one surface, in the object's frame; all arrays have the same length n."""

    points_mm: NDArray[np.float32]
    """(n, 3) float32, at least about a spacing apart."""
    normals: NDArray[np.float32]
    """(n, 3) float32, unit vectors towards the side from which the surface was seen."""
    sigma_mm: NDArray[np.float32]
    """(n,) float32: standard deviation along the normal, as the module's head defines it: in the object's frame where
    ``shares`` are known."""
    grey: NDArray[np.uint8]
    """(n,) uint8: mean of the scans' grey values, by their variances."""
    views: NDArray[np.uint16]
    """(n,) uint16: the number of scans that saw the point."""
    left_out: int = 0
    """Number of points of the scans without a normal, which take no part."""
    first_scan: NDArray[np.uint16] | None = None
    """(n,) uint16: index of the first scan that saw the point, in the order of fusion; ``None``: not kept."""
    shares: SigmaShares | None = None
    """``None``: sigma is relative to the points around, with the common errors."""

    __repr__ = one_line

    @property
    def beside_mm(self) -> NDArray[np.float32]:
        """(n,) float32: standard deviation relative to the points around."""
        return self.sigma_mm if self.shares is None else self.shares.beside_mm


def with_places(cloud: FusedCloud, place_mm: NDArray[np.floating], bending_mm: NDArray[np.floating]) -> FusedCloud:
    """Return a fused surface with sigma in the object's frame.

    ``place_mm`` and ``bending_mm`` (n,): its further shares, along the normals.
    """
    place, bending = place_mm.astype(np.float32), bending_mm.astype(np.float32)
    # The relative sigma stays as it is, also on a second call.
    beside = cloud.beside_mm
    return replace(
        cloud, sigma_mm=np.sqrt(beside**2 + place**2 + bending**2), shares=SigmaShares(beside, place, bending)
    )


def fuse(
    scans: Iterable[PlacedScan],
    spacing_mm: float = SPACING_MM,
    progress: Callable[[int], None] = lambda _: None,
) -> FusedCloud:
    """Return one surface of all scans, a point about every ``spacing_mm``. One scan is held at a time.

    ``progress`` gets the number of scans done. Scans are taken in their order; another order moves points by less than
    their sigma. Memory: some 50 bytes a fused point beside one scan. Raises ValueError for a spacing outside of
    0.02..20 mm, for a rotation that is none, and for points beyond 100 m.
    """
    if not 0.02 <= spacing_mm <= 20.0:
        raise ValueError(f"spacing_mm is {spacing_mm}; allowed are 0.02..20")
    surface = _Surface(spacing_mm)
    left_out = 0
    for number, scan in enumerate(scans, 1):
        points, without = _place(scan)
        left_out += without
        surface.add(points)
        progress(number)
    return surface.cloud(left_out)


def _place(scan: PlacedScan) -> tuple[PointsOfScan, int]:
    """Return the scan's points with a normal, in the object's frame, and the number of points without one."""
    rotation = np.asarray(scan.rotation, np.float64)
    if (
        rotation.shape != (3, 3)
        or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        or np.linalg.det(rotation) < 0
    ):
        raise ValueError("rotation is no (3, 3) rotation; give an orthonormal matrix with determinant +1")
    cloud = scan.cloud
    of_grid = normals(cloud)
    has = np.isfinite(of_grid[..., 2]) & np.isfinite(cloud.sigma_mm)
    points, normal = cloud.points_mm[has], of_grid[has]
    along = np.einsum("nk,nk->n", points, normal)
    cos2 = along**2 / np.einsum("nk,nk->n", points, points)
    variance = np.maximum(cloud.sigma_mm[has], LEAST_SIGMA_MM) ** 2 * (cos2 + ACROSS2 * (1 - cos2))
    placed = points @ rotation.T + np.asarray(scan.translation_mm, np.float64)
    if len(placed) and not float(np.abs(placed).max()) < 1e5:
        raise ValueError("a scan is placed more than 100 m from the object's origin; correct its translation_mm")
    return PointsOfScan(
        placed.astype(np.float32),
        (normal @ rotation.T).astype(np.float32),
        (variance + np.float32(scan.pose_sigma_mm**2)).astype(np.float32),
        cloud.grey[has],
        np.array(scan.translation_mm, np.float64),
    ), int(np.count_nonzero(cloud.mask)) - len(points)


class _Surface:
    """Growing discs with the table that finds them. Not for several threads."""

    def __init__(self, spacing_mm: float) -> None:
        self._spacing_mm = spacing_mm
        self._depth_mm = max(_DEPTH_MM, _DEPTH_SPACINGS * spacing_mm)
        self._count = self._cell_count = 0
        self._counts: list[int] = []
        """Number of discs after each scan: discs are founded in order, and never removed."""
        self._cells = _empty_cells(_FIRST_CELLS)
        self._discs = _empty_discs()

    def add(self, points: PointsOfScan) -> None:
        if n := len(points.grey):
            self._add(points, n)
        self._counts.append(self._count)

    def _add(self, points: PointsOfScan, n: int) -> None:
        self._make_room(n)
        owner = np.empty(n, np.int32)
        done = 0
        while done < n:
            self._count, self._cell_count, done = assign(
                points, done, self._discs, self._count, self._cells, self._cell_count,
                self._spacing_mm, self._depth_mm, owner,
            )  # fmt: skip
            if done < n:
                larger = _empty_cells(2 * len(self._cells.key))
                rehash(self._cells, larger)
                self._cells = larger
        absorb(points, owner, self._discs, np.zeros((n, 7)), np.empty(n, np.int32))

    def _make_room(self, new_points: int) -> None:
        if self._count + new_points <= len(self._discs.grey):
            return
        room = int(_ROOM_STEP * self._count) + new_points
        arrays: list[NDArray[Any]] = list(self._discs)
        self._discs = _empty_discs()
        # Grow one array after the other and free the old ones: both copies of all at once would be the peak of memory.
        for k, array in enumerate(arrays):
            grown = np.empty((room, *array.shape[1:]), array.dtype)
            grown[: self._count] = array[: self._count]
            arrays[k] = grown
        self._discs = Discs(*arrays)

    def cloud(self, left_out: int) -> FusedCloud:
        discs, n = self._discs, self._count
        variance = np.float32(1.0) / discs.information[:n]
        return FusedCloud(
            points_mm=discs.place_mm[:n].copy(),
            normals=discs.normal[:n].copy(),
            sigma_mm=np.sqrt(variance),
            grey=np.rint(discs.grey[:n]).astype(np.uint8),
            views=discs.views[:n].copy(),
            left_out=left_out,
            first_scan=np.repeat(np.arange(len(self._counts), dtype=np.uint16), np.diff([0, *self._counts])),
        )


def _empty_discs() -> Discs:
    floats, integers = np.empty(0, np.float32), np.empty(0, np.int32)
    return Discs(floats.reshape(0, 3), floats.reshape(0, 3), floats, floats, np.empty(0, np.uint16), integers, integers)


def _empty_cells(length: int) -> CellTable:
    return CellTable(np.full(length, EMPTY, np.int64), np.empty(length, np.int32))
