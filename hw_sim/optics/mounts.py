"""Deformation of the mounts of the world ``outside`` by heat, and of the ports by pressure.

``hw_sim.in_dive`` applies it to the true rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hw_sim.ranges import Range, drawn_strengths

Vector = tuple[float, float, float]

PA_PER_M = 1025.0 * 9.81
"""Pressure per metre of sea water (density times gravity)."""
SAPPHIRE_PA, SAPPHIRE_POISSON = 4.0e11, 0.27
"""Young's modulus and Poisson's ratio of sapphire, a rounded mean of its directions (handbook values, not verified)."""
EYES = ("left", "right", "projector")

RANGES = {
    "turn_deg_per_k": Range(
        0.0002,
        0.0010,
        "partly estimate: 0.009 to 0.045 px per K; one camera drifts by 1.49 px over 5 to 45 °C (a study in Sensors 2022, quoted second-hand), others without a figure here: Sensors 18 (2018) 3685",
    ),
    "focal_per_k": Range(
        2e-6,
        1.2e-5,
        "single glasses: −12e-6 to 28e-6 per K (T. H. Jamieson, Opt. Eng. 20 (1981), thermal effects in optical systems, as tabulated by others)",
    ),
    "depth_m": Range(1.0, 30.0, "estimate: recreational and most scientific diving"),
    "window_radius_mm": Range(
        22.0, 32.0, "estimate: free radius that a beam of ±22° needs 30 mm behind the face, with its seal"
    ),
}
"""Ranges of the family ``mounts``; each eye rotates in a random direction."""


@dataclass(frozen=True, slots=True)
class Mounts:
    """The strengths of heat and depth; zero is no effect. Raises ValueError for impossible numbers."""

    left_deg_per_k: Vector = (0.0, 0.0, 0.0)
    """Rotation vector of the left camera with its port per kelvin of the case, in its own frame."""
    right_deg_per_k: Vector = (0.0, 0.0, 0.0)
    projector_deg_per_k: Vector = (0.0, 0.0, 0.0)
    focal_per_k: float = 0.0
    """Relative growth of all principal distances per kelvin."""
    depth_m: float = 0.0
    window_radius_mm: float = 25.0

    def __post_init__(self) -> None:
        for eye in EYES:
            value = self.turn_of(eye)
            if len(value) != 3 or not all(abs(part) <= 0.1 for part in value):
                raise ValueError(f"mounts: {eye}_deg_per_k = {value}; give three numbers, each within -0.1..0.1")
        for name, lowest, highest in (
            ("focal_per_k", -1e-3, 1e-3), ("depth_m", 0.0, 300.0), ("window_radius_mm", 5.0, 60.0),
        ):  # fmt: skip
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"mounts: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Mounts:
        """Return strengths drawn from ``RANGES``."""
        values = drawn_strengths(RANGES, rng)
        turns = rng.standard_normal((3, 3))
        turns *= values["turn_deg_per_k"] / np.linalg.norm(turns, axis=1, keepdims=True)
        left, right, projector = ((float(a), float(b), float(c)) for a, b, c in turns)
        return cls(left, right, projector, values["focal_per_k"], values["depth_m"], values["window_radius_mm"])

    def turn_of(self, eye: str) -> Vector:
        """Return the rotation vector per kelvin of ``left``, ``right`` or ``projector``, degrees."""
        return {"left": self.left_deg_per_k, "right": self.right_deg_per_k, "projector": self.projector_deg_per_k}[eye]

    def window_bend_per_mm(self, thickness_mm: float) -> float:
        """Return the curvature, 1/mm, in the middle of a simply supported round port under pressure.

        Timoshenko, Woinowsky-Krieger, Theory of Plates and Shells (1959), article 16: the moment there is p a² (3 + ν)
        / 16, the curvature that over D (1 + ν), with D = E t³ / 12 (1 − ν²).
        """
        nu, radius_m, thickness_m = SAPPHIRE_POISSON, self.window_radius_mm / 1000.0, thickness_mm / 1000.0
        stiffness = SAPPHIRE_PA * thickness_m**3 / (12.0 * (1.0 - nu * nu))
        moment = PA_PER_M * self.depth_m * radius_m**2 * (3.0 + nu) / 16.0
        return moment / (stiffness * (1.0 + nu)) / 1000.0
