"""Owns the verbs ``scans list``, ``scans show`` and ``scans verify``: reading only, also beside a running service."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from appliance.cli.arguments import operand, operands, switch
from appliance.cli.listing import shown
from appliance.cli.output import Exit, Progress, say, say_json, table
from appliance.cli.places import WithRoot, scan_folder
from appliance.instrument import ASHORE
from appliance.measure import FaultCode
from appliance.store import Library, LibraryFolder, ScanEntry, Stage, entry_of, manifest_json

EVERY = "also those rejected, set aside or in the trash"


@dataclass(frozen=True, slots=True, kw_only=True)
class ListScans(WithRoot):
    """All scans, damaged ones marked. ``all``: also those rejected, set aside or in the trash; ``trash``: only these."""

    kernels: ClassVar[bool] = False

    all: bool = switch("--all", EVERY, either="shelves")
    trash: bool = switch("--trash", "only those in the trash", either="shelves")

    def run(self) -> Exit:
        root = self.existing_root()
        entries = Library(root).entries(LibraryFolder.TRASH) if self.trash else _entries(Library(root), self.all)
        if self.json:
            say_json([_brief(entry) for entry in entries])
        elif not entries:
            say(f"no scans under {root}")
        else:
            rows = [
                (
                    entry.scan_id,
                    _state(entry),
                    _grade(entry),
                    _when(entry),
                    _points(entry),
                    _object(entry),
                    f"{entry.size_bytes / 1e6:.1f}",
                    entry.label.name or "-",
                    _remark(entry),
                    entry.label.note or "",
                )
                for entry in entries
            ]
            say(table(("SCAN", "STATE", "GRADE", "TIME", "POINTS", "OBJECT", "MB", "NAME", "REMARK", "NOTE"), rows))
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowScan(WithRoot):
    """Everything a scan's manifest says."""

    kernels: ClassVar[bool] = False

    scan: str = operand("SCAN", "its number or its folder")

    def run(self) -> Exit:
        """Raises UnknownScan, UsageError."""
        # A folder that was copied somewhere is shown without any storage root or rig file.
        folder = scan_folder(self.scan) or Library(self.existing_root()).entry(self.scan).folder
        entry = entry_of(folder, checksums=False)
        told = [] if entry.manifest is None else entry.manifest.record.held_against
        ashore = {code.value: ASHORE[code] for code in told if code in ASHORE}
        full = {
            **_brief(entry),
            "ashore": ashore,
            "manifest": None if entry.manifest is None else manifest_json(entry.manifest),
        }
        if self.json:
            say_json(full)
            return Exit.OK
        if entry.manifest is not None:
            # Verdicts by their names, so that their numbers are lines of their own.
            record = full["manifest"]["record"]
            record["verdicts"] = {verdict.pop("name"): verdict for verdict in record["verdicts"]}
        lines = _flat(full)
        width = max(len(key) for key, _ in lines)
        for key, value in lines:
            say(f"{key:<{width}} {value}")
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyScans(WithRoot):
    """Read every byte and compare checksums; DAMAGED if any does not fit. No scans: all.

    ``scans``: numbers under the root, or folders, wherever they were copied to.
    """

    kernels: ClassVar[bool] = False
    codes: ClassVar[Sequence[Exit]] = (Exit.DAMAGED,)

    scans: Sequence[str] = operands("SCAN", "numbers or folders (default: all)", at_least_one=False)
    all: bool = switch("--all", EVERY)

    def run(self) -> Exit:
        """Raises UnknownScan, UsageError."""
        folders = [scan_folder(scan) or Library(self.existing_root()).entry(scan).folder for scan in self.scans]
        if not self.scans:
            folders = [entry.folder for entry in _entries(Library(self.existing_root()), self.all)]
        checked: list[ScanEntry] = []
        with Progress() as progress:
            for k, folder in enumerate(folders):
                progress(f"verifying {folder.name}", k / len(folders))
                checked.append(_with_frames_named(entry_of(folder, checksums=True)))
        damaged = [entry for entry in checked if not entry.ok]
        if self.json:
            say_json({"checked": len(checked), "damaged": len(damaged), "scans": [_brief(entry) for entry in checked]})
        else:
            for entry in checked:
                say(f"{entry.scan_id}  {'ok' if entry.ok else 'DAMAGED: ' + '; '.join(entry.problems)}")
            say(f"{len(checked)} checked, {len(damaged)} damaged")
        return Exit.DAMAGED if damaged else Exit.OK


def _with_frames_named(entry: ScanEntry) -> ScanEntry:
    """Return ``entry`` with the damaged frames named in its problems, where it is known which they are."""
    if entry.ok or entry.manifest is None:
        return entry
    from appliance.store import damaged_frames

    # The checksum of the file said that something is wrong; the CRC of each frame says in which image (ADR 0033).
    frames = {one.file: str(one) for one in damaged_frames(entry.folder, entry.manifest)}
    return replace(entry, problems=tuple(frames.get(text.partition(":")[0], text) for text in entry.problems))


def _entries(library: Library, every: bool) -> list[ScanEntry]:
    shelves = tuple(LibraryFolder) if every else (LibraryFolder.SCANS,)
    return [entry for shelf in shelves for entry in library.entries(shelf)]


def _brief(entry: ScanEntry) -> dict[str, Any]:
    record = None if entry.manifest is None else entry.manifest.record
    return {
        "scan": entry.scan_id,
        "shelf": entry.shelf.value,
        "folder": str(entry.folder),
        "ok": entry.ok,
        "problems": list(entry.problems),
        "recovered": None if entry.manifest is None else entry.manifest.recovered,
        "wall_time": None if record is None else record.wall_time,
        "clock_trusted": None if record is None else record.clock_trusted,
        "grade": None if record is None or record.grade is None else record.grade.value,
        "corrected": None if record is None else record.compensated,
        "told": None if record is None else [code.value for code in record.held_against],
        "points": _point_count(entry),
        "object": None if record is None else record.object,
        "size_bytes": entry.size_bytes,
        "name": entry.label.name,
        "note": entry.label.note,
    }


def _state(entry: ScanEntry) -> str:
    if entry.problems:
        return "DAMAGED"
    if entry.shelf is not LibraryFolder.SCANS or entry.manifest is None:
        return entry.shelf.value
    return "recovered" if entry.manifest.recovered else "saved"


def _when(entry: ScanEntry) -> str:
    if entry.manifest is None or entry.manifest.record.wall_time is None:
        return "?"
    record = entry.manifest.record
    return f"{record.wall_time}" if record.clock_trusted else f"{record.wall_time} ?"


def _points(entry: ScanEntry) -> str:
    points = _point_count(entry)
    return "-" if points is None else str(points)


def _point_count(entry: ScanEntry) -> int | None:
    points = None if entry.manifest is None else entry.manifest.record.cloud.get("points")
    return None if points is None else round(points)


def _object(entry: ScanEntry) -> str:
    number = None if entry.manifest is None else entry.manifest.record.object
    return "-" if number is None else str(number)


def _grade(entry: ScanEntry) -> str:
    grade = None if entry.manifest is None else entry.manifest.record.grade
    return "-" if grade is None else grade.value.upper()


def _remark(entry: ScanEntry) -> str:
    """Return what the diver was told of the scan, or what became of it."""
    if entry.problems:
        return entry.problems[0]
    if entry.manifest is None:
        return ""
    if entry.manifest.stage is Stage.RAW:
        return "raw frames only"
    record = entry.manifest.record
    told = [_words(code) for code in record.held_against if code is not FaultCode.COMPENSATED]
    return entry.manifest.reason or ", ".join([*([_words(FaultCode.COMPENSATED)] if record.compensated else []), *told])


def _words(code: FaultCode) -> str:
    return "MOTION CORRECTED" if code is FaultCode.COMPENSATED else code.value.replace("_", " ")


def _flat(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values as lines ``a.b.c value``; long lists only by their length."""
    if isinstance(value, dict):
        return [line for key, one in value.items() for line in _flat(one, f"{prefix}.{key}" if prefix else str(key))]
    if isinstance(value, list):
        if len(value) > 6 or any(isinstance(one, dict | list) for one in value):
            return [(prefix, f"{len(value)} items")]
        return [(prefix, ", ".join(shown(prefix, one) for one in value) or "-")]
    return [(prefix, shown(prefix, value))]
