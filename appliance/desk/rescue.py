"""Cloud of an incomplete scan, from its first direction alone, unchecked and marked so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from appliance.base import Progress
from appliance.measure import UNCHECKED, NoPoint, first_direction_cloud
from appliance.store import (
    ChosenCalibration,
    IncompleteRecording,
    Instrument,
    LocalFileSystem,
    ScanError,
    SourceScan,
    encode_ply,
)

FEWEST_POINTS = 100


def rescue_recording(
    recording: IncompleteRecording,
    source: SourceScan,
    chosen: ChosenCalibration,
    out: Path,
    progress: Progress,
) -> dict[str, Any]:
    """Make the cloud of ``recording``, of which ``source`` is the scan, written as PLY to ``out``.

    File and report say that it is unchecked, and which frames are missing. Raises ScanError, also if (nearly) no points are
    left; StorageError.
    """
    scan, calibration = recording.scan, chosen.calibration
    record = scan.manifest.record
    water = scan.water(calibration)
    progress("matching along epipolar curves")
    try:
        cloud, correspondences = first_direction_cloud(
            scan.frames,
            scan.sequence,
            calibration,
            water,
            Instrument(source.rig).settings_of_scan(record).noise,
        )
    except ValueError as error:
        raise ScanError(f"{scan.folder}: {error}") from error
    if cloud.summary.points < FEWEST_POINTS:
        raise ScanError(f"{scan.folder}: {cloud.summary.points} points; it has no usable cloud")
    progress("writing")
    # The word itself begins the header's line.
    note = f"{UNCHECKED.removeprefix('unchecked: ')}; {scan.manifest.reason}"
    LocalFileSystem().replace_file(out, *encode_ply(cloud, unchecked=note))
    s = cloud.summary
    return {
        "recording": scan.manifest.scan_id,
        "file": str(out),
        "unchecked": note,
        "missing": ", ".join(recording.missing),
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "distance_mm": s.distance_mm,
        "noise_mm": s.noise_mm,
        "without_points": {
            reason.name.lower(): correspondences.count(reason) for reason in NoPoint if reason is not NoPoint.FOUND
        },
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "calibration_method": calibration.method,
        "same_calibration": calibration.hash == record.calibration_hash,
        "water_index": water.index,
    }
