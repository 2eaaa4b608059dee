"""The samples for the judge of identity, and the thresholds of their Gray bits.

The samples lie along a few complete rows and columns, where one stripe follows the next. The mean of a sample's darkest
and brightest value is a good threshold only if the backscatter is fainter than the object. Otherwise coarse stripes
that illuminate the water invert bits, also in good scans. The remedy of decoding
(``appliance.measure.decode.backscatter``) is applied here along the lines: the fringes give the object's light, and
samples with certain bits give the share of the backscatter that each image illuminates. For lines across the baseline
no remedy is needed: the stripe that illuminates the object illuminates the water before it as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.backscatter import (
    APART_SIGMAS,
    BEYOND,
    MARGIN,
    MARGIN_OF_VEIL,
    MIN_LIGHT_DN,
    NOISE_SIGMAS,
    SURE,
    Floats,
    illuminated_share,
    sample_pixels,
    scale_of_backscatter,
)
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence

LINES = 32
"""Number of rows, and of columns: each crosses each stripe's edge once."""
SAMPLES = 400
"""Approximate number of samples along a line, for cameras of any resolution."""
COARSE = 80
"""Number of pixels across the image by which the illuminated part is found."""
THIRD = 3
"""Stride over the frames that are used for this: fringes of both directions are among them."""
MIN_SWING_DN = 8.0
"""Least change of an illuminated sample over the sequence."""
MIN_SWING_SIGMA = 8.0
"""The same in standard deviations of the noise; the range of 24 frames is four by noise alone."""
MIN_PERIOD_PX = 4.0
"""Least length of a fringe in the image, for following the phase from one pixel to the next."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Samples along parallel lines of one camera's image; ``along`` is the direction in which they run."""

    along: Direction
    values: NDArray[np.uint8]
    """(n, lines, samples): all frames."""
    low: NDArray[np.uint8]
    """(lines, samples): least value over all frames, since any frame may be in the wrong place."""
    high: NDArray[np.uint8]
    """(lines, samples): largest value over all frames."""
    illuminated: NDArray[np.bool_]
    """(lines, samples): changes by more than noise."""


def can_follow(sequence: PatternSequence, width_px: int) -> bool:
    """Return True if the fringes are long enough in an image ``width_px`` wide.

    Camera and projector are assumed to have the same field.
    """
    return sequence.period_px * width_px / sequence.width_px >= MIN_PERIOD_PX


class LineTaker:
    """Takes rows and columns over the illuminated part of one camera's images, frame by frame.

    Samples are a sixth of a fringe apart or less. ``noise`` is the camera's.
    """

    def __init__(self, sequence: PatternSequence, noise: CameraNoise) -> None:
        self._sequence, self._noise = sequence, noise
        # Any frame may be in the wrong place: fringes of both directions show the illuminated part in any order.
        self._last_asked = (len(sequence) - 1) // THIRD * THIRD
        self._places: dict[Direction, NDArray[np.intp]] = {}
        self._values: dict[Direction, NDArray[np.uint8]] = {}

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the samples of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0."""
        if index < self._last_asked:
            return
        first = index
        if index == self._last_asked:
            first = 0
            self._choose(frames)
        for k in range(first, index + 1):
            for along, places in self._places.items():
                np.take(frames[k].reshape(-1), places, out=self._values[along][k], mode="clip")

    def _choose(self, frames: NDArray[np.uint8]) -> None:
        _, height_px, width_px = frames.shape
        sixth_px = self._sequence.period_px * width_px / self._sequence.width_px / 6.0
        step = max(1, min(int(sixth_px), width_px // SAMPLES))
        rows, columns = _where_illuminated(frames[: self._last_asked + 1], self._noise)
        self._places = {
            Direction.X: rows[:, None] * width_px + np.arange(0, width_px, step),
            Direction.Y: columns[:, None] + np.arange(0, height_px, step) * width_px,
        }
        self._values = {
            along: np.empty((len(self._sequence), *places.shape), np.uint8) for along, places in self._places.items()
        }

    def finish(self) -> Mapping[Direction, Lines]:
        """Return the lines, after the last frame."""
        return {along: _lines(along, values, self._noise) for along, values in self._values.items()}


def take_lines(frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise) -> Mapping[Direction, Lines]:
    """Take the lines of complete ``frames`` (n, h, w) uint8."""
    taker = LineTaker(sequence, noise)
    for index in range(len(frames)):
        taker.push(frames, index)
    return taker.finish()


def _where_illuminated(frames: NDArray[np.uint8], noise: CameraNoise) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns over the illuminated part: as many on a small object as on a large one."""
    _, height_px, width_px = frames.shape
    coarse = max(1, width_px // COARSE)
    few = np.ascontiguousarray(frames[::THIRD, coarse // 2 :: coarse, coarse // 2 :: coarse])
    low, high = few.min(axis=0), few.max(axis=0)
    illuminated = high - low >= _least_swing(noise)[high]
    return _spread(illuminated.sum(axis=1), height_px, coarse), _spread(illuminated.sum(axis=0), width_px, coarse)


def _spread(illuminated: NDArray[np.int64], size_px: int, coarse_px: int) -> NDArray[np.intp]:
    """Return ``LINES`` positions from the first to the last illuminated one.

    A fiftieth at either end is left out, since it may be specks.
    """
    first, stop = 0.0, float(size_px)
    if illuminated.any():
        share = np.cumsum(illuminated) / illuminated.sum()
        first = float(np.searchsorted(share, 0.02) * coarse_px)
        stop = min(float((np.searchsorted(share, 0.98) + 1) * coarse_px), stop)
    return np.unique((first + (np.arange(LINES) + 0.5) * (stop - first) / LINES).astype(np.intp))


def _least_swing(noise: CameraNoise) -> NDArray[np.uint8]:
    """Return (256,) the least swing at each brightest value."""
    levels = np.arange(256.0)
    sigma = np.sqrt(noise.variance_dn2(levels))
    return np.minimum(np.maximum(MIN_SWING_DN, MIN_SWING_SIGMA * sigma), 255.0).astype(np.uint8)


def _lines(along: Direction, values: NDArray[np.uint8], noise: CameraNoise) -> Lines:
    low, high = values.min(axis=0), values.max(axis=0)
    return Lines(along, values, low, high, high - low >= _least_swing(noise)[high])


ALL = (slice(None), slice(None))
CLEAR_MODULATION_DN = 3.0
"""Least modulation of samples by which the object's share of the light is measured: less than decoding needs, since
there are few samples."""


def thresholds(
    lines: Lines, sequence: PatternSequence, noise: CameraNoise, order: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return the thresholds of the Gray images along the lines, and where bits are uncertain.

    The second result is the distance from the threshold below which a bit is uncertain. Frame ``order[k]`` is taken as
    pattern k. Thresholds: (images, lines, samples), or (1, lines, samples) if they are the same for all images; NaN:
    none. Distances: (lines, samples). Both in DN.
    """
    plain = np.float32(0.5) * (lines.low.astype(np.float32) + lines.high.astype(np.float32))
    no_doubt_dn = np.zeros(plain.shape, np.float32)
    if lines.along is not Direction.X:
        return plain[None], no_doubt_dn
    frames = lines.values[order]
    bright, dark = (frames[k].astype(np.float32) for k in (sequence.bright, sequence.dark))
    mask = np.where(bright - dark < MIN_LIGHT_DN, np.uint8(1), np.uint8(0))
    scale = scale_of_backscatter(sequence, frames, mask, noise, CLEAR_MODULATION_DN)
    if scale is None:
        return plain[None], no_doubt_dn
    pixels = sample_pixels(sequence, frames, ALL, scale)
    # Light is that of the object plus backscatter; the threshold is the part of the latter that an image illuminates,
    # plus half of the former.
    object_dn = np.minimum(pixels.object_dn, pixels.light_dn)
    backscatter_dn, apart_dn = pixels.light_dn - object_dn, np.float32(APART_SIGMAS) * pixels.noise_dn
    room_dn = np.float32(0.5) * object_dn + np.maximum(np.float32(BEYOND) * object_dn, apart_dn)
    sure = np.float32(SURE) * pixels.object_dn - np.float32(NOISE_SIGMAS) * pixels.noise_dn
    without_backscatter = np.where(pixels.light_dn < np.float32(2.0) * sure, plain, np.float32(np.nan))
    middles = []
    for k in sequence.axis(Direction.X).gray:
        gray = frames[k].astype(np.float32) - dark
        middle = _of_samples(illuminated_share(gray, pixels), gray.shape) * backscatter_dn + np.float32(0.5) * object_dn
        is_known = pixels.usable & np.isfinite(middle)
        # A value too far from its threshold for object and noise fits neither bit.
        middle[abs(gray - middle) > room_dn] = np.nan
        middles.append(np.where(is_known, dark + middle, without_backscatter))
    doubt_dn = np.minimum(np.float32(MARGIN_OF_VEIL) * backscatter_dn, np.float32(MARGIN) * object_dn)
    return np.stack(middles), doubt_dn + np.maximum(apart_dn - np.float32(0.5) * object_dn, np.float32(0.0))


def _of_samples(share: Floats, shape: tuple[int, ...]) -> Floats:
    rows, columns = (np.arange(size) * cells // size for size, cells in zip(shape, share.shape, strict=True))
    return np.asarray(share[rows][:, columns], np.float32)
