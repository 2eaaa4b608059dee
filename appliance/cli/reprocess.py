"""Owns the verbs ``reprocess`` and ``season``: all scans of an archive reprocessed, and one page about what came of it."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from appliance.base import require
from appliance.cli.arguments import Verb, number, operand, option, switch, whole
from appliance.cli.desk import measuring, writable_page, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, Progress, UsageError, say, say_json, time_text
from appliance.store import LibraryFolder, LocalFileSystem, hold_lock, replace_file, scan_folders

if TYPE_CHECKING:  # brings NumPy
    from appliance.store import ListedScan, ScanList


@dataclass(frozen=True, slots=True, kw_only=True)
class Reprocess(Verb):
    """Work through every scan below SOURCE that has no result yet; FAILED if one has none afterwards."""

    source: Path = operand("SOURCE", "storage root, packed or not", parse=Path)
    out: Path | None = option("--out", "folder of results, one below it for each setting", parse=Path, metavar="DIR")
    calibration: Path | None = option("--calibration", "default: each scan's own", parse=Path, metavar="FILE")
    foreign_calibration: bool = switch("--foreign-calibration", "also if it is another instrument's")
    temperature_c: float | None = option("--temperature-c", "of the water, not the recorded", parse=number(-2, 40))
    salinity_psu: float | None = option("--salinity-psu", "together with the temperature", parse=number(0, 45))
    list: Path | None = option("--list", "which artefacts are shown, as for `evaluate`", parse=Path, metavar="LIST")
    table_only: bool = switch("--table-only", "no clouds: rows of the table only")
    all: bool = switch("--all", "also the rejected ones")
    workers: int | None = option(
        "--workers", "processes of this computer (default: its cores)", parse=whole(1, 256), metavar="N", either="where"
    )
    scheduler: str | None = option(
        "--scheduler", "address of a scheduler of Dask's: work on its workers", metavar="ADDRESS", either="where"
    )
    limit_s: float = option(
        "--limit-s", "time for one scan before it is begun again (600)", default=600.0, parse=number(1, 86_400)
    )

    def run(self) -> Exit:
        """Raises UsageError, ListError, StorageError, CalibrationError, SchedulerError, MissingLibraryError."""
        if self.out is None:
            raise UsageError("--out is missing; give the folder for the results")
        if (self.temperature_c is None) != (self.salinity_psu is None):
            raise UsageError("--temperature-c and --salinity-psu: give both or neither")
        if not (self.source / LibraryFolder.SCANS.value).is_dir():
            raise UsageError(f"SOURCE {self.source}: no storage root; give the folder that holds scans/")
        measuring(self.calibration)
        folders, scans, listed = self._scans()
        for library in ("distributed", "cryptography"):
            require(library, library, "reprocess")
        begun_s = time.monotonic()
        if self.scheduler is None:
            compile_kernels()  # once, before any worker starts: each of them would compile the same minute
        from appliance.desk import AGAIN, DONE, FAILED, Job, Results, program_digits, work_through_all
        from appliance.store import load_calibration

        results = Results.of(
            self.out.absolute(),
            {
                "calibration": None if self.calibration is None else load_calibration(self.calibration).hash,
                "foreign": self.foreign_calibration,
                "water": None if self.temperature_c is None else (self.temperature_c, self.salinity_psu),
                "clouds": not self.table_only,
                "program": program_digits(),
                "list": None if scans is None else repr(scans),
                "reference_mm": 0.0 if scans is None else scans.reference_mm,
            },
        )
        calibration = None if self.calibration is None else str(self.calibration.absolute())
        jobs = [
            Job(str(folder.absolute()), str(results.folder), calibration, listed.get(_number(folder)))
            for folder in folders
        ]
        rows = []
        with hold_lock(results.folder), Progress() as progress:
            swept = results.sweep()
            with closing(work_through_all(jobs, self.scheduler, self.workers, self.limit_s)) as coming:
                for row in coming:
                    rows.append(row)
                    left = time_text((time.monotonic() - begun_s) / len(rows) * (len(jobs) - len(rows)))
                    progress(f"{len(rows)} of {len(jobs)} scans, {left} left", len(rows) / len(jobs))
            table = results.write_table(rows)
        count = Counter(row["state"] for row in rows)
        not_begun = len(jobs) - len(rows)
        stopped = str(rows[-1]["reason"]) if not_begun else None
        if self.json:
            say_json(
                {
                    "done": count[DONE], "failed": count[FAILED], "left": count[AGAIN], "not_begun": not_begun, "key": results.folder.name,
                    "table": str(table), "drafts_swept": swept, "s": time.monotonic() - begun_s, "stopped": stopped, "rows": rows,
                }
            )  # fmt: skip
        else:
            said = {FAILED: "failed", AGAIN: "left for the next call"}
            for row in rows:
                if row["state"] in said:
                    say(f"{row['scan']}  {said[row['state']]}: {row['reason']}")
            say(f"{count[DONE]} done, {count[FAILED]} failed, {count[AGAIN] + not_begun} left; {table}")
        return Exit.OK if count[DONE] == len(jobs) else Exit.FAILED

    def _scans(self) -> tuple[Sequence[Path], ScanList | None, Mapping[str, ListedScan]]:
        """Return the folders of the scans, and the list of artefacts with its entries by their number. Raises UsageError, ListError, before any work."""
        shelves = (LibraryFolder.SCANS, LibraryFolder.REJECTED) if self.all else (LibraryFolder.SCANS,)
        folders = scan_folders(self.source, shelves)
        if not folders:
            raise UsageError(
                f"SOURCE {self.source}: there is no scan in it{'' if self.all else '; --all takes the rejected ones, too'}"
            )
        from appliance.store import read_list

        scans = None if self.list is None else read_list(self.list)
        listed = {} if scans is None else {_number(Path(one.scan)): one for one in scans.entries}
        if unknown := sorted(listed.keys() - {_number(folder) for folder in folders}):
            raise UsageError(
                f"--list {self.list}: scan {', '.join(unknown)} is not below {self.source}; name the scans by their numbers"
            )
        return folders, scans, listed


def _number(folder: Path) -> str:
    """Return a scan's number without leading zeros."""
    return folder.name.lstrip("0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Season(Verb):
    """One page about a table: lengths over time, health of the calibration, water, refused scans and why."""

    kernels: ClassVar[bool] = False

    table: Path = operand("TABLE", "table.csv of `kingfisher reprocess`", parse=Path)
    out: Path | None = option("--out", "default: season.html here", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        """Raises UsageError, ResultsError, StorageError."""
        from appliance.desk import read_table, season_page

        page = self.out or Path("season.html")
        writable_page(page)
        rows = read_table(self.table)
        with writing(page):
            replace_file(LocalFileSystem(), page, season_page(rows, str(self.table)).encode())
        say_json({"page": str(page), "scans": len(rows)}) if self.json else say(f"{page}  {len(rows)} scans")
        return Exit.OK
