"""Owns the cloud of a stored scan made again from its raw frames: the file, and the report of what it says."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from appliance.desk.salvaging import Salvaged
from appliance.measure import SPOILS_SCAN, Calibration, Cloud, Fault, Grade, Judgement, Water, grade
from appliance.store import (
    CLOUD_FILE,
    Bytes,
    Chosen,
    Instrument,
    LocalFileSystem,
    Rig,
    ScanError,
    SourceScan,
    StoredScan,
    encode_ply,
    lost,
    refuse_empty,
    replace_file,
    reprocess_bracket,
    reprocess_scan,
)


def reconstruct_scan(
    source: SourceScan,
    chosen: Chosen,
    out: Path | None,
    progress: Callable[[str], None],
    salvaged: Salvaged | None = None,
) -> dict[str, Any]:
    """Make the cloud of a stored scan from its raw frames, written as PLY to ``out`` (``None``: ``NAME.ply`` here).

    The same frames, calibration and version give the same points as on the instrument; ``stored_cloud`` says what became
    of those that the instrument stored. Of a ``salvaged`` scan, which ``source`` is then of, file and report say what was
    lost. Raises ScanError, also where no points are left; CalibrationError, OSError.
    """
    scan, rig, calibration = source.scan, source.rig, chosen.calibration
    record = scan.manifest.record
    notes = salvaged.notes if salvaged is not None else ()
    cloud, water, faults = cloud_of_scan(scan, rig, calibration, progress, salvaged)
    target = out if out is not None else Path(f"{scan.folder.name}.ply")
    progress("writing")
    header, body = encode_ply(cloud, "; ".join(notes) or None)
    before = _stored_cloud(scan, header, body)  # compared before it may be written over
    replace_file(LocalFileSystem(), target, header, body)
    s = cloud.summary
    return {
        "scan": scan.manifest.scan_id,
        "file": str(target),
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "distance_mm": s.distance_mm,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
        "exposure": Instrument(rig).exposures_label(record),
        "period_px": record.sequence.period_px,
        "stored_cloud": before,
        "salvaged": list(notes) or None,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "calibration_method": calibration.method,
        "same_calibration": calibration.hash == record.calibration_hash,
        "water_index": water.index,
        "warnings": [f"{fault.code.value}: {fault.detail}" for fault in faults],
    }


def _stored_cloud(scan: StoredScan, *parts: Bytes) -> str:
    """Return what became of the cloud that the instrument stored, beside the new one in ``parts``."""
    stamp = scan.manifest.files.get(CLOUD_FILE)
    if stamp is None:
        return "none was stored"
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    # By its checksum in the manifest, so that it can be said also where the stored cloud itself is damaged or gone.
    same = digest.hexdigest() == stamp.sha256
    problem = lost(scan.folder, scan.manifest, CLOUD_FILE)
    if problem is None:
        return "the same, byte for byte" if same else "other points"
    return f"{CLOUD_FILE}: {problem}; {'made again, byte for byte' if same else 'these are not the points it had'}"


@dataclass(frozen=True, slots=True, eq=False)
class WorkedThrough:
    """One sequence, or both that a scan has, as the instrument would have worked them through."""

    cloud: Cloud
    water: Water
    faults: tuple[Fault, ...]
    """Warnings about the scan."""
    judgements: tuple[Judgement, ...]

    @property
    def grade(self) -> Grade:
        """The grade that the instrument gives such a scan; BAD where it would not keep it."""
        codes = {fault.code for fault in self.faults}
        if not SPOILS_SCAN.isdisjoint(codes):
            return Grade.BAD
        return grade(self.cloud.summary.coverage_percent, self.cloud.summary.noise_mm, codes)


def cloud_of_scan(
    scan: StoredScan,
    rig: Rig,
    calibration: Calibration,
    progress: Callable[[str], None],
    salvaged: Salvaged | None = None,
) -> tuple[Cloud, Water, tuple[Fault, ...]]:
    """Return the cloud of one sequence, or of both that the scan has, its water, and warnings.

    Raises ScanError, also where no points are left.
    """
    worked = work_through(scan, rig, calibration, progress, salvaged)
    return worked.cloud, worked.water, worked.faults


def work_through(
    scan: StoredScan,
    rig: Rig,
    calibration: Calibration,
    progress: Callable[[str], None],
    salvaged: Salvaged | None = None,
) -> WorkedThrough:
    """Reconstruct and judge a scan, one sequence or both. Raises ScanError, also where no points are left."""
    record = scan.manifest.record
    settings = Instrument(rig).settings_of_scan(record)
    if salvaged is not None:
        # A made-up frame is noisier than a recorded one, and the points' sigmas must say so.
        settings = replace(settings, noise=salvaged.noise(settings.noise))
    if scan.second is None or record.second is None:
        reprocessed = reprocess_scan(scan, calibration, settings, progress)
        # No file for a cloud without points: it would look like a result.
        refuse_empty(scan.folder, reprocessed.empty)
        return WorkedThrough(reprocessed.cloud, reprocessed.water, reprocessed.faults, reprocessed.judgements)
    both = (settings, Instrument(rig).settings(record.second.exposure))
    pair = reprocess_bracket(scan, scan.second, both, calibration, progress)
    if pair.cloud is None:
        raise ScanError(f"{scan.folder}: {pair.pair.verdict.text}")
    refuse_empty(scan.folder, pair.empty)
    return WorkedThrough(pair.cloud, pair.water, pair.faults, (*pair.first, *pair.second, pair.pair))
