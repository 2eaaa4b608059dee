"""Owns the gaps of one scan as a table of patches of the left image: robust means with their standard errors."""

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
"""Most matches whose pixels are handed on for the third gap."""
OUTLIER_SIGMAS = 3.0
"""Distance from the median in robust standard deviations beyond which a match is false and says nothing about the
calibration."""


def without_veil(gaps: PatchGaps, veil: VeilGaps, size_px: tuple[int, int]) -> PatchGaps:
    """Return ``gaps`` less what backscatter is expected to have added, with what is not known of that.

    ``size_px`` is the image's.
    """
    patch = PatchGaps.patch_of(veil.left_px, size_px)
    counts = np.bincount(patch, minlength=PatchGaps.COUNT)

    def mean(values: Array) -> Array:
        # A patch without a sample is like the mean of all.
        sums = np.bincount(patch, values, minlength=PatchGaps.COUNT)
        return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.mean(values))[gaps.patch])

    moved = mean(veil.gap_um)
    doubts = np.stack([mean(veil.doubts_um[:, k]) for k in range(PatchGaps.DOUBTS)], -1)
    return replace(gaps, gap_um=gaps.gap_um - moved, veil_um=moved, doubts_um=doubts, shape_um=mean(veil.shape_um))


def average(
    modes: GapModes, left_px: Array, right_px: Array, gap_um: Array, pattern_px: Array | None = None
) -> PatchGaps:
    """Return the means over patches of the left image of gaps (n,) of matched pixels (n, 2), and a sample of those where
    their ``pattern_px`` (n, 2) are known."""
    patch = PatchGaps.patch_of(left_px, modes.size_px)
    kept, good, noise_um = true_matches(patch, gap_um, FEWEST_IN_PATCH)
    counts = np.bincount(patch[kept], minlength=PatchGaps.COUNT)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(patch[kept], values[kept], minlength=PatchGaps.COUNT)[good] / counts[good])

    seen_px = [np.stack([mean(px[:, k]) for k in (0, 1)], -1) for px in (left_px, right_px)]
    few = np.flatnonzero(kept)
    few = few[:: max(1, -(-len(few) // SAMPLE))]
    return PatchGaps(
        patch=good,
        gap_um=mean(gap_um),
        noise_um=noise_um,
        modes=modes.at(*seen_px) if len(good) else np.empty((0, len(MODES))),
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
    """Return which of ``values`` (n,) are no outliers of their patches, which patches have at least so many of them, and
    the standard errors of these patches' means."""
    # Median and MAD first, the mean after: the median of few samples is noisier by a quarter, and a mean alone follows
    # false matches.
    away = np.abs(values - _medians(patch, values)[patch])
    sigma = MAD_TO_SIGMA * _medians(patch, away)
    kept = away <= OUTLIER_SIGMAS * sigma[patch]
    counts = np.bincount(patch[kept], minlength=PatchGaps.COUNT)
    good = np.flatnonzero(counts >= fewest)
    return kept, good, sigma[good] / np.sqrt(counts[good])


def _medians(patch: NDArray[np.intp], values: Array) -> Array:
    """Return the median of each patch, (48,); zero where it is empty."""
    order = np.argsort(values)
    order = order[np.argsort(patch[order].astype(np.uint8), kind="stable")]  # six times as fast as lexsort
    counts = np.bincount(patch, minlength=PatchGaps.COUNT)
    first = np.cumsum(counts) - counts
    ordered = values[order]
    medians = np.zeros(PatchGaps.COUNT)
    seen = counts > 0
    low, high = first + (counts - 1) // 2, first + counts // 2
    medians[seen] = 0.5 * (ordered[low[seen]] + ordered[high[seen]])
    return medians
