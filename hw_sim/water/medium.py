"""The simulated water: its index (own evaluation of Quan and Fry's empirical formula) and attenuation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw_sim.water.scattering import WAY_MM, backscatter, seen_in_fringes

GREEN_NM = 530.0
"""The projector's light: the middle of its band-pass."""
PX_MM = 0.160
"""A px of 1600 in the middle of the volume."""
LIMITS = {
    "temperature_c": (-2.0, 40.0),
    "salinity_psu": (0.0, 45.0),
    "attenuation_per_m": (0.0, 20.0),
    "backscatter": (0.0, 1.0),
    "blur_px_per_m": (0.0, 20.0),
}


def refractive_index(temperature_c: float, salinity_psu: float, wavelength_nm: float) -> float:
    """Return the index of water relative to air: X. Quan, E. S. Fry, Appl. Opt. 34 (1995) 3477, equation 3."""
    t, s = temperature_c, salinity_psu
    # n = Σ terms λ⁻ᵏ, k = 0..3, λ in nm.
    terms = np.array(
        [
            1.31405 - 2.02e-6 * t**2 + s * (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2),
            15.868 + 0.01155 * s - 0.00423 * t,
            -4382.0,
            1.1455e6,
        ]
    )
    return float(terms @ wavelength_nm ** -np.arange(4.0))


@dataclass(frozen=True, slots=True)
class Water:
    """The water around the instrument. Raises ValueError for values that no water has (``LIMITS``)."""

    temperature_c: float = 20.0
    salinity_psu: float = 0.0
    attenuation_per_m: float = 0.4
    """The share exp(−attenuation · path) of the light goes on; no scattered light is added."""
    backscatter: float = 0.01
    """Backscatter of a white pattern before the middle of the volume in otherwise clear water, as a fraction of the
    reflection of a surface of albedo 0.6 there."""
    blur_px_per_m: float = 0.3
    """Forward scattering: Gaussian sigma per metre of path, in px of 1600."""

    def __post_init__(self) -> None:
        for name, (lowest, highest) in LIMITS.items():
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"water: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @property
    def index(self) -> float:
        """The refractive index relative to air at the projector's green."""
        return refractive_index(self.temperature_c, self.salinity_psu, GREEN_NM)


AIR = Water(attenuation_per_m=0.0, backscatter=0.0, blur_px_per_m=0.0)
"""Air does not attenuate, scatter or blur; its index is in ``truth.in_air``."""


def turbid(
    attenuation_per_m: float, scattering_share: float = 0.8, temperature_c: float = 20.0, salinity_psu: float = 0.0
) -> Water:
    """Return natural water of a beam attenuation c, 1/m, with the share b/c of it due to scattering.

    c is that of a transmissometer. Attenuation, backscatter and blur then belong together (``scattering``): light
    scattered by small angles still carries the fringes, a little softer; light scattered further is lost, and a part of
    it is backscatter. Clear ocean has c = 0.1, coast 0.4 (share 0.55), a harbour 2 (share 0.8). Raises ValueError.
    """
    if not 0.0 <= scattering_share <= 1.0:
        raise ValueError(f"water: scattering_share = {scattering_share}; allowed are 0..1 (single-scattering albedo)")
    if not 0.0 <= attenuation_per_m <= LIMITS["attenuation_per_m"][1]:
        lowest, highest = LIMITS["attenuation_per_m"]
        raise ValueError(f"water: attenuation_per_m = {attenuation_per_m}; allowed are {lowest:g}..{highest:g}")
    scattering_per_m = attenuation_per_m * scattering_share
    given_back_per_m, sigma_mm = seen_in_fringes(scattering_per_m)
    return Water(
        temperature_c,
        salinity_psu,
        attenuation_per_m - given_back_per_m,
        backscatter(scattering_per_m),
        sigma_mm / PX_MM / (WAY_MM / 1000.0),
    )
