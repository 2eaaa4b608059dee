"""Owns the two cameras' names, and how one camera's part is taken out of what both have."""

from __future__ import annotations

from typing import Protocol, TypeVar

SIDES = ("left", "right")
"""Left as the diver sees it.

The cloud is in the left camera's frame and has at most one point for each of its pixels.
"""

Part_co = TypeVar("Part_co", covariant=True)


class BothSides(Protocol[Part_co]):
    """Anything with one part for each camera: noise, a stereo rig, a rig file's cameras, the corners of one view."""

    @property
    def left(self) -> Part_co:
        """The left camera's part."""

    @property
    def right(self) -> Part_co:
        """The right camera's part."""


def of_side(both: BothSides[Part_co], side: str) -> Part_co:
    """Return the part of ``both`` that belongs to the camera ``side``; raises ValueError unless that is left or right."""
    if side == "left":
        return both.left
    if side == "right":
        return both.right
    raise ValueError(f"side {side!r}: the cameras are called {' and '.join(SIDES)}")
