"""Owns one scan worked through anew: a job in, a row out, whoever runs it, and as often as somebody does.

Nothing here knows of pools or networks. What is wrong with the scan itself is a result, written down with its reason; what is
wrong with the machine (a full disk, no memory, another program) is ``AGAIN``: somebody else may do it, or the same one later.
"""

from __future__ import annotations

import hashlib
import resource
import socket
import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import appliance
from appliance import __version__
from appliance.calibration.file import Calibration, CalibrationError
from appliance.evaluation.points import NotFound
from appliance.instrument import exposures_label
from appliance.machine.alerts import RULES
from appliance.offline.anew.results import Results, Row, name_of
from appliance.offline.evaluation import ListedScan, ScanList, run_evaluation
from appliance.offline.origin import SourceScan, Wish, calibration_for, open_source
from appliance.offline.reconstruct import work_through
from appliance.storage.atomic import StorageError
from appliance.storage.damage import refuse_damaged_frames
from appliance.storage.packed import PackedError
from appliance.storage.ply import encode_ply
from appliance.storage.scan import ScanError

DONE, FAILED, AGAIN = "done", "failed", "again"
"""States of a row; one that is to be tried again is never published."""
_MB = 1024.0


@dataclass(frozen=True, slots=True)
class Job:
    """Everything that one scan's task must know; small, and the same bytes on every machine."""

    folder: str
    """The scan's; every machine must see it there."""
    results: str
    """Folder of the results of this key."""
    calibration: str | None
    """Calibration file; ``None``: each scan's own."""
    foreign: bool
    water: tuple[float, float] | None
    """Temperature in °C and salinity in psu that take the place of the recorded ones."""
    clouds: bool
    program: str
    """Digits of the program that is to do it (``program_digits``)."""
    listed: ListedScan | None = None
    """The artefact that the scan shows; ``None``: none that is known."""
    reference_mm: float = 0.0

    @property
    def name(self) -> str:
        """Name of the scan's folder."""
        return Path(self.folder).name


def attempt(job: Job) -> Row:
    """Work one scan through, publish its result and return the row; never raises what the machine or the scan is to blame for."""
    try:
        return _row(job)
    except (StorageError, OSError, MemoryError) as error:
        return {"scan": job.name, "folder": job.folder, "state": AGAIN, "reason": f"{type(error).__name__}: {error}"}


def _row(job: Job) -> Row:
    if job.program != program_digits():
        # Results of two programs under one key would be neither's.
        raise OSError(f"{socket.gethostname()} has another version of kingfisher; install the same one everywhere")
    results, folder = Results(Path(job.results)), Path(job.folder)
    name = name_of(folder)
    published = results.row(name)
    if published is not None:
        return published
    begun_s, begun_cpu_s = time.monotonic(), time.process_time()
    row: Row = {"scan": folder.name, "folder": str(folder), "host": socket.gethostname()}
    try:
        found, cloud = _worked_through(job, folder)
    except (ScanError, CalibrationError, PackedError) as error:
        return results.publish_failure(name, {**row, "state": FAILED, "reason": str(error)})
    times = {
        "cpu_s": round(time.process_time() - begun_cpu_s, 3),
        "wall_s": round(time.monotonic() - begun_s, 3),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MB),
    }
    return results.publish(name, {**row, "state": DONE, **found, **times}, cloud)


def _worked_through(job: Job, folder: Path) -> tuple[Row, Any]:
    refuse_damaged_frames(folder)
    wish = Wish(calibration=None if job.calibration is None else Path(job.calibration), foreign=job.foreign)
    source = open_source(folder, wish)
    chosen = calibration_for(source, wish)
    if job.water is not None:
        source = _in_water(source, job.water, chosen.calibration)
    worked = work_through(source.scan, source.rig, chosen.calibration, lambda _: None)
    record, summary = source.scan.manifest.record, worked.cloud.summary
    found: Row = {
        "recorded": record.wall_time,
        "points": summary.points,
        "coverage_percent": summary.coverage_percent,
        "distance_mm": summary.distance_mm,
        "noise_mm": summary.noise_mm,
        "gap_mm": summary.gap_mm,
        "exposure": exposures_label(record, source.rig),
        "spoilt": any(RULES[fault.code].spoils_scan for fault in worked.faults),
        "faults": "; ".join(f"{fault.code.value}: {fault.detail}" for fault in worked.faults),
        "verdicts": " ".join(f"{one.verdict.name}={_passed(one.verdict.passed)}" for one in worked.judgements),
        "temperature_c": worked.water.temperature_c,
        "salinity_psu": worked.water.salinity_psu,
        "water_index": worked.water.index,
        "calibration": chosen.calibration.hash,
        "same_calibration": chosen.calibration.hash == record.calibration_hash,
        "recorded_by_version": record.software_version,
    }
    if job.listed is not None:
        found |= _lengths(job.listed, job.reference_mm, source, wish)
    return found, encode_ply(worked.cloud) if job.clouds else None


def _in_water(source: SourceScan, water_of: tuple[float, float], calibration: Calibration) -> SourceScan:
    manifest, recorded = source.scan.manifest, source.scan.manifest.record.water
    colour_nm = recorded.get("wavelength_nm")
    water = {
        **recorded,
        "temperature_c": water_of[0],
        "salinity_psu": water_of[1],
        # Without a wavelength the recorded water counts as not known, and this one would be left out in silence.
        "wavelength_nm": calibration.water.wavelength_nm if colour_nm is None else colour_nm,
    }
    record = replace(manifest.record, water=water)
    return replace(source, scan=replace(source.scan, manifest=replace(manifest, record=record)))


def _lengths(listed: ListedScan, reference_mm: float, source: SourceScan, wish: Wish) -> Row:
    """Return what ``kingfisher evaluate`` says of the scan's artefact, with its own limits of quality."""
    scans = ScanList((listed,), None, reference_mm)
    evaluation = run_evaluation(scans, (source,), calibration_for(source, wish).calibration, lambda *_: None)
    (item,) = evaluation.items
    if isinstance(item.result.fit, NotFound):
        return {"artefact": listed.artefact.value, "reason": f"not evaluated: {item.result.fit.reason}"}
    errors = [one.measured_mm - one.calibrated_mm for one in item.result.lengths]
    worst = item.result.worst_e_l
    return {
        "artefact": listed.artefact.value,
        "e_l_percent": None if worst is None else 100.0 * worst,
        "length_error_mm": max(errors, key=abs, default=None),
    }


def _passed(passed: bool | None) -> str:
    return "-" if passed is None else "yes" if passed else "no"


@cache
def program_digits() -> str:
    """Return the version with digits that change with any file of the product: results of two programs have different keys."""
    digest = hashlib.sha256()
    top = Path(appliance.__file__).parent
    for path in sorted(top.rglob("*.py")):
        digest.update(path.relative_to(top).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{__version__}-{digest.hexdigest()[:12]}"
