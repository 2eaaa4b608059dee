"""Reading of CAD models: triangles of STL, OBJ and PLY files, if sizes, counts and numbers agree.

STL is read here, since programs write it in ways that no library sorts out: names in any encoding, `end solid` in two
words, CR alone as the end of a line, bytes behind the last triangle, a binary file that begins with ``solid``.
Unambiguous files are read; files that are cut off or miscounted are rejected with both counts. OBJ and PLY are read
by trimesh (MIT) once their heads are checked. Sources: 3D Systems, "StereoLithography Interface Specification" (1989);
G. Turk, "The PLY Polygon File Format" (1994); Wavefront, "Object Files (.obj)".
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import needed, read_bounded
from appliance.desk.surface.drawing_file import MAX_BYTES, NominalError, check_drawing

FARTHEST_MM = 1e11
"""Largest coordinate: 100,000 km holds every place on Earth in any system."""
COARSEST_MM = 0.05
"""Coarsest step of a corner's coordinates: half of the least tolerance in practice."""

_STL_HEAD, _FACET = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_WORDS = re.compile(rb"(?i)\bvertex((?:[ \t\r\n]+[^ \t\r\n]+){3})")
_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def read_triangles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return corners (v, 3), as the file has them, and triangles (m, 3).

    Raises NominalError, and MissingLibraryError where trimesh is absent.
    """
    suffix = check_drawing(path)
    if suffix != ".stl":
        trimesh = needed("trimesh", "trimesh", f"a CAD model in {suffix}")
    try:
        data = read_bounded(path, MAX_BYTES)
        if suffix == ".stl":
            vertices, faces, single = _stl(data)
        else:
            single = _check_ply(data) if suffix == ".ply" else _check_obj(data)
            if suffix == ".ply":
                data = _with_line_feeds(data)
            vertices, faces = _by_library(trimesh, data, suffix)
        return _check_triangles(vertices, faces, single)
    except OSError as error:
        raise NominalError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise NominalError(f"{path}: {error}; give an STL, OBJ or PLY file in mm") from error


# ------------------------------------------------------------------------------------------------ STL


def _stl(data: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64], bool]:
    corners, single = _binary_stl(data)
    if corners is None:
        corners, single = _ascii_stl(data), False
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), single


def _binary_stl(data: bytes) -> tuple[NDArray[np.float64] | None, bool]:
    """Return the corners (m, 3, 3) of a binary file; ``None`` for a text file.

    Raises ValueError for fewer triangles than it states.
    """
    is_solid = data[:_STL_HEAD].lstrip().lower().startswith(b"solid")
    stated = int.from_bytes(data[80:_STL_HEAD], "little") if len(data) >= _STL_HEAD else -1
    present = max(0, len(data) - _STL_HEAD) // _FACET.itemsize
    # Many binary files begin with "solid", too: their length fits, or they have bytes that no text has.
    if is_solid and stated != present and (b"facet" in data[:4096].lower() or b"\0" not in data[:_STL_HEAD]):
        return None, False
    if stated < 0:
        raise ValueError(f"holds no triangles: it ends within the head of an STL file ({len(data)} bytes)")
    if stated > present:
        raise ValueError(f"is cut off: {present:,} of {stated:,} triangles are there")
    if stated == 0:
        raise ValueError("holds no triangles: its header says 0")
    facets = np.frombuffer(data, _FACET, stated, _STL_HEAD)
    remaining_bytes = len(data) - _STL_HEAD - stated * _FACET.itemsize
    # One triangle more means a wrong count; other bytes behind the last are an addition of another program.
    if (
        remaining_bytes >= _FACET.itemsize
        and remaining_bytes % _FACET.itemsize == 0
        and np.any(np.frombuffer(data, np.uint8)[-remaining_bytes:])
    ):
        raise ValueError(f"states {stated:,} triangles, and {present:,} are there: correct the file")
    return facets["corners"].astype(np.float64), True


def _ascii_stl(data: bytes) -> NDArray[np.float64]:
    """Return the corners (m, 3, 3) of a text file."""
    try:
        numbers = np.array([corner.split() for corner in _WORDS.findall(data)], dtype="S40").astype(np.float64)
    except ValueError as error:
        raise ValueError(f"a vertex is not three numbers ({error})") from error
    stated = len(re.findall(rb"(?i)\bendfacet\b|\bend[ \t]+facet\b", data))
    if not len(numbers):
        raise ValueError("holds no triangles: it has no vertices")
    if len(numbers) % 3 or stated != len(numbers) // 3 or not re.search(rb"(?i)\bend[ \t]*solid\b", data[-4096:]):
        raise ValueError(
            f"is cut off: {len(numbers)} vertices, {stated} whole triangles, and no matching end of the solid"
        )
    return numbers.reshape(-1, 3, 3)


# ------------------------------------------------------------------------------------------------ PLY and OBJ


def _with_line_feeds(data: bytes) -> bytes:
    """Return a PLY file with LF as line end of its head, as the library needs.

    Some programs write CR alone.
    """
    end = data.find(b"end_header")
    head = data[:end]
    if b"\n" in head or b"\r" not in head:
        return data
    tail = data[end + len(b"end_header") :]
    body = tail[1:] if tail[:1] == b"\r" else tail
    body = body.replace(b"\r", b"\n") if b"format ascii" in head else body
    return head.replace(b"\r", b"\n") + b"end_header\n" + body


def _check_ply(data: bytes) -> bool:
    """Return whether a PLY file has its corners in single precision.

    Raises ValueError if head and bytes disagree.
    """
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("holds no triangles: it has no PLY head")
    min_bytes, single, element, text = 0, True, "", b"format ascii" in data[:end]
    for line in re.split(rb"[\r\n]+", data[:end]):
        fields = line.decode("ascii", "replace").split()
        match fields:
            case ["element", name, count] if count.isascii() and count.isdigit():
                element, number = name, int(count)
            case ["element", *_]:
                raise ValueError(f"its header says {line.decode('ascii', 'replace')!r}, which is no count")
            case ["property", "list", count_type, _, name]:
                if element == "vertex":
                    raise ValueError(
                        f"its vertices have a list ({name}), which may vary in length and is not supported: write "
                        "the file without it"
                    )
                min_bytes += number * (2 if text else _PLY_BYTES.get(count_type, 1))
            case ["property", kind, name]:
                min_bytes += number * (2 if text else _PLY_BYTES.get(kind, 1))
                single &= not (element == "vertex" and name == "x" and _PLY_BYTES.get(kind) == 8)
            case _:
                # Comments, the format, and lines for the library.
                continue
    # Digits and a blank are two bytes at least; the last blank may be missing.
    if min_bytes > len(data) - end:
        raise ValueError(f"is cut off: its head asks for {min_bytes:,} bytes at least, {len(data) - end:,} are there")
    return single and not text


def _check_obj(data: bytes) -> bool:
    """Return False, as text has no single precision. Raises ValueError for indices of missing corners."""
    corners = len(re.findall(rb"(?m)^[ \t]*v[ \t]", data))
    for line in re.finditer(rb"(?m)^[ \t]*f[ \t]+([^\r\n]*)", data):
        for word in line[1].split():
            index = word.split(b"/")[0]
            if (
                index == b"0"
                or (index.isdigit() and int(index[:12]) > corners)
                or (index[:1] == b"-" and index[1:].isdigit() and int(index[1:13]) > corners)
            ):
                raise ValueError(
                    f"a face names vertex {index.decode('ascii', 'replace')[:20]} of {corners}: OBJ counts from 1; was "
                    "it written from 0?"
                )
    return False


def _by_library(trimesh: Any, data: bytes, suffix: str) -> tuple[NDArray[Any], NDArray[Any]]:
    try:
        read = trimesh.load(io.BytesIO(data), file_type=suffix[1:], force="mesh", process=False)
        return read.vertices, read.faces
    # The parser raises any kind of error for bytes that are no mesh.
    except Exception as error:
        raise ValueError(f"holds no triangles that can be used ({type(error).__name__})") from error


def _check_triangles(
    vertices: NDArray[Any], faces: NDArray[Any], single: bool
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return corners and triangles, checked. Raises ValueError for numbers that are no place."""
    corners, triangles = np.asarray(vertices, np.float64).reshape(-1, 3), np.asarray(faces, np.int64).reshape(-1, 3)
    if not len(triangles):
        raise ValueError("holds no triangles")
    if triangles.min() < 0 or triangles.max() >= len(corners):
        raise ValueError(f"a triangle names a vertex beyond its {len(corners):,}")
    used = corners[triangles]
    wrong = ~(np.isfinite(used) & (np.abs(used) <= FARTHEST_MM)).all(axis=(1, 2))
    if wrong.any():
        first = int(np.flatnonzero(wrong)[0])
        raise ValueError(
            f"{int(wrong.sum()):,} of {len(triangles):,} triangles have a vertex that is not finite or beyond "
            f"{FARTHEST_MM:g} mm (the first: "
            f"triangle {first + 1}, {used[first].tolist()})"
        )
    step_mm = float(np.spacing(np.float32(np.abs(used).max()))) if single else 0.0
    if step_mm > COARSEST_MM:
        raise ValueError(
            f"its vertices lie up to {np.abs(used).max() / 1000.0:,.0f} m from the origin, where single precision has "
            f"steps of {step_mm:g} mm: "
            "move it to the origin in the CAD program, or write a PLY with double"
        )
    return corners, triangles
