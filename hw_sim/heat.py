"""Temperatures inside the housing: devices heat it, masses store the heat, and the water carries it off.

Lumped masses with conductances between them, as in the design of housings (e.g. Incropera, Fundamentals of Heat and
Mass Transfer, ch. 5). The numbers are of an aluminium cylinder of 180 mm diameter and 450 mm length with some 0.3 m² of
wetted surface: 100 W/(m² K) of free convection there (water, some degrees of difference) make 30 W/K; inside, air and
brackets conduct heat from the parts to the shell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CAPACITY_J_PER_K = {
    "shell": 5400.0,  # 6 kg of aluminium
    "TCASE": 900.0,  # air, brackets and what sits on them: where the sensor is
    "computer": 1100.0,
    "TBOARD": 120.0,
    "TPROJ": 700.0,
    "camera": 260.0,  # both
}
CONDUCTANCE_W_PER_K = {
    ("TCASE", "shell"): 5.0,
    ("computer", "shell"): 2.5,
    ("computer", "TCASE"): 0.8,
    ("TBOARD", "TCASE"): 0.35,
    ("TPROJ", "shell"): 0.9,
    ("TPROJ", "TCASE"): 0.7,
    ("camera", "shell"): 0.45,
    ("camera", "TCASE"): 0.10,
}
OUTSIDE_W_PER_K = {"water": 30.0, "air": 2.4}
"""Conductance from the shell: 0.3 m² times 100 W/(m² K) in water at rest, times 8 in air with what it radiates."""
STEP_S = 1.0
"""Step of the integration; the quickest part follows in five minutes."""
PLACES = tuple(CAPACITY_J_PER_K)


@dataclass(frozen=True, slots=True)
class Powers:
    """The consumers that are on."""

    projector_lit: bool = False
    """The projector's LED is on."""
    streaming: bool = False
    """Both cameras send images."""
    lasers: bool = False

    def watts(self) -> dict[str, float]:
        """Return the heat of each part, W."""
        return {
            "computer": 28.0,
            "TBOARD": 1.5 + (0.6 if self.lasers else 0.0),
            "TPROJ": 34.0 if self.projector_lit else 9.0,
            "camera": 8.4 if self.streaming else 4.8,
        }


class Housing:
    """All temperatures at one moment; they begin at that of the water."""

    def __init__(self, outside_c: float, medium: str = "water") -> None:
        """``medium``: water or air, around the housing."""
        self.outside_c = outside_c
        """May be changed, as ``medium`` may."""
        self.medium = medium
        self._now_c: NDArray[np.float64] = np.full(len(PLACES), float(outside_c))
        conductance = np.zeros((len(PLACES), len(PLACES)))
        for (first, second), watts_per_k in CONDUCTANCE_W_PER_K.items():
            i, j = PLACES.index(first), PLACES.index(second)
            conductance[i, j] += watts_per_k
            conductance[j, i] += watts_per_k
        self._conductance = conductance
        self._capacity = np.array([CAPACITY_J_PER_K[place] for place in PLACES])

    @property
    def _outwards(self) -> NDArray[np.float64]:
        return np.array([OUTSIDE_W_PER_K[self.medium] if place == "shell" else 0.0 for place in PLACES])

    def temperature_c(self, place: str) -> float:
        """Return the temperature of a place of ``PLACES``, °C. Raises ValueError for another place."""
        return float(self._now_c[PLACES.index(place)])

    def advance(self, duration_s: float, powers: Powers) -> None:
        """Let ``duration_s`` pass with these consumers on."""
        watts = powers.watts()
        power_w = np.array([watts.get(place, 0.0) for place in PLACES])
        left_s = duration_s
        while left_s > 0.0:
            step_s = min(STEP_S, left_s)
            t = self._now_c
            # Explicit Euler of C dT/dt = P + Σ G (T_other − T) + G_out (T_out − T).
            inside = self._conductance @ t - self._conductance.sum(axis=1) * t
            self._now_c = t + step_s * (power_w + inside + self._outwards * (self.outside_c - t)) / self._capacity
            left_s -= step_s

    def settled(self, powers: Powers) -> dict[str, float]:
        """Return the steady-state temperatures with these consumers on, °C by place."""
        watts = powers.watts()
        power_w = np.array([watts.get(place, 0.0) for place in PLACES])
        # Steady state: the same balance with dT/dt = 0.
        system = np.diag(self._conductance.sum(axis=1) + self._outwards) - self._conductance
        settled_c = np.linalg.solve(system, power_w + self._outwards * self.outside_c)
        return dict(zip(PLACES, settled_c.tolist(), strict=True))
