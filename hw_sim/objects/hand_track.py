"""Motion of the hands in the world ``outside``: jerk, a swell, and rotation about the shoulder.

It is added to a scene's motion (``objects.motion``), and begins with time 0 as that does.
"""

# Symbols:
#   rotation, shift   motion of the rig since time 0: p_then = rotation (p_now − shoulder) + shoulder + shift, rig frame
#   j             jerk, mm/s³; A, ω, φ amplitude, angular frequency and phase of the swell or of the turn

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw_sim.ranges import Range, drawn_strengths

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

RANGES = {
    "jerk_mm_s3": Range(
        2.0,
        100.0,
        "estimate: a thousandth to a twentieth of the peak of a reach of 270 mm in 2 s, 60 D/T³ (Flash, Hogan, J. Neurosci. 5 (1985) 1688)",
        True,
    ),
    "swell_mm": Range(
        0.03,
        0.6,
        "estimate: Airy's waves of 1 Hz; 2 to 10 cm of height move water 1.4 to 1 m below by 0.04 to 0.9 mm",
        True,
    ),
    "swell_hz": Range(
        0.7, 1.3, "estimate: the short chop that still reaches a diver; longer swell is slower than a scan"
    ),
    "shoulder_deg": Range(0.003, 0.06, "estimate: 0.02 to 0.4 °/s at 1 Hz, as a camera that is held with care", True),
    "shoulder_hz": Range(0.5, 1.5, "estimate: breathing and balance of a held arm"),
    "shoulder_back_mm": Range(350.0, 550.0, "estimate: shoulder behind a device that is held in front of the chest"),
    "shoulder_up_mm": Range(100.0, 300.0, "estimate: shoulder above it"),
    "shoulder_side_mm": Range(150.0, 220.0, "estimate: half the breadth of the shoulders"),
}
"""Ranges of the family ``hands``; directions, phases and the side of the shoulder are drawn as well."""


@dataclass(frozen=True, slots=True)
class HandTrack:
    """Motion of the hands besides a scene's motion; zero is none. Raises ValueError for wrong numbers."""

    jerk_mm_s3: Vector = (0.0, 0.0, 0.0)
    swell_mm: Vector = (0.0, 0.0, 0.0)
    """Amplitudes of the swell along x, y and z of the rig."""
    swell_hz: float = 1.0
    swell_phase_rad: float = 0.0
    shoulder_deg: Vector = (0.0, 0.0, 0.0)
    """Amplitude of the turn about the shoulder, as a rotation vector."""
    shoulder_hz: float = 1.0
    shoulder_phase_rad: float = 0.0
    shoulder_mm: Vector = (180.0, -200.0, -450.0)
    """The shoulder in the rig frame at time 0."""

    def __post_init__(self) -> None:
        for name, highest in (
            ("jerk_mm_s3", 1e5),
            ("swell_mm", 100.0),
            ("shoulder_deg", 10.0),
            ("shoulder_mm", 5000.0),
        ):
            value = getattr(self, name)
            if len(value) != 3 or not all(abs(part) <= highest for part in value):
                raise ValueError(f"hands: {name} = {value}; give three numbers, each within -{highest:g}..{highest:g}")
        for name in ("swell_hz", "shoulder_hz"):
            value = getattr(self, name)
            if not 0.0 < value <= 30.0:
                raise ValueError(f"hands: {name} = {value}; allowed are 0..30, without 0")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> HandTrack:
        """Return strengths drawn from ``RANGES``, in uniformly distributed directions."""
        values = drawn_strengths(RANGES, rng)
        side = values["shoulder_side_mm"] * float(rng.choice([-1.0, 1.0]))
        return cls(
            _towards_anywhere(values["jerk_mm_s3"], rng),
            _towards_anywhere(values["swell_mm"], rng),
            values["swell_hz"],
            float(rng.uniform(0.0, 2.0 * math.pi)),
            _towards_anywhere(values["shoulder_deg"], rng),
            values["shoulder_hz"],
            float(rng.uniform(0.0, 2.0 * math.pi)),
            (side, -values["shoulder_up_mm"], -values["shoulder_back_mm"]),
        )

    def seen(self, R: Array, t: Array, time_s: float) -> tuple[Array, Array]:
        """Return the pose in the rig frame of an object that would be at (R, t) without this motion.

        Rotation (3, 3) and translation (3,), mm.
        """
        swell = 2.0 * math.pi * self.swell_hz * time_s + self.swell_phase_rad
        # s = j t³/6 + A (sin(ωt + φ) − sin φ): at time 0 nothing has moved.
        shift = np.array(self.jerk_mm_s3) * time_s**3 / 6.0
        shift += np.array(self.swell_mm) * (math.sin(swell) - math.sin(self.swell_phase_rad))
        angle = 2.0 * math.pi * self.shoulder_hz * time_s + self.shoulder_phase_rad
        rotation = _turn(np.radians(self.shoulder_deg) * (math.sin(angle) - math.sin(self.shoulder_phase_rad)))
        # A point p is now at rotationᵀ (p − shift − shoulder) + shoulder.
        shoulder = np.array(self.shoulder_mm)
        return rotation.T @ R, rotation.T @ (t - shift - shoulder) + shoulder


def _towards_anywhere(length: float, rng: np.random.Generator) -> Vector:
    direction = rng.standard_normal(3)
    direction *= length / np.linalg.norm(direction)
    return float(direction[0]), float(direction[1]), float(direction[2])


def _turn(vector_rad: Array) -> Array:
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    # Rodrigues: R = I + sin θ K + (1 − cos θ) K², K the cross product with the axis.
    K = np.cross(np.eye(3), vector_rad / angle)
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K)
