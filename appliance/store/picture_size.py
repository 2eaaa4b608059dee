"""Owns how large and how deep a picture says it is, read from the first bytes of its file, before anything is decoded.

A file of some kilobytes can promise thousands of millions of pixels, which a decoder would make room for. Formats: PNG
(ISO/IEC 15948, IHDR), JPEG (ITU-T T.81, SOF), TIFF 6.0 (first directory), BMP (BITMAPINFOHEADER and BITMAPCOREHEADER),
PGM and PPM (Netpbm).
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
"""Most entries of a TIFF directory: real ones have some twenty."""

Head = tuple[int, int, int]
"""Width, height, and bits of a grey value."""


def picture_head(data: bytes | mmap) -> Head | None:
    """Return width, height and bits that the header states; ``None`` for a damaged header or a format that is not read
    here."""
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
    found = _NETPBM.match(data[:4096])
    return (int(found[1]), int(found[2]), 8 if int(found[3]) < 256 else 16) if found else None


def _tiff(data: bytes | mmap, order: str) -> Head | None:
    # The offset of the first directory: a count, then entries of 12 bytes.
    (at,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, at)
    found = {_BITS: 1}
    for entry in range(min(count, _MOST_ENTRIES)):
        here = at + 2 + 12 * entry
        tag, kind, values = struct.unpack_from(order + "HHI", data, here)
        if tag in (_WIDTH, _HEIGHT, _BITS) and kind in (_SHORT, _LONG):
            # The bits of three colours do not fit, and lie elsewhere.
            place = struct.unpack_from(order + "I", data, here + 8)[0] if tag == _BITS and values > 2 else here + 8
            (found[tag],) = struct.unpack_from(order + ("H" if kind == _SHORT else "I"), data, place)
    return (found[_WIDTH], found[_HEIGHT], found[_BITS]) if len(found) == 3 else None


def _jpeg(data: bytes | mmap) -> Head | None:
    at = 2
    while True:  # to where the data end, which raises
        lead, marker = struct.unpack_from("BB", data, at)
        if lead != 0xFF:
            return None
        if marker in _START_OF_FRAME:
            bits, height_px, width_px = struct.unpack_from(">BHH", data, at + 4)
            return width_px, height_px, bits
        if marker == 0xFF:
            at += 1  # filling
        elif marker in _WITHOUT_LENGTH:
            at += 2
        else:
            # The length counts its own two bytes; at least those are skipped, so that a damaged 0 does not loop for
            # ever.
            at += 2 + max(struct.unpack_from(">H", data, at + 2)[0], 2)
