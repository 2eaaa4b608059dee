"""The change of the texture: the mean of the sines of one direction against that of the other.

The sum of four steps of 90° is an image without fringes. The one of the x-sines and the one of the y-sines are eleven
frames apart. At rest they differ by noise, by a gain if the ambient light changes, and by residual fringes: four steps
leave each fourth harmonic of a light that is no pure sine. That part follows the phase, by which it is fitted and
subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.patterns import Direction, PatternSequence

WIDTH_PX = 400
"""Images are binned to about this width."""
_FULL_SIZE_BIN_PX = 4
"""Bin size of a camera of 1600 px, for which there is a separate loop."""
SURROUNDINGS_PX, BLUR_PX = 15, 5
"""Binned px: window of the mean light by which texture is divided, and blur for following the texture."""
ALIKE, STAYS_PX = 0.9, 0.3
"""Least correlation of a texture that was followed, and least displacement of one that moved, binned px."""
ROUNDS, SETTLED = 30, 1e-3
LEAST_PIXELS = 200
"""Least number of binned pixels that show the object, away from its occluding contour."""
LOCKED_FROM = 1.1
"""Least difference, in units of noise, of which the part that follows the phase is fitted: there is none at rest below.
"""
LOCKED_BINS, LOCKED_ROUNDS = 24, 2
"""Number of bins of a quarter of a fringe, and number of rounds in which both directions' parts are fitted in turn."""
CLIP, CLIPPED = 2.5, 0.986
"""Limit in standard deviations to which differences are clipped, and the factor by which this reduces the standard
deviation of normal values."""


def warm_up() -> None:
    """Run the kernels that need decoded pixels on a few pixels."""
    image, inside = np.ones((4, 4), np.float32), np.ones((4, 4), np.bool_)
    _difference(image, image, _used_pixels(inside), 1.0)


@dataclass(frozen=True, slots=True)
class TextureChange:
    """Change of the texture before one camera: RMS differences in units of noise, 1 at rest."""

    late: float
    """Difference of the means of the x-sines and of the y-sines."""
    early: float
    """Difference of (bright + dark)/2 and the mean of the x-sines."""
    locked: float = 0.0
    """Part that followed the phase and was taken out of both, in units of noise."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_row(row: NDArray[np.uint8], line: NDArray[np.uint16]) -> None:
    for x in range(line.size):
        line[x] = np.uint16(line[x] + np.uint16(row[x]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_binned(image: NDArray[np.uint8], bin_px: int, stride: int, sums: NDArray[np.uint32]) -> None:
    """Add the sums over squares of ``bin_px`` (of which each ``stride``-th row counts).

    Rows are added up first, which the compiler vectorises; so are four neighbours, if their number is a constant.
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
    """Takes the means of one camera's sequence, frame by frame; two thirds of its images are not used."""

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
    """Return the means of complete ``frames`` (n, h, w) uint8."""
    averager = Averager(sequence)
    for index in range(len(sequence)):
        averager.push(frames, index)
    return averager.finish()


def _bins(width_px: int) -> tuple[int, int]:
    """Return the side of a bin in px, and the distance of its rows that are used."""
    bin_px = max(1, round(width_px / WIDTH_PX))
    return bin_px, 2 if bin_px >= 4 else 1


def texture_change(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
    means: Means,
) -> TextureChange | None:
    """Measure the change of the texture in one camera's frames (n, h, w) uint8.

    ``None``: too few decoded pixels. ``variance_dn2`` as in ``drift_map``.
    """
    bin_px, stride = _bins(frames.shape[2])
    references, first, second = means.references, means.x, means.y
    bin_centres = (slice(bin_px // 2, None, bin_px), slice(bin_px // 2, None, bin_px))
    inside = _inside(decoded, bin_centres, first.shape)
    if np.count_nonzero(inside) < LEAST_PIXELS:
        return None
    dark, per_dn = variance_dn2
    noise = float(dark + per_dn * np.mean(first[inside])) / (bin_px * (bin_px // stride))
    used = _used_pixels(inside)

    def changes(fringes: _Fringes | None) -> tuple[float, float]:
        late = _difference(first, second, used, noise * (0.25 + 0.25), fringes)
        return late, _difference(references, first, used, noise * (0.5 + 0.25), fringes)

    before = changes(None)
    if max(before) <= LOCKED_FROM:
        return TextureChange(*before)
    after = changes(_fringes(decoded, inside, sequence.period_px, bin_centres))
    return TextureChange(*after, float(np.sqrt(max(max(before) ** 2 - max(after) ** 2, 0.0))))


@dataclass(frozen=True, slots=True)
class _Fringes:
    """Bins of the pixels within a quarter of a fringe.

    For both directions: (pixels inside,) each, 0..``LOCKED_BINS`` − 1.
    """

    bins: tuple[NDArray[np.int64], NDArray[np.int64]]

    def without(self, difference: NDArray[np.float32], light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return differences (pixels,) less their part that follows the phase, proportional to the ``light``."""
        residual = difference.astype(np.float64)
        for _ in range(LOCKED_ROUNDS):
            for bins in self.bins:
                part = np.bincount(bins, light * residual, LOCKED_BINS) / np.maximum(
                    np.bincount(bins, light * light, LOCKED_BINS), 1e-3
                )
                residual -= part[bins] * light
        return residual.astype(np.float32)


def _fringes(
    decoded: CameraDecoder, inside: NDArray[np.bool_], period_px: int, bin_centres: tuple[slice, slice]
) -> _Fringes:
    height, width = inside.shape
    p, q = (
        (coordinate[bin_centres][:height, :width][inside] * (4.0 / period_px)) % 1.0 * LOCKED_BINS
        for coordinate in (decoded.p_px, decoded.q_px)
    )
    return _Fringes((np.minimum(p, LOCKED_BINS - 1).astype(np.int64), np.minimum(q, LOCKED_BINS - 1).astype(np.int64)))


@dataclass(frozen=True, slots=True)
class _UsedPixels:
    """Binned pixels that are used for the texture's change; arrays (rows, columns)."""

    inside: NDArray[np.bool_]
    around: NDArray[np.float32]
    """Share of the pixels around each that are used as well."""


def _used_pixels(inside: NDArray[np.bool_]) -> _UsedPixels:
    around = np.asarray(cv2.boxFilter(inside.astype(np.float32), -1, (9, 9)), np.float32)
    return _UsedPixels(inside, np.maximum(around, np.float32(1e-3), out=around))


def _difference(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    used: _UsedPixels,
    variance: float,
    fringes: _Fringes | None = None,
) -> float:
    """Return the robust RMS of b − gain · a in standard deviations of noise.

    Its smooth part, and the part that follows ``fringes``, are subtracted.
    """
    inside = used.inside
    residual = np.empty_like(a)
    gain = _subtract(a, b, inside, residual)
    if fringes is not None:
        residual[inside] = fringes.without(residual[inside], a[inside])
    # The smooth part is ambient light; the fine part is texture that moved, or noise.
    smooth = np.asarray(cv2.boxFilter(residual, -1, (9, 9)), np.float32)
    return float(_clipped_sd(residual, smooth, used.around, inside) / CLIPPED / np.sqrt(variance * gain**2))


_SUMS_FAST = {"reassoc", "contract", "nsz"}


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_SUMS_FAST)
def _subtract(
    a: NDArray[np.float32], b: NDArray[np.float32], inside: NDArray[np.bool_], residual: NDArray[np.float32]
) -> float:
    """Write b − gain · a to ``residual``, 0 outside; return the gain by least squares."""
    products = squares = 0.0
    for j in range(a.shape[0]):
        for i in range(a.shape[1]):
            value = np.float64(a[j, i]) if inside[j, i] else 0.0
            products += value * np.float64(b[j, i])
            squares += value * value
    gain = products / squares
    for j in range(a.shape[0]):
        for i in range(a.shape[1]):
            difference = b[j, i] - np.float32(gain) * a[j, i]
            residual[j, i] = difference if inside[j, i] else np.float32(0.0)
    return float(gain)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_SUMS_FAST)
def _clipped_sd(
    residual: NDArray[np.float32], smooth: NDArray[np.float32], around: NDArray[np.float32], inside: NDArray[np.bool_]
) -> float:
    """Return the clipped standard deviation of residual − smooth / around inside.

    The limit is ``CLIP`` times the unclipped one. ``residual`` is overwritten.
    """
    count, total, squares = 0, 0.0, 0.0
    for j in range(residual.shape[0]):
        for i in range(residual.shape[1]):
            high = residual[j, i] - smooth[j, i] / around[j, i]
            high = high if inside[j, i] else np.float32(0.0)
            residual[j, i] = high
            count += inside[j, i]
            total += np.float64(high)
            squares += np.float64(high) * np.float64(high)
    limit = np.float32(CLIP) * np.float32(np.sqrt(max(squares / count - (total / count) ** 2, 0.0)))
    total, squares = 0.0, 0.0
    for j in range(residual.shape[0]):
        for i in range(residual.shape[1]):
            high = residual[j, i]
            high = limit if high > limit else high
            high = -limit if high < -limit else high
            total += np.float64(high)
            squares += np.float64(high) * np.float64(high)
    return float(np.sqrt(max(squares / count - (total / count) ** 2, 0.0)))


def follow_px(decoded: CameraDecoder, means: Means) -> tuple[float, float] | None:
    """Return the displacement of the texture right and down, px, from the x-sines to the y-sines.

    It is one vector for the image, between the means of the sines. ``None``: the texture stays, or is no longer the
    same. Light is divided by its surroundings first: the projector's light stays with the instrument, only albedo
    moves. Phase correlation gives an approximation, ECC (Evangelidis and Psarakis 2008) the result.
    """
    bin_px = _bins(decoded.p_px.shape[1])[0]
    bin_centres = (slice(bin_px // 2, None, bin_px), slice(bin_px // 2, None, bin_px))
    inside = _inside(decoded, bin_centres, means.x.shape).astype(np.uint8)
    textures = []
    for light in (means.x, means.y):
        around = cv2.boxFilter(light, -1, (SURROUNDINGS_PX, SURROUNDINGS_PX))
        textures.append(np.asarray(light / np.maximum(around, 1.0) - 1.0, np.float32))
    before, after = textures
    window = np.asarray(cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F), np.float32)
    (right, down), _ = cv2.phaseCorrelate(before, after, window)
    warp = np.array([[1.0, 0.0, right], [0.0, 1.0, down]], np.float32)
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ROUNDS, SETTLED)
    try:
        alike, shift = cv2.findTransformECC(before, after, warp, cv2.MOTION_TRANSLATION, ends, inside, BLUR_PX)
    except cv2.error:  # it does not converge
        return None
    right, down = float(shift[0, 2]), float(shift[1, 2])
    return None if alike < ALIKE or np.hypot(right, down) < STAYS_PX else (right * bin_px, down * bin_px)


def _inside(decoded: CameraDecoder, bin_centres: tuple[slice, slice], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the binned pixels (rows, columns) that have coordinates, away from occluding contours."""
    valid = np.isfinite(decoded.p_px[bin_centres] + decoded.q_px[bin_centres])[: shape[0], : shape[1]]
    return np.asarray(cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)
