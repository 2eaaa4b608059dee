"""Owns one scan reprocessed: a job in, a row out, whoever runs it, and as often as somebody does.

Nothing here knows of processes or networks. What is wrong with the scan itself is a result, written down with its reason; what is
wrong with the machine (a full disk, no memory, another program, a folder that it does not see) is raised, and nothing written down.
"""

from __future__ import annotations

import resource
import socket
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from appliance.base import MissingLibraryError, raise_if_interrupted
from appliance.desk.anew.results import Results, Row, name_of, program_digits
from appliance.desk.anew.work import DONE, FAILED, Again, Job
from appliance.desk.evaluation import run_evaluation
from appliance.desk.reconstruct import work_through
from appliance.measure import SPOILS_SCAN, Calibration, CalibrationError, NotFound
from appliance.store import (
    Instrument,
    ListedScan,
    PackedError,
    ScanError,
    ScanList,
    SourceScan,
    StorageError,
    Wish,
    calibration_for,
    encode_ply,
    load_calibration,
    manifest_of,
    open_source,
    refuse_damaged_frames,
)

_MB = 1024.0
_PASSED = {True: "yes", False: "no", None: "-"}


def attempt(job: Job) -> Row:
    """Reprocess one scan, publish its result or why it has none, and return the row; where it has a result, nothing is done.

    Raises Again, StorageError, OSError, MemoryError, MissingLibraryError where this computer cannot.
    """
    results, folder = Results(Path(job.results)), Path(job.folder)
    settings = results.settings
    _refuse_unfit(job, settings)
    wish = Wish(calibration=None if job.calibration is None else Path(job.calibration), foreign=settings["foreign"])
    name = name_of(folder)
    if (published := results.row(name)) is not None:
        return published
    begun_s, begun_cpu_s = time.monotonic(), time.process_time()
    row: Row = {"scan": folder.name, "folder": job.folder, "host": socket.gethostname(), "result": name}
    try:
        row["recorded"] = manifest_of(folder).record.wall_time
        found, cloud = _worked_through(job, settings, wish)
    except (ScanError, CalibrationError, PackedError) as error:
        failure = {"reason": str(error)}
    except (StorageError, OSError, MemoryError, MissingLibraryError, ImportError):
        raise
    except Exception as error:
        raise_if_interrupted(error)
        # A mistake of the program's: it ends this scan, and neither the process nor the others.
        told = "".join(traceback.format_exception(error))
        failure = {"reason": f"unexpected {type(error).__name__}: {error}", "traceback": told}
    else:
        times = {
            "cpu_s": round(time.process_time() - begun_cpu_s, 3),
            "wall_s": round(time.monotonic() - begun_s, 3),
            "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MB),
        }
        return results.publish(name, {**row, "state": DONE, **found, **times}, cloud)
    # A disk that went away meanwhile looks like a damaged scan: only one that is still there as it was is to blame itself.
    if name_of(folder) != name:
        raise Again(f"{folder} changed while it was worked through: {failure['reason']}")
    return results.publish_failure(name, {**row, "state": FAILED, **failure})


def _refuse_unfit(job: Job, settings: Mapping[str, Any]) -> None:
    """Raises Again where this computer can do no job like ``job``; the text says why and what to do. Cheap enough for every scan."""
    if settings["program"] != program_digits():
        # Results of two programs under one key would be neither's.
        raise Again(f"has {program_digits()}, not {settings['program']}; install the same version everywhere")
    if not Path(job.folder).is_dir():
        raise Again(f"does not see {job.folder}; mount SOURCE there under the same path")
    # The key was made from the caller's file: one that was exchanged meanwhile would be published under a wrong key.
    if job.calibration is not None and load_calibration(Path(job.calibration)).hash != settings["calibration"]:
        raise Again(f"sees another calibration in {job.calibration}; let it see the same file, and call again")


def _worked_through(job: Job, settings: Mapping[str, Any], wish: Wish) -> tuple[Row, Any]:
    refuse_damaged_frames(Path(job.folder))
    source = open_source(Path(job.folder), wish)
    chosen = calibration_for(source, wish)
    if settings["water"] is not None:
        source = _in_water(source, settings["water"], chosen.calibration)
    worked = work_through(source.scan, source.rig, chosen.calibration, lambda _: None)
    record = source.scan.manifest.record
    found: Row = {
        **asdict(worked.cloud.summary),
        "exposure": Instrument(source.rig).exposures_label(record),
        "grade": worked.grade.value,
        "spoilt": any(fault.code in SPOILS_SCAN for fault in worked.faults),
        "faults": "; ".join(f"{fault.code.value}: {fault.detail}" for fault in worked.faults),
        "verdicts": " ".join(f"{one.verdict.name}={_PASSED[one.verdict.passed]}" for one in worked.judgements),
        "temperature_c": worked.water.temperature_c,
        "salinity_psu": worked.water.salinity_psu,
        "water_index": worked.water.index,
        "calibration": chosen.calibration.hash,
        "same_calibration": chosen.calibration.hash == record.calibration_hash,
        "recorded_by_version": record.software_version,
    }
    if job.listed is not None:
        found |= _lengths(job.listed, settings["reference_mm"], source, chosen.calibration)
    return found, encode_ply(worked.cloud) if settings["clouds"] else None


def _in_water(source: SourceScan, water_of: Sequence[float], calibration: Calibration) -> SourceScan:
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


def _lengths(listed: ListedScan, reference_mm: float, source: SourceScan, calibration: Calibration) -> Row:
    """Return what ``kingfisher evaluate`` says of the scan's artefact, with its own limits of quality."""
    scans = ScanList((listed,), None, reference_mm)
    evaluation = run_evaluation(scans, (source,), calibration, lambda *_: None)
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
