"""Owns two clouds of one surface as one, once it is known how they lie against each other.

The first cloud's pixels are the lattice. Where both have the surface, the point goes along its normal to their mean,
each weighted by its expected error; where only the second has it, its point is taken; where they contradict, neither
is.

Symbols: s1 (``mine``) and s2 (``theirs``) are the expected errors of two points, d (``apart``) the distance of the
second one from the first one's surface, along its normal n. Their mean is x1 + s1² / (s1² + s2²) · d n, with error s1
s2 / √(s1² + s2²).
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
"""Largest distance over its noise of two points of one surface: they are farther apart once in a million."""
OTHER_SURFACE_MM = 1.0
"""Distance in mm beyond which two points belong to two surfaces, one seen past an edge of the other, and do not
contradict."""
_SHARED, _MASKED = np.uint8(1), np.uint8(2)


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """A fused cloud, and shares 0..1 of its points."""

    cloud: Cloud
    second: float
    """Share that only the second cloud has."""
    both: float
    masked: float
    """Share taken out, of what both had."""


def fuse(surface: Surface, first: Cloud, second: Cloud, found: Registration, grey: tuple[float, float]) -> Fused:
    """Fuse ``first``, which made ``surface``, and ``second`` in the first one's frame; pixels are the first one's.

    ``grey`` is what either cloud's intensities are multiplied by, so that both mean the same light.
    """
    points_mm, sigma_mm = first.points_mm.copy(), first.sigma_mm.copy()
    fate = np.zeros(len(first.pixel), np.uint8)
    placed = np.full(len(second.pixel), -1, np.int64)
    moved_mm = found.apply(second.points_mm)
    _fuse(surface, moved_mm, second.sigma_mm, points_mm, sigma_mm, fate, placed, np.zeros(surface.at.shape, np.bool_))
    shared, masked = int((fate == _SHARED).sum()), int((fate == _MASKED).sum())
    taken = np.flatnonzero(placed >= 0)
    cloud = _joined(first, second, (points_mm, sigma_mm), fate != _MASKED, taken, moved_mm, placed, grey)
    n = max(1, len(cloud.pixel))
    return Fused(cloud, len(taken) / n, shared / n, masked / max(1, shared + masked))


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
    """Fuse point by point; the first point that comes decides about a pixel."""
    rows, columns = surface.at.shape
    terms, a, b, normal = np.empty(TERMS), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(moved_mm)):
        x, y, z = np.float64(moved_mm[k, 0]), np.float64(moved_mm[k, 1]), np.float64(moved_mm[k, 2])
        # The pixel of the first cloud's lattice that the point falls into.
        u, v = pixel_of(surface, x, y, z, terms)
        if not (-0.5 < u < columns - 0.5 and -0.5 < v < rows - 0.5):
            continue
        row, column = round(v), round(u)
        one = surface.at[row, column]
        # Nothing there in the first cloud: the second one's point is taken.
        if one < 0:
            if not filled[row, column]:
                filled[row, column] = True
                placed[k] = row * columns + column
            continue
        if fate[one] == _SHARED or not normal_at(surface, row, column, a, b, normal):
            continue
        # Distance along the normal, against the noise of both.
        mine, theirs = np.float64(surface.sigma_mm[one]), np.float64(moved_sigma_mm[k])
        expected = math.sqrt(mine * mine + theirs * theirs)
        apart = normal[0] * (x - surface.points_mm[one, 0]) + normal[1] * (y - surface.points_mm[one, 1])
        apart += normal[2] * (z - surface.points_mm[one, 2])
        # One surface: the mean x1 + s1²/(s1² + s2²) · d n, with error s1 s2 / √(s1² + s2²).
        if abs(apart) <= MAX_SIGMA * expected:
            along = mine * mine / (expected * expected) * apart
            for axis in range(3):
                points_mm[one, axis] = np.float32(surface.points_mm[one, axis] + along * normal[axis])
            sigma_mm[one] = np.float32(mine * theirs / expected)
            fate[one] = _SHARED
        # Farther apart, but too near to be another surface behind an edge: they contradict each other.
        elif abs(apart) <= OTHER_SURFACE_MM:
            fate[one] = _MASKED


def _joined(
    first: Cloud,
    second: Cloud,
    fused: tuple[NDArray[np.float32], NDArray[np.float32]],
    keep: NDArray[np.bool_],
    taken: NDArray[np.int64],
    moved_mm: NDArray[np.float32],
    placed: NDArray[np.int64],
    grey: tuple[float, float],
) -> Cloud:
    """Return the joined cloud in the order of the pixels, as every cloud is."""
    points, sigma = fused
    pixel = np.concatenate([first.pixel[keep], placed[taken].astype(np.uint32)])
    order = np.argsort(pixel, kind="stable")

    def join(one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.concatenate([one[keep], other[taken]])[order]

    # Of two exposures, the shorter one's grey values are the common scale.
    def level(cloud: Cloud, factor: float) -> NDArray[np.float32]:
        return np.asarray(np.rint(cloud.intensity.astype(np.float32) * np.float32(factor)), np.float32)

    intensity = np.clip(join(level(first, grey[0]), level(second, grey[1])), 0.0, 255.0).astype(np.uint8)
    sigma_mm = join(sigma, second.sigma_mm)
    gap_mm = join(first.ray_gap_mm, second.ray_gap_mm)
    xyz_mm = np.concatenate([points[keep], moved_mm[taken]])[order]
    known = len(xyz_mm) > 0
    illuminated = max(_illuminated(first), _illuminated(second))
    summary = CloudSummary(
        points=len(xyz_mm),
        coverage_percent=min(100.0, 100.0 * len(xyz_mm) / illuminated) if illuminated else None,
        distance_mm=float(np.median(xyz_mm[:, 2])) if known else None,
        noise_mm=float(np.median(sigma_mm)) if known else None,
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
    """Return the number of pixels with projector light."""
    coverage = cloud.summary.coverage_percent
    return 100.0 * len(cloud.pixel) / coverage if coverage else 0.0
