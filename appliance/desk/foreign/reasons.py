"""Owns why a pixel of a foreign set has no point, in words."""

from __future__ import annotations

from enum import IntEnum

GAP_PIXELS, SIGMA_PIXELS = 2.5, 5.0
"""Largest ray gap and expected error of a point, over the size of a pixel on the object there."""


class Reason(IntEnum):
    """Why a left pixel has no point: the first of these that applies."""

    FOUND = 0
    SATURATED = 1
    WEAK = 2
    CONTRADICTION = 3
    OUTSIDE = 4
    NO_RAY = 5
    NO_MATCH = 6
    GAP = 7
    SIGMA = 8
    DEPTH = 9
    NEIGHBOURS = 10

    @property
    def word(self) -> str:
        """The reason's name in reports."""
        return self.name.lower().replace("_", "-")


REASONS = {
    "saturated": "white in some image",
    "weak": "too little light or contrast",
    "contradiction": "the parts of the code contradict each other",
    "outside": "beyond the pattern; its size, [x] and [y] say how far it goes",
    "no-ray": "the lens model folds over there",
    "no-match": "nothing on the other side has that coordinate where the pixel looks",
    "gap": f"rays pass each other by more than {GAP_PIXELS:g} pixels; check the cameras' numbers, [water] and [ports]",
    "sigma": f"the expected error is larger than {SIGMA_PIXELS:g} pixels on the object; range.max_sigma_mm sets another limit",
    "depth": "nearer or farther than range.near_mm and range.far_mm",
    "neighbours": "an edge, or alone",
}
"""Meaning of each reason, with what to do about it."""
BEFORE_POINTS = tuple(REASONS)[: Reason.NO_RAY - 1]
"""Reasons of pixels without coordinates."""
