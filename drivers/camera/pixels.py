"""The pixel formats that a camera may send, and their reduction to the upper 8 bits, as in Mono8.

Source of names, codes and layouts: GenICam Pixel Format Naming Convention (PFNC) 2.4 and its 32-bit values; ``p`` packs
from the least significant bit on without gaps, ``Packed`` is GigE Vision's older layout of two pixels in three bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


def _mono10(raw: Bytes, image: Bytes) -> None:
    """Reduce two bytes a pixel, the lower one first: bits 9..2."""
    np.right_shift(raw.view("<u2"), 2, out=image, casting="unsafe")


def _mono12(raw: Bytes, image: Bytes) -> None:
    """Reduce two bytes a pixel, the lower one first: bits 11..4."""
    np.right_shift(raw.view("<u2"), 4, out=image, casting="unsafe")


def _mono10p(raw: Bytes, image: Bytes) -> None:
    """Reduce four pixels in five bytes.

    Pixel k has bits 10k .. 10k + 9, of which the upper eight begin at bit 10k + 2.
    """
    five, four = raw.reshape(-1, 5), image.reshape(-1, 4)
    for k in range(4):
        low = 2 * k + 2
        np.left_shift(five[:, k + 1], 8 - low, out=four[:, k])
        if low < 8:
            four[:, k] |= five[:, k] >> low


def _mono12p(raw: Bytes, image: Bytes) -> None:
    """Reduce two pixels in three bytes.

    Bits 4..11 of the first lie in two bytes, those of the second are the third byte.
    """
    three, two = raw.reshape(-1, 3), image.reshape(-1, 2)
    np.left_shift(three[:, 1], 4, out=two[:, 0])
    two[:, 0] |= three[:, 0] >> 4
    two[:, 1] = three[:, 2]


def _packed(raw: Bytes, image: Bytes) -> None:
    """Reduce two pixels in three bytes; the middle byte has the bits below their upper eight."""
    three, two = raw.reshape(-1, 3), image.reshape(-1, 2)
    two[:, 0] = three[:, 0]
    two[:, 1] = three[:, 2]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """One format on the wire."""

    name: str
    code: int
    bits_per_pixel: int
    group: int
    """Pixels that are packed together: an image has a whole number of groups."""
    reduce: Callable[[Bytes, Bytes], None] | None
    """Converts an image's bytes to its pixels, both 1-D; ``None``: they are the same."""

    def payload_size(self, pixels: int) -> int | None:
        """Return the bytes of an image of so many pixels; ``None`` where they are no whole number of groups."""
        return None if pixels % self.group else int(Fraction(self.bits_per_pixel, 8) * pixels)


FORMATS: Mapping[str, PixelFormat] = MappingProxyType(
    {
        pixel_format.name: pixel_format
        for pixel_format in (
            PixelFormat("Mono8", 0x01080001, 8, 1, None),
            PixelFormat("Mono10", 0x01100003, 16, 1, _mono10),
            PixelFormat("Mono10p", 0x010A0046, 10, 4, _mono10p),
            PixelFormat("Mono10Packed", 0x010C0004, 12, 2, _packed),
            PixelFormat("Mono12", 0x01100005, 16, 1, _mono12),
            PixelFormat("Mono12p", 0x010C0047, 12, 2, _mono12p),
            PixelFormat("Mono12Packed", 0x010C0006, 12, 2, _packed),
        )
    }
)
"""Formats by their names; all other formats of cameras are colour, or no images."""
