"""Owns whether the texture stood still: the fringes' mean of one direction against that of the other, and how it flowed.

Four steps of 90° add up to an image without fringes. The one of the x-sines and the one of the y-sines are eleven frames
apart; at rest they differ by noise, once the daylight's change is fitted as a gain, and by what is left of the fringes: four
steps take out all harmonics of a light that is no pure sine but each fourth one. That part follows the phase, and is taken out by it. Texture is divided by its surroundings
before it is followed: the projector's light stays with the instrument, only albedo moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.scan.noise import MAD_TO_SIGMA

WIDTH_PX = 400
"""Images are binned to about this width."""
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
"""A difference, in units of noise, from which on its part that follows the phase is looked for: at rest there is none below it."""
LOCKED_BINS, LOCKED_ROUNDS = 24, 2
"""Bins of a quarter of a fringe, and rounds in which both directions' parts are found in turn."""
CLIP, CLIPPED = 2.5, 0.986
"""Differences beyond so many standard deviations count as that; and what this leaves of a normal one's."""


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
def _binned_mean(
    images: NDArray[np.uint8], numbers: NDArray[np.int64], bin_px: int, stride: int, out: NDArray[np.float32]
) -> None:
    """Compute the mean over the images ``numbers`` and over squares of ``bin_px`` (of which each ``stride``-th row
    counts).

    Whole rows are added up first, which is what vector instructions do best.
    """
    line = np.zeros(out.shape[1] * bin_px, np.uint16)
    scale = np.float32(1.0 / (numbers.size * bin_px * ((bin_px + stride - 1) // stride)))
    for j in range(out.shape[0]):
        # The column sums of one row of bins, over all its images and rows; 16 bits hold 257 full-scale rows.
        line[:] = np.uint16(0)
        for k in numbers:
            for y in range(0, bin_px, stride):
                _add_row(images[k, j * bin_px + y], line)
        for i in range(out.shape[1]):
            total = np.uint32(0)
            for x in range(i * bin_px, (i + 1) * bin_px):
                total += np.uint32(line[x])
            out[j, i] = np.float32(total) * scale


@dataclass(frozen=True, slots=True)
class EarlyMeans:
    """One camera's binned means before Y, (rows, columns) float32."""

    references: NDArray[np.float32]
    """Mean of bright and dark."""
    x: NDArray[np.float32]
    """Mean of the sine images of X."""


def early_means(frames: NDArray[np.uint8], sequence: PatternSequence) -> EarlyMeans:
    """Return the means of ``frames`` (n, h, w) uint8, of which those of Y may still be missing."""
    references = _mean(frames, (sequence.bright, sequence.dark))
    return EarlyMeans(references, _mean(frames, sequence.axis(Direction.X).sine))


def _bins(width_px: int) -> tuple[int, int]:
    """Return how many pixels are binned along a side, and which rows of them count: each so-and-so-many-th."""
    bin_px = max(1, round(width_px / WIDTH_PX))
    return bin_px, 2 if bin_px >= 4 else 1


def _mean(frames: NDArray[np.uint8], numbers: tuple[int, ...]) -> NDArray[np.float32]:
    bin_px, stride = _bins(frames.shape[2])
    out = np.zeros((frames.shape[1] // bin_px, frames.shape[2] // bin_px), np.float32)
    _binned_mean(frames, np.array(numbers), bin_px, stride, out)
    return out


def texture_shift(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
    means: EarlyMeans | None = None,
) -> TextureShift:
    """Measure the texture's movement in one camera's frames (n, h, w) uint8; ``variance_dn2`` as in ``drift_map``.

    ``means``: what ``early_means`` returned, where it was asked while the frames arrived.
    """
    bin_px, stride = _bins(frames.shape[2])
    x_axis, y_axis = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    means = means or early_means(frames, sequence)
    early, first, second = means.references, means.x, _mean(frames, y_axis.sine)
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
    """Places in a quarter of a fringe at which the pixels lie, for both directions: (pixels inside,) each, 0..``LOCKED_BINS`` − 1."""

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
    """Binned pixels, m of them, by which the texture's change is judged."""

    shape: tuple[int, int]
    place: NDArray[np.intp]
    """(m,): flat numbers."""
    around: NDArray[np.float32]
    """(m,): share of the pixels around each that are judged as well."""


def _judged(inside: NDArray[np.bool_]) -> _Judged:
    place = np.flatnonzero(inside)
    around = np.maximum(cv2.boxFilter(inside.astype(np.float32), -1, (9, 9)), 1e-3)
    return _Judged((inside.shape[0], inside.shape[1]), place, np.asarray(around, np.float32).ravel()[place])


def _difference(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    judged: _Judged,
    variance: float,
    fringes: _Fringes | None = None,
) -> float:
    """Return the RMS of b − gain · a without what is smooth, robust, in standard deviations of noise; and without what
    follows ``fringes``."""
    before, after = a.ravel()[judged.place], b.ravel()[judged.place]
    gain = float(np.sum(before * after) / np.sum(before**2))
    rest = after - np.float32(gain) * before
    if fringes is not None:
        rest = fringes.without(rest, before)
    image = np.zeros(judged.shape, np.float32)
    image.ravel()[judged.place] = rest
    # What is smooth is daylight; the finest grain is texture that moved, or noise.
    high = rest - np.asarray(cv2.boxFilter(image, -1, (9, 9))).ravel()[judged.place] / judged.around
    most = np.float32(CLIP) * np.float32(high.std())
    return float(np.clip(high, -most, most).std() / CLIPPED / np.sqrt(variance * gain**2))


def _texture(image: NDArray[np.float32], valid: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return the light divided by its surroundings, as levels around 128, and the levels per grey value of each
    pixel."""
    weight = valid.astype(np.float32)
    size = (SURROUNDINGS_PX, SURROUNDINGS_PX)
    around = cv2.boxFilter(image * weight, -1, size) / np.maximum(cv2.boxFilter(weight, -1, size), 1e-3)
    scale = np.float32(TEXTURE_LEVELS) / np.maximum(around, np.float32(1.0))
    levels = np.float32(128.0) + scale * (image - around)
    picture = np.where(valid, np.clip(np.rint(levels), 0.0, 255.0), 128.0).astype(np.uint8)
    return picture, np.asarray(scale, np.float32)


def _follow(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    valid: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    variance: float,
) -> NDArray[np.float64]:
    """Return flows (n, 2) in binned px, where there is texture enough and the way back leads back."""
    height, width = first.shape
    before, scale = _texture(first, valid)
    after, _ = _texture(second, valid)
    columns, rows = FLOW_POINTS
    x = (np.arange(columns) + 0.5) * width / columns
    y = (np.arange(rows) + 0.5) * height / rows
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2).astype(np.float32)
    at = grid.astype(int)
    grid = grid[inside[at[:, 1], at[:, 0]]]
    # Silhouettes are not followed: they bend with the view.
    gx = cv2.Sobel(before, cv2.CV_32F, 1, 0, scale=0.125) * inside
    gy = cv2.Sobel(before, cv2.CV_32F, 0, 1, scale=0.125) * inside
    size = (WINDOW_PX, WINDOW_PX)
    xx, yy, xy = (cv2.boxFilter(g, -1, size) for g in (gx * gx, gy * gy, gx * gy))
    # The smaller eigenvalue of the structure tensor: texture must hold in both directions to be followed.
    least = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    # Sobel/8 of white noise has 3/16 of its variance.
    noise = (0.1875 * np.float32(variance)) * scale * scale * cv2.boxFilter(inside.astype(np.float32), -1, size)
    at = grid.astype(int)
    good = least[at[:, 1], at[:, 0]] > MIN_CONTRAST * noise[at[:, 1], at[:, 0]]
    grid = grid[good]
    if not len(grid):
        return np.empty((0, 2))
    # There and back again: a place that does not return was not followed.
    there, found = _lucas_kanade(before, after, grid)
    back, returned = _lucas_kanade(after, before, there)
    miss = np.linalg.norm(back - grid, axis=1)
    kept = found & returned & (miss < 0.5)
    return np.asarray((there - grid)[kept], np.float64)


def _lucas_kanade(
    before: NDArray[np.uint8], after: NDArray[np.uint8], places: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return where places (n, 2) of one picture are in the other, and whether they were found."""
    start = np.array(places, np.float32).reshape(-1, 1, 2)
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, start, start.copy(), winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS
    )
    return np.asarray(there, np.float32).reshape(-1, 2), np.asarray(found).reshape(-1) > 0
