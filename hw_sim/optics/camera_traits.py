"""The cameras of the world ``outside``: sensors and lenses that differ from those of the ordinary world.

The strengths of sensor, lens and port, and the effects of lens and port on an image before readout: vignetting and
veiling glare. Readout is in ``rendering.sensor_of_traits``.
"""

# Symbols:
#   ρ         distance from the middle of the picture, in half diagonals
#   g         veiling glare: share of the light that port and lens scatter over the whole image

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.ranges import Range, drawn_strengths

Picture = NDArray[np.float32]

NEAR_GLARE_PX = 160.0
"""Gaussian sigma, px of 1600, of the half of the glare around its source: two reflections in a port 30 mm away."""
SHRINK = 8
"""Factor by which the image is reduced to compute the smooth glare."""

RANGES = {
    "full_well_e": Range(
        8_000.0, 20_000.0, "partly estimate: 9.5 ke (Sony IMX900, EMVA 1288 report by FRAMOS); larger pixels hold more"
    ),
    "read_noise_e": Range(
        2.2, 26.0, "partly estimate: 2.0 to 5.6 e (same report, by gain); older CMOS sensors have more"
    ),
    "black_dn": Range(0.5, 7.0, "estimate: 0 to 3 % of 255 as delivered; the sensor of that report has 5.9 %"),
    "prnu": Range(0.003, 0.012, "partly estimate: 0.7 to 0.8 % (same report); the ends are estimates"),
    "dsnu_e": Range(1.0, 16.0, "partly estimate: 1.3 to 3.7 e (same report); older CMOS sensors have more"),
    "nonlinearity": Range(
        0.010, 0.020, "partly estimate: deviations of −1.1 to 0.6 % (same report); here at least 1 % was wanted"
    ),
    "corner_loss": Range(
        0.12,
        0.40,
        "partly estimate: 43 % wide open in the example of Edmund Optics' imaging guide (section 3.2), less when stopped down; good lenses are sold with 10 %",
    ),
    "row_noise_e": Range(0.4, 4.0, "estimate: a tenth to a fifth of the pixel's"),
    "hot_per_million": Range(10.0, 300.0, "estimate: defect pixels that makers allow uncorrected"),
    "glare": Range(
        0.010,
        0.040,
        "partly estimate: 1 to 2 % for lenses (veiling glare index of ISO 9358; the number is an estimate) and two bare faces of sapphire (1.96 % in water, 7.7 % in air, Fresnel)",
    ),
}
"""Ranges of the family ``cameras``. The sign of ``nonlinearity`` is drawn as well."""
_MOST = {
    "full_well_e": 1e6, "read_noise_e": 1e3, "black_dn": 64.0, "prnu": 0.1, "dsnu_e": 1e3, "nonlinearity": 0.1,
    "corner_loss": 0.9, "row_noise_e": 1e3, "hot_per_million": 1e5, "glare": 0.5,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class CameraTraits:
    """The strengths of both cameras; each has a fixed pattern of its own.

    A sensor always has a full well and noise: the defaults are those of a common one, not of the ordinary world's.
    Raises ValueError for impossible numbers.
    """

    full_well_e: float = 11_000.0
    """Electrons at 255 DN and 0 dB."""
    read_noise_e: float = 9.0
    black_dn: float = 3.0
    prnu: float = 0.006
    """Standard deviation of a pixel's sensitivity, relative."""
    dsnu_e: float = 5.0
    nonlinearity: float = 0.0
    """Largest deviation of the response from the line through zero and the full well, in full wells: at half of it."""
    corner_loss: float = 0.0
    """Relative loss of light in a corner: 1 − loss · ρ²."""
    row_noise_e: float = 0.0
    """Standard deviation of the offset of a row, new in each frame."""
    hot_per_million: float = 0.0
    """Pixels with a dark current of 1e3 to 1e6 electrons per second."""
    glare: float = 0.0
    """Share of the light that is scattered over the image: half of it everywhere, half around its source."""

    def __post_init__(self) -> None:
        for name, highest in _MOST.items():
            value = getattr(self, name)
            lowest = {"full_well_e": 100.0, "nonlinearity": -highest}.get(name, 0.0)
            if not lowest <= value <= highest:
                raise ValueError(f"cameras: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> CameraTraits:
        """Return strengths drawn from ``RANGES``."""
        values = drawn_strengths(RANGES, rng)
        values["nonlinearity"] *= float(rng.choice([-1.0, 1.0]))
        return cls(**values)

    def through_lens(self, picture: Picture) -> Picture:
        """Return the image (h, w) float32, electrons, after lens and port; glare is added where it arrives."""
        h, w = picture.shape
        if self.corner_loss > 0.0:
            v, u = np.ogrid[:h, :w]
            rho2 = ((u - 0.5 * (w - 1)) ** 2 + (v - 0.5 * (h - 1)) ** 2) * (4.0 / (w * w + h * h))
            picture = np.asarray(picture * (1.0 - self.corner_loss * rho2), np.float32)
        if self.glare > 0.0:
            small = cv2.resize(picture, (math.ceil(w / SHRINK), math.ceil(h / SHRINK)), interpolation=cv2.INTER_AREA)
            sigma_px = max(NEAR_GLARE_PX * w / 1600.0 / SHRINK, 0.5)
            soft = cv2.GaussianBlur(small, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT)
            around = cv2.resize(soft, (w, h), interpolation=cv2.INTER_LINEAR)
            thrown = 0.5 * (around + np.float32(picture.mean()))
            picture = np.asarray(picture + np.float32(self.glare) * (thrown - picture), np.float32)
        return picture
