"""The interface of a scan-out for projector and display, be it a connector or a window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class FlipStamp:
    """One picture became visible. ``sequence`` counts vertical blanks, ``None`` without a counter."""

    sequence: int | None
    time_ns: int


class Picture(Protocol):
    """Memory that can be shown."""

    def write(self, pixels: NDArray[np.uint8]) -> None:
        """Copy (height, width, 4) uint8 in: blue, green, red, unused."""


P = TypeVar("P", bound=Picture)


class Surface(Protocol[P]):
    """One lit output that shows one picture after the other. Used by one thread at a time."""

    device: str
    size_px: tuple[int, int]
    """(width, height)."""
    refresh_hz: float

    def create_picture(self) -> P:
        """Make a black picture of the surface's size; it lives as long as the surface. Raises DeviceError."""

    def flip(self, picture: P, timeout_s: float) -> FlipStamp:
        """Show ``picture`` from the next vertical blank on and wait until it is visible. Raises DeviceGone."""

    def check_connection(self) -> None:
        """Raise DeviceGone if the surface is known to be invisible: unplugged or closed."""

    def describe(self) -> tuple[str, Mapping[str, str]]:
        """Return one line about the lit output, and details by name."""

    def close(self) -> None:
        """Go dark and release all memory. Idempotent."""
