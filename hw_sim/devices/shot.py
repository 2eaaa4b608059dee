"""Owns what identifies one pulse of the trigger line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Shot:
    """Which pulse of which sequence; rides along with the trigger line so that faults can name a frame."""

    series: int
    """Number of the ARM, from 1; 0 for live pulses."""
    index: int
    count: int | None
    """Pulses of the ARM; ``None`` for live pulses."""

    @property
    def frame(self) -> int | None:
        """Index in the armed sequence."""
        return self.index if self.count is not None else None
