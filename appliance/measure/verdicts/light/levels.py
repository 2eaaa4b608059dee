"""Saturation, modulation and ambient light of one camera in a captured sequence, on a grid of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import MIN_CONTRAST_DN, MIN_MODULATION_DN
from appliance.measure.light.noise import FULL_DN, CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sine import AMPLITUDE_CODE, MEAN_CODE
from appliance.measure.points.quality import median, quantile

SAMPLES = 25_000
"""Approximate number of illuminated pixels; the standard error of a share of 1 % is then a twentieth of it."""
MOST_PIXELS = 500_000
"""Largest number of pixels of the grid, if only few of them are illuminated: it has 32 bits for each image."""
GOLDEN = 0.6180339887
COARSE_PX = 8
"""Distance of the pixels by which the illuminated ones are counted at first."""
SEEN_DN = 3.0
"""Least bright minus dark that is light of the projector, though perhaps too little for decoding: three sigma."""
DIM_MODULATION_DN = 2.5
"""Least modulation of visible fringes; below ``MIN_MODULATION_DN`` they are too weak for decoding."""
FAINT_DN = 5.0
"""Least bright minus dark that is certainly light of the projector, though too little for decoding."""
TOP_SHARE = 0.003
"""Share of all pixels that may be brighter than the level by which an exposure is chosen: glints."""
CENSORED_FACTOR = 8.0
"""Multiple of the full scale as which a pixel counts that is saturated even at the minimum of the fringe."""

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sample:
    """A grid of one camera's pixels with their levels, (rows, columns) float32 grey values."""

    grey: NDArray[np.uint8]
    """(n, rows, columns): all images."""
    bright_dn: Floats
    dark_dn: Floats
    contrast_dn: Floats
    """Bright minus dark."""
    modulation_dn: Floats
    """The smaller one of the two directions, also where it has no meaning."""
    top_dn: Floats
    """Largest value of the bright image and all sines."""
    illuminated: NDArray[np.bool_]
    """Pixels that are illuminated by the criterion of decoding, or saturated."""
    saturated: NDArray[np.bool_]
    """Pixels that are saturated in any sine image or in the bright one."""


class Sampler:
    """Takes about ``SAMPLES`` illuminated pixels of one camera's sequence, frame by frame.

    It takes fewer if they are rare among ``MOST_PIXELS``.
    """

    def __init__(self, sequence: PatternSequence) -> None:
        self._sequence = sequence
        self._sines = np.array([sequence.axis(d).sine for d in Direction], np.int64)
        self._places = np.empty((0, 0), np.intp)
        self._grey = np.empty((len(sequence), 0, 0), np.uint8)

    @property
    def grey(self) -> NDArray[np.uint8]:
        """Images (n, rows, columns); those of frames that were not pushed have undefined values."""
        return self._grey

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the pixels of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0."""
        references = (self._sequence.bright, self._sequence.dark)
        if index < max(references):
            return
        first = index
        if index == max(references):
            # Both references give the number of illuminated pixels, and from that follows which are taken.
            first = 0
            self._choose(frames[list(references), ::COARSE_PX, ::COARSE_PX].astype(np.int16), frames.shape[1:])
        for k in range(first, index + 1):
            np.take(frames[k].reshape(-1), self._places, out=self._grey[k], mode="clip")

    def _choose(self, few: NDArray[np.int16], shape: tuple[int, ...]) -> None:
        illuminated_pixels = COARSE_PX**2 * int(
            np.count_nonzero((few[0] - few[1] >= MIN_CONTRAST_DN) | (few[0] >= FULL_DN))
        )
        least_stride = math.ceil((shape[0] * shape[1] / MOST_PIXELS) ** 0.5)
        stride = max(least_stride, round((illuminated_pixels / SAMPLES) ** 0.5))
        self._places = _places(shape[0], stride)[:, None] * shape[1] + _places(shape[1], stride)
        self._grey = np.empty((len(self._sequence), *self._places.shape), np.uint8)

    def finish(self) -> Sample:
        """Return the sample, after the last frame."""
        sums = np.empty((5, *self._places.shape), np.float32)
        flags = np.empty((2, *self._places.shape), np.bool_)
        pixels = (len(self._grey), -1)
        _describe(
            self._grey.reshape(pixels),
            self._sequence.bright,
            self._sequence.dark,
            self._sines,
            sums.reshape(5, -1),
            flags.reshape(2, -1),
        )
        return Sample(self._grey, *sums, *flags)


def sample(frames: NDArray[np.uint8], sequence: PatternSequence) -> Sample:
    """Take the sample of complete ``frames`` (n, h, w) uint8."""
    sampler = Sampler(sequence)
    for index in range(len(sequence)):
        sampler.push(frames, index)
    return sampler.finish()


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _describe(
    grey: NDArray[np.uint8], bright: int, dark: int, sines: NDArray[np.int64], sums: Floats, flags: NDArray[np.bool_]
) -> None:
    """Write the levels of ``grey`` (n, pixels) to ``sums`` and ``flags``, as in ``Sample``.

    ``sums``: (5, pixels); ``flags``: (2, pixels).
    """
    for i in range(grey.shape[1]):
        light, black = np.float32(grey[bright, i]), np.float32(grey[dark, i])
        top, modulation = light, np.float32(np.inf)
        for d in range(2):
            s0, s1 = np.float32(grey[sines[d, 0], i]), np.float32(grey[sines[d, 1], i])
            s2, s3 = np.float32(grey[sines[d, 2], i]), np.float32(grey[sines[d, 3], i])
            top = max(top, max(max(s0, s1), max(s2, s3)))
            # Four steps of 90° make twice the modulation the length of (I0 − I2, I3 − I1).
            modulation = min(modulation, np.float32(0.5) * np.sqrt((s0 - s2) * (s0 - s2) + (s3 - s1) * (s3 - s1)))
        sums[0, i], sums[1, i], sums[2, i], sums[3, i], sums[4, i] = light, black, light - black, modulation, top
        illuminated = light - black >= MIN_CONTRAST_DN or light >= FULL_DN
        flags[0, i], flags[1, i] = illuminated, illuminated and top >= FULL_DN


def _places(size_px: int, stride: int) -> NDArray[np.intp]:
    """Return one of each ``stride`` pixels, at unequal distances.

    Equal ones would sample only a few phases of the fringes.
    """
    number = np.arange(-(-size_px // stride))
    return np.minimum((stride * (number + GOLDEN * number % 1.0)).astype(np.intp), size_px - 1)


@dataclass(frozen=True, slots=True)
class Levels:
    """Light of one camera's images; shares are of illuminated pixels, 0..1; ``None``: there are none."""

    illuminated_share: float
    """Illuminated pixels as a share of all pixels."""
    saturated: float | None
    burnt: float | None
    """Saturated, with ambient light of more than half of the scale: no exposure helps."""
    where: str
    """Part of the image that holds most of the saturation."""
    weak: float | None
    """Fringes are visible, but too weak for decoding."""
    modulation_dn: float | None
    """Median of illuminated pixels that are not saturated."""
    modulation_tenth_dn: float | None
    """Lower decile."""
    ambient_dn: float
    """Median of the dark frame over the black level where illuminated; of all pixels if none is."""
    ambient_ratio: float | None
    """Median of ambient light over the projector's."""
    ambient_beyond: float | None
    """Share with more ambient light than light of the projector."""
    ambient_peak: float | None
    """Upper decile of the ratio: with a torch it is far above the median."""
    top_dn: float
    """Level over black that ``TOP_SHARE`` of all pixels exceed in the bright frame, or would, were it not saturated."""


def measure_levels(s: Sample, sequence: PatternSequence, noise: CameraNoise) -> Levels:
    """Measure the levels of one camera."""
    illuminated, saturated = s.illuminated, s.saturated
    count = int(illuminated.sum())
    ambient = s.dark_dn - np.float32(noise.black_dn)
    top_dn = _top_dn(s, sequence, noise.black_dn)
    if count == 0:
        return Levels(0.0, None, None, "", None, None, None, median(ambient.reshape(-1)), None, None, None, top_dn)
    clear = illuminated & ~saturated
    dim = clear & (s.modulation_dn < MIN_MODULATION_DN)
    weak = int((dim & (s.modulation_dn >= DIM_MODULATION_DN)).sum())
    ratio = ambient[illuminated] / np.maximum(s.contrast_dn[illuminated], 1.0)
    modulation = s.modulation_dn[clear & ~dim]
    has_modulation = modulation.size > 0
    return Levels(
        illuminated_share=count / illuminated.size,
        saturated=float(saturated.sum()) / count,
        burnt=float((saturated & (2.0 * ambient > FULL_DN - noise.black_dn)).sum()) / count,
        where=_where(saturated),
        weak=weak / count,
        modulation_dn=median(modulation) if has_modulation else None,
        modulation_tenth_dn=quantile(s.modulation_dn[clear], 0.1) if has_modulation else None,
        ambient_dn=median(ambient[illuminated]),
        ambient_ratio=median(ratio),
        ambient_beyond=float(np.mean(ratio > 1.0)),
        ambient_peak=quantile(ratio, 0.9),
        top_dn=top_dn,
    )


def _top_dn(s: Sample, sequence: PatternSequence, black_dn: float) -> float:
    """Return the level that ``TOP_SHARE`` of all pixels exceed.

    The share is not of the illuminated pixels: their number depends on the exposure, which this decides.
    """
    level = np.where((s.contrast_dn >= SEEN_DN) | (s.bright_dn >= FULL_DN), s.bright_dn - np.float32(black_dn), 0.0)
    clipped = s.bright_dn >= FULL_DN
    if clipped.any():
        level[clipped] = _true_bright_dn(s, sequence, clipped, black_dn)
    return quantile(level.reshape(-1), 1.0 - TOP_SHARE)


def _true_bright_dn(s: Sample, sequence: PatternSequence, clipped: NDArray[np.bool_], black_dn: float) -> Floats:
    """Compute the level of saturated pixels over the black level from the two darkest of four sine images.

    At the least value the sine is A − mA cos t, and a quarter period beside A − mA sin t with 0 ≤ t ≤ 45°; two
    equations for A and t. If the second one is saturated as well, t = 45° gives a lower limit of A.
    """
    m = AMPLITUDE_CODE / MEAN_CODE
    dark = s.dark_dn[clipped]
    light_dn = np.zeros(dark.shape, np.float32)
    for direction in Direction:
        values = np.stack([s.grey[k][clipped] for k in sequence.axis(direction).sine]).astype(np.float32)
        darkest = values.argmin(axis=0)
        columns = np.arange(dark.size)
        beside = np.minimum(values[(darkest + 1) % 4, columns], values[(darkest - 1) % 4, columns])
        u = np.maximum(values[darkest, columns] - dark, 0.5)
        w = np.maximum(beside - dark, 1.0)
        # u = A (1 − m cos t), w = A (1 − m sin t): cos² + sin² = 1 leaves a quadratic in A.
        squares = u * u + w * w
        root = np.sqrt(np.maximum((u + w) ** 2 - (2.0 - m * m) * squares, 0.0))
        solved = np.maximum(squares / np.maximum(u + w - root, 1e-3), w)
        # If only the least value is below saturation, t = 45° gives the smallest A.
        at_least = np.maximum(u / (1.0 - m / np.sqrt(2.0)), w)
        mean = np.where(beside < FULL_DN, solved, at_least)
        mean = np.where(values[darkest, columns] < FULL_DN, mean, CENSORED_FACTOR * FULL_DN / 2.0)
        # Both directions see the same light: a solution is better than a lower limit.
        light_dn = np.where(beside < FULL_DN, mean, np.maximum(light_dn, mean)).astype(np.float32)
    return np.asarray(np.maximum(2.0 * light_dn + dark, FULL_DN) - black_dn, np.float32)


def _where(saturated: NDArray[np.bool_]) -> str:
    if not saturated.any():
        return ""
    rows, columns = np.nonzero(saturated)
    down = ("upper", "middle", "lower")[min(2, int(3 * np.median(rows) / saturated.shape[0]))]
    across = ("left", "centre", "right")[min(2, int(3 * np.median(columns) / saturated.shape[1]))]
    return f"{down} {across}"


def light_of(s: Sample, sequence: PatternSequence, noise: CameraNoise) -> tuple[Floats, Floats]:
    """Return the brightest level over black and the modulation of the pixels with light of the projector.

    Both are in grey values, and exceed the scale where that was saturated.
    """
    # Light without fringes is scattered by the water, with any exposure.
    has_light = ((s.illuminated | (s.contrast_dn >= FAINT_DN)) & (s.modulation_dn >= DIM_MODULATION_DN)) | s.saturated
    top, modulation = s.top_dn - np.float32(noise.black_dn), s.modulation_dn.copy()
    clear = s.illuminated & ~s.saturated & (s.contrast_dn > 0.0)
    depth = median(s.modulation_dn[clear] / s.contrast_dn[clear]) if clear.any() else 0.5
    clipped = s.bright_dn >= FULL_DN
    if clipped.any():
        top[clipped] = np.maximum(_true_bright_dn(s, sequence, clipped, noise.black_dn), FULL_DN - noise.black_dn)
    modulation[s.saturated] = np.float32(depth) * top[s.saturated]
    return np.asarray(top[has_light], np.float32), np.asarray(modulation[has_light], np.float32)
