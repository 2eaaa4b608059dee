"""Owns the samples that the identity check looks at, and the thresholds by which their Gray bits are told.

The samples lie along a few whole rows and columns, where one stripe follows the next. Half way between a sample's
darkest and brightest value a Gray image's bit is told only as long as the water's backscatter is fainter than the
object. Beyond, coarse stripes that illuminate the water turn bits over, in good scans too. What decoding does about
that (``appliance.measure.decode.backscatter``) is done here along the lines: the fringes give the object's light, and sure
samples how much of the backscatter each image illuminates. Across the base line nothing need be done: there the water
is illuminated by the same stripe as what it hides.
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
"""Rows, and columns: each crosses each stripe's edge once."""
SAMPLES = 400
"""Number of samples along a line, about: what is seen at full resolution and on a small camera is then the same."""
COARSE = 80
"""Pixels across the image that are asked where to look closer."""
THIRD = 3
"""Stride over the frames that are looked at for this: fringes of both directions are among them."""
MIN_SWING_DN = 8.0
"""A sample that changes by less over the sequence sees nothing of the projector."""
MIN_SWING_SIGMA = 8.0
"""The same in units of noise, which alone spreads 24 frames over four."""
MIN_PERIOD_PX = 4.0
"""A fringe must be this long in the image, or its steps cannot be followed from one pixel to the next."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Samples along parallel lines of one camera's image; ``along`` is the direction in which they run."""

    along: Direction
    values: NDArray[np.uint8]
    """(n, lines, samples): each frame's."""
    low: NDArray[np.uint8]
    """(lines, samples): the darkest frame's. Which one that is says nothing: any frame may be in the wrong place."""
    high: NDArray[np.uint8]
    """(lines, samples): the brightest frame's."""
    illuminated: NDArray[np.bool_]
    """(lines, samples): changes by more than noise."""


def can_follow(sequence: PatternSequence, width_px: int) -> bool:
    """Say whether the fringes are long enough in an image ``width_px`` wide. Camera and projector have about the
    same field."""
    return sequence.period_px * width_px / sequence.width_px >= MIN_PERIOD_PX


class LineTaker:
    """Takes rows and columns of one camera's sequence over what is illuminated, frame by frame; a sixth of a fringe or
    less between samples. ``noise`` is the camera's."""

    def __init__(self, sequence: PatternSequence, noise: CameraNoise) -> None:
        self._sequence, self._noise = sequence, noise
        # Any frame may be in the wrong place: fringes of both directions tell where it is light, whatever the order.
        self._last_asked = (len(sequence) - 1) // THIRD * THIRD
        self._places: dict[Direction, NDArray[np.intp]] = {}
        self._values: dict[Direction, NDArray[np.uint8]] = {}

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the samples of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0 for each sequence."""
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
    """Take the lines of whole ``frames`` (n, h, w) uint8."""
    taker = LineTaker(sequence, noise)
    for index in range(len(frames)):
        taker.push(frames, index)
    return taker.finish()


def _where_illuminated(frames: NDArray[np.uint8], noise: CameraNoise) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns over what is illuminated: a small thing gets as many as a large one."""
    _, height_px, width_px = frames.shape
    coarse = max(1, width_px // COARSE)
    few = np.ascontiguousarray(frames[::THIRD, coarse // 2 :: coarse, coarse // 2 :: coarse])
    low, high = few.min(axis=0), few.max(axis=0)
    illuminated = high - low >= _least_swing(noise)[high]
    return _spread(illuminated.sum(axis=1), height_px, coarse), _spread(illuminated.sum(axis=0), width_px, coarse)


def _spread(illuminated: NDArray[np.int64], size_px: int, coarse_px: int) -> NDArray[np.intp]:
    """Return ``LINES`` places from the first to the last illuminated one, but for a fiftieth at either end that may
    be specks."""
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
"""Least modulation of the fringes by which the object's share of the light is measured: less than decoding needs,
since few samples serve."""


def thresholds(
    lines: Lines, sequence: PatternSequence, noise: CameraNoise, order: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return the threshold of each Gray image along the lines, with frame ``order[k]`` taken as pattern k: (images,
    lines, samples), or (1, lines, samples) where one serves all, NaN where there is none; and how near to it a bit
    is in doubt, (lines, samples). Both in DN."""
    plain = np.float32(0.5) * (lines.low.astype(np.float32) + lines.high.astype(np.float32))
    none = np.zeros(plain.shape, np.float32)
    if lines.along is not Direction.X:
        return plain[None], none
    frames = lines.values[order]
    bright, dark = (frames[k].astype(np.float32) for k in (sequence.bright, sequence.dark))
    mask = np.where(bright - dark < MIN_LIGHT_DN, np.uint8(1), np.uint8(0))
    scale = scale_of_backscatter(sequence, frames, mask, noise, CLEAR_MODULATION_DN)
    if scale is None:
        return plain[None], none
    pixels = sample_pixels(sequence, frames, ALL, scale)
    # Light is the object's own and the backscatter; the threshold is what an image illuminates of the latter, and half
    # of the former.
    own = np.minimum(pixels.object_dn, pixels.light_dn)
    backscatter_dn, apart_dn = pixels.light_dn - own, np.float32(APART_SIGMAS) * pixels.noise_dn
    room_dn = np.float32(0.5) * own + np.maximum(np.float32(BEYOND) * own, apart_dn)
    sure = np.float32(SURE) * pixels.object_dn - np.float32(NOISE_SIGMAS) * pixels.noise_dn
    without_backscatter = np.where(pixels.light_dn < np.float32(2.0) * sure, plain, np.float32(np.nan))
    found = []
    for k in sequence.axis(Direction.X).gray:
        gray = frames[k].astype(np.float32) - dark
        middle = _of_samples(illuminated_share(gray, pixels), gray.shape) * backscatter_dn + np.float32(0.5) * own
        known = pixels.usable & np.isfinite(middle)
        # Farther from its threshold than object and noise can bring it, a value is explained by neither bit.
        middle[abs(gray - middle) > room_dn] = np.nan
        found.append(np.where(known, dark + middle, without_backscatter))
    doubt_dn = np.minimum(np.float32(MARGIN_OF_VEIL) * backscatter_dn, np.float32(MARGIN) * own)
    return np.stack(found), doubt_dn + np.maximum(apart_dn - np.float32(0.5) * own, np.float32(0.0))


def _of_samples(share: Floats, shape: tuple[int, ...]) -> Floats:
    rows, columns = (np.arange(size) * cells // size for size, cells in zip(shape, share.shape, strict=True))
    return np.asarray(share[rows][:, columns], np.float32)
