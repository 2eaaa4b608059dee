"""Fusion of two registered clouds of one surface into one.

The first cloud's pixels are the lattice. Where both have the surface, the result is the mean along its normal, weighted
by the standard deviations. Where only the second has a point, that is used. Where they contradict, neither is.

Symbols: s1 (``mine``) and s2 (``theirs``) are the standard deviations of two points, d (``apart``) the distance of the
second one from the first one's surface, along its normal n. Their mean is x1 + s1² / (s1² + s2²) · d n, with the
standard deviation s1 s2 / √(s1² + s2²).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import CloudSummary
from appliance.measure.points.register import Registration
from appliance.measure.points.surface import TERMS, Surface, normal_at, pixel_of
from appliance.measure.points.table import Cloud

MAX_SIGMA = 5.0
"""Largest distance of two points of one surface in standard deviations: noise exceeds it once in a million."""
OTHER_SURFACE_MM = 1.0
"""Distance beyond which two points are of two surfaces, one behind an edge of the other, and do not contradict, mm."""
_SHARED, _MASKED = np.uint8(1), np.uint8(2)


@dataclass(frozen=True, slots=True, eq=False)
class FusionResult:
    """A fused cloud, and shares 0..1 of its points."""

    cloud: Cloud
    second: float
    """Share of the points that only the second cloud has."""
    both: float
    masked: float
    """Share removed of the points that both clouds have."""


def fuse(
    surface: Surface, first: Cloud, second: Cloud, registration: Registration, grey: tuple[float, float]
) -> FusionResult:
    """Fuse ``first``, of which ``surface`` was made, and ``second`` in the first one's frame and pixels.

    ``grey``: factors of both clouds' intensities that bring them to the same light.
    """
    points_mm, sigma_mm = first.points_mm.copy(), first.sigma_mm.copy()
    fate = np.zeros(len(first.pixel), np.uint8)
    placed = np.full(len(second.pixel), -1, np.int64)
    moved_mm = registration.apply(second.points_mm)
    _fuse(
        surface,
        moved_mm,
        second.sigma_mm,
        points_mm,
        sigma_mm,
        fate,
        placed,
        np.zeros(surface.point_index.shape, np.bool_),
    )
    shared, masked = int((fate == _SHARED).sum()), int((fate == _MASKED).sum())
    added = np.flatnonzero(placed >= 0)
    cloud = _joined(first, second, (points_mm, sigma_mm), fate != _MASKED, added, moved_mm, placed, grey)
    n = max(1, len(cloud.pixel))
    return FusionResult(cloud, len(added) / n, shared / n, masked / max(1, shared + masked))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _fuse(
    surface: Surface,
    moved_mm: NDArray[np.float32],
    moved_sigma_mm: NDArray[np.float32],
    points_mm: NDArray[np.float32],
    sigma_mm: NDArray[np.float32],
    fate: NDArray[np.uint8],
    placed: NDArray[np.int64],
    filled: NDArray[np.bool_],
) -> None:
    """Fuse point by point; the first point in a pixel is used."""
    rows, columns = surface.point_index.shape
    terms, a, b, normal = np.empty(TERMS), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(moved_mm)):
        x, y, z = np.float64(moved_mm[k, 0]), np.float64(moved_mm[k, 1]), np.float64(moved_mm[k, 2])
        # The pixel of the first cloud's lattice that the point falls into.
        u, v = pixel_of(surface, x, y, z, terms)
        if not (-0.5 < u < columns - 0.5 and -0.5 < v < rows - 0.5):
            continue
        row, column = round(v), round(u)
        index = surface.point_index[row, column]
        # The first cloud has no point there: the second one's point is added.
        if index < 0:
            if not filled[row, column]:
                filled[row, column] = True
                placed[k] = row * columns + column
            continue
        if fate[index] == _SHARED or not normal_at(surface, row, column, a, b, normal):
            continue
        # Distance along the normal, against the noise of both.
        mine, theirs = np.float64(surface.sigma_mm[index]), np.float64(moved_sigma_mm[k])
        expected = math.sqrt(mine * mine + theirs * theirs)
        apart = normal[0] * (x - surface.points_mm[index, 0]) + normal[1] * (y - surface.points_mm[index, 1])
        apart += normal[2] * (z - surface.points_mm[index, 2])
        # One surface: the mean x1 + s1²/(s1² + s2²) · d n, with standard deviation s1 s2 / √(s1² + s2²).
        if abs(apart) <= MAX_SIGMA * expected:
            along = mine * mine / (expected * expected) * apart
            for axis in range(3):
                points_mm[index, axis] = np.float32(surface.points_mm[index, axis] + along * normal[axis])
            sigma_mm[index] = np.float32(mine * theirs / expected)
            fate[index] = _SHARED
        # Farther apart, but too close to be another surface behind an edge: the points contradict each other.
        elif abs(apart) <= OTHER_SURFACE_MM:
            fate[index] = _MASKED


def _joined(
    first: Cloud,
    second: Cloud,
    fused: tuple[NDArray[np.float32], NDArray[np.float32]],
    keep: NDArray[np.bool_],
    added: NDArray[np.int64],
    moved_mm: NDArray[np.float32],
    placed: NDArray[np.int64],
    grey: tuple[float, float],
) -> Cloud:
    """Return the joined cloud, in the order of the pixels as every cloud."""
    points, sigma = fused
    pixel = np.concatenate([first.pixel[keep], placed[added].astype(np.uint32)])
    order = np.argsort(pixel, kind="stable")

    def join(first_values: NDArray[np.float32], second_values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.concatenate([first_values[keep], second_values[added]])[order]

    # Of two exposures, the grey values of the shorter one are the common scale.
    def level(cloud: Cloud, factor: float) -> NDArray[np.float32]:
        return np.asarray(np.rint(cloud.intensity.astype(np.float32) * np.float32(factor)), np.float32)

    intensity = np.clip(join(level(first, grey[0]), level(second, grey[1])), 0.0, 255.0).astype(np.uint8)
    sigma_mm = join(sigma, second.sigma_mm)
    gap_mm = join(first.ray_gap_mm, second.ray_gap_mm)
    xyz_mm = np.concatenate([points[keep], moved_mm[added]])[order]
    has_points = len(xyz_mm) > 0
    illuminated = max(_illuminated(first), _illuminated(second))
    summary = CloudSummary(
        points=len(xyz_mm),
        coverage_percent=min(100.0, 100.0 * len(xyz_mm) / illuminated) if illuminated else None,
        distance_mm=float(np.median(xyz_mm[:, 2])) if has_points else None,
        noise_mm=float(np.median(sigma_mm)) if has_points else None,
        gap_mm=float(np.median(met)) if len(met := gap_mm[np.isfinite(gap_mm)]) else None,
    )
    return Cloud(
        points_mm=xyz_mm,
        intensity=intensity,
        modulation_dn=join(first.modulation_dn, second.modulation_dn),
        ray_gap_mm=gap_mm,
        sigma_mm=sigma_mm,
        pixel=pixel[order],
        summary=summary,
        gaps=first.gaps,
    )


def _illuminated(cloud: Cloud) -> float:
    """Return the number of illuminated pixels."""
    coverage = cloud.summary.coverage_percent
    return 100.0 * len(cloud.pixel) / coverage if coverage else 0.0
