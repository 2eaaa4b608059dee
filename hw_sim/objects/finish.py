"""The surfaces of the world ``outside``: albedo of white, gloss, and subsurface scattering."""

# Symbols:
#   ρ         diffuse albedo; κ wave number, 1/mm; ℓ length by which light below the surface falls to 1/e

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from hw_sim.objects.texture import MEAN_ALBEDO
from hw_sim.ranges import Range, drawn_strengths

PX_MM = 0.255
"""Size of a projector px in the middle of the volume."""
RANGES = {
    "white": Range(0.35, 0.85, "partly estimate: clean coral sand 0.28 to 0.65 from 350 to 700 nm, 0.42 at 525 nm (Maritorena, Morel, Gentili, Limnol. Oceanogr. 1994, as tabulated in the code OSOAA); white titania paint 0.85"),
    "gloss_index": Range(1.08, 1.25, "partly estimate: paint 1.45 to 1.55, aragonite of shells 1.53 to 1.68, over water's 1.335 (handbook values, not looked up again)"),
    "roughness": Range(0.10, 0.40, "estimate: rms slope of semi-gloss to matt coats; one such lobe fits paints (Ngan et al., EGSR 2005, 117)"),
    "below_part": Range(0.1, 0.6, "estimate: share of light that enters, nearly all in marble and shell, little in paint"),
    "below_mm": Range(0.15, 0.8, "partly estimate: 1/σ'_t in the green, marble 0.38 mm, skin 0.6 and 0.95 mm (Jensen et al., SIGGRAPH 2001, 511, their table as copied by renderers); chalky paint less"),
    "bounce": Range(1.0, 1.0, "interreflection is not a matter of chance"),
}  # fmt: skip
"""Ranges of the family ``surfaces``."""


@dataclass(frozen=True, slots=True)
class Finish:
    """The strengths of surface effects besides Lambert's law. Raises ValueError for impossible numbers."""

    white: float = MEAN_ALBEDO
    """Albedo of surfaces with 0.6 in the ordinary world; all albedos change by the same factor."""
    gloss_index: float = 1.0
    """Index of the coat relative to water: Fresnel's reflection. 1: no gloss."""
    roughness: float = 0.3
    """Root mean square slope of the coat's facets (Beckmann)."""
    below_part: float = 0.0
    """Share of the reflected light that has been below the surface."""
    below_mm: float = 0.3
    """Length by which it spreads there: exp(−r/ℓ)."""
    bounce: float = 0.0
    """Share of the single interreflection: 1 as in reality, 0 none."""

    def __post_init__(self) -> None:
        for name, lowest, highest in (
            *(("white", 0.01, 1.0), ("gloss_index", 1.0, 2.0), ("roughness", 0.02, 1.0)),
            *(("below_part", 0.0, 1.0), ("below_mm", 0.01, 20.0), ("bounce", 0.0, 1.0)),
        ):
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"surfaces: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Finish:
        """Return strengths drawn from ``RANGES``."""
        return cls(**drawn_strengths(RANGES, rng))

    @property
    def whiter(self) -> float:
        """Factor of all albedos."""
        return self.white / MEAN_ALBEDO

    def spread_below(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the projected light (h, w) as it leaves the surface again, in the pattern's frame.

        Part of it has spread below the surface. The slope of the surface is neglected.
        """
        if self.below_part == 0.0:
            return light
        h, w = light.shape
        border = math.ceil(6.0 * self.below_mm / PX_MM)
        rows, columns = (int(scipy.fft.next_fast_len(n + 2 * border, real=True)) for n in (h, w))
        around = cv2.copyMakeBorder(
            light, border, rows - h - border, border, columns - w - border, cv2.BORDER_REPLICATE
        )  # fmt: skip
        fy, fx = np.abs(scipy.fft.fftfreq(rows, PX_MM))[:, None], scipy.fft.rfftfreq(columns, PX_MM)[None]
        # Transform of exp(−r/ℓ) / (2π ℓ²): (1 + (κ ℓ)²)^(−3/2).
        far = (1.0 + (2.0 * math.pi * self.below_mm) ** 2 * (fy**2 + fx**2)) ** -1.5
        factor = (1.0 - self.below_part + self.below_part * far).astype(np.float32)
        spread = scipy.fft.irfft2(scipy.fft.rfft2(np.asarray(around, np.float32)) * factor, (rows, columns))
        return np.asarray(spread[border : border + h, border : border + w], np.float32)
