"""Owns which points are good enough to be shown and saved, and the numbers that describe a cloud."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import CloudSummary
from appliance.measure.light.volume import WorkingVolume
from appliance.measure.points.select import Points


@dataclass(frozen=True, slots=True)
class QualityLimits:
    """A point outside of any limit is masked, never moved or invented."""

    max_gap_mm: float = 0.25
    """Rays of a true correspondence pass at a few hundredths of a millimetre; calibration drift adds to it."""
    max_sigma_mm: float = 0.5
    min_depth_mm: float = 380.0
    """Depths, here and below, of the standard housing; ``of`` takes them to another."""
    max_depth_mm: float = 680.0
    max_step_mm: float = 1.5
    """Allowed distance in depth to the median of the 3 × 3 neighbours at full resolution; scales with the pixel."""
    min_neighbours: int = 5
    """Least number of neighbours, of eight; fewer is a fragment of an edge."""

    def of(self, volume: WorkingVolume) -> QualityLimits:
        """Return the same limits for a housing of that volume, given those for the standard one."""
        return replace(
            self, min_depth_mm=volume.scaled(self.min_depth_mm), max_depth_mm=volume.scaled(self.max_depth_mm)
        )


SAMPLE = 8_000
"""Number of points of which the medians are taken: their own standard error is about 1 %."""


def summarise(illuminated_pixels: int, points: Points, pieces: tuple[tuple[int, int], ...]) -> CloudSummary:
    """Return the numbers of the cloud in ``pieces`` (first, stop) of a table; ``illuminated_pixels`` at the same stride."""
    n = sum(stop - first for first, stop in pieces)
    coverage = 100.0 * n / illuminated_pixels if illuminated_pixels else None
    if n == 0:
        return CloudSummary(0, coverage, None, None, None)
    step = max(1, n // SAMPLE)

    def median(column: NDArray[np.float32]) -> float:
        return float(np.median(np.concatenate([column[first:stop:step] for first, stop in pieces])))

    return CloudSummary(
        points=n,
        coverage_percent=coverage,
        distance_mm=median(points.xyz_mm[:, 2]),
        noise_mm=median(points.sigma_mm),
        gap_mm=median(points.gap_mm),
    )
