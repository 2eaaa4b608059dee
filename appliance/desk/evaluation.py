"""Evaluation from a list to a report: each scan is reconstructed and its artefact measured."""

from __future__ import annotations

from collections.abc import Sequence

from appliance import __version__
from appliance.base import Progress, part_of
from appliance.measure import Calibration, Certificate, Evaluation, Item, QualityLimits, evaluate
from appliance.store import RAW_FILES, Instrument, ScanList, SourceScan, reprocess_scan

JUDGING_GAP_MM = 20.0
"""The instrument masks points whose rays pass at more than 0.25 mm.

A wrong calibration would so hide its own worst points, many more than the 0.3 % that may be removed; here every
calibration is judged by the same points.
"""


def run_evaluation(
    listed: ScanList,
    sources: Sequence[SourceScan],
    chosen: Calibration,
    progress: Progress,
) -> Evaluation:
    """Reconstruct and measure every scan of the list.

    ``sources`` are in its order, with complete raw frames. Raises ScanError, also for a scan in which the calibration
    leaves no points.
    """
    items = []
    for k, (entry, source) in enumerate(zip(listed.entries, sources, strict=True)):
        scan = source.scan
        step = part_of(progress, k / len(sources), (k + 1) / len(sources), scan.folder.name)
        settings = Instrument(source.rig).settings_of_scan(scan.manifest.record)
        reprocessed = reprocess_scan(scan, chosen, settings, step, QualityLimits(max_gap_mm=JUDGING_GAP_MM))
        # A missing artefact is a result; a calibration that does not fit the scan is an error.
        if reprocessed.empty is not None and reprocessed.empty.by_calibration:
            scan.refuse_empty(reprocessed.empty)
        cloud, water = reprocessed.cloud, reprocessed.water
        step(f"looking for the {entry.artefact.value}")
        certificate = Certificate(entry.length_sd_mm, entry.radius_mm, entry.radius_sd_mm)
        result = evaluate(
            cloud, entry.artefact, entry.calibrated_mm, listed.reference_mm, certificate, listed.limits_mm
        )
        record = scan.manifest.record
        provenance = {
            "recorded": record.wall_time,
            "clock_trusted": record.clock_trusted,
            "artefact_serial": entry.serial,
            "points": cloud.summary.points,
            "coverage_percent": cloud.summary.coverage_percent,
            "ray_gap_mm": cloud.summary.gap_mm,
            "water": {"temperature_c": water.temperature_c, "salinity_psu": water.salinity_psu, "index": water.index},
            "temperatures_c": dict(record.temperatures_c),
            "period_px": record.sequence.period_px,
            "warnings": [f"{fault.code.value}: {fault.detail}" for fault in reprocessed.faults],
            "recorded_by_version": record.software_version,
            "recorded_with_rig": record.rig_hash,
            "recorded_with_calibration": record.calibration_hash,
            # The hashes prove later which frames were measured, even if the folder was moved.
            "sha256": {name: scan.manifest.files[name].sha256 for name in RAW_FILES},
        }
        items.append(Item(scan.manifest.scan_id, result, provenance))
    facts = {
        "operator": listed.operator,
        "rig_serial": chosen.rig_serial,
        "calibration": chosen.hash,
        "calibration_method": chosen.method,
        "calibration_made_at": chosen.made_at,
        "software_version": __version__,
    }
    return Evaluation(facts, listed.reference_mm, chosen.rig.left.width_px, tuple(items))
