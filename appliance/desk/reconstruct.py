"""Cloud of a stored scan, made again from its raw frames: the file, and the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from appliance.base import Progress
from appliance.measure import (
    Calibration,
)
from appliance.store import (
    ChosenCalibration,
    Instrument,
    LocalFileSystem,
    ReprocessedScan,
    Rig,
    SalvagedScan,
    SourceScan,
    StoredScan,
    encode_ply,
    reprocess_bracket,
    reprocess_scan,
)


def reconstruct_scan(
    source: SourceScan,
    chosen: ChosenCalibration,
    out: Path,
    progress: Progress,
    salvaged: SalvagedScan | None = None,
) -> dict[str, Any]:
    """Make the cloud of a stored scan from its raw frames, written as PLY to ``out``.

    The same frames, calibration and version give the same points as on the instrument; ``stored_cloud`` compares them with
    the stored ones. With ``salvaged``, of which ``source`` is the scan, file and report state the losses. Raises ScanError,
    also if no points are left; CalibrationError, OSError.
    """
    scan, rig, calibration = source.scan, source.rig, chosen.calibration
    record = scan.manifest.record
    notes = salvaged.notes if salvaged is not None else ()
    reprocessed = work_through(scan, rig, calibration, progress, salvaged)
    progress("writing")
    header, body = encode_ply(reprocessed.cloud, "; ".join(notes) or None)
    comparison = scan.compare_cloud(header, body)  # compared before it may be written over
    LocalFileSystem().replace_file(out, header, body)
    s = reprocessed.cloud.summary
    return {
        "scan": scan.manifest.scan_id,
        "file": str(out),
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "distance_mm": s.distance_mm,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
        "exposure": Instrument(rig).exposures_label(record),
        "period_px": record.sequence.period_px,
        "stored_cloud": comparison,
        "salvaged": list(notes) or None,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "calibration_method": calibration.method,
        "same_calibration": calibration.hash == record.calibration_hash,
        "water_index": reprocessed.water.index,
        "warnings": [f"{fault.code.value}: {fault.detail}" for fault in reprocessed.faults],
    }


def work_through(
    scan: StoredScan,
    rig: Rig,
    calibration: Calibration,
    progress: Progress,
    salvaged: SalvagedScan | None = None,
) -> ReprocessedScan:
    """Reconstruct and judge a scan, one sequence or both. Raises ScanError, also where no points are left."""
    record = scan.manifest.record
    settings = Instrument(rig).settings_of_scan(record)
    if salvaged is not None:
        # A made-up frame is noisier than a recorded one, and the points' sigmas must say so.
        settings = replace(settings, noise=salvaged.noise(settings.noise))
    if scan.second is None or record.second is None:
        reprocessed = reprocess_scan(scan, calibration, settings, progress)
    else:
        bracket_settings = (settings, Instrument(rig).settings(record.second.exposure))
        reprocessed = reprocess_bracket(scan, scan.second, bracket_settings, calibration, progress)
    # No file for a cloud without points: it would look like a result.
    scan.refuse_empty(reprocessed.empty)
    return reprocessed
