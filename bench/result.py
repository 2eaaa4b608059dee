"""Result of a benchmark: a number, its unit, and its limit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Measurement:
    """One figure of a benchmark, with optional bounds.

    Bounds belong on CPU time, on ratios measured in one run, on memory and on errors; wall time depends on the load of
    the machine.
    """

    name: str
    value: float
    unit: str
    at_most: float | None = None
    at_least: float | None = None
    key: str | None = None
    """Name in ``latest.json``; ``None``: not listed there."""
    why: str | None = None
    """Why there is no value (NaN)."""
    spread: tuple[float, float] | None = None
    """First and ninth tenth of the values whose median this is."""
    share: tuple[int, int] | None = None
    """Numerator and denominator of a count or rate, by which figures of several parts are added up."""

    @property
    def is_kept(self) -> bool:
        """True when every bound holds. NaN keeps none."""
        if math.isnan(self.value):
            return self.at_most is None and self.at_least is None
        below = self.at_most is None or self.value <= self.at_most
        above = self.at_least is None or self.value >= self.at_least
        return below and above

    def line(self) -> str:
        """Return a row of text: value, unit, bounds, and MISSED if one is broken."""
        bounds = []
        if self.spread is not None:
            bounds.append("{:.4g} to {:.4g}".format(*self.spread))
        if self.at_least is not None:
            bounds.append(f"at least {self.at_least:g}")
        if self.at_most is not None:
            bounds.append(f"at most {self.at_most:g}")
        if self.why is not None:
            return f"  {self.name:<48} {'not measured':>12} {self.why}"
        judged = ", ".join(bounds)
        if self.at_least is not None or self.at_most is not None:
            judged += f": {'kept' if self.is_kept else 'MISSED'}"
        return f"  {self.name:<48} {self.value:>12.5g} {self.unit:<8} {judged}".rstrip()

    def as_dict(self) -> dict[str, Any]:
        """Return the figure JSON-ready."""
        return {
            "name": self.name,
            "value": None if math.isnan(self.value) else float(self.value),
            "unit": self.unit,
            "at_most": self.at_most,
            "at_least": self.at_least,
            "kept": bool(self.is_kept),
            "why": self.why,
            "spread": None if self.spread is None else [float(value) for value in self.spread],
            "share": None if self.share is None else list(self.share),
        }
