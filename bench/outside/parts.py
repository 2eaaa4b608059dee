"""Owns the list of what is measured in the world ``outside``, and how a part of it is asked for."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, cast

from bench.result import Measured
from bench.verdict.parts import Say


class Part(Protocol):
    """A module that judges what is drawn at random by ``seed``; ``count`` scales the work."""

    def measure(
        self, count: int, seed: int, say: Say, keep: Path | None = None
    ) -> tuple[list[Measured], dict[str, Any]]:
        """Return figures with their bounds, and what is needed to draw their tables again, ready for JSON. What is in the folder
        ``keep`` is not done again; what is missing there is added."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One part: where it is, what it is about, and how much of it a whole report has."""

    module: str
    about: str
    count: int
    """Scenes, scans or rigs of a report."""
    few: int
    """The same for a look at whether it still does what it is for."""


PARTS = MappingProxyType(
    {
        "scenes": Entry(
            "bench.outside.scenes", "drawn scenes: completeness, outliers, honesty of sigma, false alarms", 200, 2
        ),
        "milk": Entry("bench.outside.milk", "completeness in water like diluted milk", 8, 1),
        "health": Entry(
            "bench.outside.health", "normal scans and knocks as the calibration's health sees them", 320, 8
        ),
    }
)


def measure_part(
    name: str, count: int | None, seed: int, say: Say, keep: Path | None
) -> tuple[list[Measured], dict[str, Any]]:
    """Return what the part of that name finds out, of ``count`` scenes or as many as a report has. Raises KeyError."""
    entry = PARTS[name]
    part = cast(Part, importlib.import_module(entry.module))
    return part.measure(entry.count if count is None else count, seed, say, keep)
