"""Owns two stored scans as one cloud: two exposures of the same scene, for what is too bright in one and too dark in the other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from appliance.calibration import file as calibration_file
from appliance.calibration.file import Calibration
from appliance.capture.verdict import Verdict
from appliance.config import Rig
from appliance.optics.water import Water
from appliance.reconstruct.pipeline import Cloud
from appliance.service.desk import rework_pair
from appliance.service.instrument import calibration_of, exposure_of_scan, taking_of_scan
from appliance.storage import scan as stored
from appliance.storage.ply import write_ply
from appliance.storage.scan import ScanError


def merge_scans(
    rig: Rig, folders: tuple[Path, Path], calibration: Path | None, out: Path | None, progress: Callable[[str], None]
) -> dict[str, Any]:
    """One cloud of two stored scans of the same scene with different exposures, written as PLY to ``out`` (``None``:
    ``NAME+NAME.ply`` here).

    Raises ScanError, also for scans that do not show the same; CalibrationError, OSError.
    """
    scans = [stored.load(folder) for folder in folders]
    # The shorter exposure's grey values are those of the cloud: they are not saturated.
    scans.sort(key=lambda scan: exposure_of_scan(scan.manifest.record, rig).light)
    chosen = calibration_file.load(calibration) if calibration is not None else calibration_of(rig)[0]
    cloud, verdict, water = merged_cloud_of((scans[0], scans[1]), rig, chosen, progress)
    names = [scan.manifest.scan_id for scan in scans]
    target = out if out is not None else Path(f"{'+'.join(names)}.ply")
    progress("writing")
    write_ply(target, cloud)
    s = cloud.summary
    return {
        "scans": " + ".join(names),
        "exposures": " + ".join(exposure_of_scan(scan.manifest.record, rig).label for scan in scans),
        "file": str(target),
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
        "merged": verdict.text,
        **verdict.numbers,
        "calibration": chosen.hash,
        "calibration_method": chosen.method,
        "water_index": water.index,
    }


def merged_cloud_of(
    scans: tuple[stored.StoredScan, stored.StoredScan],
    rig: Rig,
    calibration: Calibration,
    progress: Callable[[str], None],
) -> tuple[Cloud, Verdict, Water]:
    """The full cloud of two scans as one, in the frame of the first; the verdict ``pair``, and the water.

    Raises ScanError for scans of different patterns, or of two sequences, or that do not show the same.
    """
    first, second = scans
    for scan in scans:
        if scan.second is not None:
            raise ScanError(f"{scan.folder}: is of two exposures already; merge scans of one")
    if first.manifest.record.sequence != second.manifest.record.sequence:
        raise ScanError("the scans were recorded with different patterns; merge two of the same fringe period")
    takings = (taking_of_scan(first.manifest.record, rig), taking_of_scan(second.manifest.record, rig))
    made = rework_pair(first, second.frames, takings, calibration, progress)
    if made.cloud is None:
        raise ScanError(f"{made.pair.verdict.text}: merge scans that were taken from one place")
    return made.cloud, made.pair.verdict, made.water
