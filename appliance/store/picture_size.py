"""Reading the size and depth of an image from the first bytes of its file, before it is decoded.

A file of some kilobytes can promise thousands of millions of pixels, for which a decoder would allocate memory.
Formats: PNG (ISO/IEC 15948, IHDR), JPEG (ITU-T T.81, SOF), TIFF 6.0 (first directory), BMP (BITMAPINFOHEADER and
BITMAPCOREHEADER), PGM and PPM (Netpbm).
"""

from __future__ import annotations

import re
import struct
from mmap import mmap

KNOWN = "PNG, TIFF, BMP, PGM or JPEG"
_NETPBM = re.compile(rb"P[2356](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,5})\s")
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_WITHOUT_LENGTH = frozenset((0x01, *range(0xD0, 0xD9)))
_WIDTH, _HEIGHT, _BITS, _SHORT, _LONG = 256, 257, 258, 3, 4
_MOST_ENTRIES = 1000
"""Largest number of entries of a TIFF directory: real ones have some twenty."""

Head = tuple[int, int, int]
"""Width, height, and bits of a grey value."""


def picture_head(data: bytes | mmap) -> Head | None:
    """Return width, height and bits that the header states.

    They are ``None`` for a damaged header or another format.
    """
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n" and data[12:16] == b"IHDR":
            width_px, height_px, bits = struct.unpack_from(">IIB", data, 16)
            return width_px, height_px, bits
        if data[:2] == b"BM":
            old = struct.unpack_from("<I", data, 14) == (12,)
            width_px, height_px = struct.unpack_from("<HH" if old else "<ii", data, 18)
            return width_px, abs(height_px), 8  # negative: the first row is the upper one
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff(data, "<" if data[:1] == b"I" else ">")
        if data[:3] == b"\xff\xd8\xff":
            return _jpeg(data)
    except struct.error:
        return None  # shorter than its own header
    match = _NETPBM.match(data[:4096])
    return (int(match[1]), int(match[2]), 8 if int(match[3]) < 256 else 16) if match else None


def _tiff(data: bytes | mmap, order: str) -> Head | None:
    # The offset of the first directory: a count, then entries of 12 bytes.
    (start,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, start)
    values_by_tag = {_BITS: 1}
    for entry in range(min(count, _MOST_ENTRIES)):
        start_of_entry = start + 2 + 12 * entry
        tag, kind, count_of_values = struct.unpack_from(order + "HHI", data, start_of_entry)
        if tag in (_WIDTH, _HEIGHT, _BITS) and kind in (_SHORT, _LONG):
            # The bits of three colours do not fit into the entry, which has their offset instead.
            place = (
                struct.unpack_from(order + "I", data, start_of_entry + 8)[0]
                if tag == _BITS and count_of_values > 2
                else start_of_entry + 8
            )
            (values_by_tag[tag],) = struct.unpack_from(order + ("H" if kind == _SHORT else "I"), data, place)
    return (values_by_tag[_WIDTH], values_by_tag[_HEIGHT], values_by_tag[_BITS]) if len(values_by_tag) == 3 else None


def _jpeg(data: bytes | mmap) -> Head | None:
    position = 2
    while True:  # ends at the end of the data, which raises
        lead, marker = struct.unpack_from("BB", data, position)
        if lead != 0xFF:
            return None
        if marker in _START_OF_FRAME:
            bits, height_px, width_px = struct.unpack_from(">BHH", data, position + 4)
            return width_px, height_px, bits
        if marker == 0xFF:
            position += 1  # filling
        elif marker in _WITHOUT_LENGTH:
            position += 2
        else:
            # The length counts its own two bytes; at least those are skipped, so that a damaged 0 does not loop for
            # ever.
            position += 2 + max(struct.unpack_from(">H", data, position + 2)[0], 2)
