"""Owns the export of one stored scan: its points or its mesh in a file for other programs, and the report of what is in
it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from appliance.base import Progress
from appliance.desk.export.content import CAMERA_FRAME, About
from appliance.desk.export.files import write_mesh, write_scan
from appliance.desk.export.formats import MESH_SUFFIXES, SCAN_SUFFIXES, checked_suffix
from appliance.desk.organised import organised_scan
from appliance.desk.surface.mesh import mesh_of_scan
from appliance.store import Chosen, SourceScan


def export_scan(
    source: SourceScan, chosen: Chosen, out: Path, progress: Progress, *, mesh: bool = False
) -> dict[str, Any]:
    """Write the points of a stored scan, or with ``mesh`` its triangles, to ``out``; the suffix says how.

    Raises ExportError for a suffix that is not allowed, MissingLibraryError, ScanError, StorageError.
    """
    suffix = checked_suffix(out, MESH_SUFFIXES if mesh else SCAN_SUFFIXES, "a mesh" if mesh else "a scan")
    made = organised_scan(source, chosen, progress)
    record, calibration = source.scan.manifest.record, chosen.calibration
    warnings = [f"{fault.code.value}: {fault.detail}" for fault in made.faults]
    about = About(
        title=f"scan {source.scan.manifest.scan_id}",
        frame=CAMERA_FRAME,
        notes=(
            f"calibration {calibration.hash[:12]} ({calibration.method}), water index {made.water.index:.5f}",
            f"recorded {record.wall_time or 'at an unknown time'}, software {record.software_version}",
            *(f"warning {warning}" for warning in warnings),
        ),
    )
    faces = None
    if mesh:
        progress("meshing")
        triangles = mesh_of_scan(made.cloud)
        points, faces = len(triangles.grey), len(triangles.faces)
        progress("writing")
        write_mesh(out, triangles, about)
    else:
        points = int(made.cloud.mask.sum())
        progress("writing")
        write_scan(out, made.cloud, about)
    return {
        "scan": source.scan.manifest.scan_id,
        "file": str(out),
        "format": suffix.removeprefix("."),
        "unit": "m" if suffix in (".e57", ".las") else "mm",
        "points": points,
        "faces": faces,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "water_index": made.water.index,
        "warnings": warnings,
    }
