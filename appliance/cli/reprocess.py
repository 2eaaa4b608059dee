"""The verb ``archive reprocess``: all scans of an archive reprocessed, here or on many computers."""

from __future__ import annotations

import time
from argparse import ArgumentTypeError
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.base import require
from appliance.cli.archive import storage_root
from appliance.cli.arguments import Verb, number, operand, option, path_option, switch, whole
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError, time_text
from appliance.cli.places import measuring
from appliance.store import Library, hold_lock

if TYPE_CHECKING:  # brings NumPy
    from appliance.store import ListedScan, ScanList


def _water(text: str) -> tuple[float, float]:
    temperature_c, _, salinity_psu = text.partition(",")
    return number(-2, 40, "°C")(temperature_c), number(0, 45, "PSU")(salinity_psu)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reprocess(Verb):
    """Work through every scan below SOURCE that has no result yet; FAILED if one has none afterwards."""

    source: Path = operand("SOURCE", "storage root, packed or not", parse=Path)
    list: Path | None = operand(
        "LIST", "which artefacts are shown, as for `kingfisher evaluate`", parse=Path, optional=True
    )
    out: Path | None = path_option("--out", "folder of results, one below it for each setting", metavar="DIR")
    calibration: Path | None = path_option("--calibration", "default: each scan's own")
    foreign_calibration: bool = switch("--foreign-calibration", "also if it is another instrument's")
    water: tuple[float, float] | None = option(
        "--water", "temperature in °C and salinity in PSU of the water, not the recorded", parse=_water, metavar="C,PSU"
    )
    table_only: bool = switch("--table-only", "no clouds: rows of the table only")
    all: bool = switch("--all", "also the rejected ones")
    workers: str | None = option(
        "--workers",
        "processes of this computer (default: its cores), or the address of a scheduler of Dask's: work on its workers",
        metavar="N | ADDRESS",
    )
    timeout_s: float = option(
        "--timeout-s", "time for one scan before it is begun again (600)", default=600.0, parse=number(1, 86_400)
    )

    def run(self) -> Exit:
        """Raises UsageError, ListError, StorageError, CalibrationError, SchedulerError, MissingLibraryError."""
        if self.out is None:
            raise UsageError("--out is missing; give the folder for the results")
        storage_root("SOURCE", self.source)
        workers, scheduler = self._workers()
        measuring(self.calibration)
        folders, scans, listed = self._scans()
        for library in ("distributed", "cryptography"):
            require(library, library, "reprocess")
        begun_s = time.monotonic()
        if scheduler is None:
            compile_kernels()  # once, before any worker starts: each of them would compile the same minute
        from appliance.desk import AGAIN, DONE, FAILED, Job, Results, program_digits, work_through_all
        from appliance.store import load_calibration

        results = Results.of(
            self.out.absolute(),
            {
                "calibration": None if self.calibration is None else load_calibration(self.calibration).hash,
                "foreign": self.foreign_calibration,
                "water": self.water,
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
        with hold_lock(results.folder), ProgressLine() as progress:
            swept = results.sweep()
            with closing(work_through_all(jobs, scheduler, workers, self.timeout_s)) as coming:
                for row in coming:
                    rows.append(row)
                    left = time_text((time.monotonic() - begun_s) / len(rows) * (len(jobs) - len(rows)))
                    progress(f"{len(rows)} of {len(jobs)} scans, {left} left", len(rows) / len(jobs))
            table = results.write_table(rows)
        count = Counter(row["state"] for row in rows)
        not_begun = len(jobs) - len(rows)
        stopped = str(rows[-1]["reason"]) if not_begun else None
        said = {FAILED: "failed", AGAIN: "left for the next call"}
        self.tell(
            {
                "done": count[DONE], "failed": count[FAILED], "left": count[AGAIN], "not_begun": not_begun, "key": results.folder.name,
                "table": str(table), "drafts_swept": swept, "s": time.monotonic() - begun_s, "stopped": stopped, "rows": rows,
            },
            [
                *(f"{row['scan']}  {said[row['state']]}: {row['reason']}" for row in rows if row["state"] in said),
                f"{count[DONE]} done, {count[FAILED]} failed, {count[AGAIN] + not_begun} left; {table}",
            ],
        )  # fmt: skip
        return Exit.OK if count[DONE] == len(jobs) else Exit.FAILED

    def _workers(self) -> tuple[int | None, str | None]:
        """Return how many processes, or the address of a scheduler. Raises UsageError."""
        if self.workers is None or not self.workers.lstrip("-").isdigit():
            return None, self.workers
        try:
            return whole(1, 256)(self.workers), None
        except ArgumentTypeError as error:
            raise UsageError(f"--workers {error}, or the address of a scheduler") from error

    def _scans(self) -> tuple[Sequence[Path], ScanList | None, Mapping[str, ListedScan]]:
        """Return the folders of the scans, and the list of artefacts with its entries by their number. Raises
        UsageError, ListError, before any work."""
        folders = Library(self.source).folders(every=self.all)
        if not folders:
            raise UsageError(
                f"SOURCE {self.source}: there is no scan in "
                f"it{'' if self.all else '; --all takes the rejected ones, too'}"
            )
        from appliance.store import ScanList

        scans = None if self.list is None else ScanList.read(self.list)
        listed = {} if scans is None else {_number(Path(one.scan)): one for one in scans.entries}
        if unknown := sorted(listed.keys() - {_number(folder) for folder in folders}):
            raise UsageError(
                f"LIST {self.list}: scan {', '.join(unknown)} is not below {self.source}; name the scans by their "
                f"numbers"
            )
        return folders, scans, listed


def _number(folder: Path) -> str:
    """Return a scan's number without leading zeros."""
    return folder.name.lstrip("0")
