"""Flaws of lens and port of one eye beyond five distortion coefficients and two plane faces.

They are a field of cosines up to order 11 with a falling spectrum, a dent and a stria of the port, and an entrance
pupil that moves along the axis with the field angle. ``optics.trace`` traces rays with them.
"""

# Symbols:
#   i, j      order of a cosine across and down the picture; c its coefficient in px
#   σ         width of a dent or stria, px: the displacement is √e · amount · (r/σ) exp(−r²/2σ²), so that its largest is amount

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw_sim.ranges import Range, drawn_strengths

Array = NDArray[np.float64]

ORDERS = 12
"""Number of orders of the cosines in each direction: 0 to 11."""

RANGES = {
    "field_px": Range(
        0.06,
        0.12,
        "estimate: what parametric models leave is systematic (Schöps et al., CVPR 2020, 2535), and fields are fitted to it (R. Tang, ISPRS Archives XXXIX-B1, 2012); how much is a guess",
    ),
    "fall": Range(
        1.0,
        2.0,
        "estimate: amplitudes of fields in a plane whose spectral density along a line falls with the first to third power",
    ),
    "dent_px": Range(
        0.03,
        0.12,
        "estimate: form of 0.1 to 0.3 fringe on 3 mm of a face: 15 to 50 µrad in water, times a focal length of 2556 px",
    ),
    "dent_width_px": Range(
        90.0,
        220.0,
        "estimate: a flaw of 1 to 2.5 mm in a window 30 mm before the pupil, blurred by the pupil of 1.4 mm",
    ),
    "stria_px": Range(
        0.02,
        0.06,
        "partly estimate: 10 to 30 nm of path, the better three of the four grades of ISO 12123 for 50 mm of glass (P. Hartmann, Optical Glass, SPIE 2014, 91); sapphire has no such grades",
    ),
    "stria_width_px": Range(70.0, 160.0, "estimate: cords of 0.5 to 2 mm, blurred by the pupil as above"),
    "pupil_mm": Range(
        0.2, 0.6, "estimate: tenths of a mm; that the pupil moves: D. B. Gennery, Int. J. Comput. Vis. 68 (2006) 239"
    ),
}
"""Ranges of the family ``lens``; px are those of 1600."""


@dataclass(frozen=True, slots=True)
class LensFlaws:
    """The strengths of the flaws, the same for each eye; zero is none. ValueError for wrong numbers."""

    field_px: float = 0.0
    """Root mean square of each component of the field, px of 1600."""
    fall: float = 1.0
    """Exponent of the spectrum: a coefficient's standard deviation is (1 + i + j)^−fall."""
    dent_px: float = 0.0
    """Largest displacement by a dent of the port, px of 1600; each eye has between a half and all of it."""
    dent_width_px: float = 120.0
    """Distance of the largest displacement from the dent's middle, px of 1600."""
    stria_px: float = 0.0
    """Largest displacement across a stria, px of 1600; each eye has between a half and all of it."""
    stria_width_px: float = 100.0
    pupil_mm: float = 0.0
    """Displacement of the entrance pupil along the axis over the squared tangent of the angle in air."""

    def __post_init__(self) -> None:
        for name, lowest, highest in (
            ("field_px", 0.0, 5.0), ("fall", 0.0, 8.0), ("dent_px", 0.0, 5.0), ("dent_width_px", 80.0, 800.0),
            ("stria_px", 0.0, 5.0), ("stria_width_px", 60.0, 800.0), ("pupil_mm", -5.0, 5.0),
        ):  # fmt: skip
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"lens: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> LensFlaws:
        """Return strengths drawn from ``RANGES``."""
        return cls(**drawn_strengths(RANGES, rng))


@dataclass(frozen=True, slots=True)
class Aberrations:
    """The flaws of one eye, in its own px, for ``optics.trace``."""

    field_px: tuple[float, ...] = (0.0,) * (2 * ORDERS * ORDERS)
    """Coefficients for u (row = order down the picture), then for v."""
    dent: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 0.0)
    """Middle u, v, width and largest displacement, px."""
    stria: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 1.0, 0.0)
    """A point u, v of its line, direction of its normal in radians, width and largest displacement, px."""
    pupil_mm: float = 0.0
    window_bend_per_mm: float = 0.0
    """Curvature of both faces under pressure, 1/mm, positive if the middle is nearer to the lens."""

    def packed(self) -> Array:
        """Return the numbers in the order that ``optics.trace`` uses."""
        return np.array([*self.field_px, *self.dent, *self.stria, self.pupil_mm, self.window_bend_per_mm])

    def without_window(self) -> Aberrations:
        """Return the flaws of the lens alone."""
        return Aberrations(self.field_px, pupil_mm=self.pupil_mm)

    def as_dict(self) -> dict[str, Any]:
        """Return the flaws ready for JSON and TOML: ``u_px[j][i]`` belongs to cos(iπ(u+½)/width) cos(jπ(v+½)/height)."""
        u, v = np.reshape(self.field_px, (2, ORDERS, ORDERS)).tolist()
        return {
            "u_px": u,
            "v_px": v,
            "dent": list(self.dent),
            "stria": list(self.stria),
            "pupil_mm": self.pupil_mm,
            "window_bend_per_mm": self.window_bend_per_mm,
        }

    @classmethod
    def from_dict(cls, table: dict[str, Any]) -> Aberrations:
        """Return the flaws of a table by ``as_dict``. Raises KeyError for a missing key."""
        return cls(
            tuple(float(x) for x in np.ravel([table["u_px"], table["v_px"]])),
            tuple(table["dent"]),
            tuple(table["stria"]),
            table["pupil_mm"],
            table["window_bend_per_mm"],
        )


def flawed(
    strengths: LensFlaws, rng: np.random.Generator, width_px: int, height_px: int, px_per_1600: float
) -> Aberrations:
    """Return random flaws of one eye with these strengths; ``px_per_1600``: px of the eye per px of 1600."""
    orders = np.add.outer(np.arange(ORDERS), np.arange(ORDERS))
    field = rng.standard_normal((2, ORDERS, ORDERS)) * (1.0 + orders) ** -strengths.fall
    # The constant and the two lowest orders belong to principal point and focal length.
    field[:, 0, 0] = field[:, 0, 1] = field[:, 1, 0] = 0.0
    # Mean square of a cosine over the picture: ½, or 1 for order 0.
    power = np.where(np.arange(ORDERS) == 0, 1.0, 0.5)
    square = np.einsum("cji,j,i->c", field**2, power, power)
    field *= strengths.field_px * px_per_1600 / np.sqrt(square)[:, None, None]
    centres_px = rng.uniform(0.2, 0.8, (2, 2)) * (width_px, height_px)
    share = rng.uniform(0.5, 1.0, 2) * rng.choice([-1.0, 1.0], 2) * px_per_1600
    normal_rad = rng.uniform(0.0, math.pi)
    return Aberrations(
        tuple(float(x) for x in field.ravel()),
        (
            float(centres_px[0, 0]),
            float(centres_px[0, 1]),
            strengths.dent_width_px * px_per_1600,
            strengths.dent_px * float(share[0]),
        ),
        (
            *(float(centres_px[1, 0]), float(centres_px[1, 1]), normal_rad),
            *(strengths.stria_width_px * px_per_1600, strengths.stria_px * float(share[1])),
        ),
        strengths.pupil_mm,
    )
