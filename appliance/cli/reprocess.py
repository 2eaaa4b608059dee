"""The verb ``archive reprocess``: all scans of an archive reprocessed, here or on many computers."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.base import require
from appliance.cli.archive import storage_root
from appliance.cli.arguments import Verb, number, operand, option, path_option, switch, whole_number
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine, UsageError
from appliance.cli.places import reject_air_calibration
from appliance.store import Library

if TYPE_CHECKING:  # brings NumPy
    from appliance.store import ListedScan, ScanList


def _water(text: str) -> tuple[float, float]:
    temperature_c, _, salinity_psu = text.partition(",")
    return number(-2, 40, "°C")(temperature_c), number(0, 45, "PSU")(salinity_psu)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reprocess(Verb):
    """Reprocess every scan below SOURCE that has no result yet; FAILED if any has none afterwards."""

    source: Path = operand("SOURCE", "storage root, packed or not", parse=Path)
    list: Path | None = operand(
        "LIST", "the list of scans and their artefacts, as for `kingfisher evaluate`", parse=Path, optional=True
    )
    out: Path | None = path_option(
        "--out", "folder of the results, with a folder for each set of options", metavar="DIR"
    )
    calibration: Path | None = path_option("--calibration", "calibration file (default: that of each scan)")
    foreign_calibration: bool = switch("--foreign-calibration", "accept the calibration of another instrument")
    water: tuple[float, float] | None = option(
        "--water",
        "temperature in °C and salinity in PSU of the water, instead of the recorded ones",
        parse=_water,
        metavar="C,PSU",
    )
    table_only: bool = switch("--table-only", "write the table only, no clouds")
    all: bool = switch("--all", "also rejected scans")
    workers: str | None = option(
        "--workers",
        "number of processes here (default: one a core), or address of a Dask scheduler, whose workers are used",
        metavar="N | ADDRESS",
    )
    timeout_s: float = option(
        "--timeout-s",
        "longest time for one scan; it is then started again (600)",
        default=600.0,
        parse=number(1, 86_400),
    )

    def run(self) -> Exit:
        """Reprocess the scans.

        Raises UsageError, ListError, StorageError, CalibrationError, SchedulerError, MissingLibraryError.
        """
        if self.out is None:
            raise UsageError("--out is missing; give the folder for the results")
        storage_root("SOURCE", self.source)
        workers, scheduler = self._workers()
        reject_air_calibration(self.calibration)
        folders, scans = self._scans()
        for library in ("distributed", "cryptography"):
            require(library, library, "reprocess")
        if scheduler is None:
            compile_kernels()  # once, because otherwise each worker would compile
        from appliance.desk import ArchiveWork

        work = ArchiveWork(
            folders=folders,
            out=self.out,
            scans=scans,
            calibration=self.calibration,
            foreign=self.foreign_calibration,
            water=self.water,
            clouds=not self.table_only,
            scheduler=scheduler,
            workers=workers,
            limit_s=self.timeout_s,
        )
        with ProgressLine() as progress:
            report, lines = work.run(progress)
        self.tell(report, lines)
        return Exit.OK if report["done"] == len(folders) else Exit.FAILED

    def _workers(self) -> tuple[int | None, str | None]:
        """Return the number of processes, or the address of a scheduler. Raises UsageError."""
        if self.workers is None or not self.workers.lstrip("-").isdigit():
            return None, self.workers
        try:
            return whole_number(1, 256)(self.workers), None
        except ArgumentTypeError as error:
            raise UsageError(f"--workers {error}, or the address of a scheduler") from error

    def _scans(self) -> tuple[Mapping[Path, ListedScan | None], ScanList | None]:
        """Return the folders of the scans with their entries in the list of artefacts, and that list.

        Raises UsageError, ListError before any work.
        """
        folders = Library(self.source).folders(every=self.all)
        if not folders:
            raise UsageError(
                f"SOURCE {self.source}: has no scan{'' if self.all else '; --all includes rejected scans'}"
            )
        from appliance.store import ScanList

        scans = None if self.list is None else ScanList.read(self.list)
        listed = {} if scans is None else {_number(Path(entry.scan)): entry for entry in scans.entries}
        if unknown := sorted(listed.keys() - {_number(folder) for folder in folders}):
            raise UsageError(
                f"LIST {self.list}: scan {', '.join(unknown)} is not below {self.source}; name the scans by their "
                f"numbers"
            )
        return {folder: listed.get(_number(folder)) for folder in folders}, scans


def _number(folder: Path) -> str:
    """Return a scan's number without leading zeros."""
    return folder.name.lstrip("0")
