"""Owns how the bytes of an image are cut into transfers: the four sizes that a stream is told before it begins.

Source: USB3 Vision 1.0, section 5.4: ``count`` transfers of one size, then one or two smaller ones; each is a multiple of the camera's alignment.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Transfers:
    """Sizes in bytes. A final transfer of 0 is none."""

    size: int
    count: int
    final_1: int
    final_2: int

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the transfers of one image, in order."""
        return (*(self.size,) * self.count, *(one for one in (self.final_1, self.final_2) if one))


def transfers_of(payload_size: int, alignment: int, piece: int | None) -> Transfers:
    """Return the transfers of an image: one, or where ``piece`` is given, as many of that size as it has, and the rest.

    ``alignment``: a power of two. The last transfer is rounded up to it, and what is beyond the image is padding.
    """
    whole = -(-payload_size // alignment) * alignment
    if piece is None or whole <= piece:
        return Transfers(whole, 1, 0, 0)
    size = max(piece // alignment, 1) * alignment
    count = payload_size // size
    return Transfers(size, count, whole - count * size, 0)
