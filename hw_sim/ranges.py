"""Owns how the strengths of the world ``outside`` are drawn: each from a range that names its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Range:
    """The values that a strength may take in a drawn world, both ends included; ``source`` says who found them so."""

    low: float
    high: float
    source: str

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ValueError(f"range {self.low:g}..{self.high:g}; the lower end comes first")
        if not self.source.strip():
            raise ValueError(f"range {self.low:g}..{self.high:g} has no source; say where it comes from")


def drawn_strengths(ranges: Mapping[str, Range], rng: np.random.Generator) -> dict[str, float]:
    """Return one value for each row of the table, evenly distributed over its range.

    The rows are drawn in their order, so that a row appended to a table changes none of those before it.
    """
    return {name: float(rng.uniform(r.low, r.high)) for name, r in ranges.items()}
