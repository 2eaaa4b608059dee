"""The ambient light: lamps that flicker, another diver's torch, and the caustics of waves.

It falls on a surface from everywhere (it is weighted with albedo alone and casts no shadows) and is attenuated by the
water on its way back to the camera. It follows the world's clock, not that of the hands: it flickers and moves while
the hands are at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SWING_MM = 120.0
"""Amplitude of a moving torch about its place."""
LIMITS = {
    "flicker_depth": (0.0, 1.0),
    "flicker_hz": (1.0, 100_000.0),
    "caustics": (0.0, 1.0),
    "caustics_scale_mm": (5.0, 1000.0),
    "caustics_speed_mm_s": (0.0, 5000.0),
    "torch": (0.0, 10.0),
    "torch_diameter_mm": (5.0, 1000.0),
}


@dataclass(frozen=True, slots=True)
class Daylight:
    """The ambient light. Off by default. Raises ValueError for impossible values (``LIMITS``).

    Places and directions are in the rig frame at time 0, and do not move with the hands.
    """

    flicker_depth: float = 0.0
    """The scene's ambient light is multiplied by 1 + depth · cos(2π hz t + phase)."""
    flicker_hz: float = 100.0
    """100 and 120 are lamps on mains of 50 and 60 Hz."""
    caustics: float = 0.0
    """Share of the ambient light that waves focus to caustics; the mean does not change."""
    caustics_scale_mm: float = 60.0
    """Mesh of the net."""
    caustics_speed_mm_s: float = 400.0
    """Speed of the waves that make the net."""
    sun_direction: tuple[float, float, float] = (0.1, 0.6, 0.8)
    """Direction in which the net's light travels."""
    torch: float = 0.0
    """Light in the middle of the spot, in units of the projector's white at 500 mm."""
    torch_at_mm: tuple[float, float, float] = (30.0, -20.0, 520.0)
    """The spot's middle at rest; only its distance from the beam's axis matters."""
    torch_direction: tuple[float, float, float] = (-0.5, 0.3, 1.0)
    torch_diameter_mm: float = 80.0
    """Full width at half maximum of the spot."""
    torch_velocity_mm_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the spot at its middle; it swings by ``SWING_MM``."""
    seed: int = 1
    """Seed of the flicker's phase and of the waves."""

    def __post_init__(self) -> None:
        for name, (lowest, highest) in LIMITS.items():
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"daylight: {name} = {value}; allowed are {lowest:g}..{highest:g}")
        for name in ("sun_direction", "torch_at_mm", "torch_direction", "torch_velocity_mm_s"):
            value = getattr(self, name)
            if len(value) != 3 or not all(math.isfinite(part) for part in value):
                raise ValueError(f"daylight: {name} = {value}; give three finite numbers: x, y, z of the rig frame")
        for name in ("sun_direction", "torch_direction"):
            if not any(getattr(self, name)):
                raise ValueError(f"daylight: {name} = {getattr(self, name)}; allowed are vectors other than zero")

    @property
    def steady(self) -> bool:
        """True if the light does not change with time."""
        moving = self.torch > 0.0 and any(self.torch_velocity_mm_s)
        return self.flicker_depth == 0.0 and self.caustics == 0.0 and not moving

    @property
    def even(self) -> bool:
        """True if the light is the same everywhere."""
        return self.caustics == 0.0 and self.torch == 0.0

    def flicker(self, clock_s: float, duration_s: float) -> float:
        """Return the mean factor of the ambient light over ``duration_s`` around ``clock_s``."""
        if self.flicker_depth == 0.0:
            return 1.0
        phase = np.random.default_rng([self.seed, 100]).uniform(0.0, 2.0 * math.pi)
        # A cosine averaged over T keeps sin(π f T) / (π f T) of its depth.
        averaged = float(np.sinc(self.flicker_hz * duration_s))
        return 1.0 + self.flicker_depth * averaged * math.cos(2.0 * math.pi * self.flicker_hz * clock_s + phase)

    def torch_mm(self, clock_s: float) -> NDArray[np.float64]:
        """Return the spot's middle (3,), mm in the rig frame at time 0, at ``clock_s``."""
        # A pendulum with the given speed in its middle, x = A sin(v t / A), which stays in sight.
        velocity = np.array(self.torch_velocity_mm_s)
        speed = float(np.linalg.norm(velocity))
        if speed == 0.0:
            return np.array(self.torch_at_mm)
        return np.asarray(self.torch_at_mm + velocity / speed * SWING_MM * math.sin(speed * clock_s / SWING_MM))
