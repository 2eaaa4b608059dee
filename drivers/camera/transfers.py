"""The division of an image into transfers: the four sizes that are set before a stream begins.

Source: USB3 Vision 1.0, section 5.4: ``count`` transfers of one size, then one or two smaller ones; each is a multiple
of the camera's alignment.
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
        """Sizes of the transfers of one image, in order."""
        return (*(self.size,) * self.count, *(size for size in (self.final_1, self.final_2) if size))


def transfers_of(payload_size: int, alignment: int, piece: int | None) -> Transfers:
    """Return the transfers of an image: one, or with ``piece`` as many of that size as fit and a last.

    ``alignment``: a power of two. The last transfer is rounded up to it; its bytes beyond the image are padding.
    """
    padded = -(-payload_size // alignment) * alignment
    if piece is None or padded <= piece:
        return Transfers(padded, 1, 0, 0)
    size = max(piece // alignment, 1) * alignment
    count = payload_size // size
    return Transfers(size, count, padded - count * size, 0)
