"""The soft object of the world ``outside``: a wave runs through an object that scans take as rigid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.shapes import SIZES, SIZES_OUTSIDE, SOFT
from hw_sim.ranges import Range, drawn_strengths

Array = NDArray[np.float64]

RANGES = {
    "wave_mm": Range(0.1, 3.0, "estimate: sea fans, sponges and weed in weak surge", True),
    "length_mm": Range(90.0, 250.0, "estimate: a third of a blade or more at a time"),
    "wave_hz": Range(0.3, 1.5, "estimate: surge and chop, as for the hands"),
}
"""Ranges of the family ``soft``, which is not in the set ``ALL``: one scene of ten has it."""
ONE_IN = 10


@dataclass(frozen=True, slots=True)
class SoftBody:
    """A wave along the object's z that runs obliquely over its x and y; the board stays rigid. Raises ValueError."""

    wave_mm: float = 0.0
    length_mm: float = 120.0
    wave_hz: float = 1.0
    phase_rad: float = 0.0

    def __post_init__(self) -> None:
        for name, lowest, highest in (("wave_mm", 0.0, 5.0), ("length_mm", 60.0, 1000.0), ("wave_hz", 0.01, 10.0)):
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"soft: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> SoftBody:
        """Return strengths drawn from ``RANGES``."""
        values = drawn_strengths(RANGES, rng)
        return cls(values["wave_mm"], values["length_mm"], values["wave_hz"], float(rng.uniform(0.0, 2.0 * math.pi)))

    def waving(self, sizes: Array, time_s: float) -> Array:
        """Return ``sizes`` of ``objects.shapes`` with the wave at ``time_s``."""
        out = np.zeros(SIZES_OUTSIDE)
        out[: sizes.size] = sizes
        assert sizes.size in (SIZES, SIZES_OUTSIDE)
        turned_rad = self.phase_rad - 2.0 * math.pi * self.wave_hz * time_s
        out[SOFT : SOFT + 3] = self.wave_mm, 2.0 * math.pi / self.length_mm, turned_rad
        return out


def is_soft(seed: int) -> bool:
    """Return True if the scene of this seed has a soft object: one in ``ONE_IN``, drawn."""
    return bool(np.random.default_rng([seed, 0x50F7]).integers(ONE_IN) == 0)
