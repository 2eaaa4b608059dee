"""Owns where points are left: columns in one block of memory, which two processes may share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.patches import PatchGaps
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.select import Points

Column = TypeVar("Column", bound=np.generic)
_XYZ_BYTES, _FLOAT_BYTES, _PIXEL_BYTES = 12, 4, 4
POINT_BYTES = _XYZ_BYTES + 2 * _FLOAT_BYTES + _PIXEL_BYTES + 2


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points in the left camera frame, with what is known about each. All arrays have the same length n."""

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
    """Signed gaps before any limit; of the full cloud only."""

    def thinned(self, most: int) -> Cloud:
        """Return at most about ``most`` of its points, evenly over the image; numbers are those of all."""
        k = slice(None, None, max(1, -(-len(self.pixel) // most)))
        return Cloud(
            self.points_mm[k], self.intensity[k], self.modulation_dn[k], self.ray_gap_mm[k], self.sigma_mm[k],
            self.pixel[k], self.summary,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Found:
    """A found cloud: where in the table its points are, and what describes it."""

    pieces: tuple[tuple[int, int], ...]
    """(first, stop) of each thread's share; what lies between them means nothing."""
    summary: CloudSummary
    gaps: PatchGaps | None = None
    """Signed gaps before any limit, as ``Cloud.gaps``."""


class PointTable:
    """Room for ``capacity`` points in ``memory`` (``POINT_BYTES`` each), or in memory of its own."""

    def __init__(self, capacity: int, memory: memoryview | None = None) -> None:
        self.capacity = capacity
        whole = np.frombuffer(memory if memory is not None else bytearray(capacity * POINT_BYTES), np.uint8)
        # Bytes last, so that all else is aligned.
        ends = np.cumsum([_XYZ_BYTES, _FLOAT_BYTES, _FLOAT_BYTES, _PIXEL_BYTES, 1, 1]) * capacity
        xyz, gap, sigma, pixel, modulation, intensity = np.split(whole[: ends[-1]], ends[:-1])
        self.points = Points(
            xyz.view(np.float32).reshape(capacity, 3),
            gap.view(np.float32),
            sigma.view(np.float32),
            modulation,
            pixel.view(np.uint32),
            intensity,
        )

    def put(self, cloud: Cloud) -> Found:
        """Copy a cloud of at most ``capacity`` points in, in place of whatever was there."""
        n = len(cloud.pixel)
        points = self.points
        points.xyz_mm[:n], points.gap_mm[:n], points.sigma_mm[:n] = cloud.points_mm, cloud.ray_gap_mm, cloud.sigma_mm
        points.modulation_half_dn[:n] = np.rint(2.0 * cloud.modulation_dn).astype(np.uint8)
        points.pixel[:n], points.intensity[:n] = cloud.pixel, cloud.intensity
        return Found(((0, n),), cloud.summary, cloud.gaps)

    def cloud(self, found: Found) -> Cloud:
        """Copy the points out, in one piece."""

        def join(column: NDArray[Column]) -> NDArray[Column]:
            return np.concatenate([column[first:stop] for first, stop in found.pieces])

        points = self.points
        return Cloud(
            points_mm=join(points.xyz_mm),
            intensity=join(points.intensity),
            modulation_dn=join(points.modulation_half_dn) * np.float32(0.5),
            ray_gap_mm=join(points.gap_mm),
            sigma_mm=join(points.sigma_mm),
            pixel=join(points.pixel),
            summary=found.summary,
            gaps=found.gaps,
        )
