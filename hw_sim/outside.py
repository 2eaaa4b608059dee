"""The world ``outside``: which families of physics it adds to the ordinary world, and how strongly.

Each family's strengths are a frozen value in the folder of its physics, with a table of ranges from which they are
drawn and the sources of these. A family that is ``None`` is as in the ordinary world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hw_sim.clocks import Clocks
from hw_sim.objects.bent import BentPlates
from hw_sim.objects.finish import Finish
from hw_sim.objects.hand_track import HandTrack
from hw_sim.objects.soft import SoftBody
from hw_sim.optics.aberrations import LensFlaws
from hw_sim.optics.camera_traits import CameraTraits
from hw_sim.optics.light_engine import LightEngine
from hw_sim.optics.mounts import Mounts
from hw_sim.water.particles import Particles

STREAM = 0x0075
"""Stream number that separates these draws from others with the same seed."""


@dataclass(frozen=True, slots=True)
class Outside:
    """The strengths of each family; ``None``: as in the ordinary world."""

    backscatter: Particles | None = None
    """Backscatter resolved in both directions, multiple scattering, core and halo of forward scatter."""
    projector: LightEngine | None = None
    """Bit planes, brightness from frame to frame, a hot spot, a bent focus, the LED's colour."""
    surfaces: Finish | None = None
    """Albedo other than 0.6, gloss, subsurface scattering and interreflection."""
    lens: LensFlaws | None = None
    """Distortion fields of lens and port up to order 11, a dent, a stria, a moving pupil. Part of the rig."""
    plates: BentPlates | None = None
    """Board and plane bent to other shapes than a paraboloid. Part of the rig."""
    cameras: CameraTraits | None = None
    """Other sensors, non-linear response, vignetting, row noise, hot pixels, veiling glare."""
    hands: HandTrack | None = None
    """Jerk, a swell of 1 Hz, rotation about the diver's shoulder."""
    mounts: Mounts | None = None
    """Poses that drift with the case's temperature, ports that bend with depth."""
    soft: SoftBody | None = None
    """An object that is not rigid; not in the set ``ALL``."""
    clocks: Clocks | None = None
    """Trigger jitter, wandering clocks, time stamps of start or end."""


@dataclass(frozen=True, slots=True)
class Family:
    """One family: its random generator and the type of its strengths."""

    number: int
    """Number of its generator. Never change or reuse it: the draws of a seed depend on it."""
    kind: type
    """The frozen dataclass of its strengths; the defaults are no effect."""
    drawn: Callable[[np.random.Generator], Any]
    """Draws the strengths."""
    of_the_set: bool = True
    """False for a family that is not in the set ``ALL`` and must be named."""


FAMILIES: dict[str, Family] = {
    "backscatter": Family(1, Particles, Particles.drawn),
    "projector": Family(3, LightEngine, LightEngine.drawn),
    "surfaces": Family(5, Finish, Finish.drawn),
    "lens": Family(2, LensFlaws, LensFlaws.drawn),
    "plates": Family(12, BentPlates, BentPlates.drawn),
    "cameras": Family(4, CameraTraits, CameraTraits.drawn),
    "hands": Family(6, HandTrack, HandTrack.drawn),
    "mounts": Family(16, Mounts, Mounts.drawn),
    "soft": Family(26, SoftBody, SoftBody.drawn, of_the_set=False),
    "clocks": Family(7, Clocks, Clocks.drawn),
}
ALL = tuple(name for name, family in FAMILIES.items() if family.of_the_set)
"""The set ``outside``."""


def draw_outside(seed: int, families: Sequence[str] = ALL) -> Outside:
    """Return the strengths of ``families``, each drawn from a generator of its own.

    The generator's seed is [``seed``, number of the family], so that switching one family on or off changes no other.
    Raises ValueError for a family that is not one of ``FAMILIES``.
    """
    strengths: dict[str, Any] = {}
    for name in families:
        family = FAMILIES.get(name)
        if family is None:
            raise ValueError(f"outside: family '{name}'; allowed are {', '.join(FAMILIES)}")
        strengths[name] = family.drawn(np.random.default_rng([seed, STREAM, family.number]))
    return Outside(**strengths)
