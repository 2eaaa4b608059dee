"""Gray code decoding where water scatters more light back than the object reflects.

In a Gray image a pixel shows G = b O + f V over the dark frame: the object's light O if its bit b is set, and the share
f of the backscatter V that illuminated stripes make along its ray. The middle between bright and dark decides correctly
as long as V is less than O. Beyond, coarse stripes may illuminate most of the ray (f near 1) before a dark pixel, or
almost none of it before a bright one: the bits then follow the water, and whole patches would become smooth surfaces at
wrong places.

O follows from the fringes, which backscatter averages away, since a ray crosses many of them. So V = (bright − dark) −
O is known for each pixel. f is smooth over the image: it is computed from pixels with a reliable bit (G < O: not set; G
> V: set) and extrapolated to their neighbours, whose bits it decides in turn. Where V is many times O, hardly any pixel
is reliable. There f of fine stripes is ½ initially, since a ray crosses many of them, and whole pieces of the surface
are decided by all of their reliable bits together (``pieces``). A pixel whose bit remains doubtful takes its order from
its neighbours and is masked if they do not decide, unless it lies on the border of that bit's stripes, where the phase
determines the half period anyway.

read_through_backscatter                  the half periods of one camera's columns
examine, fringe_scale, any_backscatter    whether there is so much backscatter, and the scale of O

Symbols, per pixel and in grey values: G ``gray_dn``, O ``object_dn``, bright − dark ``light_dn``, V ``veil``, f
``share`` (per block of the image) and ``veil_share``, σ ``noise_dn`` and ``sigma``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.gray_code import periods, plain_number
from appliance.measure.decode.pieces import decide_by_neighbours, decide_pieces, find_pieces
from appliance.measure.light.noise import FULL_DN, CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence

Floats = NDArray[np.float32]

BLOCKS = 100
"""Number of blocks across the image in each of which f is one number."""
SAMPLES_PER_BLOCK = 4
"""Number of samples across a block, and down it, from which f is estimated."""
LOOK_SAMPLES = 15_000
"""Number of pixels that are examined for relevant backscatter."""
SPREAD_BLOCKS = 1.5
"""Standard deviation, in blocks, of the neighbourhood from which f is averaged."""
LEAST_KNOWN = 0.03
"""Least share of that neighbourhood with known bits for an estimate of f."""
LEVEL = 2.0
"""Strength of the prior that f has no slope, in blocks squared: about that of a completely known neighbourhood."""
ROUNDS = 48
SETTLED = 0.0002
"""Share of the pixels that a round must decide for another round."""
SURE = 0.75
"""Lower limit of O over its estimate from the fringes: blur and the projector's response vary over the image."""
CONTINUOUS_SIGMAS = 6.0
"""Least O, in σ, of a sample whose phase continues to the next."""
PIECE_ROUNDS = 8
"""Largest number of rounds in which f is extrapolated and pieces are decided."""
NOISE_SIGMAS = 3.0
MARGIN = 0.25
"""Least distance of G from the threshold, in O, of a reliable bit; it must also exceed ``NOISE_SIGMAS``."""
MARGIN_OF_VEIL = 0.15
"""Uncertainty of f: a bit is doubtful if G is nearer to the threshold than this share of V, at most ``MARGIN`` of O."""
APART_SIGMAS = 5.0
"""Least distance from the threshold, in σ, of a bit that noise does not change."""
BEYOND = 0.6
"""Largest distance of G from the values of both bits, in O; beyond it f is taken as unknown."""
FINE_IMAGES = 3
"""Number of finest Gray images: one of them has no border near a given pixel, and f is ½ in all of them."""
CLEAR_MODULATION_DN = 8.0
"""Least modulation of pixels whose fringes give the share of the fringes in the object's light."""
MIN_LIGHT_DN, MIN_MODULATION_DN = 8.0, 5.0
"""Least contrast of a decoded pixel, and least modulation if the noise is unknown."""
MAX_PHASE_ERROR_PERIODS = 1 / 20
"""Largest standard deviation of the phase with much backscatter: five of them are the quarter of a period between the
phase and a wrong order. Weak fringes there do not mean a shadow or an edge."""
MIN_CLEAR = 20
"""Fewest clear pixels for an estimate."""
HALF_VEIL, FEW = 0.5, 0.005
"""Backscatter of half the object's light, and the largest share of pixels with so much that changes no bit."""
_ZERO_BIT, _ONE_BIT, _OPEN, _NONE = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
_SURE, DOUBT, UNSEEN = np.uint8(0), np.uint8(1), np.uint8(2)
"""Reliable Gray bits; too doubtful for the half period; too little light."""
_FULL, _SHADOW, _SATURATED = np.uint8(FULL_DN), np.uint8(1), np.uint8(2)


class SampledPixels(NamedTuple):
    """A sample of one camera's pixels, (h, w) float32 each."""

    light_dn: Floats
    """Bright minus dark."""
    object_dn: Floats
    """The object's light O, from the fringes."""
    noise_dn: Floats
    """Standard deviation of the bright frame."""
    usable: NDArray[np.bool_]
    """True where the pixel is illuminated and nowhere saturated."""


class FringeScale(NamedTuple):
    """Factors from grey values to O and its noise."""

    per_half_dn: np.float32
    """O per half grey value of modulation."""
    light_per_sines: np.float32
    """Bright minus dark over (sum of the four sines − 4 dark), for pixels whose bright frame is saturated."""
    dark_dn2: np.float32
    """Variance at no light."""
    shot_dn: np.float32
    """Additional variance per grey value."""


def read_through_backscatter(
    sequence: PatternSequence,
    frames: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    noise: CameraNoise,
    half_period: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
) -> float | None:
    """Write the half periods of the pattern columns (h, w) uint8, and the reliability into ``doubtful``.

    ``DOUBT``: a bit cannot be decided; ``UNSEEN``: too little light. Too little is a modulation below the weakest one
    that noise allows, if backscatter is at least half of the object's light, and below ``MIN_MODULATION_DN`` otherwise.
    ``frames`` (n, h, w) uint8 are one camera's; ``mask`` (h, w) is the decoder's. Returns the weakest modulation, in
    grey values; ``None``, with nothing written, if the backscatter is too weak to have changed a bit.
    """
    scale = scale_of_backscatter(sequence, frames, mask, noise)
    if scale is None:
        return None
    weakest_dn = _weakest_modulation_dn(sequence, frames, mask, noise)
    _read(sequence, frames, scale, half_period, doubtful, weakest_dn)
    return weakest_dn


def _weakest_modulation_dn(
    sequence: PatternSequence, frames: NDArray[np.uint8], mask: NDArray[np.uint8], noise: CameraNoise
) -> float:
    """Return the modulation with ``MAX_PHASE_ERROR_PERIODS`` of noise, at most ``MIN_MODULATION_DN``.

    Four steps with noise σ and modulation B give the phase an error of σ / (√2 B) rad. The noise is that of the mean
    grey value of the illuminated pixels, most of which is backscatter: one limit for all of them. ``frames`` and
    ``mask`` as in ``read_through_backscatter``.
    """
    sample = _few(mask.shape)
    illuminated = mask[sample] != _SHADOW
    if not illuminated.any():
        return MIN_MODULATION_DN
    grey_dn = 0.5 * sum(float(frames[k][sample][illuminated].mean()) for k in (sequence.bright, sequence.dark))
    sigma_dn = math.sqrt(noise.variance_dn2(grey_dn))
    return min(MIN_MODULATION_DN, sigma_dn / (math.sqrt(2.0) * math.tau * MAX_PHASE_ERROR_PERIODS))


def warm_up(sequence: PatternSequence, frames: NDArray[np.uint8], noise: CameraNoise) -> None:
    """Run every kernel on frames (n, h, w) of any content."""
    number, doubtful = np.zeros((2, *frames.shape[1:]), np.uint8)
    _read(sequence, frames, scale_of(1.0, 0.5, noise), number, doubtful, MIN_MODULATION_DN)


def _read(
    sequence: PatternSequence,
    frames: NDArray[np.uint8],
    scale: FringeScale,
    half_period: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
    weakest_dn: float,
) -> None:
    across = sequence.axis(Direction.X)
    stride = max(1, -(-frames.shape[2] // BLOCKS) // SAMPLES_PER_BLOCK)
    sample = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))
    pixels = sample_pixels(sequence, frames, sample, scale)
    shares = _shares(sequence, frames, sample, pixels)
    soft, sine = np.empty_like(half_period), np.array(across.sine, np.int64)
    _number(
        frames, np.array(across.gray, np.int64), sine, sequence.bright, sequence.dark, shares,
        SAMPLES_PER_BLOCK * stride, scale, np.float32(weakest_dn), half_period, soft, doubtful,
    )  # fmt: skip
    decide_by_neighbours(frames, sine, soft, half_period, doubtful)


def _shares(
    sequence: PatternSequence, frames: NDArray[np.uint8], sample: tuple[slice, slice], pixels: SampledPixels
) -> Floats:
    """Return f of all Gray images of the columns in each block, (images, rows, columns); NaN if unknown."""
    across = sequence.axis(Direction.X)
    coarse = len(across.gray) - FINE_IMAGES
    dark = frames[sequence.dark][sample].astype(np.float32)
    gray_dn = [frames[k][sample].astype(np.float32) - dark for k in across.gray]
    states = np.empty((len(gray_dn), *dark.shape), np.uint8)
    block = SAMPLES_PER_BLOCK
    rows, columns = (-(-size // block) for size in dark.shape)
    half = np.full((rows, columns), 0.5, np.float32)
    for k, gray in enumerate(gray_dn):
        _seed(gray, pixels.light_dn, pixels.object_dn, pixels.noise_dn, pixels.usable, states[k])
        if k >= coarse:
            _decide(gray, pixels.light_dn, pixels.object_dn, pixels.noise_dn, half, block, states[k])
    i0, i1, i2, i3 = (frames[k][sample].astype(np.float32) for k in across.sine)
    turns = np.float32(0.5 / np.pi) * np.arctan2(i3 - i1, i0 - i2)
    turns[~pixels.usable | (pixels.object_dn < np.float32(CONTINUOUS_SIGMAS) * pixels.noise_dn)] = np.nan
    ahead, members, ends = find_pieces(turns)
    is_decided = np.zeros(ends.size, np.bool_)
    sums, shares = np.empty((rows, columns, 3), np.float32), np.empty((len(gray_dn), rows, columns), np.float32)
    for _ in range(PIECE_ROUNDS):
        new = decide_pieces(ahead, members, ends, is_decided, states, coarse)
        decided_bits = 0
        for k, gray in enumerate(gray_dn):
            _gather(gray, pixels.light_dn, pixels.object_dn, states[k], block, sums)
            shares[k] = _smooth_share(sums)
            if k >= coarse:
                shares[k][np.isnan(shares[k])] = 0.5
            # f is known now beside the decided pieces, and decides bits of the next ones.
            decided_bits += _decide(
                gray, pixels.light_dn, pixels.object_dn, pixels.noise_dn, shares[k], block, states[k]
            )
        if new == 0 and decided_bits <= dark.size * SETTLED:
            break
    return shares


class ExaminedPixels(NamedTuple):
    """Pixels that are examined for backscatter, (n,) float32 each, grey values."""

    reason: NDArray[np.uint8]
    """(n,) uint8: the mask."""
    bright_dn: Floats
    light_dn: Floats
    """Bright minus dark."""
    double_dn: Floats
    """Twice the modulation of X."""
    swing_dn: Floats
    """Largest swing of a fine Gray image about its middle."""
    sines_dn: Floats
    """Sum of the four sines less four times dark."""


def examine(sequence: PatternSequence, frames: NDArray[np.uint8], mask: NDArray[np.uint8]) -> ExaminedPixels:
    """Sample one camera's ``frames`` (n, h, w) uint8 evenly; ``mask`` (h, w) is the decoder's."""
    grid_rows, across = _few(mask.shape)[0], sequence.axis(Direction.X)
    shown = np.array([sequence.bright, sequence.dark, *across.sine, *across.gray[-FINE_IMAGES:]], np.int64)
    room = len(range(grid_rows.start, mask.shape[0], grid_rows.step)) * len(
        range(grid_rows.start, mask.shape[1], grid_rows.step)
    )
    reason, levels = np.empty(room, np.uint8), np.empty((5, room), np.float32)
    _examine(frames, shown, mask, grid_rows.start, grid_rows.step, reason, levels)
    return ExaminedPixels(reason, *levels)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _examine(
    frames: NDArray[np.uint8],
    shown: NDArray[np.int64],
    mask: NDArray[np.uint8],
    first: int,
    stride: int,
    reason: NDArray[np.uint8],
    levels: Floats,
) -> None:
    """Write ``reason`` (n,) and ``levels`` (5, n), the fields of ``ExaminedPixels``.

    ``shown``: indices of bright, dark, sines of X and fine Gray images.
    """
    n = 0
    for y in range(first, mask.shape[0], stride):
        for x in range(first, mask.shape[1], stride):
            bright, dark = np.float32(frames[shown[0], y, x]), np.float32(frames[shown[1], y, x])
            i0, i1 = np.float32(frames[shown[2], y, x]), np.float32(frames[shown[3], y, x])
            i2, i3 = np.float32(frames[shown[4], y, x]), np.float32(frames[shown[5], y, x])
            # Four steps of 90°: (I0 − I2, I3 − I1) is 2 B (cos φ, sin φ). Only the root is not an integer.
            cosine, sine = i0 - i2, i3 - i1
            swing = np.float32(1.0)
            for k in range(6, shown.size):
                swing = max(swing, abs(np.float32(2.0) * np.float32(frames[shown[k], y, x]) - (bright + dark)))
            reason[n] = mask[y, x]
            levels[0, n], levels[1, n] = bright, bright - dark
            levels[2, n], levels[3, n] = np.sqrt(cosine * cosine + sine * sine), swing
            levels[4, n] = i0 + i1 + i2 + i3 - np.float32(4.0) * dark
            n += 1


def fringe_scale(
    examined: ExaminedPixels, noise: CameraNoise, clear_dn: float = CLEAR_MODULATION_DN
) -> FringeScale | None:
    """Measure the scale on pixels whose modulation exceeds ``clear_dn``; ``None`` if there are too few."""
    clear = examined.double_dn > 2.0 * clear_dn
    clear &= (examined.reason != _SHADOW) & (examined.reason != _SATURATED) & (examined.bright_dn < FULL_DN)
    if np.count_nonzero(clear) < MIN_CLEAR:
        return None
    # Contrast: 2B over the swing of a fine Gray image about its middle, (2b − 1) O + (2f − 1) V, which is ± O since f
    # is ½ there. Swings are integers, exact in float32.
    contrast = _median(examined.double_dn[clear] / examined.swing_dn[clear].astype(np.float64))
    return scale_of(
        contrast, _median(examined.light_dn[clear] / np.maximum(examined.sines_dn[clear], np.float32(1.0))), noise
    )


def _median(values: NDArray[Any]) -> float:
    """Return the median of finite values as ``numpy.median`` does, in a third of its time.

    That sorts for two ranks, this for one.
    """
    half = values.size // 2
    parted = np.partition(values, half)
    if values.size % 2:
        return float(parted[half])
    return float((parted[:half].max() + parted[half]) / values.dtype.type(2.0))


def scale_of(contrast: float, light_per_sines: float, noise: CameraNoise) -> FringeScale:
    """Return the scale for a ``contrast``: the modulation over half of the object's light."""
    return FringeScale(
        np.float32(1.0 / contrast),
        np.float32(light_per_sines),
        np.float32(noise.dark_variance_dn2),
        np.float32(noise.dn_per_e),
    )


def any_backscatter(examined: ExaminedPixels, scale: FringeScale) -> bool:
    """Return True if enough decoded pixels have backscatter of half the object's light.

    Motion between the images also gives some pixels more light than their fringes, and as many others less; water gives
    none less. So the number of pixels with less light is subtracted.
    """
    object_dn, noise_dn = _object_and_noise_dn(examined.bright_dn, examined.double_dn, scale)
    valid = examined.reason == np.uint8(0)
    noise_dn = NOISE_SIGMAS * noise_dn
    more = np.count_nonzero(valid & (examined.light_dn > (1.0 + HALF_VEIL) * object_dn + noise_dn))
    less = np.count_nonzero(valid & (object_dn > (1.0 + HALF_VEIL) * examined.light_dn + noise_dn))
    return bool(more - less > FEW * max(int(np.count_nonzero(valid)), 1))


def scale_of_backscatter(
    sequence: PatternSequence,
    frames: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    noise: CameraNoise,
    clear_dn: float = CLEAR_MODULATION_DN,
) -> FringeScale | None:
    """Return the scale of one camera's ``frames``; ``None`` if no relevant backscatter needs it.

    See ``fringe_scale`` and ``any_backscatter``.
    """
    examined = examine(sequence, frames, mask)
    scale = fringe_scale(examined, noise, clear_dn)
    return scale if scale is not None and any_backscatter(examined, scale) else None


def _few(shape: tuple[int, ...]) -> tuple[slice, slice]:
    stride = max(1, int((shape[0] * shape[1] / LOOK_SAMPLES) ** 0.5))
    return slice(stride // 2, None, stride), slice(stride // 2, None, stride)


def sample_pixels(
    sequence: PatternSequence, frames: NDArray[np.uint8], sample: tuple[slice, slice], scale: FringeScale
) -> SampledPixels:
    i0, i1, i2, i3 = (frames[k][sample].astype(np.float32) for k in sequence.axis(Direction.X).sine)
    bright, dark = (frames[k][sample].astype(np.float32) for k in (sequence.bright, sequence.dark))
    top = np.maximum(np.maximum(i0, i1), np.maximum(i2, i3))
    double: Floats = np.hypot(i0 - i2, i3 - i1)
    object_dn, noise_dn = _object_and_noise_dn(bright, double, scale)
    usable = (bright - dark >= MIN_LIGHT_DN) & (top < FULL_DN) & (bright < FULL_DN) & (double > 2.0 * MIN_MODULATION_DN)
    return SampledPixels(bright - dark, object_dn, noise_dn, usable)


def _object_and_noise_dn(bright_dn: Floats, double_dn: Floats, scale: FringeScale) -> tuple[Floats, Floats]:
    """Return O and σ of pixels from their bright image and twice their modulation."""
    variance = np.maximum(scale.dark_dn2 + scale.shot_dn * bright_dn, np.float32(0.0))
    return double_dn * scale.per_half_dn, np.asarray(np.sqrt(variance), np.float32)


def illuminated_share(gray_dn: Floats, pixels: SampledPixels, fine: bool = False) -> Floats:
    """Return f of one Gray image in each block, (rows, columns) float32; NaN if unknown.

    Alternates between fitting f to the pixels with a known bit, and deciding bits by this f. ``fine``: the stripes of
    the image are so narrow that f is ½ where no pixel gives another value.
    """
    block = SAMPLES_PER_BLOCK
    state = np.empty(gray_dn.shape, np.uint8)
    _seed(gray_dn, pixels.light_dn, pixels.object_dn, pixels.noise_dn, pixels.usable, state)
    rows, columns = (-(-size // block) for size in gray_dn.shape)
    sums, share = np.empty((rows, columns, 3), np.float32), np.full((rows, columns), 0.5, np.float32)
    if fine:
        _decide(gray_dn, pixels.light_dn, pixels.object_dn, pixels.noise_dn, share, block, state)
    for _ in range(ROUNDS):
        _gather(gray_dn, pixels.light_dn, pixels.object_dn, state, block, sums)
        share[:] = _smooth_share(sums)
        if fine:
            share[np.isnan(share)] = 0.5
        decided_bits = _decide(gray_dn, pixels.light_dn, pixels.object_dn, pixels.noise_dn, share, block, state)
        if decided_bits <= state.size * SETTLED:
            break
    return share


def _smooth_share(sums: Floats) -> Floats:
    """Return f (rows, columns) float32 of blocks: a plane fitted around each block; NaN if unknown.

    ``sums`` is from ``_gather``. It is a plane, since f is extrapolated to parts of the image without known bits, where
    a mean would lag behind.
    """
    # Coordinates about the middle of the image, so that their squares are exact enough in 32 bits.
    y, x = np.mgrid[: sums.shape[0], : sums.shape[1]].astype(np.float32)
    y, x = y - np.float32(sums.shape[0] // 2), x - np.float32(sums.shape[1] // 2)
    known_count, lit_veil, veil = (sums[..., k] for k in range(3))
    # Weighted by V: minimise Σ w V (g / V − f − a Δx − b Δy)², g = f V of the block; w is Gaussian.
    moments = [
        known_count,
        veil,
        veil * x,
        veil * y,
        veil * x * x,
        veil * x * y,
        veil * y * y,
        lit_veil,
        lit_veil * x,
        lit_veil * y,
    ]
    blurred = cv2.GaussianBlur(np.stack(moments, -1), (0, 0), SPREAD_BLOCKS)
    n, s, sx, sy, sxx, sxy, syy, g, gx, gy = np.moveaxis(blurred, -1, 0)
    # Moments about the block itself, with a weak prior of slopes of 0.
    prior = np.float32(LEVEL) * s + np.float32(1e-6)
    sxx, sxy, syy = (
        sxx - np.float32(2.0) * x * sx + x * x * s,
        sxy - x * sy - y * sx + x * y * s,
        syy - np.float32(2.0) * y * sy + y * y * s,
    )
    sx, sy, gx, gy, sxx, syy = sx - x * s, sy - y * s, gx - x * g, gy - y * g, sxx + prior, syy + prior
    # Cramer's rule for f. The weight of f is full if known neighbours surround the block, and small if it is
    # extrapolated.
    down, across, cross_term = sxx * syy - sxy * sxy, sx * syy - sxy * sy, sx * sxy - sxx * sy
    weight = s * down - sx * across + sy * cross_term
    share = (g * down - gx * across + gy * cross_term) / np.maximum(weight, np.float32(1e-9))
    share[n * weight <= LEAST_KNOWN * SAMPLES_PER_BLOCK**2 * s * down] = np.nan
    return np.asarray(np.clip(share, 0.0, 1.0), np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _seed(
    gray_dn: Floats,
    light_dn: Floats,
    object_dn: Floats,
    noise_dn: Floats,
    usable: NDArray[np.bool_],
    state: NDArray[np.uint8],
) -> None:
    """Write the bits that are reliable for any f between 0 and 1 into ``state``; _OPEN for the others.

    _NONE if unusable.
    """
    for y in range(state.shape[0]):
        for x in range(state.shape[1]):
            state[y, x] = _NONE
            if usable[y, x]:
                # Lower limit of O.
                sure = np.float32(SURE) * object_dn[y, x] - np.float32(NOISE_SIGMAS) * noise_dn[y, x]
                light, gray = light_dn[y, x], gray_dn[y, x]
                # V < O: the middle between bright and dark decides. Otherwise G > V is a set bit, G < O is not.
                if light < np.float32(2.0) * sure:
                    state[y, x] = _ONE_BIT if gray >= np.float32(0.5) * light else _ZERO_BIT
                elif gray > light - sure:
                    state[y, x] = _ONE_BIT
                else:
                    state[y, x] = _ZERO_BIT if gray < sure else _OPEN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _gather(
    gray_dn: Floats, light_dn: Floats, object_dn: Floats, state: NDArray[np.uint8], block: int, sums: Floats
) -> None:
    """Sum per block: number of pixels with a known bit, their f V in this image, and their V."""
    sums[:] = np.float32(0.0)
    for y in range(state.shape[0]):
        row = sums[y // block]
        for x in range(state.shape[1]):
            if state[y, x] <= _ONE_BIT:
                cell = row[x // block]
                veil = light_dn[y, x] - object_dn[y, x]
                cell[0] += np.float32(1.0)
                cell[1] += gray_dn[y, x] - (object_dn[y, x] if state[y, x] == _ONE_BIT else np.float32(0.0))
                cell[2] += veil if veil > np.float32(0.0) else np.float32(0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _decide(
    gray_dn: Floats,
    light_dn: Floats,
    object_dn: Floats,
    noise_dn: Floats,
    share: Floats,
    block: int,
    state: NDArray[np.uint8],
) -> int:
    """Decide the open bits that f makes reliable; return their number."""
    count = 0
    for y in range(state.shape[0]):
        row = share[y // block]
        for x in range(state.shape[1]):
            if state[y, x] == _OPEN:
                veil_share = row[x // block]
                object_light = object_dn[y, x]
                # G − f V is O or 0: reliable if its distance from O/2 is more than doubt and less than O.
                object_part = gray_dn[y, x] - veil_share * max(light_dn[y, x] - object_light, np.float32(0.0))
                off = object_part - np.float32(0.5) * object_light
                doubt = max(np.float32(MARGIN) * object_light, np.float32(NOISE_SIGMAS) * noise_dn[y, x])
                if (abs(off) > doubt) & (abs(off) < object_light):
                    state[y, x] = _ONE_BIT if off > np.float32(0.0) else _ZERO_BIT
                    count += 1
    return count


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _number(
    frames: NDArray[np.uint8],
    gray: NDArray[np.int64],
    sine: NDArray[np.int64],
    bright: int,
    dark: int,
    shares: Floats,
    block_px: int,
    scale: FringeScale,
    weakest_dn: np.float32,
    half_period: NDArray[np.uint8],
    soft_bits: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
) -> None:
    """Write half periods, doubtful bits, and their reliability (DOUBT; UNSEEN without light), (h, w)."""
    rows, columns = half_period.shape
    last_y, last_x = shares.shape[1] - 1, shares.shape[2] - 1
    # The length of both differences is twice the modulation. Fringes that are weak without backscatter mean darkness.
    weak, dark_weak = np.float32(4.0) * weakest_dn * weakest_dn, np.float32((2.0 * MIN_MODULATION_DN) ** 2)
    object_light = np.empty(columns, np.float32)
    veil = np.empty(columns, np.float32)
    room = np.empty(columns, np.float32)
    doubt = np.empty(columns, np.float32)
    sure = np.empty(columns, np.float32)
    code = np.empty(columns, np.int64)
    soft = np.empty(columns, np.int64)
    unseen = np.empty(columns, np.bool_)
    for y in range(rows):
        # O, V and the limits of doubt of each pixel of the row.
        i0, i1, i2, i3 = frames[sine[0], y], frames[sine[1], y], frames[sine[2], y], frames[sine[3], y]
        for x in range(columns):
            cosine, quadrature = np.float32(i0[x]) - np.float32(i2[x]), np.float32(i3[x]) - np.float32(i1[x])
            black = np.float32(frames[dark, y, x])
            light = np.float32(frames[bright, y, x]) - black
            if frames[bright, y, x] == _FULL:  # bright − dark from the sines
                sines = np.float32(i0[x]) + np.float32(i1[x]) + np.float32(i2[x]) + np.float32(i3[x])
                light = max(light, scale.light_per_sines * (sines - np.float32(4.0) * black))
            # σ² = dark + shot · grey. O from the fringes, but at most all light; V is the remainder.
            sigma = np.sqrt(max(scale.dark_dn2 + scale.shot_dn * (light + black), np.float32(0.0)))
            from_fringes = scale.per_half_dn * np.sqrt(cosine * cosine + quadrature * quadrature)
            object_light[x] = min(from_fringes, light)
            veil[x] = light - object_light[x]
            # A bit is doubtful nearer to its threshold than a share of V, at most one of O, plus the excess of noise
            # over O/2; beyond room, a value fits neither bit.
            apart = np.float32(APART_SIGMAS) * sigma
            doubt[x] = min(np.float32(MARGIN_OF_VEIL) * veil[x], np.float32(MARGIN) * object_light[x])
            doubt[x] += max(apart - np.float32(0.5) * object_light[x], np.float32(0.0))
            room[x] = np.float32(0.5) * object_light[x] + max(np.float32(BEYOND) * object_light[x], apart)
            sure[x] = np.float32(SURE) * from_fringes - np.float32(NOISE_SIGMAS) * sigma
            squared = cosine * cosine + quadrature * quadrature
            limit = weak if veil[x] >= np.float32(HALF_VEIL) * object_light[x] else dark_weak
            unseen[x] = (light < np.float32(MIN_LIGHT_DN)) | (squared < limit)
            code[x], soft[x] = 0, 0
        # Bit by bit: code takes the bits, soft a 1 for a doubtful bit.
        for k in range(gray.size):
            image, share = frames[gray[k], y], shares[k, min(y // block_px, last_y)]
            for x in range(columns):
                veil_share = share[min(x // block_px, last_x)]
                gray_dn = np.float32(image[x]) - np.float32(frames[dark, y, x])
                # G − f V against the middle O/2, where f is known; else G against (O + V)/2.
                if veil_share == veil_share:
                    off = gray_dn - veil_share * veil[x] - np.float32(0.5) * object_light[x]
                    unsure = (abs(off) < doubt[x]) | (abs(off) > room[x])
                else:
                    middle = np.float32(0.5) * (object_light[x] + veil[x])
                    off = gray_dn - middle
                    unsure = abs(off) < middle - sure[x]
                code[x] = (code[x] << 1) | (1 if off >= np.float32(0.0) else 0)
                soft[x] = (soft[x] << 1) | (1 if unsure else 0)
        # Half periods, and whether a doubtful bit matters.
        for x in range(columns):
            number = plain_number(code[x])
            half_period[y, x] = np.uint8(number)
            soft_bits[y, x] = np.uint8(soft[x])
            lost = False
            if (soft[x] != 0) & (not unseen[x]):
                # At the border of its stripes a wrong bit gives the next half period, which the phase corrects.
                turned = plain_number(code[x] ^ soft[x])
                wrapped = np.arctan2(np.float32(i3[x]) - np.float32(i1[x]), np.float32(i0[x]) - np.float32(i2[x]))
                wrapped *= np.float32(0.5 / np.pi)
                lost = periods(number, wrapped) != periods(turned, wrapped)
            doubtful[y, x] = UNSEEN if unseen[x] else (DOUBT if lost else _SURE)
