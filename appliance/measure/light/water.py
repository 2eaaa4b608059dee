"""Optical properties of water: refractive index and visibility."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.base import refuse_wrong_fields


@refuse_wrong_fields
@dataclass(frozen=True, slots=True)
class Water:
    """The water around the instrument, and the wavelength of the light in it."""

    temperature_c: float
    salinity_psu: float
    wavelength_nm: float

    @property
    def index(self) -> float:
        """Refractive index of the water relative to air (Quan & Fry 1995)."""
        return quan_fry_index(self.temperature_c, self.salinity_psu, self.wavelength_nm)


def quan_fry_index(temperature_c: float, salinity_psu: float, wavelength_nm: float) -> float:
    """Return the refractive index of water relative to air, Quan & Fry, Applied Optics 34 (1995) 3477, Eq. 3.

    Valid for 0..30 °C, 0..35 psu, 400..700 nm; raises ValueError well outside of it (-2..40, 0..45, 380..750).
    """
    for name, value, low, high, unit in (
        ("water temperature", temperature_c, -2.0, 40.0, "°C"),
        ("salinity", salinity_psu, 0.0, 45.0, "psu"),
        ("wavelength", wavelength_nm, 380.0, 750.0, "nm"),
    ):
        if not low <= value <= high:
            raise ValueError(
                f"{name} {value:g} {unit}; allowed are {low:g}..{high:g} {unit}; correct the water settings"
            )
    # The coefficients as printed: t in °C, S in per mille, λ in nm.
    t, s, w = temperature_c, salinity_psu, wavelength_nm
    return (
        1.31405
        + (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t * t) * s
        - 2.02e-6 * t * t
        + (15.868 + 0.01155 * s - 0.00423 * t) / w
        - 4382.0 / w**2
        + 1.1455e6 / w**3
    )


BLACK_DISK = 4.8
"""Distance at which a black disk vanishes in a horizontal view, times the beam attenuation."""


def sight_m(attenuation_per_m: float) -> float | None:
    """Return the visibility in water of that beam attenuation, in m: a black disk's distance, 4.8 / c.

    Davies-Colley, Limnology and Oceanography 33 (1988) 616. ``None`` without attenuation.
    """
    return BLACK_DISK / attenuation_per_m if attenuation_per_m > 0.0 else None
