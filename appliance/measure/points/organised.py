"""An organised cloud: a cloud on the pixel grid of the left image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.base import one_line
from appliance.measure.points.table import Cloud


@dataclass(frozen=True, slots=True, eq=False)
class OrganisedCloud:
    """A full cloud of one scan, left camera frame; every array is (h, w) or (h, w, 3) over the left image.

    Where a pixel has no point, floating point values are NaN. Arrays are not copied; do not write to them.
    """

    points_mm: NDArray[np.float32]
    """(h, w, 3) float32."""
    sigma_mm: NDArray[np.float32]
    """Standard deviation of the point along its ray."""
    modulation_dn: NDArray[np.float32]
    ray_gap_mm: NDArray[np.float32]
    grey: NDArray[np.uint8]
    """The left camera's bright frame, also in pixels without a point."""

    __repr__ = one_line

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(h, w) bool: the pixel has a point."""
        return np.isfinite(self.points_mm[..., 2])

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return (self.grey.shape[0], self.grey.shape[1])


def no_points(grey: NDArray[np.uint8]) -> OrganisedCloud:
    """Return a cloud without points on the grid of ``grey``, (h, w) uint8, to be filled in."""
    points, *attributes = (np.full((*grey.shape, *trailing), np.nan, np.float32) for trailing in ((3,), (), (), ()))
    return OrganisedCloud(points, attributes[0], attributes[1], attributes[2], grey)


def organised(cloud: Cloud, bright: NDArray[np.uint8]) -> OrganisedCloud:
    """Return ``cloud`` on the grid of the left camera's ``bright`` frame, (h, w) uint8.

    Raises ValueError for a cloud of a larger image.
    """
    h, w = bright.shape
    if len(cloud.pixel) and int(cloud.pixel.max()) >= h * w:
        raise ValueError(
            f"the cloud has a point of pixel {int(cloud.pixel.max())}; the image has {h * w}: give the "
            "cloud's own image"
        )

    def grid(values: NDArray[np.float32], *more: int) -> NDArray[np.float32]:
        out = np.full((h * w, *more), np.nan, np.float32)
        out[cloud.pixel] = values
        return out.reshape(h, w, *more)

    return OrganisedCloud(
        points_mm=grid(cloud.points_mm, 3),
        sigma_mm=grid(cloud.sigma_mm),
        modulation_dn=grid(cloud.modulation_dn),
        ray_gap_mm=grid(cloud.ray_gap_mm),
        grey=bright,
    )
