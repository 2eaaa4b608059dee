"""The ray gaps of one scan by patches of the left image: robust means with their standard errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import MODES, GapModes, VeilGaps
from appliance.measure.cloud import PatchGaps
from appliance.measure.light.noise import MAD_TO_SIGMA

Array = NDArray[np.float64]

FEWEST_IN_PATCH = 20
SAMPLE = 1_200
"""Largest number of matches in the sample for the third gap."""
OUTLIER_SIGMAS = 3.0
"""Largest distance of a true match from the median, in robust standard deviations."""


def without_veil(gaps: PatchGaps, veil: VeilGaps, size_px: tuple[int, int]) -> PatchGaps:
    """Return ``gaps`` without the expected part of the backscatter fringes, and with their uncertainty.

    ``size_px`` is the image's.
    """
    patch = PatchGaps.patch_of(veil.left_px, size_px)
    counts = np.bincount(patch, minlength=PatchGaps.COUNT)

    def mean(values: Array) -> Array:
        # A patch without a sample gets the mean of all.
        sums = np.bincount(patch, values, minlength=PatchGaps.COUNT)
        return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.mean(values))[gaps.patch])

    moved = mean(veil.gap_um)
    doubts = np.stack([mean(veil.doubts_um[:, k]) for k in range(PatchGaps.DOUBTS)], -1)
    return replace(gaps, gap_um=gaps.gap_um - moved, veil_um=moved, doubts_um=doubts, shape_um=mean(veil.shape_um))


def average(
    modes: GapModes, left_px: Array, right_px: Array, gap_um: Array, pattern_px: Array | None = None
) -> PatchGaps:
    """Return the means over patches of the left image of gaps (n,) of matched pixels (n, 2).

    If their ``pattern_px`` (n, 2) is given, a sample of the matches is included.
    """
    patch = PatchGaps.patch_of(left_px, modes.size_px)
    inliers, good, noise_um = true_matches(patch, gap_um, FEWEST_IN_PATCH)
    counts = np.bincount(patch[inliers], minlength=PatchGaps.COUNT)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(patch[inliers], values[inliers], minlength=PatchGaps.COUNT)[good] / counts[good])

    mean_px = [np.stack([mean(px[:, k]) for k in (0, 1)], -1) for px in (left_px, right_px)]
    few = np.flatnonzero(inliers)
    few = few[:: max(1, -(-len(few) // SAMPLE))]
    return PatchGaps(
        patch=good,
        gap_um=mean(gap_um),
        noise_um=noise_um,
        modes=modes.at(*mean_px) if len(good) else np.empty((0, len(MODES))),
        samples=len(gap_um),
        water_index=modes.water_index,
        turns_um=modes.turns_um,
        sample_px=None
        if pattern_px is None
        else np.concatenate([left_px, right_px, pattern_px], -1, dtype=np.float32)[few],
    )


def true_matches(
    patch: NDArray[np.intp], values: Array, fewest: int
) -> tuple[NDArray[np.bool_], NDArray[np.intp], Array]:
    """Return which of ``values`` (n,) are inliers, the patches with enough of them, and their errors.

    Enough are ``fewest`` inliers; the errors are the standard errors of the means of these patches.
    """
    # Outliers by median and MAD, then the mean: the median of few samples is noisier by a quarter, and a mean of all
    # follows false matches.
    away = np.abs(values - _medians(patch, values)[patch])
    sigma = MAD_TO_SIGMA * _medians(patch, away)
    inliers = away <= OUTLIER_SIGMAS * sigma[patch]
    counts = np.bincount(patch[inliers], minlength=PatchGaps.COUNT)
    good = np.flatnonzero(counts >= fewest)
    return inliers, good, sigma[good] / np.sqrt(counts[good])


def _medians(patch: NDArray[np.intp], values: Array) -> Array:
    """Return the median of each patch, (48,); zero if it is empty."""
    order = np.argsort(values)
    order = order[np.argsort(patch[order].astype(np.uint8), kind="stable")]  # six times as fast as lexsort
    counts = np.bincount(patch, minlength=PatchGaps.COUNT)
    first = np.cumsum(counts) - counts
    ordered = values[order]
    medians = np.zeros(PatchGaps.COUNT)
    occupied = counts > 0
    low, high = first + (counts - 1) // 2, first + counts // 2
    medians[occupied] = 0.5 * (ordered[low[occupied]] + ordered[high[occupied]])
    return medians
