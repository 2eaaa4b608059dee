"""Owns the matrices in a MATLAB file: the numeric arrays of its top level, versions 5 to 7.

scipy's reader ends the process on damaged files; this one reads what calibrations consist of and checks every length. Structures,
cells, texts and sparse arrays are passed over. Source: MAT-File Format, The MathWorks, chapter 1 (Level 5).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

HEADER_BYTES = 128
MOST_BYTES = 16_000_000
"""Largest array, and the largest that a compressed one may become."""
MOST_ELEMENTS = 10_000
_INT8, _UINT32, _INT32, _MATRIX, _COMPRESSED = 1, 6, 5, 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""NumPy's name of each storage type."""
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX, _CLASS = 0x0800, 0xFF


class MatlabError(ValueError):
    """The bytes are no MATLAB file of version 5 to 7, or are damaged."""


def matlab_arrays(raw: bytes) -> dict[str, NDArray[np.float64]]:
    """Return the real numeric arrays of two dimensions by name. Raises MatlabError."""
    if len(raw) < HEADER_BYTES or raw[126:128] not in (b"IM", b"MI"):
        raise MatlabError("it has no header of MATLAB 5 to 7 (7.3 is another format: save with -v7)")
    order = "<" if raw[126:128] == b"IM" else ">"
    found: dict[str, NDArray[np.float64]] = {}
    for kind, data in _elements(raw[HEADER_BYTES:], order):
        if kind == _COMPRESSED:
            for inner, content in _elements(_inflated(data), order):
                _add(found, inner, content, order)
        else:
            _add(found, kind, data, order)
    return found


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and bytes of each element; elements of up to four bytes have their size in the upper half of the type."""
    at = 0
    for _ in range(MOST_ELEMENTS):
        if at + 8 > len(data):
            return
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:
            kind, size, begin, step = kind & 0xFFFF, kind >> 16, at + 4, 8
            if size > 4:
                raise MatlabError(f"a small element has {size} bytes; allowed are 4")
        else:
            # All but compressed elements fill whole units of eight bytes.
            begin, step = at + 8, 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        if size > MOST_BYTES or begin + size > len(data):
            raise MatlabError(f"an element of {size} bytes ends behind the file")
        yield kind, data[begin : begin + size]
        at += step


def _inflated(data: bytes) -> bytes:
    try:
        unpacked = zlib.decompressobj().decompress(data, MOST_BYTES)
    except zlib.error as error:
        raise MatlabError(f"a compressed element is damaged ({error})") from error
    return unpacked


def _add(found: dict[str, NDArray[np.float64]], kind: int, data: bytes, order: str) -> None:
    """Add an array: elements for its flags, its sizes, its name and its real part, in that order."""
    if kind != _MATRIX:
        return
    parts = _elements(data, order)
    try:
        (flags_kind, flags), (sizes_kind, sizes), (name_kind, name), (numbers_kind, numbers) = (
            next(parts) for _ in range(4)
        )
    except (StopIteration, RuntimeError):
        return
    if (flags_kind, sizes_kind, name_kind) != (_UINT32, _INT32, _INT8) or len(flags) < 4 or len(sizes) != 8:
        return
    (flag,) = struct.unpack_from(f"{order}I", flags)
    if flag & _CLASS not in _NUMERIC_CLASSES or flag & _COMPLEX or numbers_kind not in _NUMBERS:
        return
    dtype = np.dtype(f"{order}{_NUMBERS[numbers_kind]}")
    rows, columns = struct.unpack(f"{order}ii", sizes)
    if rows < 0 or columns < 0 or rows * columns * dtype.itemsize != len(numbers):
        raise MatlabError(f"an array of {rows} x {columns} numbers has {len(numbers)} bytes")
    # Column by column.
    values = np.frombuffer(numbers, dtype).reshape(columns, rows).T
    found[name.decode("ascii", "replace")] = np.array(values, np.float64)
