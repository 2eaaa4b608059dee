"""Owns one surface of many scans: placed, their points fused by their variances, and what the fused sigma means.

**Sigma** of a fused point is the standard deviation of its depth along the normal, as ``fuse`` knows it: relative to the points around it, and
what all scans have in common:

    a point in its scan    σ_n² = σ² (cos² θ + sin² θ / 9)     σ along the ray, θ between ray and normal; across the ray a point
                                                              errs by a third of sigma at most (docs/uncertainty.md)
    the scan there         σ_n² + pose_sigma_mm²              the pose is common to all points of a scan
    of all scans           1 / Σ 1 / (σ_n² + pose²)           one term a scan, however many of its pixels are there
    the fused point        √(that + common_mm²)               what all scans have in common: the calibration, the water

Where the errors of all places are known (``appliance.desk.registration.joint``), ``with_places`` makes it that of the object's frame: by how much a point
may lie elsewhere with its whole scan, and by how much the object may be bent there. Its shares are kept, since neighbours have these two in common: a hole's
diameter does not depend on them, the distance of two flanges does.

Pixels of one scan are averaged, since that makes the surface smoother, and sigma does not claim anything for it: they share the
pose, ripple and part of their noise. So sigma is right where a disc holds about one pixel of a scan, and too large beyond.

Points whose normal is not known (alone, or at the border of nothing) are left out: nobody knows which side they lie on.
``surfels.py`` says which points belong together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line, refuse_wrong_fields
from appliance.desk.surface.normals import normals
from appliance.desk.surface.surfels import EMPTY, CellTable, Discs, PointsOfScan, absorb, assign, rehash
from appliance.measure import OrganisedCloud

SPACING_MM = 0.25
POSE_SIGMA_MM = 0.03
"""Standard deviation of a placement where nobody says better: what registrations of scans with texture leave."""
ACROSS2 = np.float32(1.0 / 9.0)
"""Variance of a point across its ray by that along it, at most (docs/uncertainty.md)."""
LEAST_SIGMA_MM = np.float32(1e-4)
"""Variances are divided by; no point is known to a tenth of a micrometre."""
_DEPTH_SPACINGS, _DEPTH_MM = 1.0, 0.4
"""Points of one surface differ by a spacing in depth at most, and by 0.4 mm where the spacing is less."""
_FIRST_CELLS = 1 << 16
_ROOM_STEP = 1.3


@refuse_wrong_fields
@dataclass(frozen=True, slots=True, eq=False)
class PlacedScan:
    """One scan and where it is: its points p are at rotation · p + translation in the object's frame."""

    cloud: OrganisedCloud
    rotation: NDArray[np.float64]
    """(3, 3) float64."""
    translation_mm: NDArray[np.float64]
    """(3,) float64."""
    pose_sigma_mm: float = POSE_SIGMA_MM
    """Standard deviation of where the placement puts the scan's points, along their normals."""

    __repr__ = one_line


@dataclass(frozen=True, slots=True, eq=False)
class SigmaShares:
    """Shares of the points' sigma, each (n,) float32 in mm along the normal; sigma is the root of the sum of their squares."""

    beside_mm: NDArray[np.float32]
    """Relative to the points around: noise, and places of scans beside each other."""
    place_mm: NDArray[np.float32]
    """Share of the scan's place in the object."""
    bending_mm: NDArray[np.float32]
    """Share of the depth error that all scans have in common: what may bend the object without any residual."""


@dataclass(frozen=True, slots=True, eq=False)
class FusedCloud:
    """Points of one surface, in the object's frame; all arrays have the same length n."""

    points_mm: NDArray[np.float32]
    """(n, 3) float32, at least about a spacing apart."""
    normals: NDArray[np.float32]
    """(n, 3) float32, unit vectors towards where the surface was seen from."""
    sigma_mm: NDArray[np.float32]
    """(n,) float32: standard deviation along the normal, as the module's head says: in the object's frame where ``shares`` are known."""
    grey: NDArray[np.uint8]
    """(n,) uint8: mean of the scans' grey values, by their variances."""
    views: NDArray[np.uint16]
    """(n,) uint16: the number of scans that saw the point."""
    left_out: int = 0
    """Points of the scans that have no normal and so take no part."""
    first_scan: NDArray[np.uint16] | None = None
    """(n,) uint16: number of the first scan that saw the point, from 0 in the order in which they were fused; ``None``: not kept."""
    shares: SigmaShares | None = None
    """``None``: sigma is that relative to the points around, and what is common."""

    __repr__ = one_line

    @property
    def beside_mm(self) -> NDArray[np.float32]:
        """(n,) float32: standard deviation relative to the points around."""
        return self.sigma_mm if self.shares is None else self.shares.beside_mm


def with_places(cloud: FusedCloud, place_mm: NDArray[np.floating], bending_mm: NDArray[np.floating]) -> FusedCloud:
    """Return a fused surface whose sigma is that in the object's frame. ``place_mm`` and ``bending_mm`` (n,): its further shares, along the normals."""
    place, bending = place_mm.astype(np.float32), bending_mm.astype(np.float32)
    # Its own sigma stays the share that neighbours do not have in common, also where it is called twice.
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

    ``progress`` gets the number of scans done. Scans are taken in their order; another order moves points by less than their sigma. Memory: some
    50 bytes a fused point beside one scan. Raises ValueError for a spacing outside of 0.02..20 mm, for a rotation that is
    none, and for points beyond 100 m.
    """
    if not 0.02 <= spacing_mm <= 20.0:
        raise ValueError(f"spacing_mm is {spacing_mm}; allowed are 0.02..20")
    surface = _Surface(spacing_mm)
    left_out = 0
    for number, scan in enumerate(scans, 1):
        points, without = _placed(scan)
        left_out += without
        surface.add(points)
        progress(number)
    return surface.cloud(left_out)


def _placed(scan: PlacedScan) -> tuple[PointsOfScan, int]:
    """Return the scan's points with a normal in the object's frame, and how many have none."""
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
    """Discs and the table that finds them, which both grow. Not for several threads."""

    def __init__(self, spacing_mm: float) -> None:
        self._spacing_mm = spacing_mm
        self._depth_mm = max(_DEPTH_MM, _DEPTH_SPACINGS * spacing_mm)
        self._count = self._cell_count = 0
        self._counts: list[int] = []
        """Number of discs after each scan: discs are founded in order, and never go."""
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

    def _make_room(self, more: int) -> None:
        if self._count + more <= len(self._discs.grey):
            return
        room = int(_ROOM_STEP * self._count) + more
        arrays: list[NDArray[Any]] = list(self._discs)
        self._discs = _empty_discs()
        # One array after the other, the old one let go: all of them twice at once would be the peak of the memory.
        for k, one in enumerate(arrays):
            grown = np.empty((room, *one.shape[1:]), one.dtype)
            grown[: self._count] = one[: self._count]
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
    floats, whole = np.empty(0, np.float32), np.empty(0, np.int32)
    return Discs(floats.reshape(0, 3), floats.reshape(0, 3), floats, floats, np.empty(0, np.uint16), whole, whole)


def _empty_cells(length: int) -> CellTable:
    return CellTable(np.full(length, EMPTY, np.int64), np.empty(length, np.int32))
