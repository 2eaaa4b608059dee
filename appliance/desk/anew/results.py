"""Results of reprocessing on the disk: one complete result a scan, for any number of processes.

    <out>/<key>/settings.json           the settings of the key
    <out>/<key>/results/<name>/         row.json, and cloud.ply where clouds were asked for; published by one rename
    <out>/<key>/failed/<name>.json      reason of a failure; tried again by the next call
    <out>/<key>/drafts/                 unfinished results
    <out>/<key>/table.csv               all rows

A name is the scan's number and a hash of its manifest, so that scans of several instruments do not meet. Any number
of processes and computers may make results at once: the first rename wins, and the others see it.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Any

import appliance
from appliance import __version__
from appliance.store import MANIFEST_FILE, Bytes, LocalFileSystem, StorageError, by_number

ROW, CLOUD, TABLE, SETTINGS = "row.json", "cloud.ply", "table.csv", "settings.json"
KEY_DIGITS, NAME_DIGITS = 16, 12
COMPUTING = ("numpy", "scipy", "numba", "llvmlite", "opencv-python-headless")
"""Distributions whose versions may change a point; codecs are not among them, for every decoded frame has its checksum.
"""
COLUMNS = (
    "scan", "state", "reason", "recorded", "points", "coverage_percent", "distance_mm", "noise_mm", "gap_mm", "exposure",
    "grade", "spoilt", "faults", "verdicts", "e_l_percent", "length_error_mm", "artefact", "temperature_c", "salinity_psu", "water_index",
    "calibration", "same_calibration", "recorded_by_version", "cpu_s", "wall_s", "peak_mb", "host", "cloud_sha256", "folder",
)  # fmt: skip
"""Columns of the table, which are keys of a row; an unknown value is empty."""
Row = dict[str, Any]


class ResultsError(Exception):
    """A folder of results cannot be used; the text names it and the reason."""


@dataclass(frozen=True, slots=True)
class Results:
    """Results of one key below ``out``. Every method raises StorageError for errors of the disk."""

    folder: Path

    @classmethod
    def of(cls, out: Path, settings: Mapping[str, Any]) -> Results:
        """Return the results made with ``settings`` (JSON-ready); their folder is created if it is missing."""
        text = json.dumps(settings, indent=1, sort_keys=True) + "\n"
        results = cls(out / hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS])
        for name in ("results", "failed", "drafts"):
            LocalFileSystem().make_folders(results.folder / name)
        if not (results.folder / SETTINGS).exists():
            LocalFileSystem().replace_file(results.folder / SETTINGS, text.encode())
        return results

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings of all results."""
        return _read(self.folder / SETTINGS)

    def row(self, name: str) -> Row | None:
        """Return the published result's row; ``None`` if there is none."""
        path = self.folder / "results" / name / ROW
        return _read(path) if path.exists() else None

    def publish(self, name: str, row: Row, cloud: tuple[Bytes, ...] | None) -> Row:
        """Publish a complete result by one rename, and return its row.

        If another process was first, its row is returned.
        """
        fs, target = LocalFileSystem(), self.folder / "results" / name
        with (
            StorageError.naming("cannot publish", target),
            TemporaryDirectory(dir=self.folder / "drafts") as draft_folder,
        ):
            draft = Path(draft_folder) / name
            fs.make_folder(draft)
            if cloud is not None:
                row = {**row, "cloud_sha256": fs.write_new(draft / CLOUD, cloud).sha256}
            fs.write_new(draft / ROW, (_encode(row),))
            # rename(2) refuses a folder that is not empty: of two processes at once, one gets the name.
            try:
                fs.move_folder(draft, target)
            except StorageError:
                if not target.is_dir():
                    raise
            published = _read(target / ROW)
            (self.folder / "failed" / f"{name}.json").unlink(missing_ok=True)
        return published

    def publish_failure(self, name: str, row: Row) -> Row:
        """Store the reason of a failure."""
        LocalFileSystem().replace_file(self.folder / "failed" / f"{name}.json", _encode(row))
        return row

    def sweep(self) -> int:
        """Remove the drafts of ended processes, and return their number.

        The caller must hold the folder's lock.
        """
        with StorageError.naming("cannot sweep", self.folder / "drafts"):
            old = list((self.folder / "drafts").iterdir())
            for draft in old:
                rmtree(draft)
        return len(old)

    def write_table(self, rows: Sequence[Row]) -> Path:
        """Write the table of ``rows``, and of all other scans with a result or a failure under this key.

        Rows are in the order of scan numbers.
        """
        published = (*self.folder.glob("failed/*.json"), *self.folder.glob(f"results/*/{ROW}"))
        # Of several rows of a scan the last one counts: a reason why it is left, a failure, a result, one of this call.
        of_all = (
            *(row for row in rows if "result" not in row),
            *map(_read, published),
            *(row for row in rows if "result" in row),
        )
        row_by_folder = {row["folder"]: row for row in of_all}
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(row_by_folder.values(), key=_order))
        LocalFileSystem().replace_file(self.folder / TABLE, text.getvalue().encode())
        return self.folder / TABLE


@cache
def program_digits(top: Path = Path(appliance.__file__).parent) -> str:
    """Return the parts of an installation that determine points, as a text.

    They are the version, a hash of its files below ``top``, and the versions of the libraries.
    """
    digest = hashlib.sha256()
    for path in sorted((*top.rglob("*.py"), *top.rglob("*.toml"))):
        digest.update(path.relative_to(top).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    libraries = " ".join(f"{name} {metadata.version(name)}" for name in COMPUTING)
    return f"kingfisher {__version__}-{digest.hexdigest()[:NAME_DIGITS]} {libraries}"


def name_of(folder: Path) -> str:
    """Return the name of a scan's result, which follows from its manifest.

    Raises OSError if that cannot be read.
    """
    if not (folder / MANIFEST_FILE).exists():
        return f"{folder.name}-unreadable"
    return f"{folder.name}-{hashlib.sha256((folder / MANIFEST_FILE).read_bytes()).hexdigest()[:NAME_DIGITS]}"


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table in the order of the scans' numbers, each a text by column.

    Missing columns are empty. Raises ResultsError.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if not {"scan", "state"} <= set(reader.fieldnames or ()):
                raise ResultsError(f"TABLE {path}: is no table of `kingfisher archive reprocess`: give its {TABLE}")
            return sorted(({name: row.get(name) or "" for name in COLUMNS} for row in reader), key=_order)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ResultsError(
            f"TABLE {path}: cannot be read ({error}); give a {TABLE} of `kingfisher archive reprocess`"
        ) from error


def _order(row: Mapping[str, Any]) -> tuple[float, str, str]:
    """Return the sort key of a row: the number of its scan, then its folder."""
    return *by_number(str(row["scan"])), str(row.get("folder") or "")


def _read(path: Path) -> Row:
    try:
        row: Row = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise StorageError("cannot read", path, str(error), "mount it under the same path, or move it away") from error
    return row


def _encode(row: Row) -> bytes:
    return (json.dumps(row, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()
