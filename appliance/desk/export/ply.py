"""PLY files of fused surfaces and of meshes: normals, grey as colour, sigma, and faces of a mesh.

Binary little-endian, mm. A raw scan has a PLY file of its own (``appliance.store.ply``), with a checksum and without
normals. Source: G. Turk, "The PLY Polygon File Format" (1994); names of properties as MeshLab and CloudCompare read
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import ExportedPoints, Metadata, finite, points_of_mesh, single_precision
from appliance.desk.surface.mesh import Mesh
from appliance.store import LocalFileSystem

_FIXED = (
    ("x", "<f4", "float"),
    ("y", "<f4", "float"),
    ("z", "<f4", "float"),
    ("nx", "<f4", "float"),
    ("ny", "<f4", "float"),
    ("nz", "<f4", "float"),
    ("red", "u1", "uchar"),
    ("green", "u1", "uchar"),
    ("blue", "u1", "uchar"),
    ("sigma", "<f4", "float"),
)
_AT_ONCE = 1 << 16
"""Vertices that are encoded together."""
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_points(path: Path, points: ExportedPoints, metadata: Metadata) -> None:
    """Write points alone. Raises StorageError, ExportError."""
    LocalFileSystem().replace_parts(path, encode_surface(points, metadata))


def write_mesh(path: Path, mesh: Mesh, metadata: Metadata) -> None:
    """Write a mesh. Raises StorageError, ExportError."""
    LocalFileSystem().replace_file(path, *encode_surface(points_of_mesh(mesh), metadata, mesh.faces))


def encode_surface(
    points: ExportedPoints, metadata: Metadata, faces: NDArray[np.int32] | None = None
) -> Iterator[bytes]:
    """Return header, vertices and faces ((m, 3) int32; ``None``: points alone).

    Unknown normals are (0, 0, 0). Vertices are encoded on demand: all of a large cloud need much memory.
    """
    n, coordinates_mm = len(points.grey), single_precision(points, "PLY")
    columns = [*_FIXED, *((name, "<f4", "float") for name in points.more)]
    kinds = np.dtype([(name, kind) for name, kind, _ in columns])

    def encoded(part: slice) -> bytes:
        rows, normals = np.empty(len(points.grey[part]), kinds), finite(points.normals[part])
        for axis in range(3):
            rows["xyz"[axis]] = coordinates_mm[part, axis]
            rows[f"n{'xyz'[axis]}"] = normals[:, axis]
        for name in ("red", "green", "blue"):
            rows[name] = points.grey[part]
        rows["sigma"] = points.sigma_mm[part]
        for name, values in points.more.items():
            rows[name] = values[part]
        return rows.tobytes()

    header = ["ply", "format binary_little_endian 1.0"]
    marks = metadata.mark_lines()
    # Marks stand as in the instrument's own clouds, behind "comment" alone: one reader knows both.
    header += [f"comment {'' if line in marks else 'Kingfisher '}{line}" for line in metadata.lines("mm")]
    header += [f"comment sigma: standard deviation in {metadata.unit or 'mm'}", f"element vertex {n}"]
    header += [f"property {word} {name}" for name, _, word in columns]
    triangles = np.zeros(0 if faces is None else len(faces), _FACE)
    if faces is not None:
        triangles["count"], triangles["corners"] = 3, faces
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["end_header", ""]
    vertices = (encoded(slice(begin, begin + _AT_ONCE)) for begin in range(0, n, _AT_ONCE))
    return chain(["\n".join(header).encode("ascii")], vertices, [triangles.tobytes()])
