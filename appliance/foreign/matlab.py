"""Owns the matrices in a MATLAB file: the numeric arrays of its top level and of its structures, versions 5 to 7.

scipy's reader ends the process on damaged files; this one reads what calibrations consist of and checks every length. Cells, texts and
sparse arrays are passed over, of an array of structures all but the first; objects are refused, since only MATLAB knows what is in them. Source: MAT-File Format, The MathWorks, chapter 1 (Level 5).
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
_STRUCTURE, _OPAQUE = 2, 17
"""Classes of a structure, and of an object of MATLAB's own."""
MOST_DEEP = 6
"""Most levels of structures in one another."""
MOST_FIELD_CHARACTERS = 256
_COMPLEX, _CLASS = 0x0800, 0xFF


class MatlabError(ValueError):
    """The bytes are no MATLAB file of version 5 to 7, or are damaged."""


def matlab_arrays(raw: bytes) -> dict[str, NDArray[np.float64]]:
    """Return the real numeric arrays of two dimensions by name; those of structures as STRUCTURE.FIELD. Raises MatlabError."""
    if len(raw) < HEADER_BYTES or raw[126:128] not in (b"IM", b"MI"):
        raise MatlabError("it has no header of MATLAB 5 to 7 (7.3 is another format: save with -v7)")
    order = "<" if raw[126:128] == b"IM" else ">"
    found: dict[str, NDArray[np.float64]] = {}
    objects = 0
    for kind, data in _elements(raw[HEADER_BYTES:], order):
        elements = _elements(_inflated(data), order) if kind == _COMPRESSED else iter([(kind, data)])
        for inner, content in elements:
            objects += _add(found, inner, content, order, "", 0)
    if objects and not any(numbers.size >= 9 for numbers in found.values()):
        raise MatlabError(
            "it holds an object, which only MATLAB reads: save it as a structure, s = toStruct(stereoParams); save('stereo.mat', 's', '-v7')"
        )
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


def _add(
    found: dict[str, NDArray[np.float64]],
    kind: int,
    data: bytes,
    order: str,
    before: str,
    depth: int,
    named: str | None = None,
) -> int:
    """Add an array: elements for its flags, its sizes, its name and its real part or its fields, in that order.

    ``named``: as a field of a structure, whose name is not its own. Returns the number of objects of MATLAB's own that it is or holds.
    """
    if kind != _MATRIX:
        return 0
    parts = list(_elements(data, order))
    if not parts or parts[0][0] != _UINT32 or len(parts[0][1]) < 4:
        return 0
    (flag,) = struct.unpack_from(f"{order}I", parts[0][1])
    if flag & _CLASS == _OPAQUE:
        return 1
    if len(parts) < 4:
        return 0
    (sizes_kind, sizes), (name_kind, name), (numbers_kind, numbers) = parts[1:4]
    if (sizes_kind, name_kind) != (_INT32, _INT8) or len(sizes) != 8:
        return 0
    called = f"{before}{named if named is not None else name.decode('ascii', 'replace')}"
    if flag & _CLASS == _STRUCTURE and depth < MOST_DEEP:
        return _add_fields(found, parts[3:], order, called, depth)
    if flag & _CLASS not in _NUMERIC_CLASSES or flag & _COMPLEX or numbers_kind not in _NUMBERS:
        return 0
    dtype = np.dtype(f"{order}{_NUMBERS[numbers_kind]}")
    rows, columns = struct.unpack(f"{order}ii", sizes)
    if rows < 0 or columns < 0 or rows * columns * dtype.itemsize != len(numbers):
        raise MatlabError(f"an array of {rows} x {columns} numbers has {len(numbers)} bytes")
    # Column by column.
    values = np.frombuffer(numbers, dtype).reshape(columns, rows).T
    found[called] = np.array(values, np.float64)
    return 0


def _add_fields(
    found: dict[str, NDArray[np.float64]], parts: list[tuple[int, bytes]], order: str, called: str, depth: int
) -> int:
    """Add the fields of a structure: ``parts`` are the length of a field's name, all names, and an array for each."""
    if len(parts) < 2 or parts[0][0] != _INT32 or len(parts[0][1]) != 4 or parts[1][0] != _INT8:
        return 0
    (length,) = struct.unpack(f"{order}i", parts[0][1])
    names = parts[1][1]
    if not 1 <= length <= MOST_FIELD_CHARACTERS or len(names) % length:
        raise MatlabError(f"names of fields have {length} characters each, and {len(names)} together")
    fields = [
        names[k : k + length].partition(b"\0")[0].decode("ascii", "replace") for k in range(0, len(names), length)
    ]
    # Of several structures in an array the first one's fields come first.
    return sum(
        _add(found, kind, data, order, f"{called}.", depth + 1, field)
        for field, (kind, data) in zip(fields, parts[2:], strict=False)
    )
