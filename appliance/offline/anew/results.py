"""Owns where results of reprocessing lie, and that there is one of each, whole, whoever else was making the same one.

    <out>/<key>/settings.json          what the key stands for
    <out>/<key>/results/<name>/        row.json, and cloud.ply where clouds were asked for; published by one rename
    <out>/<key>/failed/<name>.json     why there is no result; tried again by the next call
    <out>/<key>/drafts/<name>.<host>.<process>.<number>/   being made; the host by digits of its name
    <out>/<key>/table.csv              all rows
    <out>/<key>/calls/<digits>/        locks of calls, each for its part of its source

A name is the scan's number and a checksum of its manifest and of what else decides about its points, so that scans of several
instruments do not meet. Any number of processes, on any number of machines that see the folder, may make results at once: the first
rename wins, and the others see it.
"""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import json
import math
import os
import re
import socket
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.storage.archive import remove_folder
from appliance.storage.atomic import StorageError, make_folders, refused, replace_file, write_new
from appliance.storage.filesystem import Bytes, LocalFileSystem
from appliance.storage.lock import hold_lock
from appliance.storage.manifest import FILE_NAME
from appliance.storage.names import by_number

ROW, CLOUD, TABLE, SETTINGS = "row.json", "cloud.ply", "table.csv", "settings.json"
KEY_DIGITS, NAME_DIGITS = 16, 12
_DRAFT = re.compile(rf".+\.(?P<host>[0-9a-f]{{{NAME_DIGITS}}})\.(?P<process>[0-9]{{1,9}})\.[0-9]+")
OLD_DRAFT_S = 6 * 3600.0
"""A draft of another machine that is older is nobody's; two hours would be enough for the slowest scan."""
TABLE_WAIT_S = 300.0
"""Longest wait for another call that writes the table, which reads every row: minutes for a million."""
COLUMNS = (
    "scan", "state", "reason", "recorded", "points", "coverage_percent", "distance_mm", "noise_mm", "gap_mm", "exposure",
    "grade", "spoilt", "faults", "verdicts", "e_l_percent", "length_error_mm", "artefact", "temperature_c", "salinity_psu", "water_index",
    "calibration", "same_calibration", "recorded_by_version", "cpu_s", "wall_s", "peak_mb", "host", "cloud_sha256", "folder",
)  # fmt: skip
"""Columns of the table, which are keys of a row; what is not known is empty."""
NUMBERS = (
    "points", "coverage_percent", "distance_mm", "noise_mm", "gap_mm", "e_l_percent", "length_error_mm", "temperature_c", "salinity_psu",
    "water_index", "cpu_s", "wall_s", "peak_mb",
)  # fmt: skip
MOST = 1e12
"""Largest number in a table that is believed; sums and axes of larger ones would not be finite."""
Row = dict[str, Any]


class ResultsError(Exception):
    """A folder of results cannot be used; the text says which and why."""


@dataclass(frozen=True, slots=True)
class Results:
    """Results of one key below ``out``. Every method raises StorageError for what the disk refuses."""

    folder: Path

    @classmethod
    def of(cls, out: Path, settings: Mapping[str, Any]) -> Results:
        """Return the results made with ``settings`` (JSON-ready), their folder made where it is not there."""
        text = json.dumps(settings, indent=1, sort_keys=True) + "\n"
        results = cls(out / hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS])
        for name in ("results", "failed", "drafts"):
            make_folders(LocalFileSystem(), results.folder / name)
        if not (results.folder / SETTINGS).exists():
            replace_file(LocalFileSystem(), results.folder / SETTINGS, text.encode())
        return results

    @property
    def key(self) -> str:
        """Digits that stand for calibration, program and settings."""
        return self.folder.name

    def row(self, name: str) -> Row | None:
        """Return the published result's row; ``None`` where there is none."""
        try:
            found: Row = json.loads((self.folder / "results" / name / ROW).read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as error:
            raise StorageError(
                "cannot read", self.folder / "results" / name / ROW, str(error), "move it away"
            ) from error
        return found

    def publish(self, name: str, row: Row, cloud: tuple[Bytes, ...] | None) -> Row:
        """Publish a result, whole, by one rename; where another process was first, what that one published is returned."""
        fs = LocalFileSystem()
        draft = self.folder / "drafts" / f"{name}.{host_digits()}.{os.getpid()}.{time.monotonic_ns()}"
        target = self.folder / "results" / name
        with refused("cannot make", draft):
            fs.make_folder(draft)
        try:
            if cloud is not None:
                row = {**row, "cloud_sha256": write_new(fs, draft / CLOUD, cloud).sha256}
            write_new(fs, draft / ROW, (_encoded(row),))
            with refused("cannot publish", target):
                fs.sync_folder(draft)
                try:
                    draft.rename(target)
                except OSError as error:
                    # rename(2) refuses a folder that is not empty: of two who are done at once, one gets the name.
                    if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                        raise
                fs.sync_folder(target.parent)
        finally:
            if draft.exists():
                with suppress(StorageError):  # a full disk; the sweeper removes what stays
                    remove_folder(fs, draft)
        published = self.row(name)
        if published is None:
            raise StorageError("cannot publish", target, "it is not there after its rename", "call again")
        with suppress(FileNotFoundError):
            (self.folder / "failed" / f"{name}.json").unlink()
        return published

    def publish_failure(self, name: str, row: Row) -> Row:
        """Write down why there is no result."""
        replace_file(LocalFileSystem(), self.folder / "failed" / f"{name}.json", _encoded(row))
        return row

    def sweep(self) -> int:
        """Remove drafts of processes that are gone, and answer how many."""
        swept = 0
        probe = self.folder / "drafts" / f".now.{os.getpid()}"
        with refused("cannot sweep", self.folder / "drafts"):
            # The time as the disk's own machine tells it: clocks of several machines need not agree.
            probe.touch()
            now_s = probe.stat().st_mtime
            probe.unlink()
            drafts = [path for path in (self.folder / "drafts").iterdir() if path.is_dir()]
        for draft in drafts:
            made = _DRAFT.fullmatch(draft.name)
            with suppress(StorageError, FileNotFoundError):
                gone = made is not None and made["host"] == host_digits() and not _alive(int(made["process"]))
                if gone or now_s - draft.stat().st_mtime > OLD_DRAFT_S:
                    remove_folder(LocalFileSystem(), draft)
                    swept += 1
        return swept

    @contextmanager
    def call(self, part: str) -> Iterator[None]:
        """Hold the lock of ``part``, which names a source and what of it: two calls for the same one are refused with StorageError."""
        folder = self.folder / "calls" / hashlib.sha256(part.encode()).hexdigest()[:NAME_DIGITS]
        with hold_lock(folder):
            yield

    def write_table(self, rows: Iterable[Row]) -> Path:
        """Write the table of all that has a result or a failure under this key, and of those of this call's ``rows`` that have neither.

        Whole or not at all, in the order of the scans' numbers. Failures of scans that became others since are removed. Several calls
        may be done at once: each waits until the one before has written.
        """
        # Listed under the lock: whoever writes last has seen what everybody before published.
        with hold_lock(self.folder, TABLE_WAIT_S):
            named = {str(row["folder"]): row.get("result") for row in rows}
            found = list(self._current_rows(named))
            known = {str(row["folder"]) for row in found}
            found += [row for row in rows if row.get("result") is None and str(row["folder"]) not in known]
            text = io.StringIO()
            writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
            writer.writeheader()
            writer.writerows(sorted(found, key=_order))
            path = self.folder / TABLE
            replace_file(LocalFileSystem(), path, text.getvalue().encode())
        return path

    def _current_rows(self, named: Mapping[str, str | None]) -> Iterator[Row]:
        """Yield the published rows. ``named``: by the folders that were just worked on, which result is now theirs."""
        with refused("cannot list", self.folder):
            results = sorted(path.name for path in (self.folder / "results").iterdir())
            failures = sorted(path for path in (self.folder / "failed").iterdir() if path.suffix == ".json")

        def current(row: Row, name: str) -> bool:
            now = named.get(str(row["folder"]))
            return now is None or now == name

        for name in results:
            row = self.row(name)
            if row is not None and current(row, name):
                yield row
        done = set(results)
        for path in failures:
            with refused("cannot read", path), suppress(FileNotFoundError, ValueError):
                row = json.loads(path.read_bytes())
                # A process that died between its rename and its tidying leaves a failure beside a result.
                if path.stem in done or not current(row, path.stem):
                    path.unlink()
                else:
                    yield row


def host_digits() -> str:
    """Return what stands for this computer in names: whatever it is called, and wherever it was called so, a part of a path."""
    return hashlib.sha256(os.fsencode(socket.gethostname())).hexdigest()[:NAME_DIGITS]


def name_of(folder: Path, beside: Sequence[str] = ()) -> str:
    """Return the name of a scan's result, which follows its manifest and what is ``beside`` it.

    A folder without a manifest has a name, too: of the folder alone. Raises FileNotFoundError where there is no such folder, OSError where
    it cannot be read.
    """
    try:
        digest = hashlib.sha256((folder / FILE_NAME).read_bytes())
    except FileNotFoundError:
        if not folder.is_dir():
            raise
        return f"{folder.name}-unreadable"
    for text in beside:
        digest.update(b"\0" + text.encode())
    return f"{folder.name}-{digest.hexdigest()[:NAME_DIGITS]}"


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table in the order of the scans' numbers, each a text by column; missing columns are empty.

    Raises ResultsError, also for numbers that no scan has.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if not {"scan", "state"} <= set(reader.fieldnames or ()):
                raise ResultsError(f"TABLE {path}: is no table of `kingfisher reprocess`: give its {TABLE}")
            rows = []
            for row in reader:
                cells = {name: (row.get(name) or "") for name in COLUMNS}
                for name in NUMBERS:
                    if _beyond(cells[name]):
                        raise ResultsError(
                            f"TABLE {path}: line {reader.line_num}: {name} {cells[name]:.40}: allowed are -{MOST:g} to {MOST:g}; correct it"
                        )
                rows.append(cells)
            return sorted(rows, key=_order)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ResultsError(
            f"TABLE {path}: cannot be read ({error}); give a {TABLE} of `kingfisher reprocess`"
        ) from error


def _order(row: Mapping[str, Any]) -> tuple[float, str, str]:
    """Return what orders rows by the number of their scan: of several instruments, those of one number by their folders."""
    return *by_number(str(row["scan"])), str(row.get("folder") or "")


def _beyond(text: str) -> bool:
    """True for a number that is larger than any of a scan; other text is for the reader of the cell."""
    try:
        return MOST < abs(float(text)) < math.inf
    except ValueError:
        return False


def _encoded(row: Row) -> bytes:
    return (json.dumps(row, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
