"""Overlap of two scans and guidance to the next one: the values that screens show."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True, slots=True)
class Overlap:
    """Overlap of a scan with the one before."""

    share: float | None
    """Share, 0..1, of this scan's surface that the other one has, too; ``None``: unknown (a smooth pipe fits anywhere).
    """

    @property
    def none(self) -> bool:
        """True if the overlap is certainly too small for registration."""
        return self.share is not None and self.share < LEAST_SHARE

    @property
    def scant(self) -> bool:
        """True if it is certainly less than half of a good overlap: the next step should be shorter."""
        return self.share is not None and self.share < SCANT_SHARE


LEAST_SHARE = 0.08
"""Least overlap for registration (``appliance.measure.overlap.pair``)."""
SCANT_SHARE = 0.25
"""Overlap below which the next step should be shorter: 40 to 60 % are good."""
NO_OVERLAP, UNKNOWN = Overlap(0.0), Overlap(None)

LEAST_GOOD, MOST_GOOD = 0.4, 0.6
"""Good overlaps: enough for registration, and enough new surface."""


class Move(Enum):
    """The next move of the diver before a scan."""

    GO_BACK = "GO BACK"
    SCAN_NOW = "SCAN NOW"
    GO_ON = "GO ON"


@dataclass(frozen=True, slots=True)
class Guidance:
    """The overlap that a scan from here would have with the kept one, and the direction to a better one."""

    expected: Overlap
    """Overlap that it would have. Its share is never ``None``: an unknown overlap gives no guidance."""
    toward: tuple[float, float] | None = None
    """Direction of a good view in the left image, right and down, of length 1; ``None``: any, or unknown."""

    def __post_init__(self) -> None:
        """Raise ValueError for an overlap without a share."""
        if self.expected.share is None:
            raise ValueError(
                "guidance without a share; allowed are 0..1; give no guidance where the overlap is not known"
            )

    @property
    def move(self) -> Move:
        share = self.expected.share or 0.0
        return Move.GO_BACK if share < LEAST_GOOD else Move.GO_ON if share > MOST_GOOD else Move.SCAN_NOW


LOST = Guidance(NO_OVERLAP)
"""Guidance if the live image does not overlap the kept scan."""
