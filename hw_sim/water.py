"""Owns the simulated water: its index (own evaluation of Quan and Fry's empirical formula) and how it dims light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GREEN_NM = 530.0


@dataclass(frozen=True, slots=True)
class Water:
    """What surrounds the instrument."""

    temperature_c: float = 20.0
    salinity_psu: float = 0.0
    attenuation_per_m: float = 0.4
    backscatter: float = 0.01
    """Veil as a fraction of the projector's mean light."""
    blur_px_per_m: float = 0.3
    """Forward scattering: Gaussian sigma per metre of path, in px of 1600."""

    @property
    def index(self) -> float:
        """Refractive index relative to air at the projector's green."""
        powers_nm = GREEN_NM ** -np.arange(4.0)
        t, s = self.temperature_c, self.salinity_psu
        terms = np.array(
            [
                1.31405 - 2.02e-6 * t**2 + s * (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2),
                15.868 + 0.01155 * s - 0.00423 * t,
                -4382.0,
                1.1455e6,
            ]
        )
        return float(terms @ powers_nm)
