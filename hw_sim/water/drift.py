"""Particles, bubbles and fish in the water: their amounts, and their positions at a moment.

Positions are those in the water, in the rig's frame of time 0; the same pieces fill the box before the rig wherever it
is moved. They move by the world's clock, also while the hands are still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.geometry import Pose

Array = NDArray[np.float64]

LIMITS = {"particles_per_l": (0.0, 2000.0), "bubbles": (0, 5000), "fish": (0, 20)}
BOX_MM = np.array([[-230.0, -150.0, 80.0], [230.0, 150.0, 700.0]])
"""A box before the rig that contains the field of every camera: 86 litres."""
SNOW_MM, SNOW_POWER = (0.1, 1.0), 3.0
"""Range of diameters of marine snow, and the exponent of their power law."""
STRAY_MM_S = 2.0
"""Random speed of each speck, as water is never quite still (sigma, each direction)."""
BUBBLE_MM, RISE_MM_S = (1.0, 4.0), (100.0, 250.0)
BUBBLE_BOX_MM = np.array([[-180.0, -150.0, 220.0], [180.0, 150.0, 500.0]])
FISH_MM, SWIM_MM_S = (60.0, 120.0), (80.0, 250.0)
FISH_BOX_MM = np.array([[-250.0, -60.0, 330.0], [250.0, 60.0, 450.0]])
SNOW, BUBBLE = 0, 1


@dataclass(frozen=True, slots=True)
class Drift:
    """The amounts of particles, bubbles and fish. Off by default. Raises ValueError outside of ``LIMITS``."""

    particles_per_l: float = 0.0
    """Marine snow: soft specks of 0.1 to 1 mm."""
    bubbles: int = 0
    """Number of bubbles in or near the view, of 1 to 4 mm, rising with 100 to 250 mm/s."""
    fish: int = 0
    """Number of fish of 60 to 120 mm, swimming to and fro across the view; each is in view about half of the time."""
    current_mm_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the water with snow and bubbles; fish are independent of it."""
    up: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """Direction in which bubbles rise, rig frame."""
    seed: int = 1

    def __post_init__(self) -> None:
        for name, (lowest, highest) in LIMITS.items():
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"drift: {name} = {value}; allowed are {lowest:g}..{highest:g}")
            if isinstance(lowest, int) and value != int(value):
                raise ValueError(f"drift: {name} = {value}; give a whole number")
        for name in ("current_mm_s", "up"):
            value = getattr(self, name)
            if len(value) != 3 or not all(math.isfinite(part) for part in value):
                raise ValueError(f"drift: {name} = {value}; give three finite numbers: x, y, z of the rig frame")
        if not any(self.up):
            raise ValueError(f"drift: up = {self.up}; allowed are vectors other than zero")

    @property
    def nothing(self) -> bool:
        """The water is empty."""
        return not (self.particles_per_l or self.bubbles or self.fish)

    @property
    def specks(self) -> bool:
        """The water contains snow or bubbles."""
        return bool(self.particles_per_l or self.bubbles)


@dataclass(frozen=True, slots=True)
class Specks:
    """Specks at a moment; n of them, the furthest first."""

    places_mm: Array
    """(n, 3), rig frame."""
    velocity_mm_s: Array
    """(n, 3), rig frame, without the hands' motion."""
    radius_mm: Array
    kind: NDArray[np.int64]
    """``SNOW`` or ``BUBBLE``."""


@dataclass(frozen=True, slots=True)
class School:
    """Fish at a moment; n of them."""

    places_mm: Array
    """(n, 3) of their middles, rig frame."""
    axes: Array
    """(n, 3, 3): rows are unit vectors ahead, up and aside, rig frame."""
    half_mm: Array
    """(n, 3): half length, height and width of the body."""
    speed_mm_s: Array


class Swarm:
    """All pieces of one ``Drift``, drawn once."""

    def __init__(self, drift: Drift) -> None:
        rng = np.random.default_rng([drift.seed, 300])
        snow = round(drift.particles_per_l * float(np.prod(BOX_MM[1] - BOX_MM[0])) / 1e6)
        current = np.array(drift.current_mm_s)
        up = np.array(drift.up) / np.linalg.norm(drift.up)
        largest = rng.uniform(size=snow)
        # Inverse transform sampling of a density ∝ d^−power between the two diameters (Junge's law).
        lowest, highest = (d ** (1.0 - SNOW_POWER) for d in SNOW_MM)
        diameter = (lowest + largest * (highest - lowest)) ** (1.0 / (1.0 - SNOW_POWER))
        self._snow = _Cloud(
            BOX_MM,
            rng.uniform(BOX_MM[0], BOX_MM[1], (snow, 3)),
            current + rng.normal(0.0, STRAY_MM_S, (snow, 3)),
        )
        size = rng.uniform(size=drift.bubbles)
        # Larger bubbles rise faster.
        rise = RISE_MM_S[0] + (RISE_MM_S[1] - RISE_MM_S[0]) * size
        self._bubbles = _Cloud(
            BUBBLE_BOX_MM,
            rng.uniform(BUBBLE_BOX_MM[0], BUBBLE_BOX_MM[1], (drift.bubbles, 3)),
            current + rise[:, None] * up,
        )
        self._radius_mm = 0.5 * np.concatenate([diameter, BUBBLE_MM[0] + (BUBBLE_MM[1] - BUBBLE_MM[0]) * size])
        self._kind = np.repeat([SNOW, BUBBLE], [snow, drift.bubbles])
        self._lengths_mm = rng.uniform(*FISH_MM, drift.fish)
        heading = rng.uniform(-0.3, 0.3, (drift.fish, 3))
        heading[:, 0] = rng.choice([-1.0, 1.0], drift.fish)
        heading /= np.linalg.norm(heading, axis=1)[:, None]
        self._speed_mm_s = rng.uniform(*SWIM_MM_S, drift.fish)
        self._heading, self._up = heading, up
        self._fish = _Cloud(
            FISH_BOX_MM,
            rng.uniform(FISH_BOX_MM[0], FISH_BOX_MM[1], (drift.fish, 3)),
            heading * self._speed_mm_s[:, None],
        )

    def specks(self, clock_s: float, pose: Pose, initial_pose: Pose) -> Specks:
        """Return snow and bubbles at ``clock_s`` in the present frame of the rig; the furthest first.

        The object is at ``pose`` there; ``initial_pose`` is its pose at time 0.
        """
        rotation = pose.R @ initial_pose.R.T
        clouds = (self._snow, self._bubbles)
        places = np.concatenate([cloud.places(clock_s, pose, initial_pose) for cloud in clouds])
        velocity = np.concatenate([cloud.velocity for cloud in clouds]) @ rotation.T
        order = np.argsort(-places[:, 2], kind="stable")
        return Specks(places[order], velocity[order], self._radius_mm[order], self._kind[order])

    def school(self, clock_s: float, pose: Pose, initial_pose: Pose) -> School:
        """Return the fish at ``clock_s``, in the same frame as ``specks``."""
        rotation = pose.R @ initial_pose.R.T
        # Right-handed: ahead, up, aside; fish keep their backs up as far as their heading allows.
        aside = np.cross(self._heading, self._up)
        aside /= np.maximum(np.linalg.norm(aside, axis=1)[:, None], 1e-9)
        axes = np.stack([self._heading, np.cross(aside, self._heading), aside], axis=1)
        half = self._lengths_mm[:, None] * np.array([0.5, 0.17, 0.09])
        return School(self._fish.places(clock_s, pose, initial_pose), axes @ rotation.T, half, self._speed_mm_s)


@dataclass(frozen=True, slots=True)
class _Cloud:
    """Pieces that move straight; one that leaves the box before the rig on one side enters on the other."""

    box_mm: Array
    places_mm: Array
    velocity: Array

    def places(self, clock_s: float, pose: Pose, initial_pose: Pose) -> Array:
        """Return the places (n, 3), mm, in the frame of the rig now."""
        rotation = pose.R @ initial_pose.R.T
        # x_now = rotation x_then + shift, as the object stands still in the water.
        shift = pose.t - rotation @ initial_pose.t
        middle = rotation.T @ (self.box_mm.mean(axis=0) - shift)
        size = self.box_mm[1] - self.box_mm[0]
        # Wrap around the box at the present rig, so that pieces never run out.
        away = self.places_mm + self.velocity * clock_s - middle
        return np.asarray((middle + away - size * np.rint(away / size)) @ rotation.T + shift)
