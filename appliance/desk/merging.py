"""Merging: two stored scans of one scene with different exposures as one cloud."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from appliance.base import Progress
from appliance.measure import Calibration, Cloud, Verdict, Water
from appliance.store import (
    FRAME_FILES,
    ChosenCalibration,
    Instrument,
    LocalFileSystem,
    Rig,
    ScanError,
    SourceScan,
    StoredScan,
    encode_ply,
    reprocess_bracket,
)


def merge_scans(
    sources: tuple[SourceScan, SourceScan], chosen: ChosenCalibration, out: Path, progress: Progress
) -> dict[str, Any]:
    """Make one cloud of two stored scans of one scene with different exposures, as PLY in ``out``.

    Raises ScanError, also for scans that show different scenes, or are the same; CalibrationError, OSError.
    """
    rig, calibration = sources[0].rig, chosen.calibration
    refuse_same_scan(sources[0].scan, sources[1].scan)
    # The shorter exposure's grey values are those of the cloud: they are not saturated.
    scans = sorted(
        (source.scan for source in sources),
        key=lambda scan: Instrument(rig).exposure_of_scan(scan.manifest.record).light,
    )
    cloud, verdict, water = merge_clouds((scans[0], scans[1]), rig, calibration, progress)
    names = [scan.manifest.scan_id for scan in scans]
    progress("writing")
    LocalFileSystem().replace_file(out, *encode_ply(cloud))
    s = cloud.summary
    return {
        "scans": " + ".join(names),
        "exposures": " + ".join(Instrument(rig).exposure_of_scan(scan.manifest.record).label for scan in scans),
        "file": str(out),
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
        "merged": verdict.text,
        **verdict.numbers,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "calibration_method": calibration.method,
        "water_index": water.index,
    }


def refuse_same_scan(first: StoredScan, second: StoredScan) -> None:
    """Raise ScanError for two scans with a common file of frames, also under different numbers.

    Counting the same frames twice would claim a noise too small by the root of two.
    """
    of_frames = FRAME_FILES
    # Compare content: a copy under another number is the same scan.
    sums = [{scan.manifest.files[n].sha256 for n in of_frames if n in scan.manifest.files} for scan in (first, second)]
    if sums[0] & sums[1]:
        raise ScanError(
            f"{first.folder} and {second.folder} are the same scan, with the same frames; merge two scans with "
            "different exposures"
        )


def merge_clouds(
    scans: tuple[StoredScan, StoredScan],
    rig: Rig,
    calibration: Calibration,
    progress: Progress,
) -> tuple[Cloud, Verdict, Water]:
    """Return the full cloud of two scans as one, with the verdict ``pair`` and the water.

    The cloud is in the frame of the first. Raises ScanError for scans of different patterns, of two sequences, or of
    different scenes.
    """
    first, second = scans
    for scan in scans:
        if scan.second is not None:
            raise ScanError(f"{scan.folder}: has two exposures already; merge scans with one exposure")
    # Coordinates are compared pixel by pixel: those of other patterns mean other places.
    if first.manifest.record.sequence != second.manifest.record.sequence:
        raise ScanError("the scans were recorded with different patterns; merge two of the same fringe period")
    settings = (
        Instrument(rig).settings_of_scan(first.manifest.record),
        Instrument(rig).settings_of_scan(second.manifest.record),
    )
    merged = reprocess_bracket(first, second.frames, settings, calibration, progress)
    first.refuse_empty(merged.empty)
    assert merged.bracket is not None, "it has one of two exposures"
    return merged.cloud, merged.bracket, merged.water
