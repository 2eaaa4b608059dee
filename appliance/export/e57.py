"""Owns the E57 file: metres, one scan entry, normals by the registered extension, sigma and further columns by one of our own.

Places are single-precision floats: 0.06 µm at 1 m. What lies far from its frame's origin is written about a local one, with the way there as the scan's
pose in double. Readers that know neither extension pass over both. The file's GUID is made of
its content, so that the same points give the same file.
Sources: ASTM E2807-11; the extension for surface normals is that of libe57.org. Written by libE57Format, which pye57 (MIT) brings.
"""

from __future__ import annotations

import uuid
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.export.content import MM_PER_M, About, ExportedPoints, finite
from appliance.surface.libraries import needed

NORMALS = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
OWN = ("kf", "urn:kingfisher:e57:1")
"""Prefix and name of our extension: ``sigma``, the standard deviation of a point in metres, and further columns by their names: those in mm without
it and in metres, like everything in the file (``deviation_mm`` is ``kf:deviation``)."""
_MM = "_mm"
_AXES = ("X", "Y", "Z")
_GREY = (0.0, 255.0)
_INVALID = "cartesianInvalidState"


def write_e57(path: Path, points: ExportedPoints, about: About) -> None:
    """Write the file at ``path``. Raises MissingLibraryError where pye57 is absent, ValueError for no points, OSError."""
    if not len(points.grey):
        raise ValueError("an E57 file needs at least one point")
    library = needed("pye57", "pye57", "an E57 file").libe57
    metres = (points.points_mm / np.float32(MM_PER_M)).astype(np.float32)
    known = finite(points.normals)
    columns: dict[str, NDArray[Any]] = {
        **{f"cartesian{axis}": metres[:, k] for k, axis in enumerate(_AXES)},
        # Every point is one: some readers refuse a file that does not say so. A column that can only be 0 takes no room.
        _INVALID: np.zeros(len(metres), np.int8),
        "intensity": points.grey.astype(np.float32),
        **{f"nor:normal{axis}": known[:, k] for k, axis in enumerate(_AXES)},
        f"{OWN[0]}:sigma": points.sigma_mm / np.float32(MM_PER_M),
        **dict(_further(name, values) for name, values in points.more.items()),
    }
    try:
        file = library.ImageFile(str(path), "w")
        try:
            _fill(library, file, columns, about, points.origin_mm / MM_PER_M)
        finally:
            file.close()
    except library.E57Exception as error:
        # Its own errors are no OSErrors, although a full disk is what most of them are.
        raise OSError(None, f"the E57 library could not write: {error}") from error


def _further(name: str, values: NDArray[np.float32]) -> tuple[str, NDArray[np.float32]]:
    # One unit in the whole file: a reader cannot know which columns differ.
    in_metres = name.endswith(_MM)
    return f"{OWN[0]}:{name.removesuffix(_MM)}", values / np.float32(MM_PER_M) if in_metres else values


def _fill(
    library: Any, file: Any, columns: dict[str, NDArray[Any]], about: About, origin_m: NDArray[np.float64]
) -> None:
    def text(value: str) -> Any:
        return library.StringNode(file, value)

    def number(value: float) -> Any:
        return library.FloatNode(file, float(value))

    lines = about.lines("metre")
    checksum = 0
    for values in columns.values():
        checksum = zlib.crc32(np.ascontiguousarray(values).tobytes(), checksum)
    guid = uuid.uuid5(uuid.NAMESPACE_URL, f"{OWN[1]} {checksum:08x} {len(columns['intensity'])} {' '.join(lines)}")
    file.extensionsAdd("", library.E57_V1_0_URI)
    file.extensionsAdd(*NORMALS)
    file.extensionsAdd(*OWN)
    root = file.root()
    root.set("formatName", text("ASTM E57 3D Imaging Data File"))
    root.set("guid", text(f"{{{guid}}}"))
    root.set("versionMajor", library.IntegerNode(file, library.E57_FORMAT_MAJOR))
    root.set("versionMinor", library.IntegerNode(file, library.E57_FORMAT_MINOR))
    root.set("e57LibraryVersion", text(library.E57_LIBRARY_ID))
    root.set("coordinateMetadata", text(""))
    scans = library.VectorNode(file, True)
    root.set("data3D", scans)
    root.set("images2D", library.VectorNode(file, True))

    scan = library.StructureNode(file)
    scan.set("guid", text(f"{{{uuid.uuid5(guid, 'scan')}}}"))
    scan.set("name", text(about.title.encode("ascii", "replace").decode("ascii")))
    scan.set("description", text("; ".join(lines)))
    if origin_m.any():
        pose, turn, shift = (library.StructureNode(file) for _ in range(3))
        for name, value in zip("wxyz", (1.0, 0.0, 0.0, 0.0), strict=True):
            turn.set(name, number(value))
        for name, value in zip("xyz", origin_m, strict=True):
            shift.set(name, number(value))
        scan.set("pose", pose)
        pose.set("rotation", turn)
        pose.set("translation", shift)
    bounds = library.StructureNode(file)
    for axis in _AXES:
        values = columns[f"cartesian{axis}"]
        bounds.set(f"{axis.lower()}Minimum", number(values.min()))
        bounds.set(f"{axis.lower()}Maximum", number(values.max()))
    scan.set("cartesianBounds", bounds)
    limits = library.StructureNode(file)
    for name, value in zip(("intensityMinimum", "intensityMaximum"), _GREY, strict=True):
        limits.set(name, number(value))
    scan.set("intensityLimits", limits)

    prototype = library.StructureNode(file)
    buffers = library.VectorSourceDestBuffer()
    kept = []
    for name, values in columns.items():
        flag = name == _INVALID
        prototype.set(
            name, library.IntegerNode(file, 0, 0, 0) if flag else library.FloatNode(file, 0.0, library.E57_SINGLE)
        )
        column = np.array(values, np.int8 if flag else np.float32)
        # The library keeps a bare pointer: the array must live until the writer is closed.
        kept.append(column)
        buffers.append(library.SourceDestBuffer(file, name, column, len(column), True, True))
    vector = library.CompressedVectorNode(file, prototype, library.VectorNode(file, True))
    scan.set("points", vector)
    scans.append(scan)
    writer = vector.writer(buffers)
    writer.write(len(kept[0]))
    writer.close()
