"""Forms of the plates in the world ``outside``: a saddle, a twist and an S besides the paraboloid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw_sim.ranges import Range, drawn_strengths

MOST_MM = 0.2
"""Largest form that fits into the boxes around plane and board, together with a bow."""
BOARD = "estimate: a hundredth to some hundredths of a mm; 1 K across 8 mm of aluminium bends 300 mm by 0.03 mm"
PLATE = (
    "measuring plates of 250 mm: flat to 5 µm (grade 0: 4 + L/250, L in mm) or 12.5 µm (grade 1: 10 + L/100), DIN 876"
)
RANGES = {
    "board_saddle_mm": Range(0.010, 0.050, BOARD),
    "board_twist_mm": Range(0.010, 0.050, BOARD),
    "board_s_mm": Range(0.005, 0.030, BOARD),
    "plane_saddle_mm": Range(0.002, 0.006, PLATE),
    "plane_twist_mm": Range(0.002, 0.006, PLATE),
    "plane_s_mm": Range(0.001, 0.004, PLATE),
}
"""Ranges of the family ``plates``; each sign is drawn as well."""


@dataclass(frozen=True, slots=True)
class BentPlates:
    """The forms of the ChArUco board's plate and of the plane, besides their bow. Raises ValueError."""

    board_saddle_mm: float = 0.0
    """Height of the front in the middle of its right edge above the middle: (x² − y²)/a², a half the width."""
    board_twist_mm: float = 0.0
    """The same saddle turned by 45°: 2xy/a²."""
    board_s_mm: float = 0.0
    """Largest height of an S along x, which is zero in the middle and at both ends."""
    plane_saddle_mm: float = 0.0
    plane_twist_mm: float = 0.0
    plane_s_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            if not abs(value) <= MOST_MM:
                raise ValueError(f"plates: {name} = {value}; allowed are -{MOST_MM:g}..{MOST_MM:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> BentPlates:
        """Return strengths drawn from ``RANGES``, each with a random sign."""
        values = drawn_strengths(RANGES, rng)
        return cls(**{name: value * float(rng.choice([-1.0, 1.0])) for name, value in values.items()})

    @property
    def board(self) -> tuple[float, float, float]:
        """Saddle, twist and S of the board, mm."""
        return self.board_saddle_mm, self.board_twist_mm, self.board_s_mm

    @property
    def plane(self) -> tuple[float, float, float]:
        """Saddle, twist and S of the plane, mm."""
        return self.plane_saddle_mm, self.plane_twist_mm, self.plane_s_mm
