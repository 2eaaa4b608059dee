"""Owns whether the texture stood still: the fringes' mean of one direction against that of the other.

Four steps of 90° add up to an image without fringes. The one of the x-sines and the one of the y-sines are eleven
frames apart; at rest they differ by noise, once the daylight's change is fitted as a gain, and by what is left of the
fringes: four steps take out all harmonics of a light that is no pure sine but each fourth one. That part follows the
phase, and is taken out by it.
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
"""Bins of a camera of 1600 px, for which there is a loop of its own."""
SURROUNDINGS_PX, BLUR_PX = 15, 5
"""Binned px over which light is averaged that texture is divided by; and by which it is blurred to be followed."""
ALIKE, STAYS_PX = 0.9, 0.3
"""Least correlation of a texture that was followed, and least way of one that moved, binned px."""
ROUNDS, SETTLED = 30, 1e-3
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


def texture_change(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
    means: Means,
) -> TextureChange | None:
    """Measure how the texture changed in one camera's frames (n, h, w) uint8; ``None``: too little is decoded.

    ``variance_dn2`` as in ``drift_map``.
    """
    bin_px, stride = _bins(frames.shape[2])
    references, first, second = means.references, means.x, means.y
    at = (slice(bin_px // 2, None, bin_px), slice(bin_px // 2, None, bin_px))
    inside = _inside(decoded, at, first.shape)
    if np.count_nonzero(inside) < LEAST_PIXELS:
        return None
    dark, per_dn = variance_dn2
    noise = float(dark + per_dn * np.mean(first[inside])) / (bin_px * (bin_px // stride))
    judged = _judged(inside)

    def changes(fringes: _Fringes | None) -> tuple[float, float]:
        late = _difference(first, second, judged, noise * (0.25 + 0.25), fringes)
        return late, _difference(references, first, judged, noise * (0.5 + 0.25), fringes)

    before = changes(None)
    if max(before) <= LOCKED_FROM:
        return TextureChange(*before)
    after = changes(_fringes(decoded, inside, sequence.period_px, at))
    return TextureChange(*after, float(np.sqrt(max(max(before) ** 2 - max(after) ** 2, 0.0))))


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


def follow_px(decoded: CameraDecoder, means: Means) -> tuple[float, float] | None:
    """Return how far the texture as a whole went right and down, in px of the camera, from the middle of the x-sines to
    that of the y-sines; ``None``: it stays, or is not the same any more.

    Light is divided by its surroundings first: the projector's stays with the instrument, only albedo moves. The phase
    of both pictures' spectra says roughly where it went, their correlation (ECC, Evangelidis and Psarakis 2008) exactly.
    """
    bin_px = _bins(decoded.p_px.shape[1])[0]
    at = (slice(bin_px // 2, None, bin_px), slice(bin_px // 2, None, bin_px))
    inside = _inside(decoded, at, means.x.shape).astype(np.uint8)
    pictures = []
    for light in (means.x, means.y):
        around = cv2.boxFilter(light, -1, (SURROUNDINGS_PX, SURROUNDINGS_PX))
        pictures.append(np.asarray(light / np.maximum(around, 1.0) - 1.0, np.float32))
    before, after = pictures
    window = np.asarray(cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F), np.float32)
    (right, down), _ = cv2.phaseCorrelate(before, after, window)
    warp = np.array([[1.0, 0.0, right], [0.0, 1.0, down]], np.float32)
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, ROUNDS, SETTLED)
    try:
        alike, found = cv2.findTransformECC(before, after, warp, cv2.MOTION_TRANSLATION, ends, inside, BLUR_PX)
    except cv2.error:  # it does not converge
        return None
    right, down = float(found[0, 2]), float(found[1, 2])
    return None if alike < ALIKE or np.hypot(right, down) < STAYS_PX else (right * bin_px, down * bin_px)


def _inside(decoded: CameraDecoder, at: tuple[slice, slice], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the binned pixels (rows, columns) that have coordinates, away from outlines."""
    valid = np.isfinite(decoded.p_px[at] + decoded.q_px[at])[: shape[0], : shape[1]]
    return np.asarray(cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)
