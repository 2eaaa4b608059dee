"""List of the parts of the measurement of verdicts, and how a part is called."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast

from bench.result import Measurement

Say = Callable[[str, float], None]
"""Function that shows the present step, and the share 0..1 of the part that is done."""


class Part(Protocol):
    """A module of this package that judges scans drawn at random by ``seed``; ``scans`` scales the work."""

    def measure(self, scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
        """Return figures with their limits, and the data of their curves, JSON-ready."""


class KeepingPart(Protocol):
    """A part that draws a scan once and judges it often."""

    def measure(
        self, scans: int, seed: int, say: Say, keep: Path | None = None
    ) -> tuple[list[Measurement], dict[str, Any]]:
        """Measure as ``Part.measure``, with rendered scans in the folder ``keep``; missing ones are added."""


class WorldPart(Protocol):
    """Part of the measurement that can also run in another world."""

    def measure(
        self, scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ...
    ) -> tuple[list[Measurement], dict[str, Any]]:
        """Measure as ``KeepingPart.measure``, with the scans of ``world`` (``worlds.WORLDS``)."""


IN_WORLDS = ("motion", "identity", "identity_good", "causes", "compensation", "compensation_hard")
"""Names of the parts that run in both worlds."""
KEEPING = (
    "motion",
    "causes",
    "identity_good",
    "compensation",
    "compensation_full",
    "compensation_hard",
    "compensation_speed",
)
"""Names of the parts that store their frames."""
PARTS = MappingProxyType(
    {
        "identity": "each frame is the pattern it should be",
        "identity_good": "good scans, at rest, moving, in milk and rushing by, that are called wrong",
        "motion": "what moved is rejected, what did no harm is not",
        "motion_speed": "noise against the speed of the hands, for both orders of the steps",
        "compensation": "rigid motion taken out of the points",
        "compensation_full": "the same at the instrument's own resolution",
        "compensation_hard": "the same in flicker, milk, without paint, with steps and labels",
        "compensation_speed": "the same against the hand's speed",
        "light": "exposure, flicker, two exposures in one",
        "pair": "the second exposure that is proposed: what both show, at rest and moved, against any single one",
        "turbidity": "what is said of the water",
        "window": "clean windows that are called fogged, and fog that is found and named",
        "causes": "the first reason that is given for a bad scan is a true one",
        "specks": "snow, bubbles and fish: points they make wrong, points they cost",
        "uncertainty": "each point's expected error against its true one",
    }
)


def part(name: str) -> Part:
    """Return the module of a part. Raises KeyError for a name not in ``PARTS``."""
    if name not in PARTS:
        raise KeyError(name)
    return cast(Part, importlib.import_module(f"bench.verdict.{name}"))


def measure_part(
    name: str, scans: int, seed: int, say: Say, keep: Path | None, world: str | None = None
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the results of part ``name``. Raises KeyError.

    Only parts of ``KEEPING`` use ``keep``, only those of ``IN_WORLDS`` use ``world`` (``None``: the ordinary one).
    """
    if name in IN_WORLDS and world is not None:
        return cast(WorldPart, part(name)).measure(scans, seed, say, keep, world)
    if name in KEEPING:
        return cast(KeepingPart, part(name)).measure(scans, seed, say, keep)
    return part(name).measure(scans, seed, say)
