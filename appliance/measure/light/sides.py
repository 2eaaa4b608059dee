"""The names of the two cameras, and the access to one camera's part of a pair."""

from __future__ import annotations

from typing import Protocol, TypeVar

SIDES = ("left", "right")
"""The cameras, left as the diver sees it.

The cloud is in the left camera's frame and has at most one point for each of its pixels.
"""

Part_co = TypeVar("Part_co", covariant=True)


class BothSides(Protocol[Part_co]):
    """A pair with one part for each camera, such as noise, a stereo rig or the corners of one view."""

    @property
    def left(self) -> Part_co:
        """The left camera's part."""

    @property
    def right(self) -> Part_co:
        """The right camera's part."""


def of_side(pair: BothSides[Part_co], side: str) -> Part_co:
    """Return the part of ``pair`` for the camera ``side``; raises ValueError unless that is left or right."""
    if side == "left":
        return pair.left
    if side == "right":
        return pair.right
    raise ValueError(f"side {side!r}: the cameras are called {' and '.join(SIDES)}")
