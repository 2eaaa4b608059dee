"""The particles of the world ``outside``: phase function, and the effect of forward scattering on images.

The phase function is that of G. R. Fournier and J. L. Forand (Proc. SPIE 2258 (1994) 194) in the form of Fournier and
M. Jonasz (Proc. SPIE 3761, 1999): Mie scattering by particles whose number falls with a power of their size. It is
singular forwards, rises again towards 180°, and belongs to no table of the ordinary world.

Light scattered by small angles arrives near its undisturbed position. After a path of length s the share of light that
carries a fringe of wave number κ is exp(−c s + b s S(κ s)), with S the mean of J0(κ θ u s) over scattering angles θ and
places u of the path (W. H. Wells, J. Opt. Soc. Am. 59 (1969) 686). That holds for any number of scatterings through
small angles. Relative to the unscattered light, the point spread is a spike, a core and a halo whose width grows with
the path.
"""

# Symbols:
#   n, m      index of the particles relative to water; exponent of their sizes (Junge slope)
#   δ, ν      4 sin²(θ/2) / (3 (n − 1)²); (3 − m) / 2
#   b, c      scattering and attenuation coefficients, 1/m; s length of a path; κ wave number, 1/mm

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import itj0y0

from hw_sim.ranges import Range, drawn_strengths

Array = NDArray[np.float64]

FORWARD_DEG = 30.0
"""Light scattered by larger angles is lost to the image. Up to here angle and tangent differ by 10 %."""
RANGES = {
    "scattering_share": Range(
        0.55, 0.88, "b/c near 530 nm: coast 0.55 and 0.59, San Diego harbour 0.82 to 0.91 (Petzold, SIO Ref. 72-78, 1972); Jerlov's coastal types 1C to 5C 0.78 to 0.87 (Williamson, Hollins, Appl. Opt. 61 (2022) 9951)"
    ),
    "index": Range(1.05, 1.15, "two sorts of particles, of 1.05 and of 1.15, make up most scattering in the Sargasso Sea (Zaneveld, Roach, Pak, J. Geophys. Res. 79, no. 27, 1974); Twardowski et al., J. Geophys. Res. 106 (2001) 14129, estimate the mean of a water"),
    "slope": Range(3.3, 3.9, "partly estimate: 3.58 for Petzold's mean (Mobley, Sundman and Boss, Appl. Opt. 41 (2002) 1035); others allow 3 to 5"),
}  # fmt: skip
"""Ranges of the family ``backscatter``."""


@dataclass(frozen=True, slots=True)
class Particles:
    """The strengths of scattering resolved in both directions of the pattern. Raises ValueError."""

    scattering_share: float = 0.0
    """Share b/c of the scene's attenuation that is scattering. Light scattered forwards returns to the image as core
    and halo, and illuminates more water. 0: single scattering alone."""
    index: float = 1.10
    """Real index of the particles relative to water's; with the slope it defines the phase function."""
    slope: float = 3.5835
    """Number of particles falls with this power of their size."""

    def __post_init__(self) -> None:
        for name, lowest, highest in (("scattering_share", 0.0, 0.99), ("index", 1.01, 1.30), ("slope", 3.01, 4.90)):
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"backscatter: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Particles:
        """Return strengths drawn from ``RANGES``."""
        return cls(**drawn_strengths(RANGES, rng))

    def phase(self, angle_rad: Array) -> Array:
        """Return the share of scattered light per steradian, 1/sr, at scattering angles 0..π (0 excluded)."""
        nu = 0.5 * (3.0 - self.slope)
        per = 4.0 / (3.0 * (self.index - 1.0) ** 2)
        half2 = np.sin(0.5 * np.asarray(angle_rad, np.float64)) ** 2
        d = per * half2
        # δ = 1 is a removable singularity of fourth order: step over it.
        d = np.where(np.abs(d - 1.0) < 1e-3, 1.0 + 1e-3, d)
        power, remainder = d**nu, 1.0 - d
        forward = nu * remainder - (1.0 - power) + (d * (1.0 - power) - nu * remainder) / half2
        back, backs = per, per**nu  # δ at 180°
        wide = (1.0 - backs) / (16.0 * math.pi * (back - 1.0) * backs) * (3.0 * (1.0 - 2.0 * half2) ** 2 - 1.0)
        return np.asarray(forward / (4.0 * math.pi * remainder**2 * power) + wide)

    def survival(self, waves: Array) -> Array:
        """Return S of light scattered once by up to ``FORWARD_DEG``, as a share of all scattered light.

        ``waves``: κ s ≥ 0, radians per radian: 2π path / period. The value at 0 is the share of forward scattering.
        """
        angles = np.geomspace(1e-7, math.radians(FORWARD_DEG), 1500)
        # The ring of directions at θ has the solid angle 2π sin θ dθ.
        weight = 2.0 * math.pi * self.phase(angles) * np.sin(angles)
        z = np.maximum(np.asarray(waves, np.float64)[..., None] * angles, 1e-9)
        # Mean over the place u of scattering: ∫ J0(z u) du over 0..1 = (1/z) ∫ J0 over 0..z.
        return np.asarray(np.trapezoid(weight * itj0y0(z)[0] / z, angles))

    @property
    def turned_forwards(self) -> float:
        """Share of the scattered light with angles below ``FORWARD_DEG``."""
        return float(self.survival(np.zeros(1))[0])


class Transfer:
    """The light after a path through water with these particles, relative to the unscattered light."""

    WAVES = np.concatenate([[0.0], np.geomspace(1e-2, 1e4, 120)])
    """Arguments κ s at which S is tabulated; beyond the last it is 0."""

    def __init__(self, particles: Particles, attenuation_per_m: float) -> None:
        self._per_mm = particles.scattering_share * attenuation_per_m / 1000.0
        self._survival = particles.survival(self.WAVES)

    def __call__(self, way_mm: float, wave_per_mm: Array) -> Array:
        """Return exp(b s S(κ s)) at wave numbers κ ≥ 0, in 1/mm across the path.

        1 means that only unscattered light carries the fringe.
        """
        carried = np.interp(np.asarray(wave_per_mm) * way_mm, self.WAVES, self._survival, right=0.0)
        return np.asarray(np.exp(self._per_mm * way_mm * carried))
