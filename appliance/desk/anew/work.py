"""Reprocessing of every scan of an archive, once each, by Dask on this computer or in workers on many.

* ``ArchiveWork``, ``work_through_all``: the distribution. Dask notices a worker that dies, and gives its scans to others;
  a scan that exceeds its limit ends its worker. Importing this module compiles no kernels: a worker must be told where
  they are before it imports any.
* ``attempt``: one scan: a job in, a row out, in any process, any number of times. It knows of no processes or networks.
  A fault of the scan itself is a result, stored with its reason; a fault of the machine (a full disk, no memory, another
  program, a folder that it does not see) is raised, and not stored.
"""

from __future__ import annotations

import faulthandler
import logging
import os
import resource
import socket
import time
import traceback
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from appliance.base import (
    KernelOrigin,
    MissingLibraryError,
    Progress,
    missing_kernels,
    needed,
    raise_if_interrupted,
    silent,
    use_kernel_cache,
)
from appliance.desk.anew.results import Results, Row, name_of, program_digits
from appliance.desk.evaluation import run_evaluation
from appliance.desk.reconstruct import work_through
from appliance.measure import SPOILS_SCAN, Calibration, CalibrationError, NotFound
from appliance.store import (
    Instrument,
    ListedScan,
    ScanError,
    ScanList,
    ScanOptions,
    SourceScan,
    StorageError,
    StoredScan,
    encode_ply,
    hold_lock,
    load_calibration,
)

_MB = 1024.0
_PASSED_WORDS = {True: "yes", False: "no", None: "-"}


def attempt(job: Job) -> Row:
    """Reprocess one scan, publish its result or the reason of its failure, and return the row.

    If it has a result already, that is returned. Raises RetryError, StorageError, OSError, MemoryError, MissingLibraryError
    if this computer cannot do it.
    """
    results, folder = Results(Path(job.results)), Path(job.folder)
    settings = results.settings
    _refuse_unfit(job, settings)
    options = ScanOptions(
        calibration=None if job.calibration is None else Path(job.calibration), foreign=settings["foreign"]
    )
    name = name_of(folder)
    if (published := results.row(name)) is not None:
        return published
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    row: Row = {"scan": folder.name, "folder": job.folder, "host": socket.gethostname(), "result": name}
    try:
        row["recorded"] = StoredScan.manifest_of(folder).record.wall_time
        figures, cloud = _reprocess(job, settings, options)
    except (ScanError, CalibrationError) as error:
        failure = {"reason": str(error)}
    except (StorageError, OSError, MemoryError, MissingLibraryError, ImportError):
        raise
    except Exception as error:
        raise_if_interrupted(error)
        # A bug of the program ends this scan alone, and neither the process nor other scans.
        traceback_text = "".join(traceback.format_exception(error))
        failure = {"reason": f"unexpected {type(error).__name__}: {error}", "traceback": traceback_text}
    else:
        times = {
            "cpu_s": round(time.process_time() - start_cpu_s, 3),
            "wall_s": round(time.monotonic() - start_s, 3),
            "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MB),
        }
        return results.publish(name, {**row, "state": DONE, **figures, **times}, cloud)
    # A disk that was removed meanwhile looks like a damaged scan: a failure counts only if the scan is unchanged.
    if name_of(folder) != name:
        raise RetryError(f"{folder} changed during reprocessing: {failure['reason']}")
    return results.publish_failure(name, {**row, "state": FAILED, **failure})


def _refuse_unfit(job: Job, settings: Mapping[str, Any]) -> None:
    """Raise RetryError, with reason and remedy, if this computer cannot do jobs like ``job``.

    It is cheap enough for every scan.
    """
    if settings["program"] != program_digits():
        # Results of two programs must not share one key.
        raise RetryError(
            f"has {program_digits()}, not {settings['program']}; install the same version on all computers"
        )
    if not Path(job.folder).is_dir():
        raise RetryError(f"has no {job.folder}; mount SOURCE there under the same path")
    # The key is from the caller's file: results with a file that was replaced since would get a wrong key.
    if job.calibration is not None and load_calibration(Path(job.calibration)).hash != settings["calibration"]:
        raise RetryError(f"has another calibration in {job.calibration}; make the file the same there, and call again")


def _reprocess(job: Job, settings: Mapping[str, Any], options: ScanOptions) -> tuple[Row, Any]:
    source = SourceScan.open(Path(job.folder), options, whole=True)
    chosen = source.calibration_for(options)
    if settings["water"] is not None:
        source = _in_water(source, settings["water"], chosen.calibration)
    reprocessed = work_through(source.scan, source.rig, chosen.calibration, silent)
    record = source.scan.manifest.record
    row: Row = {
        **asdict(reprocessed.cloud.summary),
        "exposure": Instrument(source.rig).exposures_label(record),
        "grade": reprocessed.grade.value,
        "spoilt": any(fault.code in SPOILS_SCAN for fault in reprocessed.faults),
        "faults": "; ".join(f"{fault.code.value}: {fault.detail}" for fault in reprocessed.faults),
        "verdicts": " ".join(
            f"{judgement.verdict.name}={_PASSED_WORDS[judgement.verdict.passed]}"
            for judgement in reprocessed.judgements
        ),
        "temperature_c": reprocessed.water.temperature_c,
        "salinity_psu": reprocessed.water.salinity_psu,
        "water_index": reprocessed.water.index,
        "calibration": chosen.calibration.hash,
        "same_calibration": chosen.calibration.hash == record.calibration_hash,
        "recorded_by_version": record.software_version,
    }
    if job.listed is not None:
        row |= _lengths(job.listed, settings["reference_mm"], source, chosen.calibration)
    return row, encode_ply(reprocessed.cloud) if settings["clouds"] else None


def _in_water(source: SourceScan, water_of: Sequence[float], calibration: Calibration) -> SourceScan:
    manifest, recorded = source.scan.manifest, source.scan.manifest.record.water
    colour_nm = recorded.get("wavelength_nm")
    water = {
        **recorded,
        "temperature_c": water_of[0],
        "salinity_psu": water_of[1],
        # Without a wavelength the recorded water counts as unknown, and this one would be ignored silently.
        "wavelength_nm": calibration.water.wavelength_nm if colour_nm is None else colour_nm,
    }
    record = replace(manifest.record, water=water)
    return replace(source, scan=replace(source.scan, manifest=replace(manifest, record=record)))


def _lengths(listed: ListedScan, reference_mm: float, source: SourceScan, calibration: Calibration) -> Row:
    """Return the results of ``kingfisher evaluate`` for the scan's artefact, with its own quality limits."""
    scans = ScanList((listed,), None, reference_mm)
    evaluation = run_evaluation(scans, (source,), calibration, lambda *_: None)
    (item,) = evaluation.items
    if isinstance(item.result.fit, NotFound):
        return {"artefact": listed.artefact.value, "reason": f"not evaluated: {item.result.fit.reason}"}
    errors = [length.measured_mm - length.calibrated_mm for length in item.result.lengths]
    worst = item.result.worst_e_l
    return {
        "artefact": listed.artefact.value,
        "e_l_percent": None if worst is None else 100.0 * worst,
        "length_error_mm": max(errors, key=abs, default=None),
    }


DONE, FAILED, AGAIN = "done", "failed", "again"
"""States of a row; a row with the last one is never published."""
RETRIES = 2
"""Number of further tries of a scan after faults of a machine, before it is left for the next call."""
TROUBLES_IN_A_ROW = 8
"""Number of scans in a row without a result after which the call ends: the disk is full, or a worker sees no scans."""
IN_WORK = 1000
"""Number of scans that Dask holds at a time, so that neither its memory nor ours grows with the archive."""
CONNECT_S = 30.0
WORKER_MEMORY = "3GB"
"""Memory at which Dask starts a process of this computer again; one that reprocesses stays below half of it."""

_UNINTERRUPTED = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Code that makes Dask's processes ignore Ctrl-C, which reaches every process of a terminal: this process ends them."""


class RetryError(Exception):
    """A scan cannot be done now, or not on this computer, through no fault of its own; the text says why."""


class SchedulerError(Exception):
    """The scheduler cannot be reached, or has no worker; the text names the fault and the remedy."""


@dataclass(frozen=True, slots=True)
class Job:
    """Task of one scan: small, and the same bytes on every computer."""

    folder: str
    """Folder of the scan; every computer must see it there."""
    results: str
    """Folder of the results of this key, which holds the settings."""
    calibration: str | None
    """Calibration file; ``None``: each scan's own."""
    listed: ListedScan | None
    """The artefact in the scan; ``None``: no known one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveWork:
    """Reprocessing of an archive: its scans, settings and workers."""

    folders: Mapping[Path, ListedScan | None]
    """Folders of the scans, and the artefact in each; ``None``: no known one."""
    out: Path
    """Folder of results, with one folder below it for each key."""
    scans: ScanList | None
    """The list with the artefacts."""
    calibration: Path | None
    """``None``: each scan's own."""
    foreign: bool
    water: tuple[float, float] | None
    """Temperature in °C and salinity in PSU; ``None``: as recorded."""
    clouds: bool
    scheduler: str | None
    workers: int | None
    limit_s: float
    """Time limit for one scan, after which it is started again."""

    def run(self, progress: Progress) -> tuple[dict[str, Any], list[str]]:
        """Reprocess every scan without a result, and write the table.

        The results are the report, JSON-ready, and its lines. Raises StorageError, CalibrationError, SchedulerError,
        MissingLibraryError.
        """
        begun_s = time.monotonic()
        results = Results.of(
            self.out.absolute(),
            {
                "calibration": None if self.calibration is None else load_calibration(self.calibration).hash,
                "foreign": self.foreign,
                "water": self.water,
                "clouds": self.clouds,
                "program": program_digits(),
                "list": None if self.scans is None else repr(self.scans),
                "reference_mm": 0.0 if self.scans is None else self.scans.reference_mm,
            },
        )
        calibration = None if self.calibration is None else str(self.calibration.absolute())
        jobs = [
            Job(str(folder.absolute()), str(results.folder), calibration, listed)
            for folder, listed in self.folders.items()
        ]
        rows = []
        with hold_lock(results.folder):
            swept = results.sweep()
            with closing(work_through_all(jobs, self.scheduler, self.workers, self.limit_s)) as coming:
                for row in coming:
                    rows.append(row)
                    left_s = (time.monotonic() - begun_s) / len(rows) * (len(jobs) - len(rows))
                    progress(f"{len(rows)} of {len(jobs)} scans, {left_s / 60.0:.0f} min left", len(rows) / len(jobs))
            table = results.write_table(rows)
        count = Counter(row["state"] for row in rows)
        not_begun = len(jobs) - len(rows)
        state_text = {FAILED: "failed", AGAIN: "left for the next call"}
        lines = [
            f"{row['scan']}  {state_text[row['state']]}: {row['reason']}" for row in rows if row["state"] in state_text
        ]
        lines.append(f"{count[DONE]} done, {count[FAILED]} failed, {count[AGAIN] + not_begun} left; {table}")
        return {
            "done": count[DONE],
            "failed": count[FAILED],
            "left": count[AGAIN],
            "not_begun": not_begun,
            "key": results.folder.name,
            "table": str(table),
            "drafts_swept": swept,
            "s": time.monotonic() - begun_s,
            "stopped": str(rows[-1]["reason"]) if not_begun else None,
            "rows": rows,
        }, lines


def work_through_all(
    jobs: Sequence[Job], scheduler: str | None, processes: int | None, limit_s: float
) -> Generator[Row, None, None]:
    """Yield a row of every job as workers of ``scheduler``, or ``processes`` here, finish them.

    The default of ``processes`` is the number of cores. Ends early if scan after scan is left. Raises SchedulerError,
    MissingLibraryError.
    """
    dask = needed("distributed", "distributed", "reprocess")
    troubles, waiting = 0, iter(jobs)
    with _client(dask, scheduler, processes) as client:
        name = f"reprocess-{uuid4().hex}"

        def submit(max_count: int) -> list[Any]:
            # With one name Dask keeps waiting jobs at its scheduler: a worker that dies is then blamed for one or two
            # scans only.
            return [
                client.submit(do, job, limit_s, key=(name, job.folder), retries=RETRIES, pure=False)
                for job in islice(waiting, max_count)
            ]

        finished = dask.as_completed(submit(IN_WORK))
        for future in finished:
            try:
                row, troubles = future.result(timeout=limit_s), 0
            except Exception as error:  # also Dask's errors if all workers of a scan, or its scheduler, died
                row = {"scan": Path(future.key[1]).name, "folder": future.key[1], "state": AGAIN, "reason": str(error)}
                troubles += 1
            yield row
            if troubles == TROUBLES_IN_A_ROW:
                return
            finished.update(submit(1))


def do(job: Job, limit_s: float) -> Row:
    """Do one job in a worker of Dask (``attempt``).

    Raises RetryError, which names this computer; ends the process after ``limit_s``.
    """
    try:
        _find_kernels()
        from appliance.desk.anew.work import attempt

        # Written in C: it also ends kernels that let no other thread run. Dask starts the worker again, and gives the
        # scan out again.
        faulthandler.dump_traceback_later(limit_s, exit=True)
        return attempt(job)
    except Exception as error:
        reason = str(error) if isinstance(error, RetryError) else f"{type(error).__name__}: {error}"
        # Drop the cause: not every error can be pickled.
        raise RetryError(f"{socket.gethostname()}: {reason}") from None
    finally:
        faulthandler.cancel_dump_traceback_later()


@cache
def _find_kernels() -> None:
    kernels = use_kernel_cache()  # before any kernel is imported
    from appliance.measure import PIECES

    # Else each worker would compile all of them at the same time, for longer than a scan's limit.
    if kernels.origin is not KernelOrigin.GIVEN and missing_kernels(kernels.path, PIECES):
        raise RetryError("its kernels are not compiled; call `kingfisher setup compile` there once")


def _client(dask: Any, scheduler: str | None, processes: int | None) -> Any:
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # rows report lost workers
    if scheduler is None:
        return dask.Client(
            n_workers=processes or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            memory_limit=WORKER_MEMORY,
            dashboard_address=":0",
            security=True,
            silence_logs=logging.CRITICAL,
            preload=_UNINTERRUPTED,
        )
    try:
        client = dask.Client(scheduler, timeout=CONNECT_S, name="kingfisher-reprocess")
        client.wait_for_workers(1, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        # The last two: files for TLS are missing, or the address is without it where Dask's settings require it.
        raise SchedulerError(
            f"--workers {scheduler}: cannot be reached, or has no worker ({error}); start `dask scheduler` and `dask "
            "worker`, "
            "with the same settings of TLS (docs/archive.md)"
        ) from error
    return client
