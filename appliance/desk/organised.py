"""Organised cloud of a stored scan, made from the raw frames as ``kingfisher cloud`` does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.desk.reconstruct import work_through
from appliance.measure import Fault, OrganisedCloud, Water, organised
from appliance.store import ChosenCalibration, SourceScan


@dataclass(frozen=True, slots=True, eq=False)
class OrganisedScan:
    """Organised cloud of a stored scan, with its water and its faults."""

    cloud: OrganisedCloud
    water: Water
    """Water in which it was reconstructed."""
    faults: tuple[Fault, ...]
    """Warnings about the scan, which has points nevertheless."""

    def __repr__(self) -> str:
        """Return one line: the number of points, and their median sigma."""
        sigma_mm = self.sigma_mm
        parts = [f"{len(sigma_mm):,} points"]
        if len(sigma_mm):
            parts.append(f"{1000.0 * float(np.median(sigma_mm)):.0f} µm")
        return f"<{', '.join((*parts, *(fault.code.value for fault in self.faults)))}>"

    @property
    def points_mm(self) -> NDArray[np.float32]:
        """(n, 3) float32: the points without gaps, in the order of their pixels; left camera frame."""
        return self.cloud.points_mm[self.cloud.mask]

    @property
    def sigma_mm(self) -> NDArray[np.float32]:
        """(n,) float32: the standard deviation of each point along its ray."""
        return self.cloud.sigma_mm[self.cloud.mask]


def organised_scan(source: SourceScan, chosen: ChosenCalibration, progress: Progress) -> OrganisedScan:
    """Return the full organised cloud of a stored scan, of both exposures of a bracket.

    Raises ScanError, also where no points are left.
    """
    scan = source.scan
    reprocessed = work_through(scan, source.rig, chosen.calibration, progress)
    # A copy: the frames may be a file that is mapped, and the cloud outlives it.
    bright = np.array(scan.frames["left"][scan.sequence.bright])
    return OrganisedScan(organised(reprocessed.cloud, bright), reprocessed.water, reprocessed.faults)
