"""Owns how points and meshes become files, by their suffix, each whole or not at all."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import (
    MM_PER_M,
    About,
    ExportedPoints,
    points_of_mesh,
    points_of_scan,
    points_of_surface,
)
from appliance.desk.export.e57 import E57Scan, write_e57
from appliance.desk.export.las import encode_las
from appliance.desk.export.npz import encode_npz
from appliance.desk.export.ply import encode_surface
from appliance.desk.export.suffixes import MESH_SUFFIXES, SCAN_SUFFIXES, SURFACE_SUFFIXES, checked_suffix
from appliance.desk.export.triangles import encode_obj, encode_stl
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.mesh import Mesh
from appliance.measure import OrganisedCloud
from appliance.store import LocalFileSystem, replace_by, replace_file, replace_parts


def write_scan(path: Path, cloud: OrganisedCloud, about: About) -> None:
    """Write the points of one scan; the suffix says how (``SCAN_SUFFIXES``). Raises ExportError, StorageError,
    ValueError, and MissingLibraryError where the format's library is absent."""
    if checked_suffix(path, SCAN_SUFFIXES, "a scan") == ".npz":
        replace_file(LocalFileSystem(), path, encode_npz(cloud, about))
        return
    points = points_of_scan(cloud, about.unit or "mm")
    if about.unit and path.suffix.lower() in (".e57", ".las"):
        # These divide by 1000 for their metres: without a scale, numbers are as they are.
        points = replace(
            points, points_mm=points.points_mm * np.float32(MM_PER_M), sigma_mm=points.sigma_mm * np.float32(MM_PER_M)
        )
    _write_points(path, points, about)


def write_surface(
    path: Path,
    cloud: FusedCloud,
    about: About,
    deviation_mm: NDArray[np.float32] | None = None,
    origin_mm: NDArray[np.float64] | None = None,
) -> None:
    """Write the points of a fused surface (``SURFACE_SUFFIXES``), with ``deviation_mm`` (n,) as a further column where it is given.
    ``origin_mm`` (3,): place of their (0, 0, 0) in the frame of the file.

    Raises ExportError, StorageError, ValueError, and MissingLibraryError where the format's library is absent.
    """
    checked_suffix(path, SURFACE_SUFFIXES, "a surface of points")
    points = points_of_surface(cloud, origin_mm)
    if deviation_mm is not None:
        points = replace(points, more={**points.more, "deviation_mm": deviation_mm})
    _write_points(path, points, about)


def write_mesh(path: Path, mesh: Mesh, about: About) -> None:
    """Write a mesh (``MESH_SUFFIXES``). Raises ExportError, StorageError,
    ValueError, and MissingLibraryError where the format's library is absent."""
    match checked_suffix(path, MESH_SUFFIXES, "a mesh"):
        case ".ply":
            parts = list(encode_surface(points_of_mesh(mesh), about, mesh.faces))
        case ".stl":
            parts = list(encode_stl(mesh, about))
        case _:
            parts = encode_obj(mesh, about)
    replace_file(LocalFileSystem(), path, *parts)


def _write_points(path: Path, points: ExportedPoints, about: About) -> None:
    match path.suffix.lower():
        case ".e57":
            # The library wants a name to write to, and gets that of the draft.
            replace_by(LocalFileSystem(), path, partial(write_e57, scans=[E57Scan(points, about.title)], about=about))
        case ".las":
            replace_file(LocalFileSystem(), path, encode_las(points, about))
        case _:
            replace_parts(LocalFileSystem(), path, encode_surface(points, about))
