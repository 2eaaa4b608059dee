"""Writing of points and meshes to files in the format of their suffix, each complete or not at all."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import Metadata, points_of_scan, points_of_surface
from appliance.desk.export.formats import (
    FORMATS,
    MESH_SUFFIXES,
    OBJECT_SCANS_SUFFIXES,
    SCAN_SUFFIXES,
    SURFACE_SUFFIXES,
    check_suffix,
)
from appliance.desk.surface.fusion import FusedCloud, PlacedScan
from appliance.desk.surface.mesh import Mesh
from appliance.measure import OrganisedCloud


def write_scan(path: Path, cloud: OrganisedCloud, metadata: Metadata) -> None:
    """Write the points of one scan in the format of the suffix (``SCAN_SUFFIXES``).

    Raises ExportError, StorageError, ValueError, and MissingLibraryError where the format's library is absent.
    """
    suffix = check_suffix(path, SCAN_SUFFIXES, "a scan")
    if any(row.suffix == suffix and "grid" in row.contents for row in FORMATS):
        _writer(suffix, "grid")(path, cloud, metadata)
    else:
        _writer(suffix, "points")(path, points_of_scan(cloud, metadata.unit or "mm"), metadata)


def write_surface(
    path: Path,
    cloud: FusedCloud,
    metadata: Metadata,
    deviation_mm: NDArray[np.float32] | None = None,
    origin_mm: NDArray[np.float64] | None = None,
) -> None:
    """Write the points of a fused surface (``SURFACE_SUFFIXES``), with ``deviation_mm`` (n,) as a column.

    ``origin_mm`` (3,): place of their (0, 0, 0) in the frame of the file. Raises ExportError, StorageError, ValueError, and
    MissingLibraryError where the format's library is absent.
    """
    suffix = check_suffix(path, SURFACE_SUFFIXES, "a surface of points")
    points = points_of_surface(cloud, origin_mm)
    if deviation_mm is not None:
        points = replace(points, more={**points.more, "deviation_mm": deviation_mm})
    _writer(suffix, "points")(path, points, metadata)


def write_scans(path: Path, scans: Iterable[PlacedScan], metadata: Metadata) -> None:
    """Write the single scans of an object, unmoved, with their poses (``OBJECT_SCANS_SUFFIXES``).

    One scan is held at a time. Raises ExportError, StorageError, MissingLibraryError where the format's library is absent,
    and the errors of ``scans``.
    """
    _writer(check_suffix(path, OBJECT_SCANS_SUFFIXES, "the scans of an object"), "scans")(path, scans, metadata)


def write_mesh(path: Path, mesh: Mesh, metadata: Metadata) -> None:
    """Write a mesh (``MESH_SUFFIXES``).

    Raises ExportError, StorageError, ValueError, and MissingLibraryError where the format's library is absent.
    """
    _writer(check_suffix(path, MESH_SUFFIXES, "a mesh"), "mesh")(path, mesh, metadata)


def _writer(suffix: str, content: str) -> Callable[[Path, Any, Metadata], None]:
    """Return the function of the format's module."""
    module = next(row.module for row in FORMATS if row.suffix == suffix)
    writer: Callable[[Path, Any, Metadata], None] = getattr(
        importlib.import_module(f"appliance.desk.export.{module}"), f"write_{content}"
    )
    return writer
