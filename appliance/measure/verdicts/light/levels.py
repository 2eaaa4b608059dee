"""Owns how bright a recorded sequence is: saturation, modulation and ambient light of one camera, on a grid of pixels."""

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
"""Lit pixels that are asked, about; shares of a hundredth are then known to a twentieth of themselves."""
MOST_PIXELS = 500_000
"""Most pixels of the grid, however little of it is illuminated: it has 32 bits for each image."""
GOLDEN = 0.6180339887
COARSE_PX = 8
"""Distance of the pixels by which the illuminated ones are counted first."""
SEEN_DN = 3.0
"""Bright minus dark above this is light of the projector, though perhaps too little to measure by: three sigma."""
DIM_MODULATION_DN = 2.5
"""Fringes above this are there; below ``MIN_MODULATION_DN`` they are too weak to measure by."""
FAINT_DN = 5.0
"""Bright minus dark above this is light of the projector beyond doubt, though too little to measure by."""
TOP_SHARE = 0.003
"""Share of all pixels that may be brighter than the level an exposure is chosen by: glints."""
CENSORED_FACTOR = 8.0
"""A pixel that is saturated even at the fringe's darkest counts as so many times the full scale."""

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Sample:
    """A grid of one camera's pixels, (rows, columns) float32 grey values, and what is read off it directly."""

    grey: NDArray[np.uint8]
    """(n, rows, columns): all images."""
    bright_dn: Floats
    dark_dn: Floats
    contrast_dn: Floats
    """Bright minus dark."""
    modulation_dn: Floats
    """The smaller one of the two directions, whether or not it means anything."""
    top_dn: Floats
    """Largest value of the bright image and all sines."""
    illuminated: NDArray[np.bool_]
    """Pixels that the projector illuminates, as decoding has it, or that are saturated."""
    saturated: NDArray[np.bool_]
    """Pixels that are saturated in any sine image or in the bright one."""


class Sampler:
    """Takes about ``SAMPLES`` illuminated pixels of one camera's sequence, frame by frame; fewer where they are rare
    among ``MOST_PIXELS``."""

    def __init__(self, sequence: PatternSequence) -> None:
        self._sequence = sequence
        self._sines = np.array([sequence.axis(d).sine for d in Direction], np.int64)
        self._places = np.empty((0, 0), np.intp)
        self._grey = np.empty((len(sequence), 0, 0), np.uint8)

    @property
    def grey(self) -> NDArray[np.uint8]:
        """(n, rows, columns): the images taken so far; of the others, anything."""
        return self._grey

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the pixels of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0 for each sequence."""
        references = (self._sequence.bright, self._sequence.dark)
        if index < max(references):
            return
        first = index
        if index == max(references):
            # How many pixels are illuminated, both references tell, and from that follows which are taken.
            first = 0
            self._choose(frames[list(references), ::COARSE_PX, ::COARSE_PX].astype(np.int16), frames.shape[1:])
        for k in range(first, index + 1):
            np.take(frames[k].reshape(-1), self._places, out=self._grey[k], mode="clip")

    def _choose(self, few: NDArray[np.int16], shape: tuple[int, ...]) -> None:
        illuminated_pixels = COARSE_PX**2 * int(
            np.count_nonzero((few[0] - few[1] >= MIN_CONTRAST_DN) | (few[0] >= FULL_DN))
        )
        least = math.ceil((shape[0] * shape[1] / MOST_PIXELS) ** 0.5)
        stride = max(least, round((illuminated_pixels / SAMPLES) ** 0.5))
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
    """Take the sample of whole ``frames`` (n, h, w) uint8."""
    sampler = Sampler(sequence)
    for index in range(len(sequence)):
        sampler.push(frames, index)
    return sampler.finish()


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _describe(
    grey: NDArray[np.uint8], bright: int, dark: int, sines: NDArray[np.int64], sums: Floats, flags: NDArray[np.bool_]
) -> None:
    """Write to ``sums`` (5, pixels) and ``flags`` (2, pixels) what ``Sample`` has beside its images ``grey`` (n,
    pixels), in its order."""
    for i in range(grey.shape[1]):
        light, black = np.float32(grey[bright, i]), np.float32(grey[dark, i])
        top, least = light, np.float32(np.inf)
        for d in range(2):
            s0, s1 = np.float32(grey[sines[d, 0], i]), np.float32(grey[sines[d, 1], i])
            s2, s3 = np.float32(grey[sines[d, 2], i]), np.float32(grey[sines[d, 3], i])
            top = max(top, max(max(s0, s1), max(s2, s3)))
            # Four steps of 90° make twice the modulation the length of (I0 − I2, I3 − I1).
            least = min(least, np.float32(0.5) * np.sqrt((s0 - s2) * (s0 - s2) + (s3 - s1) * (s3 - s1)))
        sums[0, i], sums[1, i], sums[2, i], sums[3, i], sums[4, i] = light, black, light - black, least, top
        illuminated = light - black >= MIN_CONTRAST_DN or light >= FULL_DN
        flags[0, i], flags[1, i] = illuminated, illuminated and top >= FULL_DN


def _places(size_px: int, stride: int) -> NDArray[np.intp]:
    """Return one of each ``stride`` pixels, not at equal distances: those would meet the fringes at a few phases
    only."""
    number = np.arange(-(-size_px // stride))
    return np.minimum((stride * (number + GOLDEN * number % 1.0)).astype(np.intp), size_px - 1)


@dataclass(frozen=True, slots=True)
class Levels:
    """One camera's light in numbers. Shares are of illuminated pixels, 0..1; ``None``: nothing is illuminated."""

    illuminated_share: float
    """Illuminated pixels as a share of all pixels."""
    saturated: float | None
    burnt: float | None
    """Saturated, and light from elsewhere takes half of the scale there: no exposure helps."""
    where: str
    """Part of the image that holds most of the saturation."""
    weak: float | None
    """Fringes are there, but too weak to measure by."""
    modulation_dn: float | None
    """Median of illuminated pixels that are not saturated."""
    modulation_tenth_dn: float | None
    """Nine of ten have more."""
    ambient_dn: float
    """Median of the dark frame over the black level where illuminated; of all pixels where nothing is."""
    ambient_ratio: float | None
    """Median of ambient light over the projector's."""
    ambient_beyond: float | None
    """Share with more light from elsewhere than from the projector."""
    ambient_peak: float | None
    """The ratio in the tenth with the most: a torch shows as a peak far above the median."""
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
    known = modulation.size > 0
    return Levels(
        illuminated_share=count / illuminated.size,
        saturated=float(saturated.sum()) / count,
        burnt=float((saturated & (2.0 * ambient > FULL_DN - noise.black_dn)).sum()) / count,
        where=_where(saturated),
        weak=weak / count,
        modulation_dn=median(modulation) if known else None,
        modulation_tenth_dn=quantile(s.modulation_dn[clear], 0.1) if known else None,
        ambient_dn=median(ambient[illuminated]),
        ambient_ratio=median(ratio),
        ambient_beyond=float(np.mean(ratio > 1.0)),
        ambient_peak=quantile(ratio, 0.9),
        top_dn=top_dn,
    )


def _top_dn(s: Sample, sequence: PatternSequence, black_dn: float) -> float:
    """Return the level that ``TOP_SHARE`` of the pixels exceed. The share is of all pixels, not of the illuminated
    ones: how many are illuminated depends on the exposure, which this decides."""
    level = np.where((s.contrast_dn >= SEEN_DN) | (s.bright_dn >= FULL_DN), s.bright_dn - np.float32(black_dn), 0.0)
    clipped = s.bright_dn >= FULL_DN
    if clipped.any():
        level[clipped] = _true_bright_dn(s, sequence, clipped, black_dn)
    return quantile(level.reshape(-1), 1.0 - TOP_SHARE)


def _true_bright_dn(s: Sample, sequence: PatternSequence, clipped: NDArray[np.bool_], black_dn: float) -> Floats:
    """Compute how bright saturated pixels would be, over the black level, from the two darkest of four sine images.

    At the least value the sine is A − mA cos t, and a quarter period beside A − mA sin t with 0 ≤ t ≤ 45°; two
    equations for A and t. Where the second one is saturated as well, A is at least what t = 45° makes it.
    """
    m = AMPLITUDE_CODE / MEAN_CODE
    dark = s.dark_dn[clipped]
    found = np.zeros(dark.shape, np.float32)
    for direction in Direction:
        values = np.stack([s.grey[k][clipped] for k in sequence.axis(direction).sine]).astype(np.float32)
        least = values.argmin(axis=0)
        columns = np.arange(dark.size)
        beside = np.minimum(values[(least + 1) % 4, columns], values[(least - 1) % 4, columns])
        u = np.maximum(values[least, columns] - dark, 0.5)
        w = np.maximum(beside - dark, 1.0)
        # u = A (1 − m cos t), w = A (1 − m sin t): cos² + sin² = 1 leaves a quadratic in A.
        squares = u * u + w * w
        root = np.sqrt(np.maximum((u + w) ** 2 - (2.0 - m * m) * squares, 0.0))
        solved = np.maximum(squares / np.maximum(u + w - root, 1e-3), w)
        # Only the least value is below saturation: A is smallest where it lies at t = 45°.
        at_least = np.maximum(u / (1.0 - m / np.sqrt(2.0)), w)
        mean = np.where(beside < FULL_DN, solved, at_least)
        mean = np.where(values[least, columns] < FULL_DN, mean, CENSORED_FACTOR * FULL_DN / 2.0)
        # Both directions see the same light: one that is known beats one that is at least something.
        found = np.where(beside < FULL_DN, mean, np.maximum(found, mean)).astype(np.float32)
    return np.asarray(np.maximum(2.0 * found + dark, FULL_DN) - black_dn, np.float32)


def _where(saturated: NDArray[np.bool_]) -> str:
    if not saturated.any():
        return ""
    rows, columns = np.nonzero(saturated)
    down = ("upper", "middle", "lower")[min(2, int(3 * np.median(rows) / saturated.shape[0]))]
    across = ("left", "centre", "right")[min(2, int(3 * np.median(columns) / saturated.shape[1]))]
    return f"{down} {across}"


def light_of(s: Sample, sequence: PatternSequence, noise: CameraNoise) -> tuple[Floats, Floats]:
    """Return the brightest level over black and the modulation of the pixels with light of the projector; grey
    values, above the scale where that was saturated."""
    # Light without fringes is scattered by the water, whatever the exposure.
    seen = ((s.illuminated | (s.contrast_dn >= FAINT_DN)) & (s.modulation_dn >= DIM_MODULATION_DN)) | s.saturated
    top, modulation = s.top_dn - np.float32(noise.black_dn), s.modulation_dn.copy()
    clear = s.illuminated & ~s.saturated & (s.contrast_dn > 0.0)
    depth = median(s.modulation_dn[clear] / s.contrast_dn[clear]) if clear.any() else 0.5
    clipped = s.bright_dn >= FULL_DN
    if clipped.any():
        top[clipped] = np.maximum(_true_bright_dn(s, sequence, clipped, noise.black_dn), FULL_DN - noise.black_dn)
    modulation[s.saturated] = np.float32(depth) * top[s.saturated]
    return np.asarray(top[seen], np.float32), np.asarray(modulation[seen], np.float32)
