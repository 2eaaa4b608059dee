"""Owns two stored scans as one cloud: two exposures of the same scene, for what is too bright in one and too dark in the other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from appliance.calibration import file as calibration_file
from appliance.calibration.file import Calibration
from appliance.config import Rig
from appliance.optics.water import Water
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.decode import CameraDecoder
from appliance.reconstruct.merge import Agreement, merge
from appliance.reconstruct.pipeline import SIDES, Cloud, Pipeline
from appliance.service.desk import water_of_scan
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
    cloud, agreements, water = merged_cloud_of((scans[0], scans[1]), rig, chosen, progress)
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
        **{f"{side}_{key}": value for side, a in agreements.items() for key, value in _agreement(a).items()},
        "calibration": chosen.hash,
        "calibration_method": chosen.method,
        "water_index": water.index,
    }


def merged_cloud_of(
    scans: tuple[stored.StoredScan, stored.StoredScan],
    rig: Rig,
    calibration: Calibration,
    progress: Callable[[str], None],
) -> tuple[Cloud, dict[str, Agreement], Water]:
    """The full cloud of two scans as one, how far they agreed, and the water. The first one's grey values are the cloud's.

    Raises ScanError for scans of different patterns, and where something moved in between.
    """
    first, second = scans
    made = first.manifest.record.sequence
    if made != second.manifest.record.sequence:
        raise ScanError("the scans were recorded with different patterns; merge two of the same fringe period")
    sequence = build_sequence(made.period_px, made.width_px, made.height_px)
    water = water_of_scan(first, calibration)
    noises = [taking_of_scan(scan.manifest.record, rig).noise for scan in scans]
    agreements = {}
    with Pipeline(calibration, water, sequence, noise=noises[0]) as pipeline:
        for side in SIDES:
            progress(f"decoding the {side} camera")
            height_px, width_px = first.frames[side].shape[1:]
            other = CameraDecoder(sequence, width_px, height_px)
            for index in range(len(sequence)):
                pipeline.push(side, first.frames[side], index)
                other.push(second.frames[side], index)
            noise = (getattr(noises[0], side), getattr(noises[1], side))
            agreements[side] = merge(pipeline.decoded(side), other, noise, made.period_px)
            _check_agreement(side, agreements[side])
        progress("matching")
        pipeline.coarse()
        return pipeline.full(), agreements, water


def _check_agreement(side: str, found: Agreement) -> None:
    if found.agrees is None:
        raise ScanError(
            f"only {100.0 * found.both:.1f} % of the {side} images are lit well in both scans; whether they show the same "
            "cannot be told: merge exposures that are nearer to each other"
        )
    if not found.agrees:
        raise ScanError(
            f"in the {side} images all has shifted by {found.shift:.1f} times the noise from one scan to the other; instrument "
            "or object moved in between: merge scans that were taken without moving"
        )


def _agreement(found: Agreement) -> dict[str, float | None]:
    return {
        "only_first_percent": 100.0 * found.first,
        "only_second_percent": 100.0 * found.second,
        "both_percent": 100.0 * found.both,
        "masked_percent": 100.0 * found.masked,
        "shift_over_noise": found.shift,
    }
