"""Owns whether paint repeats itself: a printed grid fits as well one square farther, and no residual tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure import Array, Paint, Patches, patch_pitch_mm

ALIKE = 0.55
"""Correlation of the paint with itself, moved, from which on it repeats."""
NEAR_MM = 4.0
"""Paint always resembles itself this close by."""
MOST = 6
"""Number of shifts that are returned."""
LEAST_COMMON = 0.3
"""Least share of the patches that are compared at a shift."""


def repeats_of(patches: Patches, paint: Paint) -> list[Array]:
    """Return shifts (3,), mm in the scan's frame, by which the paint looks like itself; the most alike first.

    From the masked autocorrelation over the grid of patches (D. Padfield 2012), which on the usual distances of a dive is nearly metric.
    """
    value = paint.value
    known = np.isfinite(value)
    if np.count_nonzero(known) < 200:
        return []
    correlation, common = _autocorrelation(np.where(known, value, 0.0), known)
    h, w = value.shape
    pitch = patch_pitch_mm(patches)
    dv, du = np.mgrid[-h + 1 : h, -w + 1 : w]
    far = np.hypot(dv, du) * pitch > NEAR_MM
    # Each shift and its opposite are the same news.
    half = (dv > 0) | ((dv == 0) & (du > 0))
    candidate = far & half & (common > LEAST_COMMON * np.count_nonzero(known)) & (correlation > ALIKE)
    candidate &= _is_peak(correlation)
    at = np.argwhere(candidate)
    order = np.argsort(-correlation[candidate])[:MOST]
    shifts = []
    for v, u in at[order]:
        shift = _shift_mm(patches.centre_mm, int(dv[v, u]), int(du[v, u]))
        if shift is not None:
            shifts += [shift, -shift]
    return shifts


def _autocorrelation(value: Array, known: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return Pearson's correlation of the known values with themselves at each shift, zero shift in the middle, and how many are in
    common."""
    h, w = value.shape
    size = (2 * h - 1, 2 * w - 1)

    def correlate(a: Array, b: Array) -> Array:
        spectrum = np.fft.rfft2(a, size) * np.conj(np.fft.rfft2(b, size))
        full = np.fft.irfft2(spectrum, size)
        return np.roll(full, (h - 1, w - 1), axis=(0, 1))

    one = known.astype(np.float64)
    n = np.maximum(np.round(correlate(one, one)), 1.0)
    first, second = correlate(value, one), correlate(one, value)
    square = value * value
    product = correlate(value, value) - first * second / n
    spread = (correlate(square, one) - first**2 / n) * (correlate(one, square) - second**2 / n)
    return np.asarray(product / np.sqrt(np.maximum(spread, 1e-12))), n


def _is_peak(correlation: Array) -> NDArray[np.bool_]:
    inner = correlation[1:-1, 1:-1]
    peak = np.ones(inner.shape, bool)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            if (dv, du) != (0, 0):
                peak &= (
                    inner >= correlation[1 + dv : correlation.shape[0] - 1 + dv, 1 + du : correlation.shape[1] - 1 + du]
                )
    return np.pad(peak, 1)


def _shift_mm(centre: Array, dv: int, du: int) -> Array | None:
    """Return the median displacement (3,) between patches ``dv`` rows and ``du`` columns apart."""
    h, w = centre.shape[:2]
    to = centre[max(dv, 0) : h + min(dv, 0), max(du, 0) : w + min(du, 0)]
    here = centre[max(-dv, 0) : h + min(-dv, 0), max(-du, 0) : w + min(-du, 0)]
    step = (to - here).reshape(-1, 3)
    step = step[np.isfinite(step[:, 0])]
    return np.median(step, axis=0) if len(step) else None
