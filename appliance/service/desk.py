"""Owns what the metrologist does at the desk: reconstruct a stored scan again, look at and make calibration files."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.calibration import file as calibration_file
from appliance.calibration.file import Calibration
from appliance.config import Rig
from appliance.machine.alerts import RULES
from appliance.optics.water import Water
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.processing.bracket import ProcessedSequence, faults_of
from appliance.processing.procedure import AllJudged, FullFound, SequenceProcessor
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.reconstruct.quality import QualityLimits
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.sides import of_side
from appliance.scan.verdict import Judgement
from appliance.service.empty import Empty, why_empty
from appliance.service.instrument import (
    CALIBRATION_FILE,
    calibration_of,
    design_of,
    exposures_label,
    settings_of,
    settings_of_scan,
)
from appliance.service.origin import Chosen, Taken, lost
from appliance.service.salvage import Salvaged
from appliance.storage import scan as stored
from appliance.storage.atomic import replace_file
from appliance.storage.filesystem import Bytes, LocalFileSystem
from appliance.storage.ply import encode_ply


def reconstruct_scan(
    source: Taken,
    chosen: Chosen,
    out: Path | None,
    progress: Callable[[str], None],
    salvaged: Salvaged | None = None,
) -> dict[str, Any]:
    """The cloud of a stored scan from its raw frames, written as PLY to ``out`` (``None``: ``NAME.ply`` here).

    The same frames, calibration and version give the same points as on the instrument; ``stored_cloud`` says what became
    of those that the instrument stored. Of a ``salvaged`` scan, which ``source`` is then of, file and report say what was
    lost. Raises ScanError, also where no points are left; CalibrationError, OSError.
    """
    scan, rig, calibration = source.scan, source.rig, chosen.calibration
    record = scan.manifest.record
    said = salvaged.said if salvaged is not None else ()
    cloud, water, faults = _points_of(scan, rig, calibration, progress, salvaged)
    target = out if out is not None else Path(f"{scan.folder.name}.ply")
    progress("writing")
    header, body = encode_ply(cloud, "; ".join(said) or None)
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
        "exposure": exposures_label(record, rig),
        "period_px": record.sequence.period_px,
        "stored_cloud": before,
        "salvaged": list(said) or None,
        "calibration": calibration.hash,
        "calibration_from": chosen.whose,
        "calibration_method": calibration.method,
        "same_calibration": calibration.hash == record.calibration_hash,
        "water_index": water.index,
        "warnings": [f"{fault.code.value}: {fault.detail}" for fault in faults],
    }


def _stored_cloud(scan: stored.StoredScan, *parts: Bytes) -> str:
    """What became of the cloud that the instrument stored, beside the new one in ``parts``."""
    stamp = scan.manifest.files.get(stored.CLOUD)
    if stamp is None:
        return "none was stored"
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    same = digest.hexdigest() == stamp.sha256
    problem = lost(scan.folder, scan.manifest, stored.CLOUD)
    if problem is None:
        return "the same, byte for byte" if same else "other points"
    return f"{stored.CLOUD}: {problem}; {'made again, byte for byte' if same else 'these are not the points it had'}"


def _points_of(
    scan: stored.StoredScan,
    rig: Rig,
    calibration: Calibration,
    progress: Callable[[str], None],
    salvaged: Salvaged | None,
) -> tuple[Cloud, Water, tuple[Fault, ...]]:
    """Of one sequence, or of both that the scan has."""
    record = scan.manifest.record
    settings = settings_of_scan(record, rig)
    if salvaged is not None:
        settings = replace(settings, noise=salvaged.noise(settings.noise))
    if scan.second is None or record.second is None:
        reworked = rework(scan, calibration, settings, progress)
        refuse_empty(scan.folder, reworked.empty)
        return reworked.cloud, reworked.water, reworked.faults
    both = (settings, settings_of(rig, record.second.exposure))
    pair = rework_pair(scan, scan.second, both, calibration, progress)
    if pair.cloud is None:
        raise stored.ScanError(f"{scan.folder}: {pair.pair.verdict.text}")
    refuse_empty(scan.folder, pair.empty)
    return pair.cloud, pair.water, pair.faults


def refuse_empty(folder: Path, empty: Empty | None) -> None:
    """Raises ScanError where ``why_empty`` had a reason."""
    if empty is not None:
        raise stored.ScanError(f"{folder}: {empty.reason}")


@dataclass(frozen=True, slots=True, eq=False)
class Reworked:
    """A stored scan after everything the instrument does with one."""

    pipeline: Pipeline
    """Closed; it keeps the decoded maps of both cameras, but for a pair."""
    cloud: Cloud
    water: Water
    """In which it was reconstructed."""
    judgements: tuple[Judgement, ...]
    empty: Empty | None = None
    """Why there are (nearly) no points, and what to do; ``None`` where there are some."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is held against the scan."""
        return tuple(judgement.fault for judgement in self.judgements if judgement.fault is not None)

    @property
    def unfit(self) -> Fault | None:
        """Why its decoded maps must not calibrate; ``None`` where they may. They are those of before any compensation."""
        return next((fault for fault in self.faults if _spoils_maps(fault)), None)


def _spoils_maps(fault: Fault) -> bool:
    rule = RULES[fault.code]
    return rule.spoils_scan or rule.spoils_points or fault.code is FaultCode.COMPENSATED


def rework(
    scan: stored.StoredScan,
    calibration: Calibration,
    settings: AcquisitionSettings,
    progress: Callable[[str], None],
    limits: QualityLimits | None = None,
) -> Reworked:
    """Reconstruct and judge a stored scan with ``calibration``, as the instrument does; of a pair, its first sequence.

    ``settings``: how it was taken (``settings_of_scan``). ``limits`` ``None``: those of the instrument. Frames that are not
    what they should be give their points all the same: the judgements say so.
    """
    water = water_of_scan(scan, calibration)
    with Pipeline(calibration, water, sequence_of_scan(scan), limits, noise=settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        full = _work_through(processor, scan.frames, settings, len(pipeline.sequence), progress)
        judgements, cloud = full.judgements, pipeline.table.cloud(full.found)
        return Reworked(pipeline, cloud, water, judgements, why_empty(pipeline, cloud, judgements))


@dataclass(frozen=True, slots=True, eq=False)
class ReworkedPair:
    """Two sequences after everything the instrument does with a pair."""

    cloud: Cloud | None
    """Of both; ``None``: ``pair`` says why not."""
    water: Water
    first: tuple[Judgement, ...]
    second: tuple[Judgement, ...]
    pair: Judgement
    empty: Empty | None = None
    """As ``Reworked.empty``."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What is held against the pair."""
        return faults_of(self.first, self.second, self.pair)


def rework_pair(
    first: stored.StoredScan,
    second: Mapping[str, NDArray[np.uint8]],
    both: tuple[AcquisitionSettings, AcquisitionSettings],
    calibration: Calibration,
    progress: Callable[[str], None],
) -> ReworkedPair:
    """Reconstruct and judge ``first`` and the frames of a ``second`` sequence as one, as the instrument does.

    ``both``: how either was taken. Raises ScanError where frames are not what they should be.
    """
    water = water_of_scan(first, calibration)
    with Pipeline(calibration, water, sequence_of_scan(first), noise=both[0].noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        judged = []
        held: list[ProcessedSequence] = []
        for name, frames, settings in (("first", first.frames, both[0]), ("second", second, both[1])):
            judgements = _work_through(processor, frames, settings, len(pipeline.sequence), progress).judgements
            spoiled = judgements[0].fault
            if spoiled is not None:
                raise stored.ScanError(f"{name} sequence: {spoiled.code.value}: {spoiled.detail}")
            judged.append(judgements)
            if not held:
                held.append(processor.hold())
        progress("merging")
        merged = processor.merge_with(held[0])
        cloud = None if merged.found is None else pipeline.table.cloud(merged.found)
        empty = None if cloud is None else why_empty(pipeline, cloud, judged[1])
        return ReworkedPair(cloud, water, judged[0], judged[1], merged.judgement, empty)


def _work_through(
    processor: SequenceProcessor,
    frames: Mapping[str, NDArray[np.uint8]],
    settings: AcquisitionSettings,
    count: int,
    progress: Callable[[str], None],
) -> FullFound:
    """Take every step with one stored sequence of ``count`` frames, also where it shows wrong patterns; return the last one."""
    progress("loading")
    processor.begin(settings)
    for index in processor.push_all(frames):
        progress(f"decoding frame {index + 1} of {count}")
    progress("judging")
    full: FullFound | None = None
    for step in processor.steps(even_if_wrong=True):
        match step:
            case AllJudged():
                progress("taking the motion out" if step.compensating else "matching")
            case FullFound():
                full = step
            case _:
                pass
    assert full is not None, "the last step, since no wrong pattern ends them"
    return full


def sequence_of_scan(scan: stored.StoredScan) -> PatternSequence:
    """The patterns it was recorded with."""
    made = scan.manifest.record.sequence
    return build_sequence(made.period_px, made.width_px, made.height_px)


def describe_calibration(rig: Rig, path: Path | None) -> dict[str, Any]:
    """What a calibration file says (``None``: the instrument's own). Raises CalibrationError."""
    calibration = calibration_file.load(path) if path is not None else calibration_of(rig)[0]
    left, right = calibration.rig.left, calibration.rig.right
    has_ports = not (left.lens_in_water or right.lens_in_water)
    return {
        "rig_serial": calibration.rig_serial,
        "camera_serials": " / ".join(calibration.camera_serials) if calibration.camera_serials else None,
        "method": calibration.method,
        "made_at": calibration.made_at,
        "made_from": "; ".join(calibration.made_from),
        "residual_px": calibration.residual_px,
        "water_index": calibration.water.index,
        "size_px": f"{left.width_px}x{left.height_px}",
        "principal_distance_px": f"{left.lens.f_px[0]:.2f} / {right.lens.f_px[0]:.2f}",
        "interface_distance_mm": f"{left.port.distance_mm:.3f} / {right.port.distance_mm:.3f}" if has_ports else None,
        "port_tilt_deg": (
            f"{_tilt_deg(calibration, 'left'):.3f} / {_tilt_deg(calibration, 'right'):.3f}" if has_ports else None
        ),
        "baseline_mm": sum(x * x for x in right.translation_mm) ** 0.5,
        "hash": calibration.hash,
    }


def write_nominal_calibration(rig: Rig, out: Path | None) -> Path:
    """Write the design's calibration to ``out`` (``None``: ``calibration/nominal.json`` below the storage root).

    Raises StorageError.
    """
    path = out if out is not None else rig.storage.root / CALIBRATION_FILE.with_name("nominal.json")
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(LocalFileSystem(), path, calibration_file.encode(design_of(rig)))
    return path


def water_of_scan(scan: stored.StoredScan, calibration: Calibration) -> Water:
    """The water the scan was recorded in, as its manifest says; else that of the calibration."""
    water = scan.manifest.record.water
    t, s, w = water.get("temperature_c"), water.get("salinity_psu"), water.get("wavelength_nm")
    if t is None or s is None or w is None:
        return calibration.water
    return Water(t, s, w)


def _tilt_deg(calibration: Calibration, side: str) -> float:
    port = of_side(calibration.rig, side).port
    return math.degrees(math.acos(min(1.0, port.normal[2])))
