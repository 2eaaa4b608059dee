"""Owns the words for how much of a scan the one before has seen, too: a share, none, or that nobody can tell."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Overlap:
    """Overlap of a scan with the one before."""

    share: float | None
    """Share, 0..1, of this scan's surface that the other one has, too; ``None``: it cannot be told (a smooth pipe fits everywhere)."""

    @property
    def none(self) -> bool:
        """True if it is known that so little is in common that the scans cannot be placed to each other."""
        return self.share is not None and self.share < LEAST_SHARE

    @property
    def scant(self) -> bool:
        """True if it is known to be less than half of what is wanted: the next step should be shorter."""
        return self.share is not None and self.share < SCANT_SHARE


LEAST_SHARE = 0.08
"""Smaller overlaps hold no pair of scans together (``appliance.desk.registration.pair``)."""
SCANT_SHARE = 0.25
"""Overlaps of 40 to 60 % are good: enough to hold, and new surface in every scan."""
NO_OVERLAP, UNKNOWN = Overlap(0.0), Overlap(None)
