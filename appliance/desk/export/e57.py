"""E57 files: metres, one entry a scan, with normals, sigma and further columns by extensions.

Normals are in the registered extension, the others in our own. Places are single-precision floats: 0.06 µm at 1 m. Each
scan is written about an origin of its own, with the transform into the file's frame as its pose in double: the scan's
pose in its object, or the middle of points far from their frame's origin. Readers without the extensions ignore them.
The file's GUID is made of its content, so that the same points give the same file. Sources: ASTM E2807-11; the extension
for surface normals is that of libe57.org. Written by libE57Format, which pye57 (MIT) brings.
"""

from __future__ import annotations

import uuid
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from appliance.base import needed
from appliance.desk.export.content import MM_PER_M, ExportedPoints, Metadata, finite, points_of_scan, scaled_to_mm
from appliance.desk.surface.fusion import PlacedScan
from appliance.store import LocalFileSystem

NORMALS = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
OWN = ("kf", "urn:kingfisher:e57:1")
"""Prefix and name of our extension: ``sigma``, the standard deviation of a point in metres, and further columns by
their names. Those in mm are without the unit and in metres, like all lengths in the file (``deviation_mm`` is
``kf:deviation``)."""
_MM = "_mm"
_AXES = ("X", "Y", "Z")
_GREY = (0.0, 255.0)
_INVALID = "cartesianInvalidState"


def write_points(path: Path, points: ExportedPoints, metadata: Metadata) -> None:
    """Write one scan or surface.

    Raises StorageError, ValueError for one without points, MissingLibraryError where pye57 is absent.
    """
    _replace(path, [(metadata.title, scaled_to_mm(points, metadata))], metadata)


def write_scans(path: Path, scans: Iterable[PlacedScan], metadata: Metadata) -> None:
    """Write an object's scans, each about its own origin, with its pose; one scan is held at a time.

    Raises the errors of ``write_points`` and ``scans``.
    """
    placed = (
        (scan.name, replace(points_of_scan(scan.cloud), origin_mm=scan.translation_mm, rotation=scan.rotation))
        for scan in scans
    )
    _replace(path, placed, metadata)


def _replace(path: Path, scans: Iterable[tuple[str, ExportedPoints]], metadata: Metadata) -> None:
    # The library needs a name to write to, and gets that of the draft.
    LocalFileSystem().replace_by(path, partial(_write, scans=scans, metadata=metadata))


def _write(path: Path, scans: Iterable[tuple[str, ExportedPoints]], metadata: Metadata) -> None:
    """Write the file at ``path`` with the metadata of all scans; each entry has them under its own title."""
    library = needed("pye57", "pye57", "an E57 file").libe57
    try:
        file = library.ImageFile(str(path), "w")
        try:
            entries = _begin(library, file)
            keys = [_add(library, file, entries, points, replace(metadata, title=title)) for title, points in scans]
            file.root().set("guid", library.StringNode(file, _guid(keys)))
        finally:
            file.close()
    except library.E57Exception as error:
        # The library's errors are no OSErrors, although most of them are a full disk.
        raise OSError(None, f"the E57 library could not write: {error}") from error


def _guid(keys: Sequence[str], part: str = "") -> str:
    of_all = uuid.uuid5(uuid.NAMESPACE_URL, "\n".join(keys))
    return f"{{{uuid.uuid5(of_all, part) if part else of_all}}}"


def _columns(points: ExportedPoints) -> dict[str, NDArray[Any]]:
    if not len(points.grey):
        raise ValueError("an E57 file needs at least one point of each scan")
    metres = (points.points_mm / np.float32(MM_PER_M)).astype(np.float32)
    normals = finite(points.normals)
    return {
        **{f"cartesian{axis}": metres[:, k] for k, axis in enumerate(_AXES)},
        # Mark every point as valid: some readers reject a file without that. A column that can only be 0 takes no room.
        _INVALID: np.zeros(len(metres), np.int8),
        "intensity": points.grey.astype(np.float32),
        **{f"nor:normal{axis}": normals[:, k] for k, axis in enumerate(_AXES)},
        f"{OWN[0]}:sigma": points.sigma_mm / np.float32(MM_PER_M),
        **dict(_column(name, values) for name, values in points.more.items()),
    }


def _column(name: str, values: NDArray[np.float32]) -> tuple[str, NDArray[np.float32]]:
    # The file has one unit: a reader cannot know which columns differ.
    in_metres = name.endswith(_MM)
    return f"{OWN[0]}:{name.removesuffix(_MM)}", values / np.float32(MM_PER_M) if in_metres else values


def _begin(library: Any, file: Any) -> Any:
    """Write all but the GUID and the scans; return the node for the scans."""
    file.extensionsAdd("", library.E57_V1_0_URI)
    file.extensionsAdd(*NORMALS)
    file.extensionsAdd(*OWN)
    root = file.root()
    root.set("formatName", library.StringNode(file, "ASTM E57 3D Imaging Data File"))
    root.set("versionMajor", library.IntegerNode(file, library.E57_FORMAT_MAJOR))
    root.set("versionMinor", library.IntegerNode(file, library.E57_FORMAT_MINOR))
    root.set("e57LibraryVersion", library.StringNode(file, library.E57_LIBRARY_ID))
    root.set("coordinateMetadata", library.StringNode(file, ""))
    scans = library.VectorNode(file, True)
    root.set("data3D", scans)
    root.set("images2D", library.VectorNode(file, True))
    return scans


def _add(library: Any, file: Any, scans: Any, points: ExportedPoints, metadata: Metadata) -> str:
    """Write one scan; return a text that differs for any other content."""

    def number(value: float) -> Any:
        return library.FloatNode(file, float(value))

    columns, lines = _columns(points), metadata.lines("metre")
    checksum = 0
    for values in columns.values():
        checksum = zlib.crc32(np.ascontiguousarray(values).tobytes(), checksum)
    key = f"{OWN[1]} {checksum:08x} {len(columns['intensity'])} {' '.join(lines)}"
    scan = library.StructureNode(file)
    scan.set("guid", library.StringNode(file, _guid([key], "scan")))
    scan.set("name", library.StringNode(file, metadata.title.encode("ascii", "replace").decode("ascii")))
    scan.set("description", library.StringNode(file, "; ".join(lines)))
    origin_m = points.origin_mm / MM_PER_M
    if origin_m.any() or not np.array_equal(points.rotation, np.eye(3)):
        pose, rotation, shift = (library.StructureNode(file) for _ in range(3))
        quaternion = Rotation.from_matrix(points.rotation).as_quat(canonical=True, scalar_first=True)
        for name, value in zip("wxyz", quaternion, strict=True):
            rotation.set(name, number(value))
        for name, value in zip("xyz", origin_m, strict=True):
            shift.set(name, number(value))
        scan.set("pose", pose)
        pose.set("rotation", rotation)
        pose.set("translation", shift)
        key += f" {quaternion.tolist()} {origin_m.tolist()}"
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
    live_columns = []
    for name, values in columns.items():
        flag = name == _INVALID
        prototype.set(
            name, library.IntegerNode(file, 0, 0, 0) if flag else library.FloatNode(file, 0.0, library.E57_SINGLE)
        )
        column = np.array(values, np.int8 if flag else np.float32)
        # The library holds a bare pointer: the array must live until the writer is closed.
        live_columns.append(column)
        buffers.append(library.SourceDestBuffer(file, name, column, len(column), True, True))
    vector = library.CompressedVectorNode(file, prototype, library.VectorNode(file, True))
    scan.set("points", vector)
    scans.append(scan)
    writer = vector.writer(buffers)
    writer.write(len(live_columns[0]))
    writer.close()
    return key
