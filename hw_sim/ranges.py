"""Random strengths of the world ``outside``, each drawn from a range with a source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Range:
    """The values that a strength may have in a drawn world, both ends included.

    ``source`` says where they come from. It begins with "estimate:" if they are a guess, and with "partly estimate:" if
    a value within them was measured and the ends are a guess.
    """

    low: float
    high: float
    source: str
    even_in_log: bool = False
    """Uniform in the logarithm: a tenth to one is as likely as one to ten."""

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ValueError(f"range {self.low:g}..{self.high:g}; the lower end comes first")
        if not self.source.strip():
            raise ValueError(f"range {self.low:g}..{self.high:g} has no source; say where it comes from")
        if self.even_in_log and not self.low > 0.0:
            raise ValueError(f"range {self.low:g}..{self.high:g} in logarithms; it must begin above zero")

    def at(self, share: float) -> float:
        """Return the value at ``share`` of the range, 0..1."""
        if self.even_in_log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


def drawn_strengths(ranges: Mapping[str, Range], rng: np.random.Generator) -> dict[str, float]:
    """Return one value for each row of the table, uniform over its range or its logarithm.

    The rows are drawn in their order, so that a row appended to a table changes none of those before it.
    """
    return {name: r.at(float(rng.uniform())) for name, r in ranges.items()}
