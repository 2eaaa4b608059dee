"""Owns changes of the ambient light during a sequence: where, how strong, and the phase bias.

Principle. The four sine images I0..I3 of one direction give (I0 − I2, I3 − I1) = 2B (cos φ, sin φ). That is a circle
about the origin, and bright and dark image tell its radius. Ambient light that changes by δ0..δ3 moves the circle's
centre to (δ0 − δ2, δ3 − δ1). The same shift biases the phase.

Coarse changes. The centre is fitted in each block of the image (``fit.py``), from the vector's length as a function of
its direction. Fringes, and motion along them, do not move the centre. Fitted as well: smooth terms, the projector's
third harmonic, and backscatter, which shortens the circle of dark surfaces more than that of bright ones.

Fine changes (caustics). I0 − I1 + I2 − I3 contains neither fringe nor texture; the code calls it the third difference.
What neighbouring pixels have in common there is light; what they have not is noise.

A level that is common to all four images of a direction is not seen, and does no harm.
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
"""Squares of both differences that bias phases, over that of the third: 1 for light that changes at random from image
to image, 2 for light that drifts."""
CLEAR_DN = 248.0
"""No image of the pixel may be brighter."""
SURE = 0.5
"""A block is judged when its shift is known better than this, times what would harm."""
HARMFUL_RIPPLE = 0.5
"""Bias of the phase, as a share of its noise, from which on it is seen in the surface."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes of light that one camera saw; ``None``: too little is illuminated to tell."""

    harmed: float | None
    """Share of judged pixels, 0..1, whose phase is biased by more than ``HARMFUL_RIPPLE`` of its noise."""
    ripple: float | None
    """The bias over the noise, rms over the fringe, median over the image."""
    ripple_px: float | None
    """The same in pattern px."""
    common: float | None
    """Amplitude of what all blocks have in common, as a share of the projector's light."""
    local: float | None
    """Amplitude of what they have not: rms over the blocks, the fit's own noise taken off."""
    ambient_flicker: float | None
    """``common`` over ambient light; unknown where there is next to none."""


UNKNOWN = Changes(None, None, None, None, None, None)


@dataclass(frozen=True, slots=True)
class _Fit:
    """One direction: differences of the four levels in each block, over the projector's light, and their sigma."""

    cosine: Floats
    sine: Floats
    third: Floats
    sigma: Floats
    expected: Floats
    """The sigma that there would be with a noise of one grey value in each difference: how well the phases are
    spread."""
    fine: Floats
    """Mean square of the third difference within the block, less its mean, that neighbours have in common: light of
    finer grain than a block."""


@dataclass(frozen=True, slots=True)
class EarlyFit:
    """Fit of X as X alone tells it; arrays over the sample's pixels (rows, columns) and over its blocks, row by row."""

    good: NDArray[np.bool_]
    """(rows, columns): pixels that the fit was made with."""
    found: Floats
    """(5, blocks): what ``fit_blocks`` found; NaN of blocks with too few pixels."""
    rest: Floats
    """(rows · columns,): what it left of their third differences, of the good pixels."""


def fit_early(grey: NDArray[np.uint8], sequence: PatternSequence) -> EarlyFit:
    """Fit one camera's sine images of X, while Y is still being recorded; ``grey`` (n, rows, columns) as in ``Sample``."""
    four = np.stack([grey[k] for k in sequence.axis(Direction.X).sine]).astype(np.float32)
    bright, contrast = grey[sequence.bright], grey[sequence.bright].astype(np.float32) - grey[sequence.dark]
    top_dn = np.maximum(bright, four.max(axis=0))
    modulation_dn = np.float32(0.5) * np.sqrt((four[0] - four[2]) ** 2 + (four[3] - four[1]) ** 2)
    good = _good((contrast >= MIN_CONTRAST_DN) | (bright >= FULL_DN), top_dn, modulation_dn)
    pixels, rows, columns, order, ends = in_blocks(good, (BLOCK_ROWS, BLOCK_COLUMNS), MIN_PIXELS)
    found, rest = np.full((5, BLOCK_ROWS * BLOCK_COLUMNS), np.nan), np.zeros(good.size)
    if ends.size:
        steps, light = (values.reshape(*values.shape[:-2], -1)[..., pixels] for values in (four, contrast))
        of_blocks, of_pixels = fit_blocks(
            np.ascontiguousarray(steps, np.float64), light.astype(np.float64), rows, columns, order, ends
        )
        found[:, _numbers(rows, columns, order, ends, good.shape)] = of_blocks
        rest[pixels] = of_pixels
    return EarlyFit(good, found, rest)


def _good(
    illuminated: NDArray[np.bool_], top_dn: NDArray[np.float32], modulation_dn: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return the pixels by which light is judged."""
    # Where noise alone decides what is saturated, only pixels with favourable phases would be left.
    return np.asarray(illuminated & (top_dn <= CLEAR_DN) & (modulation_dn >= MIN_MODULATION_DN))


def _numbers(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
    shape: tuple[int, ...],
) -> NDArray[np.intp]:
    """Return the numbers (blocks,) of the blocks that ``in_blocks`` kept, of an image of ``shape``."""
    first = order[ends - np.diff(ends, prepend=0)]
    down, across = rows[first] * BLOCK_ROWS // shape[0], columns[first] * BLOCK_COLUMNS // shape[1]
    return np.asarray(down * BLOCK_COLUMNS + across)


def measure_changes(s: Sample, sequence: PatternSequence, noise: CameraNoise, early: EarlyFit | None = None) -> Changes:
    """Measure one camera's changes of light by its sine and Gray images.

    ``early``: what ``fit_early`` returned, where it was asked while the frames arrived.
    """
    good = _good(s.illuminated, s.top_dn, s.modulation_dn)
    pixels, rows, columns, order, ends = in_blocks(good, (BLOCK_ROWS, BLOCK_COLUMNS), MIN_PIXELS)
    if not ends.size:
        return UNKNOWN
    grey = s.grey.reshape(len(s.grey), -1)
    contrast = s.contrast_dn.reshape(-1)[pixels].astype(np.float64)
    four = {d: np.stack([grey[k][pixels] for k in sequence.axis(d).sine]).astype(np.float64) for d in Direction}
    places = rows, columns
    fit_x = fit_blocks if early is None else partial(_fit_the_rest, early, good)
    fits = {
        Direction.X: _fit(fit_x, four[Direction.X], contrast, places, order, ends),
        Direction.Y: _fit(fit_blocks, four[Direction.Y], contrast, places, order, ends),
    }
    # Noise of a block's pixels against their contrast, as the phase has it: rms of sigma over contrast.
    mean = four[Direction.X].mean(axis=0)
    variance = noise.variance_dn2(mean) / contrast**2
    relative = np.sqrt(medians_of(variance, order, ends))
    counts = np.diff(ends, prepend=0).astype(np.float64)
    expected = np.maximum(*(fit.expected for fit in fits.values())) * math.sqrt(2.0 * median(variance * contrast**2))
    judged = expected < SURE * HARMFUL_RIPPLE * relative
    if not judged.any():
        return UNKNOWN
    weight, relative = counts[judged] / counts[judged].sum(), relative[judged]
    # Mean square of the shift without that of its own noise, and the light of finer grain than a block.
    squares = [
        (np.maximum(f.cosine**2 + f.sine**2 - 2.0 * f.sigma**2, 0.0) + FINE_FACTOR * np.maximum(f.fine, 0.0))[judged]
        for f in fits.values()
    ]
    square = (squares[0] + squares[1]) / 2.0
    ripple = np.sqrt(square) / (2.0 * relative)
    # A fringe's amplitude is half of the contrast: phase = difference / (2 √2 B).
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


def _fit_the_rest(
    early: EarlyFit,
    good: NDArray[np.bool_],
    four: Floats,
    contrast: Floats,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> tuple[Floats, Floats]:
    """Return what ``fit_blocks`` does, of which only those blocks are fitted that have lost a pixel since the ``early``
    fit."""
    numbers = _numbers(rows, columns, order, ends, good.shape)
    v, u = np.nonzero(good != early.good)
    lost = np.bincount(
        v * BLOCK_ROWS // good.shape[0] * BLOCK_COLUMNS + u * BLOCK_COLUMNS // good.shape[1],
        minlength=early.found.shape[1],
    )
    same = lost[numbers] == 0
    counts = np.diff(ends, prepend=0)
    kept = np.repeat(same, counts)
    found, rest = fit_blocks(four, contrast, rows, columns, order[~kept], np.cumsum(counts[~same]))
    both = np.empty((len(found), ends.size))
    both[:, same], both[:, ~same] = early.found[:, numbers[same]], found
    # Pixels outside of all blocks keep their third difference, as it is.
    mine = order[kept]
    rest[mine] = early.rest[rows[mine] * good.shape[1] + columns[mine]]
    return both, rest


def _fit(
    fit: Callable[..., tuple[Floats, Floats]],
    four: Floats,
    contrast: Floats,
    places: tuple[NDArray[np.intp], NDArray[np.intp]],
    order: NDArray[np.intp],
    ends: NDArray[np.intp],
) -> _Fit:
    """Fit ``four`` (4, n) sine images of the pixels at ``places`` (row and column) by ``fit``, in blocks as
    ``fit_blocks`` takes them."""
    found, third = fit(four, contrast, *places, order, ends)
    # Light that is usual before dark pixels is many grey values before bright ones; noise is not. Either is no edge.
    usual = CLIP * MAD_TO_SIGMA
    most_dn, most_share = usual * median(np.abs(third * contrast)), usual * median(np.abs(third))
    fine = common_of_neighbours(third, contrast, *places, order, ends, most_dn, most_share)
    cosine, sine, third_common, sigma, expected = found
    return _Fit(cosine, sine, third_common, sigma, expected, fine)


def _apart(fits: dict[Direction, _Fit], judged: NDArray[np.bool_], weight: Floats) -> tuple[float, float]:
    """Return the amplitude of what blocks have in common, and of what they have not."""
    common2, local2 = 0.0, 0.0
    for fit in fits.values():
        parts = np.stack([fit.cosine, fit.sine, fit.third])[:, judged]
        c, s, third = middle = [_median(part, weight) for part in parts]
        apart2 = np.sum((parts[:2].T - middle[:2]) ** 2, axis=1) - 2.0 * fit.sigma[judged] ** 2
        local2 += float(np.sum(weight * np.maximum(apart2, 0.0)))
        # Of the four levels that have these differences and no sum: the inverse of (δ0 − δ2, δ3 − δ1,
        # δ0 − δ1 + δ2 − δ3).
        common2 += 0.5 * (c * c + s * s) + 0.25 * third * third
    # A sine of amplitude a has a mean square of a²/2; a difference of two images has twice the square of one.
    return float(np.sqrt(2.0 * common2 / 8.0)), float(np.sqrt(local2 / 4.0))


def _median(value: Floats, weight: Floats) -> float:
    order = np.argsort(value)
    at = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(value[order][min(int(at), value.size - 1)])
