"""Files and reports of clouds: of a stored scan, of a bracket, of an incomplete scan, of an object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from appliance.base import Progress
from appliance.desk.export.content import CAMERA_FRAME, Metadata
from appliance.desk.export.files import write_mesh, write_scan, write_scans, write_surface
from appliance.desk.export.formats import (
    MESH_SUFFIXES,
    OBJECT_SCANS_SUFFIXES,
    SCAN_SUFFIXES,
    SURFACE_SUFFIXES,
    check_suffix,
    has_triangles,
)
from appliance.desk.merging import merge_scans
from appliance.desk.object_store import StoredObject
from appliance.desk.objects import metadata_of_object, placed_scans, surface_of
from appliance.desk.organised import organised_scan
from appliance.desk.reconstruct import reconstruct_scan
from appliance.desk.rescue import rescue_recording
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.mesh import Mesh, mesh_of_scan
from appliance.desk.surface.object_mesh import VOXEL_MM, mesh_of_surface
from appliance.store import ChosenCalibration, IncompleteRecording, SalvagedScan, ScanOptions, SourceScan


def write_cloud(
    folders: Sequence[Path], out: Path, options: ScanOptions, progress: Progress, *, own_form: bool, mesh: bool
) -> dict[str, Any]:
    """Write the cloud of a stored scan, of two as one, or of an incomplete scan, and return the report.

    ``own_form``: in the instrument's own format, the only one of the last two; of a damaged scan it states the made-up
    frames. ``mesh``: triangles instead of points. Raises ScanError, CalibrationError, ExportError, StorageError,
    MissingLibraryError.
    """
    folder = folders[0]
    if IncompleteRecording.is_in(folder):
        recording = IncompleteRecording.load(folder)
        source = SourceScan.open(folder, options, recording.scan)
        return rescue_recording(recording, source, source.calibration_for(options), out, progress)
    if own_form and len(folders) == 1:
        salvaged = SalvagedScan.of(folder)
        source = SourceScan.open(folder, options, salvaged.scan)
        return reconstruct_scan(source, source.calibration_for(options), out, progress, salvaged)
    sources = [SourceScan.open(path, options, whole=True) for path in folders]
    if len(sources) == 1:
        return _export(sources[0], sources[0].calibration_for(options), out, progress, mesh=mesh)
    SourceScan.instrument_of(sources, options)  # refuses two
    return merge_scans((sources[0], sources[1]), SourceScan.one_calibration(sources, options), out, progress)


class ObjectFiles:
    """Files of a solved object; its surface and the mesh of that are made once, on first use."""

    def __init__(
        self,
        root: Path,
        solved: StoredObject,
        options: ScanOptions,
        progress: Progress,
        spacing_mm: float,
        close_holes_mm: float,
    ) -> None:
        """Keep the spacing of the surface's points, and the size of holes in its mesh that are closed."""
        self._of, self._progress, self._about = (root, solved, options, progress), progress, metadata_of_object(solved)
        self._spacing_mm, self._close_holes_mm = spacing_mm, close_holes_mm
        self._surface: FusedCloud | None = None
        self._mesh: Mesh | None = None

    def prepare(self, out: Path, *, mesh: bool, single_scans: bool) -> Callable[[], None]:
        """Prepare the content of a file and return the function that writes it.

        ``mesh``: triangles where the suffix leaves the choice; ``single_scans``: scans with their poses likewise, which are
        made while they are written. Raises ScanError, CalibrationError; the function raises ExportError, StorageError,
        MissingLibraryError.
        """
        suffix = out.suffix.lower()
        if suffix in OBJECT_SCANS_SUFFIXES and (single_scans or suffix not in SURFACE_SUFFIXES):
            return lambda: write_scans(out, placed_scans(*self._of), self._about)
        surface = self._surface = self._surface or surface_of(*self._of, self._spacing_mm)
        self._progress(f"writing {out.name}")
        if not has_triangles(out, mesh):
            return lambda: write_surface(out, surface, self._about)
        # The mesh takes as long as all steps before.
        size_mm = max(VOXEL_MM, 2.0 * self._spacing_mm)
        triangles = self._mesh = self._mesh or mesh_of_surface(surface, size_mm, self._close_holes_mm)
        return lambda: write_mesh(out, triangles, self._about)


def _export(
    source: SourceScan, chosen: ChosenCalibration, out: Path, progress: Progress, *, mesh: bool
) -> dict[str, Any]:
    """Write the points of a stored scan, or with ``mesh`` its triangles, in the format of the suffix.

    Raises ExportError for a suffix that is not allowed, MissingLibraryError, ScanError, StorageError.
    """
    suffix = check_suffix(out, MESH_SUFFIXES if mesh else SCAN_SUFFIXES, "a mesh" if mesh else "a scan")
    scan = organised_scan(source, chosen, progress)
    record, calibration = source.scan.manifest.record, chosen.calibration
    warnings = [f"{fault.code.value}: {fault.detail}" for fault in scan.faults]
    metadata = Metadata(
        title=f"scan {source.scan.manifest.scan_id}",
        frame=CAMERA_FRAME,
        notes=(
            f"calibration {calibration.hash[:12]} ({calibration.method}), water index {scan.water.index:.5f}",
            f"recorded {record.wall_time or 'at an unknown time'}, software {record.software_version}",
            *(f"warning {warning}" for warning in warnings),
        ),
    )
    faces = None
    if mesh:
        progress("meshing")
        triangles = mesh_of_scan(scan.cloud)
        points, faces = len(triangles.grey), len(triangles.faces)
        progress("writing")
        write_mesh(out, triangles, metadata)
    else:
        points = int(scan.cloud.mask.sum())
        progress("writing")
        write_scan(out, scan.cloud, metadata)
    return {
        "scan": source.scan.manifest.scan_id,
        "file": str(out),
        "format": suffix.removeprefix("."),
        "unit": "m" if suffix in (".e57", ".las") else "mm",
        "points": points,
        "faces": faces,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "water_index": scan.water.index,
        "warnings": warnings,
    }
