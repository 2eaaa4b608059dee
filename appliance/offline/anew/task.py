"""Owns one scan worked through anew: a job in, a row out, whoever runs it, and as often as somebody does.

Nothing here knows of pools or networks. What is wrong with the scan itself is a result, written down with its reason; what is
wrong with the machine (a full disk, no memory, another program, a folder that it does not see) is ``AGAIN``: somebody else may do
it, or the same one later. The row then says whom to blame.
"""

from __future__ import annotations

import logging
import os
import resource
import socket
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from appliance.calibration.file import Calibration, CalibrationError, load
from appliance.evaluation.points import NotFound
from appliance.instrument import exposures_label
from appliance.machine.alerts import RULES
from appliance.offline.anew.program import program_digits
from appliance.offline.anew.results import SETTINGS, Results, Row, name_of
from appliance.offline.evaluation import run_evaluation
from appliance.offline.origin import SourceScan, calibration_for, open_source
from appliance.offline.reconstruct import work_through
from appliance.offline.scan_list import ListedScan, ScanList
from appliance.offline.wish import Wish
from appliance.process_start import raise_if_interrupted
from appliance.storage.atomic import StorageError
from appliance.storage.damage import refuse_damaged_frames
from appliance.storage.packed import PackedError
from appliance.storage.ply import encode_ply
from appliance.storage.scan import ScanError, manifest_of
from appliance.surface.libraries import MissingLibraryError

DONE, FAILED, AGAIN = "done", "failed", "again"
"""States of a row; one that is to be tried again is never published."""
BLAME = "blame"
"""Key of a row that is to be tried again: whose fault it is."""
OF_HOST, OF_SCAN, OF_MACHINE = "host", "scan", "machine"
"""``OF_HOST``: no scan can be done there; ``OF_SCAN``: that one scan cannot be done now; ``OF_MACHINE``: what may pass, or not."""
_MB = 1024.0
log = logging.getLogger(__name__)


class _Unfit(Exception):
    """Nothing can be done on this host; the text says why and what to do."""


class _Gone(Exception):
    """The scan is not where it was."""


@dataclass(frozen=True, slots=True)
class Job:
    """Everything that one scan's task must know; small, and the same bytes on every machine."""

    folder: str
    """The scan's; every machine must see it there."""
    results: str
    """Folder of the results of this key."""
    calibration: str | None
    """Calibration file; ``None``: each scan's own."""
    calibration_hash: str | None
    """Hash of that file, under which results are published."""
    foreign: bool
    water: tuple[float, float] | None
    """Temperature in °C and salinity in psu that take the place of the recorded ones."""
    clouds: bool
    program: str
    """The program that is to do it (``program_digits``)."""
    listed: ListedScan | None = None
    """The artefact that the scan shows; ``None``: none that is known."""
    reference_mm: float = 0.0

    @property
    def name(self) -> str:
        """Name of the scan's folder."""
        return Path(self.folder).name


def attempt(job: Job) -> Row:
    """Work one scan through, publish its result and return the row; raises nothing but what ends a process."""
    try:
        return _row(job)
    except (_Unfit, MissingLibraryError, ImportError) as error:
        return again(job, str(error), OF_HOST)
    except _Gone as error:
        return again(job, str(error), OF_SCAN)
    except (StorageError, OSError, MemoryError) as error:
        return again(job, f"{type(error).__name__}: {error}", OF_MACHINE)


def again(job: Job, reason: str, blame: str) -> Row:
    """Return the row of a scan that this host could not do; it is published nowhere."""
    host = socket.gethostname()
    return {"scan": job.name, "folder": job.folder, "state": AGAIN, "reason": reason, "host": host, BLAME: blame}


def unfit(job: Job) -> str | None:
    """Return why this host can do no job like ``job``, and what to do; ``None`` where it can. Cheap enough for every scan."""
    host, mine = socket.gethostname(), program_digits()
    if job.program != mine:
        # Results of two programs under one key would be neither's.
        return (
            f"{host} has another version: {mine}; the call was made by {job.program}; install the same one everywhere"
        )
    if not (Path(job.results) / SETTINGS).is_file():
        return f"{host} does not see --out {Path(job.results).parent}; mount it there under the same path"
    shelf = Path(job.folder).parent
    # A folder that waits for its disk to be mounted is there, and empty.
    if not shelf.is_dir() or _empty(shelf):
        return f"{host} sees no scans in {shelf}; mount SOURCE there under the same path"
    if job.calibration is not None:
        try:
            seen = load(Path(job.calibration)).hash
        except CalibrationError as error:
            return f"{host} cannot use --calibration: {error}; let it see the file under the same path"
        # The key was made from the caller's file: one that was exchanged meanwhile would be published under a wrong key.
        if seen != job.calibration_hash:
            return f"{host} sees another calibration in {job.calibration}; let it see the same file, and call again"
    return None


def _empty(folder: Path) -> bool:
    with os.scandir(folder) as entries:  # not iterdir, which lists all of them first
        return next(entries, None) is None


def _row(job: Job) -> Row:
    problem = unfit(job)
    if problem is not None:
        raise _Unfit(problem)
    results, folder, host = Results(Path(job.results)), Path(job.folder), socket.gethostname()
    name = _name(job, folder)
    published = results.row(name)
    if published is not None:
        return published
    begun_s, begun_cpu_s = time.monotonic(), time.process_time()
    row: Row = {"scan": folder.name, "folder": str(folder), "host": host, "result": name, "recorded": _recorded(folder)}
    try:
        found, cloud = _worked_through(job, folder)
    except (ScanError, CalibrationError, PackedError) as error:
        failure = {**row, "state": FAILED, "reason": str(error)}
    except (StorageError, OSError, MemoryError, MissingLibraryError, ImportError):
        raise
    except Exception as error:
        raise_if_interrupted(error)
        # A mistake of the program's: it ends this scan, and neither the process nor the others.
        log.exception("%s: unexpected %s", folder, type(error).__name__)
        told = "".join(traceback.format_exception(error))
        reason = f"unexpected {type(error).__name__}: {error}"
        failure = {**row, "state": FAILED, "reason": reason, "traceback": told}
    else:
        times = {
            "cpu_s": round(time.process_time() - begun_cpu_s, 3),
            "wall_s": round(time.monotonic() - begun_s, 3),
            "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MB),
        }
        return results.publish(name, {**row, "state": DONE, **found, **times}, cloud)
    # A disk that went away meanwhile looks like a damaged scan: only one that is still there as it was is to blame itself.
    if _name(job, folder) != name:
        raise _Gone(f"{host}: {folder} changed while it was worked through: {failure['reason']}")
    return results.publish_failure(name, failure)


def _name(job: Job, folder: Path) -> str:
    """Return the name of the scan's result: of its manifest, and of what decides about its points and is not in there."""
    try:
        return name_of(folder, ())
    except FileNotFoundError as error:
        raise _Gone(f"{socket.gethostname()}: {folder} is not there any more") from error


def _recorded(folder: Path) -> str | None:
    """Return when a scan was taken, as its manifest says; also for one whose frames cannot be used."""
    try:
        return manifest_of(folder).record.wall_time
    except ScanError:
        return None


def _wish(job: Job) -> Wish:
    return Wish(calibration=None if job.calibration is None else Path(job.calibration), foreign=job.foreign)


def _worked_through(job: Job, folder: Path) -> tuple[Row, Any]:
    refuse_damaged_frames(folder)
    wish = _wish(job)
    source = open_source(folder, wish)
    chosen = calibration_for(source, wish)
    if job.water is not None:
        source = _in_water(source, job.water, chosen.calibration)
    worked = work_through(source.scan, source.rig, chosen.calibration, lambda _: None)
    record, summary = source.scan.manifest.record, worked.cloud.summary
    found: Row = {
        "points": summary.points,
        "coverage_percent": summary.coverage_percent,
        "distance_mm": summary.distance_mm,
        "noise_mm": summary.noise_mm,
        "gap_mm": summary.gap_mm,
        "exposure": exposures_label(record, source.rig),
        "grade": worked.grade.value,
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
