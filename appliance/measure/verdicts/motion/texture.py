"""Owns whether the texture stood still: the fringes' mean of one direction against that of the other, and how it
flowed.

Four steps of 90° add up to an image without fringes. The one of the x-sines and the one of the y-sines are eleven
frames apart; at rest they differ by noise, once the daylight's change is fitted as a gain, and by what is left of the
fringes: four steps take out all harmonics of a light that is no pure sine but each fourth one. That part follows the
phase, and is taken out by it. Texture is divided by its surroundings before it is followed: the projector's light stays
with the instrument, only albedo moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.patterns import Direction, PatternSequence

WIDTH_PX = 400
"""Images are binned to about this width."""
_FULL_SIZE_BIN_PX = 4
"""Bins of a camera of 1600 px, for which there is a loop of its own."""
SURROUNDINGS_PX = 15
FLOW_POINTS = (16, 12)
WINDOW_PX, LEVELS = 21, 3
TEXTURE_LEVELS = 500.0
"""Grey levels per unit of texture, for an image of eight bits."""
MIN_CONTRAST = 4.0
"""Least square of a window's gradients over that of noise, in the direction that has less of it."""
MIN_POINTS = 6
LEAST_PIXELS = 200
"""Binned pixels that show the object, away from its outline; of fewer nothing is said."""
LOCKED_FROM = 1.1
"""A difference, in units of noise, from which on its part that follows the phase is looked for: at rest there is none
below it."""
LOCKED_BINS, LOCKED_ROUNDS = 24, 2
"""Bins of a quarter of a fringe, and rounds in which both directions' parts are found in turn."""
CLIP, CLIPPED = 2.5, 0.986
"""Differences beyond so many standard deviations count as that; and what this leaves of a normal one's."""


def warm_up() -> None:
    """Run the kernels that are asked where something is decoded on next to nothing."""
    image, inside = np.ones((4, 4), np.float32), np.ones((4, 4), np.bool_)
    _difference(image, image, _judged(inside), 1.0)
    picture, _ = _texture(image, inside, _weights(inside))
    _structure(picture, inside, np.zeros((1, 2), np.int64), np.empty((1, 4), np.float32))


@dataclass(frozen=True, slots=True)
class TextureShift:
    """Movement of the texture before one camera, in the camera's own px."""

    flow_px: tuple[float, float] | None
    """Median flow from the middle of the x-sines to that of the y-sines; ``None``: there is no texture to follow."""
    flow_sd_px: float | None
    change: float | None
    """RMS difference between both means in units of noise: 1 at rest."""
    early_change: float | None
    """The same between (bright + dark)/2 and the x-mean."""
    frames: float
    """Number of frames between the two means."""
    bin_px: int
    """The camera's pixels that were binned, along a side."""
    locked: float = 0.0
    """Part that followed the phase and was taken out of both changes, in units of noise."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_row(row: NDArray[np.uint8], line: NDArray[np.uint16]) -> None:
    for x in range(line.size):
        line[x] = np.uint16(line[x] + np.uint16(row[x]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_binned(image: NDArray[np.uint8], bin_px: int, stride: int, sums: NDArray[np.uint32]) -> None:
    """Add the sums over squares of ``bin_px`` (of which each ``stride``-th row counts).

    Whole rows are added up first, which is what vector instructions do best; so are four neighbours, if their number is
    known.
    """
    line = np.zeros(sums.shape[1] * bin_px, np.uint16)
    for j in range(sums.shape[0]):
        # The column sums of one row of bins; 16 bits hold 257 full-scale rows.
        line[:] = np.uint16(0)
        for y in range(0, bin_px, stride):
            _add_row(image[j * bin_px + y], line)
        if bin_px == _FULL_SIZE_BIN_PX:
            for i in range(sums.shape[1]):
                sums[j, i] += np.uint32(line[4 * i]) + line[4 * i + 1] + line[4 * i + 2] + line[4 * i + 3]
            continue
        for i in range(sums.shape[1]):
            total = np.uint32(0)
            for x in range(i * bin_px, (i + 1) * bin_px):
                total += np.uint32(line[x])
            sums[j, i] += total


@dataclass(frozen=True, slots=True)
class Means:
    """One camera's binned means, (rows, columns) float32."""

    references: NDArray[np.float32]
    """Mean of bright and dark."""
    x: NDArray[np.float32]
    """Mean of the sine images of X."""
    y: NDArray[np.float32]
    """Mean of those of Y."""


class Averager:
    """Takes the means of one camera's sequence, frame by frame: two thirds of its images are asked for nothing."""

    def __init__(self, sequence: PatternSequence) -> None:
        x, y = (sequence.axis(direction).sine for direction in (Direction.X, Direction.Y))
        self._numbers = ((sequence.bright, sequence.dark), x, y)
        self._sums = np.empty((len(self._numbers), 0, 0), np.uint32)
        self._bins = (1, 1)

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0 for each sequence."""
        _, height_px, width_px = frames.shape
        if index == 0:
            self._bins = _bins(width_px)
            bin_px = self._bins[0]
            self._sums = np.zeros((len(self._numbers), height_px // bin_px, width_px // bin_px), np.uint32)
        for numbers, sums in zip(self._numbers, self._sums, strict=True):
            if index in numbers:
                _add_binned(frames[index], *self._bins, sums)

    def finish(self) -> Means:
        """Return the means, after the last frame."""
        bin_px, stride = self._bins
        rows = (bin_px + stride - 1) // stride
        references, x, y = (
            sums.astype(np.float32) * np.float32(1.0 / (len(numbers) * bin_px * rows))
            for numbers, sums in zip(self._numbers, self._sums, strict=True)
        )
        return Means(references, x, y)


def means_of(frames: NDArray[np.uint8], sequence: PatternSequence) -> Means:
    """Return the means of whole ``frames`` (n, h, w) uint8."""
    averager = Averager(sequence)
    for index in range(len(sequence)):
        averager.push(frames, index)
    return averager.finish()


def _bins(width_px: int) -> tuple[int, int]:
    """Return how many pixels are binned along a side, and which rows of them count: each so-and-so-many-th."""
    bin_px = max(1, round(width_px / WIDTH_PX))
    return bin_px, 2 if bin_px >= 4 else 1


def texture_shift(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
    means: Means | None = None,
) -> TextureShift:
    """Measure the texture's movement in one camera's frames (n, h, w) uint8; ``variance_dn2`` as in ``drift_map``.

    ``means``: what an ``Averager`` returned, where it was there while the frames arrived.
    """
    bin_px, stride = _bins(frames.shape[2])
    x_axis, y_axis = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    means = means or means_of(frames, sequence)
    early, first, second = means.references, means.x, means.y
    shape = first.shape
    middle = bin_px // 2
    valid = np.isfinite(decoded.p_px[middle::bin_px, middle::bin_px][: shape[0], : shape[1]])
    valid &= np.isfinite(decoded.q_px[middle::bin_px, middle::bin_px][: shape[0], : shape[1]])
    inside = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    pixels = bin_px * (bin_px // stride)
    apart = float(np.mean(y_axis.sine) - np.mean(x_axis.sine))
    dark, per_dn = variance_dn2
    if np.count_nonzero(inside) < LEAST_PIXELS:
        # Too little is decoded to tell noise from a change, but what is illuminated can still be followed.
        masks = decoded.mask[middle::bin_px, middle::bin_px][: shape[0], : shape[1]]
        valid = (masks != Mask.SHADOW) & (masks != Mask.SATURATED)
        inside = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        if np.count_nonzero(inside) < LEAST_PIXELS:
            return TextureShift(None, None, None, None, apart, bin_px)
        noise = float(dark + per_dn * np.mean(first[inside])) / pixels
        return _flow(_follow(first, second, valid, inside, 0.25 * noise), None, None, apart, bin_px)
    noise = float(dark + per_dn * np.mean(first[inside])) / pixels
    judged = _judged(inside)
    change = _difference(first, second, judged, noise * (0.25 + 0.25))
    early_change = _difference(early, first, judged, noise * (0.5 + 0.25))
    locked = 0.0
    if max(change, early_change) > LOCKED_FROM:
        at = (slice(middle, None, bin_px), slice(middle, None, bin_px))
        fringes = _fringes(decoded, inside, sequence.period_px, at)
        before = max(change, early_change)
        change = _difference(first, second, judged, noise * (0.25 + 0.25), fringes)
        early_change = _difference(early, first, judged, noise * (0.5 + 0.25), fringes)
        locked = float(np.sqrt(max(before**2 - max(change, early_change) ** 2, 0.0)))
    flows = _follow(first, second, valid, inside, 0.25 * noise)
    return replace(_flow(flows, change, early_change, apart, bin_px), locked=locked)


def _flow(
    flows: NDArray[np.float64], change: float | None, early_change: float | None, apart: float, bin_px: int
) -> TextureShift:
    """Return the texture's movement by ``flows`` (n, 2) in binned px; no flow where these are too few."""
    if len(flows) < MIN_POINTS:
        return TextureShift(None, None, change, early_change, apart, bin_px)
    flow = np.median(flows, 0)
    spread = MAD_TO_SIGMA * np.median(np.abs(flows - flow), 0)
    sd = float(np.hypot(*spread) * 1.25 / np.sqrt(len(flows)))
    shift_px = (float(flow[0]) * bin_px, float(flow[1]) * bin_px)
    return TextureShift(shift_px, sd * bin_px, change, early_change, apart, bin_px)


@dataclass(frozen=True, slots=True)
class _Fringes:
    """Places in a quarter of a fringe at which the pixels lie, for both directions: (pixels inside,) each,
    0..``LOCKED_BINS`` − 1."""

    bins: tuple[NDArray[np.int64], NDArray[np.int64]]

    def without(self, rest: NDArray[np.float32], light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return differences (pixels,) without their part that follows the phase, in proportion to the ``light``."""
        left = rest.astype(np.float64)
        for _ in range(LOCKED_ROUNDS):
            for at in self.bins:
                of = np.bincount(at, light * left, LOCKED_BINS) / np.maximum(
                    np.bincount(at, light * light, LOCKED_BINS), 1e-3
                )
                left -= of[at] * light
        return left.astype(np.float32)


def _fringes(decoded: CameraDecoder, inside: NDArray[np.bool_], period_px: int, at: tuple[slice, slice]) -> _Fringes:
    height, width = inside.shape
    p, q = (
        (coordinate[at][:height, :width][inside] * (4.0 / period_px)) % 1.0 * LOCKED_BINS
        for coordinate in (decoded.p_px, decoded.q_px)
    )
    return _Fringes((np.minimum(p, LOCKED_BINS - 1).astype(np.int64), np.minimum(q, LOCKED_BINS - 1).astype(np.int64)))


@dataclass(frozen=True, slots=True)
class _Judged:
    """Binned pixels by which the texture's change is judged; arrays (rows, columns)."""

    inside: NDArray[np.bool_]
    around: NDArray[np.float32]
    """Share of the pixels around each that are judged as well."""


def _judged(inside: NDArray[np.bool_]) -> _Judged:
    around = np.asarray(cv2.boxFilter(inside.astype(np.float32), -1, (9, 9)), np.float32)
    return _Judged(inside, np.maximum(around, np.float32(1e-3), out=around))


def _difference(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    judged: _Judged,
    variance: float,
    fringes: _Fringes | None = None,
) -> float:
    """Return the RMS of b − gain · a without what is smooth, robust, in standard deviations of noise; and without what
    follows ``fringes``."""
    inside = judged.inside
    rest = np.empty_like(a)
    gain = _subtract(a, b, inside, rest)
    if fringes is not None:
        rest[inside] = fringes.without(rest[inside], a[inside])
    # What is smooth is daylight; the finest grain is texture that moved, or noise.
    smooth = np.asarray(cv2.boxFilter(rest, -1, (9, 9)), np.float32)
    return float(_clipped_sd(rest, smooth, judged.around, inside) / CLIPPED / np.sqrt(variance * gain**2))


_SUMS_FAST = {"reassoc", "contract", "nsz"}


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_SUMS_FAST)
def _subtract(
    a: NDArray[np.float32], b: NDArray[np.float32], inside: NDArray[np.bool_], rest: NDArray[np.float32]
) -> float:
    """Write b − gain · a to ``rest``, 0 outside; return the gain, that of least squares."""
    both = own = 0.0
    for j in range(a.shape[0]):
        for i in range(a.shape[1]):
            mine = np.float64(a[j, i]) if inside[j, i] else 0.0
            both += mine * np.float64(b[j, i])
            own += mine * mine
    gain = both / own
    for j in range(a.shape[0]):
        for i in range(a.shape[1]):
            left = b[j, i] - np.float32(gain) * a[j, i]
            rest[j, i] = left if inside[j, i] else np.float32(0.0)
    return float(gain)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_SUMS_FAST)
def _clipped_sd(
    rest: NDArray[np.float32], smooth: NDArray[np.float32], around: NDArray[np.float32], inside: NDArray[np.bool_]
) -> float:
    """Return the standard deviation of rest − smooth / around inside, clipped at ``CLIP`` times what it would be
    without; ``rest`` is written to."""
    count, total, squares = 0, 0.0, 0.0
    for j in range(rest.shape[0]):
        for i in range(rest.shape[1]):
            high = rest[j, i] - smooth[j, i] / around[j, i]
            high = high if inside[j, i] else np.float32(0.0)
            rest[j, i] = high
            count += inside[j, i]
            total += np.float64(high)
            squares += np.float64(high) * np.float64(high)
    most = np.float32(CLIP) * np.float32(np.sqrt(max(squares / count - (total / count) ** 2, 0.0)))
    total, squares = 0.0, 0.0
    for j in range(rest.shape[0]):
        for i in range(rest.shape[1]):
            high = rest[j, i]
            high = most if high > most else high
            high = -most if high < -most else high
            total += np.float64(high)
            squares += np.float64(high) * np.float64(high)
    return float(np.sqrt(max(squares / count - (total / count) ** 2, 0.0)))


def _texture(
    image: NDArray[np.float32], valid: NDArray[np.bool_], weights: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return the light divided by its surroundings, as levels around 128, and the levels per grey value of each
    pixel. ``weights``: the share of the surroundings that is ``valid`` (``_weights``)."""
    picture, scale = np.empty(image.shape, np.uint8), np.empty(image.shape, np.float32)
    around = np.asarray(cv2.boxFilter(image * valid, -1, (SURROUNDINGS_PX, SURROUNDINGS_PX)), np.float32)
    _write_levels(image, valid, around, weights, picture, scale)
    return picture, scale


def _weights(valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    return np.asarray(cv2.boxFilter(valid.astype(np.float32), -1, (SURROUNDINGS_PX, SURROUNDINGS_PX)), np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _write_levels(
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    around: NDArray[np.float32],
    weights: NDArray[np.float32],
    picture: NDArray[np.uint8],
    scale: NDArray[np.float32],
) -> None:
    """Write levels around 128, of valid pixels, and levels per grey value; ``around`` over ``weights`` is the mean
    light about each pixel."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            weight, least = weights[j, i], np.float32(1e-3)
            mean = around[j, i] / (weight if weight > least else least)
            per_dn = np.float32(TEXTURE_LEVELS) / (mean if mean > np.float32(1.0) else np.float32(1.0))
            level = np.rint(np.float32(128.0) + per_dn * (image[j, i] - mean))
            level = min(max(level, np.float32(0.0)), np.float32(255.0)) if valid[j, i] else np.float32(128.0)
            scale[j, i] = per_dn
            picture[j, i] = np.uint8(level)


def _follow(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    valid: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    variance: float,
) -> NDArray[np.float64]:
    """Return flows (n, 2) in binned px, where there is texture enough and the way back leads back."""
    height, width = first.shape
    weights = _weights(valid)
    before, scale = _texture(first, valid, weights)
    columns, rows = FLOW_POINTS
    x = (np.arange(columns) + 0.5) * width / columns
    y = (np.arange(rows) + 0.5) * height / rows
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2).astype(np.float32)
    at = grid.astype(int)
    grid = grid[inside[at[:, 1], at[:, 0]]]
    at = grid.astype(int)
    tensors = np.empty((len(at), 4), np.float32)
    _structure(before, inside, at, tensors)
    xx, yy, xy, share = tensors.T
    # The smaller eigenvalue of the structure tensor: texture must hold in both directions to be followed.
    least = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    # Sobel/8 of white noise has 3/16 of its variance.
    scale = scale[at[:, 1], at[:, 0]]
    good = least > MIN_CONTRAST * ((0.1875 * np.float32(variance)) * scale * scale * share)
    grid = grid[good]
    if not len(grid):
        return np.empty((0, 2))
    after, _ = _texture(second, valid, weights)
    # There and back again: a place that does not return was not followed.
    there, found = _lucas_kanade(before, after, grid)
    back, returned = _lucas_kanade(after, before, there)
    miss = np.linalg.norm(back - grid, axis=1)
    kept = found & returned & (miss < 0.5)
    return np.asarray((there - grid)[kept], np.float64)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _mirrored(place: int, size: int) -> int:
    """Return the place of the pixel that stands for one beyond the border, which counts once."""
    while place < 0 or place >= size:
        place = -place if place < 0 else 2 * (size - 1) - place
    return place


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _structure(
    picture: NDArray[np.uint8], inside: NDArray[np.bool_], at: NDArray[np.int64], tensors: NDArray[np.float32]
) -> None:
    """Write the means of gx², gy², gx gy and of ``inside`` over the windows around each place ``at`` (n, 2) to
    ``tensors`` (n, 4).

    Gradients are those of Sobel, per px, inside only: silhouettes are not followed, for they bend with the view.
    """
    height, width = picture.shape
    half = WINDOW_PX // 2
    for k in range(len(at)):
        xx = yy = xy = count = 0
        for y in range(at[k, 1] - half, at[k, 1] + half + 1):
            # Rows of the window, and those above and below; eight times the gradients are whole numbers.
            v = _mirrored(y, height)
            above, below = _mirrored(v - 1, height), _mirrored(v + 1, height)
            for x in range(at[k, 0] - half, at[k, 0] + half + 1):
                u = _mirrored(x, width)
                if not inside[v, u]:
                    continue
                left, right = _mirrored(u - 1, width), _mirrored(u + 1, width)
                corner, other = (
                    np.int64(picture[below, right]) - picture[above, left],
                    np.int64(picture[above, right]) - picture[below, left],
                )
                gx = corner + other + 2 * (np.int64(picture[v, right]) - picture[v, left])
                gy = corner - other + 2 * (np.int64(picture[below, u]) - picture[above, u])
                xx, yy, xy, count = xx + gx * gx, yy + gy * gy, xy + gx * gy, count + 1
        # Means over the window, of gradients per px.
        of_all = 1.0 / (64.0 * WINDOW_PX * WINDOW_PX)
        tensors[k, 0], tensors[k, 1], tensors[k, 2] = xx * of_all, yy * of_all, xy * of_all
        tensors[k, 3] = count / (WINDOW_PX * WINDOW_PX)


def _lucas_kanade(
    before: NDArray[np.uint8], after: NDArray[np.uint8], places: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return where places (n, 2) of one picture are in the other, and whether they were found."""
    start = np.array(places, np.float32).reshape(-1, 1, 2)
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, start, start.copy(), winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS
    )
    return np.asarray(there, np.float32).reshape(-1, 2), np.asarray(found).reshape(-1) > 0
