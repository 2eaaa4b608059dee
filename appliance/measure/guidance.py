"""Owns the words for what two scans have in common: a share, none, or that nobody can tell; and for where to take the
next one from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True, slots=True)
class Overlap:
    """Overlap of a scan with the one before."""

    share: float | None
    """Share, 0..1, of this scan's surface that the other one has, too; ``None``: it cannot be told (a smooth pipe fits
    everywhere)."""

    @property
    def none(self) -> bool:
        """True if it is known that so little is in common that the scans cannot be placed to each other."""
        return self.share is not None and self.share < LEAST_SHARE

    @property
    def scant(self) -> bool:
        """True if it is known to be less than half of what is wanted: the next step should be shorter."""
        return self.share is not None and self.share < SCANT_SHARE


LEAST_SHARE = 0.08
"""Smaller overlaps hold no pair of scans together (``appliance.measure.overlap.pair``)."""
SCANT_SHARE = 0.25
"""Overlaps of 40 to 60 % are good: enough to hold, and new surface in every scan."""
NO_OVERLAP, UNKNOWN = Overlap(0.0), Overlap(None)

LEAST_GOOD, MOST_GOOD = 0.4, 0.6
"""Shares between which a scan holds well and shows enough that is new."""


class Move(Enum):
    """The thing to do before the next scan."""

    GO_BACK = "GO BACK"
    SCAN_NOW = "SCAN NOW"
    GO_ON = "GO ON"


@dataclass(frozen=True, slots=True)
class Guidance:
    """The overlap that a scan taken from here would have with the one that was kept last, and the way to a better one."""

    expected: Overlap
    """Overlap that it would have. Its share is never ``None``: what cannot be told is no guidance."""
    toward: tuple[float, float] | None = None
    """Direction of a good view in the left picture, right and down, of length 1; ``None``: any will do, or it is not
    known."""

    def __post_init__(self) -> None:
        """Raises ValueError for an overlap without a share."""
        if self.expected.share is None:
            raise ValueError(
                "guidance without a share; allowed are 0..1; give no guidance where the overlap is not known"
            )

    @property
    def move(self) -> Move:
        share = self.expected.share or 0.0
        return Move.GO_BACK if share < LEAST_GOOD else Move.GO_ON if share > MOST_GOOD else Move.SCAN_NOW


LOST = Guidance(NO_OVERLAP)
"""Nothing of what is seen lies on the scan that was kept."""
