"""Changes of the ambient light during a sequence: place, strength, and their phase errors.

Principle. The four sine images I0..I3 of one direction give (I0 − I2, I3 − I1) = 2B (cos φ, sin φ). That is a circle
about the origin, and bright and dark image tell its radius. Ambient light that changes by δ0..δ3 moves the circle's
centre to (δ0 − δ2, δ3 − δ1). The same shift causes a phase error.

Coarse changes. The centre is fitted in each block of the image (``fit.py``), from the vector's length as a function of
its direction. Fringes, and motion along them, do not move the centre. Fitted as well: smooth terms, the projector's
third harmonic, and backscatter, which shortens the circle of dark surfaces more than that of bright ones.

Fine changes (caustics). I0 − I1 + I2 − I3 contains neither fringe nor texture; the code calls it the third difference.
Its part that neighbouring pixels have in common is light; the other part is noise.

A level that is common to all four images of a direction is not detected, and causes no error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import MIN_CONTRAST_DN, MIN_MODULATION_DN
from appliance.measure.light.noise import FULL_DN, MAD_TO_SIGMA, CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.points.quality import median
from appliance.measure.verdicts.light.fit import (
    CLIP,
    common_of_neighbours,
    fit_blocks,
    in_blocks,
    medians_of,
)
from appliance.measure.verdicts.light.levels import Sample

BLOCK_ROWS, BLOCK_COLUMNS = 6, 8
MIN_PIXELS = 100
"""Least number of pixels of a block for its light to be judged."""
FINE_FACTOR = 1.5
"""Squares of both differences that cause phase errors, over that of the third: 1 for light that changes at random from
image to image, 2 for light that drifts."""
CLEAR_DN = 248.0
"""Largest grey value of the pixel in any image."""
SURE = 0.5
"""A block is judged if the standard deviation of its shift is below this share of a harmful shift."""
HARMFUL_RIPPLE = 0.5
"""Phase error, as a share of the phase noise, from which on it is visible in the surface."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes of light in the images of one camera; ``None``: too few pixels are illuminated."""

    harmed: float | None
    """Share of judged pixels, 0..1, whose phase error is more than ``HARMFUL_RIPPLE`` of the phase noise."""
    ripple: float | None
    """Phase error over the noise, RMS over the fringe, median over the image."""
    ripple_px: float | None
    """The same in pattern px."""
    common: float | None
    """Amplitude of the part that all blocks have in common, as a share of the projector's light."""
    local: float | None
    """Amplitude of the other part: RMS over the blocks, less the noise of the fit."""
    ambient_flicker: float | None
    """``common`` over ambient light; unknown if there is almost no ambient light."""


UNKNOWN = Changes(None, None, None, None, None, None)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Differences of the four levels of one direction in each block, and their sigma.

    They are shares of the projector's light.
    """

    cosine: Floats
    sine: Floats
    third: Floats
    sigma: Floats
    expected: Floats
    """Sigma for a noise of one grey value in each difference; it is small if the phases are well distributed."""
    fine: Floats
    """Common part of neighbours in the third difference less its mean, as a mean square: light that varies within a
    block."""


@dataclass(frozen=True, slots=True)
class EarlyFit:
    """Fit of X before the frames of Y; arrays by the sample's pixels or its blocks, row by row."""

    good: NDArray[np.bool_]
    """(rows, columns): pixels that were used."""
    coefficients: Floats
    """(5, blocks): coefficients of ``fit_blocks``; NaN for blocks with too few pixels."""
    residuals: Floats
    """(rows · columns,): residuals of the third differences; only those of the good pixels have a meaning."""


def fit_early(grey: NDArray[np.uint8], sequence: PatternSequence) -> EarlyFit:
    """Fit one camera's sine images of X while Y is captured; ``grey`` (n, rows, columns) as in ``Sample``."""
    four = np.stack([grey[k] for k in sequence.axis(Direction.X).sine]).astype(np.float32)
    bright, contrast = grey[sequence.bright], grey[sequence.bright].astype(np.float32) - grey[sequence.dark]
    top_dn = np.maximum(bright, four.max(axis=0))
    modulation_dn = np.float32(0.5) * np.sqrt((four[0] - four[2]) ** 2 + (four[3] - four[1]) ** 2)
    good = _good((contrast >= MIN_CONTRAST_DN) | (bright >= FULL_DN), top_dn, modulation_dn)
    pixels, rows, columns, order, ends = in_blocks(good, (BLOCK_ROWS, BLOCK_COLUMNS), MIN_PIXELS)
    coefficients, residuals = np.full((5, BLOCK_ROWS * BLOCK_COLUMNS), np.nan), np.zeros(good.size)
    if ends.size:
        steps, light = (values.reshape(*values.shape[:-2], -1)[..., pixels] for values in (four, contrast))
        of_blocks, of_pixels = fit_blocks(
            np.ascontiguousarray(steps, np.float64), light.astype(np.float64), rows, columns, order, ends
        )
        coefficients[:, _numbers(rows, columns, order, ends, good.shape)] = of_blocks
        residuals[pixels] = of_pixels
    return EarlyFit(good, coefficients, residuals)


def _good(
    illuminated: NDArray[np.bool_], top_dn: NDArray[np.float32], modulation_dn: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return the pixels by which light is judged."""
    # Near saturation only pixels with favourable phases and noise would be left.
    return np.asarray(illuminated & (top_dn <= CLEAR_DN) & (modulation_dn >= MIN_MODULATION_DN))


def _numbers(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
    shape: tuple[int, ...],
) -> NDArray[np.intp]:
    """Return the numbers (blocks,) of the blocks that ``in_blocks`` used in an image of ``shape``."""
    first = order[ends - np.diff(ends, prepend=0)]
    down, across = rows[first] * BLOCK_ROWS // shape[0], columns[first] * BLOCK_COLUMNS // shape[1]
    return np.asarray(down * BLOCK_COLUMNS + across)


def measure_changes(s: Sample, sequence: PatternSequence, noise: CameraNoise, early: EarlyFit | None = None) -> Changes:
    """Measure one camera's changes of light by its sine and Gray images.

    ``early``: the result of ``fit_early``, if it was computed while the frames arrived.
    """
    good = _good(s.illuminated, s.top_dn, s.modulation_dn)
    pixels, rows, columns, order, ends = in_blocks(good, (BLOCK_ROWS, BLOCK_COLUMNS), MIN_PIXELS)
    if not ends.size:
        return UNKNOWN
    grey = s.grey.reshape(len(s.grey), -1)
    contrast = s.contrast_dn.reshape(-1)[pixels].astype(np.float64)
    four = {d: np.stack([grey[k][pixels] for k in sequence.axis(d).sine]).astype(np.float64) for d in Direction}
    places = rows, columns
    fit_x = fit_blocks if early is None else partial(_fit_changed_blocks, early, good)
    fits = {
        Direction.X: _fit(fit_x, four[Direction.X], contrast, places, order, ends),
        Direction.Y: _fit(fit_blocks, four[Direction.Y], contrast, places, order, ends),
    }
    # Noise of the phase: RMS of sigma over contrast in each block.
    mean = four[Direction.X].mean(axis=0)
    variance = noise.variance_dn2(mean) / contrast**2
    relative = np.sqrt(medians_of(variance, order, ends))
    counts = np.diff(ends, prepend=0).astype(np.float64)
    expected = np.maximum(*(fit.expected for fit in fits.values())) * math.sqrt(2.0 * median(variance * contrast**2))
    judged = expected < SURE * HARMFUL_RIPPLE * relative
    if not judged.any():
        return UNKNOWN
    weight, relative = counts[judged] / counts[judged].sum(), relative[judged]
    # Mean square of the shift less that of its noise, and of the light that varies within a block.
    squares = [
        (np.maximum(f.cosine**2 + f.sine**2 - 2.0 * f.sigma**2, 0.0) + FINE_FACTOR * np.maximum(f.fine, 0.0))[judged]
        for f in fits.values()
    ]
    square = (squares[0] + squares[1]) / 2.0
    ripple = np.sqrt(square) / (2.0 * relative)
    # The modulation B is half of the contrast: phase error = difference / (2 √2 B).
    ripple_px = sequence.period_px / (2.0 * np.pi) * np.sqrt(square) / np.sqrt(2.0)
    common, local = _apart(fits, judged, weight)
    ambient = median((s.dark_dn.reshape(-1)[pixels] - noise.black_dn) / contrast)
    return Changes(
        harmed=float(weight[ripple > HARMFUL_RIPPLE].sum()),
        ripple=_median(ripple, weight),
        ripple_px=_median(ripple_px, weight),
        common=common,
        local=local,
        ambient_flicker=common / ambient if ambient > 0.02 else None,
    )


def _fit_changed_blocks(
    early: EarlyFit,
    good: NDArray[np.bool_],
    four: Floats,
    contrast: Floats,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> tuple[Floats, Floats]:
    """Return the result of ``fit_blocks``; fit only blocks that lost pixels since the ``early`` fit."""
    numbers = _numbers(rows, columns, order, ends, good.shape)
    v, u = np.nonzero(good != early.good)
    lost = np.bincount(
        v * BLOCK_ROWS // good.shape[0] * BLOCK_COLUMNS + u * BLOCK_COLUMNS // good.shape[1],
        minlength=early.coefficients.shape[1],
    )
    same = lost[numbers] == 0
    counts = np.diff(ends, prepend=0)
    unchanged = np.repeat(same, counts)
    coefficients, residuals = fit_blocks(four, contrast, rows, columns, order[~unchanged], np.cumsum(counts[~same]))
    all_coefficients = np.empty((len(coefficients), ends.size))
    all_coefficients[:, same], all_coefficients[:, ~same] = early.coefficients[:, numbers[same]], coefficients
    # Pixels outside of all blocks keep their third difference.
    unchanged_pixels = order[unchanged]
    residuals[unchanged_pixels] = early.residuals[rows[unchanged_pixels] * good.shape[1] + columns[unchanged_pixels]]
    return all_coefficients, residuals


def _fit(
    fit: Callable[..., tuple[Floats, Floats]],
    four: Floats,
    contrast: Floats,
    places: tuple[NDArray[np.intp], NDArray[np.intp]],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> _Fit:
    """Fit ``four`` (4, n) sine images at ``places`` (row and column) by ``fit``, block by block."""
    coefficients, third = fit(four, contrast, *places, order, ends)
    # Usual changes of light are many grey values before bright pixels, usual noise is not. Neither is an edge.
    usual = CLIP * MAD_TO_SIGMA
    most_dn, most_share = usual * median(np.abs(third * contrast)), usual * median(np.abs(third))
    fine = common_of_neighbours(third, contrast, *places, order, ends, most_dn, most_share)
    cosine, sine, third_common, sigma, expected = coefficients
    return _Fit(cosine, sine, third_common, sigma, expected, fine)


def _apart(fits: dict[Direction, _Fit], judged: NDArray[np.bool_], weight: Floats) -> tuple[float, float]:
    """Return the amplitude of the part that all blocks have in common, and that of their own parts."""
    common2, local2 = 0.0, 0.0
    for fit in fits.values():
        parts = np.stack([fit.cosine, fit.sine, fit.third])[:, judged]
        c, s, third = middle = [_median(part, weight) for part in parts]
        apart2 = np.sum((parts[:2].T - middle[:2]) ** 2, axis=1) - 2.0 * fit.sigma[judged] ** 2
        local2 += float(np.sum(weight * np.maximum(apart2, 0.0)))
        # Squares of the four levels with these differences and sum 0: the inverse of (δ0 − δ2, δ3 − δ1,
        # δ0 − δ1 + δ2 − δ3).
        common2 += 0.5 * (c * c + s * s) + 0.25 * third * third
    # A sine of amplitude a has a mean square of a²/2; a difference of two images has twice the square of one image.
    return float(np.sqrt(2.0 * common2 / 8.0)), float(np.sqrt(local2 / 4.0))


def _median(value: Floats, weight: Floats) -> float:
    order = np.argsort(value)
    index = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(value[order][min(int(index), value.size - 1)])
