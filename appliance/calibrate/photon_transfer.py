"""A camera's noise from a recorded scan: photon transfer, from the four sine frames.

I0 + I2 − I1 − I3 of a pixel is zero but for noise and the response's even harmonics, whatever the albedo. Along a
fringe the harmonics are smooth and noise is not: fourth differences keep only the noise. Along the fringes of columns,
which run down the image, they also keep noise that whole rows share. The variance over the mean of the four images is a
straight line; its slope is grey values per electron (EMVA 1288).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure import FULL_DN, MAD_TO_SIGMA, CameraFigures, Direction, PatternSequence

Array = NDArray[np.float64]

DIFFERENCE = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
BRIGHTEST_DN = 235.0
"""Largest grey value that a used pixel may have in any frame, well below saturation."""
BIN_DN = 8.0
FEWEST_IN_BIN = 2_000
FEWEST_BINS = 3


SHORTEST_FRINGE_PX = 5.0
"""Shortest fringe in camera px. Shorter ones that are inclined in the image leave harmonics in fourth differences."""
DARKEST_SHARE = 0.02
"""Share of the dark frame's blocks that are taken as without light."""
BLOCK_PX = 10


class NoiseError(Exception):
    """Error of a scan that does not determine the noise; the text says why and the remedy."""


@dataclass(frozen=True, slots=True)
class MeasuredNoise:
    """Noise of one camera, measured from one scan."""

    dn_per_e: float
    """Grey values per electron at the gain of the scan."""
    variance_at_dn2: tuple[float, float]
    """Mean light of the scan in grey values, and the variance of one grey value there."""
    darkest_dn: float
    """Mean grey value of the darkest parts of the dark frame: black level plus ambient light."""
    pixels: int

    @property
    def full_well_e(self) -> float:
        """Electrons at 255 grey values, at the gain of the scan."""
        return FULL_DN / self.dn_per_e

    def figures(self, serial: str, gain_db: float) -> CameraFigures:
        """Return the figures of camera ``serial`` at 0 dB, as a data sheet states them.

        ``gain_db`` is the gain of the scan.
        """
        return CameraFigures.of_line(serial, gain_db, self.dn_per_e, self.variance_at_dn2, self.darkest_dn)


def measure_noise(sequence: PatternSequence, frames: NDArray[np.uint8]) -> MeasuredNoise:
    """Return the noise of the camera that recorded ``frames`` (n, h, w) uint8 at rest. Raises NoiseError."""
    fringe_px = sequence.period_px * frames.shape[2] / sequence.width_px
    if fringe_px < SHORTEST_FRINGE_PX:
        raise NoiseError(
            f"fringes of about {fringe_px:.0f} px in images {frames.shape[2]} px wide; needed are "
            f"{SHORTEST_FRINGE_PX:.0f} px; "
            "record with a longer scan.period_px"
        )
    light, noise = [], []
    for direction in Direction:
        sines = frames[list(sequence.axis(direction).sine)].astype(np.float64)
        # Steps of 90°: the fundamental and all odd harmonics cancel in I0 + I2 − I1 − I3, whatever phase and albedo
        # are. Its variance is four times that of one image.
        alternating = sines[0] + sines[2] - sines[1] - sines[3]
        # Even harmonics remain and are smooth along a fringe; the fourth difference (1, −4, 6, −4, 1) takes them away
        # and multiplies the variance of white noise by 70 = Σ d². Fringes of columns run down, those of rows across.
        if direction is Direction.X:
            alternating, sines = alternating.T, sines.transpose(0, 2, 1)
        along = np.apply_along_axis(np.convolve, 1, alternating, DIFFERENCE, "valid")
        mean, brightest = (np.asarray(f(sines, axis=0))[:, 2:-2] for f in (np.mean, np.max))
        # Differences that share pixels are correlated and would make the bins look better filled than they are.
        mean_once = mean[:, :: len(DIFFERENCE)]  # each pixel is used once
        is_usable = brightest[:, :: len(DIFFERENCE)] <= BRIGHTEST_DN
        light.append(mean_once[is_usable])
        noise.append(along[:, :: len(DIFFERENCE)][is_usable])
    return _line(np.concatenate(light), np.concatenate(noise), _darkest_dn(frames[sequence.dark]))


def _darkest_dn(dark: NDArray[np.uint8]) -> float:
    """Return the mean grey value of the darkest blocks of the dark frame; single pixels have offsets of their own."""
    rows, columns = (size // BLOCK_PX for size in dark.shape)
    blocks = dark[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX)
    return float(np.quantile(blocks.mean(axis=(1, 3)), DARKEST_SHARE))


def _line(light: Array, noise: Array, darkest_dn: float) -> MeasuredNoise:
    """Fit a line through robust variances in bins of light. Raises NoiseError."""
    centres, variances, weights = [], [], []
    bins = np.floor(light / BIN_DN).astype(np.intp)
    for k in np.unique(bins):
        inside = noise[bins == k]
        if len(inside) < FEWEST_IN_BIN:
            continue
        # Robust: edges of the scene leave large differences, and they are few.
        sigma = MAD_TO_SIGMA * float(np.median(np.abs(inside)))
        if sigma == 0.0:
            raise NoiseError("the frames have no noise; give a recorded scan")
        centres.append(float(light[bins == k].mean()))
        variances.append(sigma**2 / (4.0 * float(DIFFERENCE @ DIFFERENCE)))
        weights.append(math.sqrt(len(inside)) / variances[-1])  # one over the variance's standard error
    if len(centres) < FEWEST_BINS:
        raise NoiseError(
            f"light of {len(centres)} levels, {BIN_DN:g} grey values apart; needed are {FEWEST_BINS}; scan something "
            "that is "
            "light and dark in large parts, without glare"
        )
    # EMVA 1288: variance = offset + light · (grey values per electron). The offset is read noise and quantisation.
    slope, offset = np.polyfit(centres, variances, 1, w=weights)
    if not slope > 0.0:
        raise NoiseError(
            f"the noise does not grow with light ({slope:.4f} per grey value); hold the instrument still, and "
            "scan again"
        )
    middle = float(np.average(centres, weights=weights))
    return MeasuredNoise(float(slope), (middle, float(offset + slope * middle)), darkest_dn, int(light.size))
