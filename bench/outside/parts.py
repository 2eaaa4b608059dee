"""List of the parts that are measured in the world ``outside``, and how a part is called."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast

from bench.result import Measurement
from bench.verdict.parts import Say


class Part(Protocol):
    """A module that judges random scenes by ``seed``; ``count`` scales the work."""

    def measure(
        self, count: int, seed: int, say: Say, keep: Path | None = None
    ) -> tuple[list[Measurement], dict[str, Any]]:
        """Return figures with their limits, and the data of their tables, JSON-ready.

        Results in the folder ``keep`` are not computed again; missing ones are added.
        """


class PartWithNoise(Protocol):
    """Part of the measurement that depends on how the instrument knows its camera noise."""

    def measure(
        self, count: int, seed: int, say: Say, keep: Path | None, noise: str
    ) -> tuple[list[Measurement], dict[str, Any]]:
        """Measure as ``Part.measure``; ``noise`` is one of ``noise.WAYS``."""


class PartOfWorlds(Protocol):
    """A part that is measured in the ordinary world as well."""

    def measure(
        self, scans: int, seed: int, say: Say, keep: Path | None, world: str
    ) -> tuple[list[Measurement], dict[str, Any]]:
        """Measure as ``Part.measure``, in the ``world`` of that name."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Entry of one part: its module, subject, and size."""

    module: str
    subject: str
    count: int
    """Scenes, scans or rigs of a report."""
    few: int
    """Scenes, scans or rigs of a quick check."""
    noise: bool = False
    """True for a ``PartWithNoise``."""
    world: str | None = None
    """World to pass to a module that has several; ``None`` for a module of this one only."""


OUTSIDE = "outside"
"""Name of this world in ``bench.verdict.worlds``."""
PARTS = MappingProxyType(
    {
        "scenes": Entry(
            "bench.outside.scenes",
            "drawn scenes: completeness, outliers, honesty of sigma, false alarms",
            200,
            2,
            noise=True,
        ),
        "sample": Entry("bench.outside.sample", "some of these scenes again, and all soft ones", 30, 1, noise=True),
        "milk": Entry("bench.outside.milk", "completeness in water like diluted milk", 8, 1, noise=True),
        "rigs": Entry("bench.outside.rigs", "calibrated rigs: lengths, planes, and whether misses are announced", 8, 1),
        "health": Entry(
            "bench.outside.health", "normal scans and knocks as the calibration's health sees them", 112, 8
        ),
        "motion": Entry(
            "bench.verdict.motion", "what moved is rejected, what did no harm is not", 120, 2, world=OUTSIDE
        ),
        "identity": Entry(
            "bench.verdict.identity", "wrong orders of frames are found and rightly named", 60, 1, world=OUTSIDE
        ),
        "compensation": Entry(
            "bench.outside.compensation",
            "hands' movement undone: how far what is shown errs, and what is refused",
            40,
            1,
        ),
        "causes": Entry(
            "bench.verdict.causes", "the first reason that is given for a bad scan is a true one", 80, 1, world=OUTSIDE
        ),
    }
)


def measure_part(
    name: str, count: int | None, seed: int, say: Say, keep: Path | None, noise: str
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the results of part ``name``, for ``count`` scenes or as many as a report has.

    ``noise`` is the source of the camera noise (``noise.WAYS``). Raises KeyError.
    """
    entry = PARTS[name]
    module, count = importlib.import_module(entry.module), entry.count if count is None else count
    if entry.world is not None:
        return cast(PartOfWorlds, module).measure(count, seed, say, keep, entry.world)
    if entry.noise:
        return cast(PartWithNoise, module).measure(count, seed, say, keep, noise)
    return cast(Part, module).measure(count, seed, say, keep)
