"""The points of a fit: their source, the share of outliers (at most 0.3 %), and thinning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

OUTLIER_SHARE = 0.003
"""Largest share of the measured points that may be removed as outliers (VDI/VDE 2634; the paper's section 3.5)."""


class PointSource(Protocol):
    """Points in the left camera frame; ``appliance.measure.points.table.Cloud`` is one."""

    @property
    def points_mm(self) -> NDArray[np.float32]: ...
    @property
    def sigma_mm(self) -> NDArray[np.float32]: ...
    @property
    def pixel(self) -> NDArray[np.uint32]: ...


@dataclass(frozen=True, slots=True)
class NotFound:
    """Reason why there is no result, in one sentence for the person with the artefact."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class FitPoints:
    """Points of a cloud to which a surface was fitted, with their residuals."""

    indices: Indices
    """(n,) rows of the cloud."""
    pixel: NDArray[np.uint32]
    """(n,) flat index of the left pixel of each."""
    residual_mm: Array
    """(n,) signed distance from the fitted surface: of a sphere positive outwards, of a plane behind it."""
    rejected: Indices
    """(m,) rows of the points that belong to the surface but were removed as outliers: m <= 0.3 % of n + m."""

    @property
    def count(self) -> int:
        """Number of used points."""
        return int(self.indices.size)

    @property
    def rejected_count(self) -> int:
        """Number of points removed as outliers."""
        return int(self.rejected.size)

    @property
    def rms_mm(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residual_mm**2)))

    @property
    def range_mm(self) -> float:
        """Largest minus smallest residual."""
        return float(np.ptp(self.residual_mm))


def without_outliers(badness: Array) -> NDArray[np.bool_]:
    """Return (n,) True for the points that remain without the worst 0.3 % (rounded down) by ``badness``."""
    keep = np.ones(badness.size, bool)
    allowed = int(OUTLIER_SHARE * badness.size)
    if allowed:
        # By number, not by a limit: the guideline allows a share of the points, at any distance.
        keep[np.argpartition(badness, badness.size - allowed)[badness.size - allowed :]] = False
    return keep


def thinned(points: Array, cell_mm: float) -> Indices:
    """Return the rows of at most one point in each cube of ``cell_mm``: the first in order, deterministic."""
    cells = np.floor((points - points.min(axis=0)) / cell_mm).astype(np.int64)
    extent = cells.max(axis=0) + 1
    key = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    return np.sort(np.unique(key, return_index=True)[1])


def finite_rows(points: NDArray[np.float32]) -> Indices:
    """Return the rows with finite coordinates."""
    return np.flatnonzero(np.isfinite(points).all(axis=1))
