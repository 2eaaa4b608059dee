"""Owns the verbs ``reprocess`` and ``season``: all scans of an archive reprocessed, and one page about what came of it."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from appliance.cli.arguments import Verb, number, operand, option, part_of, switch, whole
from appliance.cli.desk import measuring, writable_page, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, Progress, UsageError, say, say_json
from appliance.storage.atomic import replace_file
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import LibraryFolder

if TYPE_CHECKING:  # brings NumPy and the kernels
    from appliance.offline.anew.coordinator import Worked
    from appliance.offline.anew.local import LocalEngine
    from appliance.offline.anew.many import ManyEngine
    from appliance.offline.anew.task import Job
    from appliance.offline.scan_list import ListedScan, ScanList

LIMIT_S = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Reprocess(Verb):
    """Work through every scan below SOURCE that has no result yet; FAILED if one has none afterwards."""

    source: Path = operand("SOURCE", "storage root, packed or not", parse=Path)
    out: Path | None = option(
        "--out", "folder of results, one below it for each calibration, program and setting", parse=Path, metavar="DIR"
    )
    calibration: Path | None = option("--calibration", "default: each scan's own", parse=Path, metavar="FILE")
    foreign_calibration: bool = switch("--foreign-calibration", "also if it is another instrument's")
    temperature_c: float | None = option(
        "--temperature-c", "of the water, instead of what was recorded", parse=number(-2, 40)
    )
    salinity_psu: float | None = option(
        "--salinity-psu", "of the water, together with its temperature", parse=number(0, 45)
    )
    list: Path | None = option(
        "--list", "which artefacts some scans show, as for `evaluate`", parse=Path, metavar="LIST"
    )
    part: tuple[int, int] | None = option(
        "--part", "only the K-th of N parts of the scans: several calls share an archive", parse=part_of, metavar="K/N"
    )
    table_only: bool = switch("--table-only", "no clouds: rows of the table only")
    all: bool = switch("--all", "also the rejected ones")
    workers: int | None = option(
        "--workers", "processes on this computer (default: its cores)", parse=whole(1, 256), metavar="N", either="where"
    )
    scheduler: str | None = option(
        "--scheduler", "address of a scheduler of Dask's: work on its workers", metavar="ADDRESS", either="where"
    )
    limit_s: float = option(
        "--limit-s", "time for one scan before it is begun again (600)", default=LIMIT_S, parse=number(1, 86_400)
    )

    def run(self) -> Exit:
        """Raises UsageError, StorageError, CalibrationError, SchedulerError, MissingLibraryError."""
        if self.out is None:
            raise UsageError("--out is missing; give the folder for the results")
        if (self.temperature_c is None) != (self.salinity_psu is None):
            raise UsageError("--temperature-c and --salinity-psu: give both or neither")
        if not (self.source / LibraryFolder.SCANS.value).is_dir():
            raise UsageError(f"SOURCE {self.source}: no storage root; give the folder that holds scans/")
        measuring(self.calibration)
        folders, scans = self._scans()
        begun_s = time.monotonic()
        if self.scheduler is None:
            compile_kernels()  # once, before any worker starts: each of them would compile the same minute
        from appliance.offline.anew.results import Results

        made, settings = self._jobs(folders, scans)
        results = Results.of(self.out.absolute(), settings)
        jobs = [job(str(results.folder)) for job in made]
        with results.call(f"{self.source.resolve()} {self.part}"):
            swept = results.sweep()
            worked, started_s = self._work(jobs, begun_s)
            swept += results.sweep()
            table = results.write_table((*worked.rows, *worked.left))
        self._tell(
            worked,
            {
                "key": results.key,
                "table": str(table),
                "drafts_swept": swept,
                "start_s": started_s,
                "s": time.monotonic() - begun_s,
            },
        )
        return (
            Exit.OK
            if len(worked.rows) == len(jobs) and not any(row["state"] == "failed" for row in worked.rows)
            else Exit.FAILED
        )

    def _scans(self) -> tuple[Sequence[Path], ScanList | None]:
        """Return the folders of this call's scans, and the list of artefacts where there is one. Raises UsageError, before any work."""
        from appliance.storage.archive import scan_folders

        scans = None
        if self.list is not None:
            from appliance.offline.scan_list import ListError, read_list

            try:
                scans = read_list(self.list)
            except ListError as error:
                raise UsageError(str(error)) from error
        shelves = (LibraryFolder.SCANS, LibraryFolder.REJECTED) if self.all else (LibraryFolder.SCANS,)
        folders = list(scan_folders(self.source, shelves))
        if not folders:
            raise UsageError(
                f"SOURCE {self.source}: there is no scan in it{'' if self.all else '; --all takes the rejected ones, too'}"
            )
        if unknown := sorted(_listed(scans).keys() - {folder.name.lstrip("0") for folder in folders}):
            raise UsageError(
                f"--list {self.list}: scan {', '.join(unknown)} is not below {self.source}; name the scans by their numbers"
            )
        if self.part is not None:
            number, of = self.part
            folders = folders[number - 1 :: of]
            if not folders:
                raise UsageError(f"--part {number}/{of}: there are fewer scans than parts; give fewer parts")
        return folders, scans

    def _jobs(
        self, folders: Sequence[Path], scans: ScanList | None
    ) -> tuple[Sequence[Callable[[str], Job]], dict[str, object]]:
        """Return what makes each job, given the folder of results, and the settings that the key stands for."""
        from appliance.calibration import file as calibration_file
        from appliance.offline.anew.program import program_digits
        from appliance.offline.anew.task import Job

        water = (
            None if self.temperature_c is None or self.salinity_psu is None else (self.temperature_c, self.salinity_psu)
        )
        listed = _listed(scans)
        calibration = None if self.calibration is None else str(self.calibration.absolute())
        digits = None if self.calibration is None else calibration_file.load(self.calibration).hash
        settings: dict[str, object] = {
            "calibration": digits,
            "foreign": self.foreign_calibration,
            "water": water,
            "clouds": not self.table_only,
            "program": program_digits(),
            "list": None if scans is None else repr(scans),
        }

        def made(folder: Path) -> Callable[[str], Job]:
            return lambda results: Job(
                str(folder.absolute()), results, calibration, digits, self.foreign_calibration, water, not self.table_only, program_digits(),
                listed.get(folder.name.lstrip("0")), 0.0 if scans is None else scans.reference_mm,
            )  # fmt: skip

        return [made(folder) for folder in folders], settings

    def _engine(self, like: Job) -> AbstractContextManager[LocalEngine] | AbstractContextManager[ManyEngine]:
        from appliance.offline.anew.local import LocalEngine
        from appliance.offline.anew.many import ManyEngine

        if self.scheduler is not None:
            return ManyEngine(self.scheduler, self.limit_s, like)
        return LocalEngine(self.workers or len(os.sched_getaffinity(0)), self.limit_s)

    def _work(self, jobs: Sequence[Job], begun_s: float) -> tuple[Worked, float]:
        from appliance.offline.anew.coordinator import work_through_all

        with Progress() as progress, self._engine(jobs[0]) as engine:
            started_s = time.monotonic() - begun_s
            return work_through_all(jobs, engine, _Said(progress)), started_s

    def _tell(self, worked: Worked, facts: dict[str, object]) -> None:
        failed = [row for row in worked.rows if row["state"] == "failed"]
        counts = {
            "done": len(worked.rows) - len(failed),
            "failed": len(failed),
            "left": len(worked.left),
            "not_begun": worked.not_begun,
            "lost_workers": worked.lost,
            "left_out": dict(worked.left_out),
        }
        if self.json:
            say_json({**counts, **facts, "stopped": worked.stopped, "rows": [*worked.rows, *worked.left]})
            return
        for place, reason in worked.left_out.items():
            say(f"{place}  got no more scans: {reason}")
        for row in (*failed, *worked.left):
            say(f"{row['scan']}  {'failed' if row['state'] == 'failed' else 'left for the next call'}: {row['reason']}")
        if worked.stopped is not None:
            say(f"stopped: {worked.stopped}")
        say(
            f"{counts['done']} done, {counts['failed']} failed, {len(worked.left) + worked.not_begun} left; {facts['table']}"
        )


def _listed(scans: ScanList | None) -> dict[str, ListedScan]:
    """Return the entries of a list by the scan's number without leading zeros."""
    return {} if scans is None else {Path(one.scan).name.lstrip("0"): one for one in scans.entries}


class _Said:
    """Says how far it is, and how long it will take."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def __call__(self, done: int, of: int, left_s: float | None) -> None:
        left = "" if left_s is None else f", {_time(left_s)} left"
        self._progress(f"{done} of {of} scans{left}", done / of if of else None)


def _time(seconds: float) -> str:
    minutes = math.ceil(seconds / 60.0)
    return f"{seconds:.0f} s" if seconds < 90 else f"{minutes} min" if minutes < 90 else f"{minutes / 60:.1f} h"


@dataclass(frozen=True, slots=True, kw_only=True)
class Season(Verb):
    """One page about a table: lengths over time, health of the calibration, water, refused scans and why."""

    kernels: ClassVar[bool] = False

    table: Path = operand("TABLE", "table.csv of `kingfisher reprocess`", parse=Path)
    out: Path | None = option("--out", "default: season.html here", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        """Raises UsageError, ResultsError, StorageError."""
        from appliance.offline.anew.results import TABLE, read_table
        from appliance.offline.anew.season import season_page

        page = self.out or Path("season.html")
        writable_page(page)
        rows = read_table(self.table)
        if not rows:
            raise UsageError(
                f"TABLE {self.table}: has no scan in it; give the {TABLE} of a finished `kingfisher reprocess`"
            )
        with writing(page):
            replace_file(LocalFileSystem(), page, season_page(rows, str(self.table)).encode())
        say_json({"page": str(page), "scans": len(rows)}) if self.json else say(f"{page}  {len(rows)} scans")
        return Exit.OK
