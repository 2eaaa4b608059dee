"""The point cloud of one scan, and the memory into which its points are written.

A ``PointTable`` is one block of memory, divided into columns: coordinates, ray gap, sigma, pixel, modulation, grey
value. The block may be shared memory, so that two processes use the same points. ``put`` copies a ``Cloud`` in;
``cloud`` copies the points of a reconstruction out, as one ``Cloud``.

Callers allocate ``POINT_BYTES`` for each point of a table, and ``CLOUD_BYTES`` for each point of a cloud. The order of
the columns is private to this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import CloudLocation, CloudSummary, PatchGaps
from appliance.measure.points.select import Points

Column = TypeVar("Column", bound=np.generic)
_XYZ_BYTES, _FLOAT_BYTES, _PIXEL_BYTES = 12, 4, 4
POINT_BYTES = _XYZ_BYTES + 2 * _FLOAT_BYTES + _PIXEL_BYTES + 2
CLOUD_BYTES = _XYZ_BYTES + 3 * _FLOAT_BYTES + _PIXEL_BYTES + 1
"""Bytes of one point of a ``Cloud``."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points in the left camera frame with their attributes. All arrays have the same length n."""

    points_mm: NDArray[np.float32]
    """(n, 3) float32."""
    intensity: NDArray[np.uint8]
    """(n,) uint8, the left camera's bright frame."""
    modulation_dn: NDArray[np.float32]
    ray_gap_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    pixel: NDArray[np.uint32]
    """(n,) uint32: flat index of the left pixel."""
    summary: CloudSummary
    gaps: PatchGaps | None = None
    """Signed gaps before any limit; only in a full cloud."""

    def thinned(self, count: int) -> Cloud:
        """Return at most about ``count`` of its points, evenly over the image; ``summary`` does not change."""
        k = slice(None, None, max(1, -(-len(self.pixel) // count)))
        return Cloud(
            self.points_mm[k],
            self.intensity[k],
            self.modulation_dn[k],
            self.ray_gap_mm[k],
            self.sigma_mm[k],
            self.pixel[k],
            self.summary,
        )


class PointTable:
    """Memory for ``capacity`` points, of its own or in ``memory`` (``POINT_BYTES`` each)."""

    def __init__(self, capacity: int, memory: memoryview | None = None) -> None:
        self.capacity = capacity
        block = np.frombuffer(memory if memory is not None else bytearray(capacity * POINT_BYTES), np.uint8)
        # Bytes last, so that all else is aligned.
        ends = np.cumsum([_XYZ_BYTES, _FLOAT_BYTES, _FLOAT_BYTES, _PIXEL_BYTES, 1, 1]) * capacity
        xyz, gap, sigma, pixel, modulation, intensity = np.split(block[: ends[-1]], ends[:-1])
        self.points = Points(
            xyz.view(np.float32).reshape(capacity, 3),
            gap.view(np.float32),
            sigma.view(np.float32),
            modulation,
            pixel.view(np.uint32),
            intensity,
        )

    def put(self, cloud: Cloud) -> CloudLocation:
        """Copy a cloud of at most ``capacity`` points in; the earlier points are lost."""
        n = len(cloud.pixel)
        points = self.points
        points.xyz_mm[:n], points.gap_mm[:n], points.sigma_mm[:n] = cloud.points_mm, cloud.ray_gap_mm, cloud.sigma_mm
        points.modulation_half_dn[:n] = np.rint(2.0 * cloud.modulation_dn).astype(np.uint8)
        points.pixel[:n], points.intensity[:n] = cloud.pixel, cloud.intensity
        return CloudLocation(((0, n),), cloud.summary, cloud.gaps)

    def cloud(self, location: CloudLocation, block: NDArray[np.uint8] | None = None) -> Cloud:
        """Copy the points out, in one piece, into ``block`` (``CLOUD_BYTES`` for each at least) or new memory."""
        count = sum(stop - first for first, stop in location.pieces)
        # Columns of four bytes first, so that all are aligned.
        ends = np.cumsum([_XYZ_BYTES, _FLOAT_BYTES, _FLOAT_BYTES, _FLOAT_BYTES, _PIXEL_BYTES, 1]) * count
        places: list[NDArray[np.uint8] | None] = [None] * len(ends)
        if block is not None:
            places[:] = np.split(block[: ends[-1]], ends[:-1])

        def join(column: NDArray[Column], place: NDArray[np.uint8] | None) -> NDArray[Column]:
            into = None if place is None else place.view(column.dtype).reshape(count, *column.shape[1:])
            return np.concatenate([column[first:stop] for first, stop in location.pieces], out=into)

        points = self.points
        xyz, modulation, gap, sigma, pixel, intensity = places
        modulation_dn = np.empty(count, np.float32) if modulation is None else modulation.view(np.float32)
        half_dn = np.concatenate([points.modulation_half_dn[first:stop] for first, stop in location.pieces])
        return Cloud(
            points_mm=join(points.xyz_mm, xyz),
            intensity=join(points.intensity, intensity),
            modulation_dn=np.multiply(half_dn, np.float32(0.5), out=modulation_dn),
            ray_gap_mm=join(points.gap_mm, gap),
            sigma_mm=join(points.sigma_mm, sigma),
            pixel=join(points.pixel, pixel),
            summary=location.summary,
            gaps=location.gaps,
        )
