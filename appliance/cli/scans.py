"""The verbs ``scans``: list, show, verify and label stored scans, and put them away.

They also run beside the service, except those that change scans. Nothing is deleted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from appliance.base import ContentError
from appliance.cli.arguments import operand, operands, option, path_option, switch
from appliance.cli.desk import check_writable, write_files
from appliance.cli.output import Exit, ProgressLine, UsageError, format_value, table
from appliance.cli.places import WithRoot, scan_folder
from appliance.instrument import ASHORE
from appliance.measure import SIDES, FaultCode
from appliance.store import Label, Library, LibraryFolder, ScanEntry, hold_lock, verified_entry

SHELVES = tuple(folder.value for folder in LibraryFolder)
COLUMNS = ("SCAN", "STATE", "GRADE", "TIME", "POINTS", "OBJECT", "MB", "NAME", "REMARK", "NOTE")


@dataclass(frozen=True, slots=True, kw_only=True)
class OfScans(WithRoot):
    """A verb of stored scans, without kernels."""

    kernels: ClassVar[bool] = False

    def folder_of(self, scan: str) -> Path:
        """Return the folder of ``scan``; a folder needs neither storage root nor rig file.

        Raises UnknownScan, UsageError.
        """
        return scan_folder(scan) or Library(self.existing_root()).entry(scan).folder


@dataclass(frozen=True, slots=True, kw_only=True)
class ListScans(OfScans):
    """List scans, damaged ones marked."""

    shelf: str = operand("SHELF", f"one of {', '.join(SHELVES)} (default: scans)", optional=True, parse=str)
    all: bool = switch("--all", "of every shelf")

    def run(self) -> Exit:
        shelf = self.shelf or LibraryFolder.SCANS.value
        if shelf not in SHELVES:
            raise UsageError(f"SHELF {shelf}: there is none; there are: {', '.join(SHELVES)}")
        root = self.existing_root()
        entries = [
            entry
            for folder in LibraryFolder
            if self.all or folder.value == shelf
            for entry in Library(root).entries(folder)
        ]
        lines = [table(COLUMNS, map(_row, entries)) if entries else f"no scans under {root}"]
        self.tell([_brief(entry) for entry in entries], lines)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowScan(OfScans):
    """Show the manifest of a scan, or one of its frames as a picture; only that frame is decoded."""

    scan: str = operand("SCAN", "its number or its folder")
    side: str | None = operand("SIDE", "left or right: show a frame of this camera", optional=True)
    pattern: str | None = operand("PATTERN", "pattern of the frame, for example bright or sine-x-90", optional=True)
    out: Path | None = path_option("--out", "file of the frame (default: SCAN-SIDE-PATTERN.png here)")

    def run(self) -> Exit:
        """Print the manifest, or write the frame.

        Raises UnknownScan, UsageError, ScanError, StorageError, MissingLibraryError.
        """
        if self.side is not None:
            return self._frame(self.side)
        if self.out is not None:
            raise UsageError(f"--out {self.out}: is for a frame; give SIDE and PATTERN, for example left bright")
        entry = ScanEntry.of(self.folder_of(self.scan), checksums=False)
        codes = [] if entry.manifest is None else entry.manifest.record.held_against
        ashore = {code.value: ASHORE[code] for code in codes if code in ASHORE}
        full = {
            **_brief(entry),
            "ashore": ashore,
            "manifest": None if entry.manifest is None else entry.manifest.as_json(),
        }
        if not self.json and entry.manifest is not None:
            # Verdicts by name, so that each number has its own line.
            record = full["manifest"]["record"]
            record["verdicts"] = {verdict.pop("name"): verdict for verdict in record["verdicts"]}
        lines = _flat(full)
        width = max(len(key) for key, _ in lines)
        self.tell(full, (f"{key:<{width}} {value}" for key, value in lines))
        return Exit.OK

    def _frame(self, side: str) -> Exit:
        from appliance.store import StoredScan

        folder = self.folder_of(self.scan)
        if side not in SIDES:
            raise UsageError(f"SIDE {side}: allowed are {' and '.join(SIDES)}")
        names = StoredScan.manifest_of(folder).record.sequence.patterns
        if self.pattern not in names:
            raise UsageError(f"PATTERN {self.pattern or 'is missing'}: this scan has {', '.join(names)}")
        out = self.out or Path(f"{folder.name}-{side}-{self.pattern}.png")
        check_writable(out)
        if out.suffix.lower() != ".png":
            raise UsageError(f"--out {out}: a frame is written as PNG; give {out.with_suffix('.png')}")
        frame = StoredScan.read_frame(folder, side, names.index(self.pattern))
        import cv2  # here, because other verbs need no pictures

        write_files({out: cv2.imencode(".png", frame)[1].tobytes()})
        height_px, width_px = frame.shape
        facts = {"file": str(out), "width_px": width_px, "height_px": height_px}
        self.tell(facts, [f"{out}  {width_px} x {height_px} px"])
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyScans(OfScans):
    """Read every byte and compare checksums, of packed frames decoded; DAMAGED if any differs."""

    codes: ClassVar[Sequence[Exit]] = (Exit.DAMAGED,)

    scans: Sequence[str] = operands("SCAN", "numbers or folders (default: all)", at_least_one=False)
    all: bool = switch("--all", "of all shelves: also rejected, set aside, and trash")

    def run(self) -> Exit:
        """Verify the scans. Raises UnknownScan, UsageError, MissingLibraryError."""
        folders = [self.folder_of(scan) for scan in self.scans]
        if not self.scans:
            library = Library(self.existing_root())
            shelves = tuple(LibraryFolder) if self.all else (LibraryFolder.SCANS,)
            folders = [entry.folder for shelf in shelves for entry in library.entries(shelf)]
        checked: list[ScanEntry] = []
        with ProgressLine() as progress:
            for k, folder in enumerate(folders):
                progress(f"verifying {folder.name}", k / len(folders))
                checked.append(verified_entry(folder))
        damaged = sum(not entry.ok for entry in checked)
        lines = [
            f"{entry.scan_id}  {'ok' if entry.ok else 'DAMAGED: ' + '; '.join(entry.problems)}" for entry in checked
        ]
        self.tell(
            {"checked": len(checked), "damaged": damaged, "scans": [_brief(entry) for entry in checked]},
            [*lines, f"{len(checked)} checked, {damaged} damaged"],
        )
        return Exit.DAMAGED if damaged else Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelScan(OfScans):
    """Give a scan a name, and write a note about it; an empty text removes either."""

    scan: str = operand("SCAN", "its number")
    name: str | None = option("--name", f"up to {Label.LONGEST['name']} characters", metavar="TEXT")
    note: str | None = option("--note", f"up to {Label.LONGEST['note']} characters", metavar="TEXT")

    def run(self) -> Exit:
        """Write the label. Raises UsageError, UnknownScan, StorageError."""
        if self.name is None and self.note is None:
            raise UsageError("--name and --note are missing; give --name TEXT or --note TEXT, or both")
        root, library = self.existing_root(), Library(self.existing_root())
        name = _check_label("name", self.name)
        note = _check_label("note", self.note)
        with hold_lock(root):
            entry = library.entry(self.scan)
            try:
                before = Label.read(entry.folder)
            except ContentError:
                before = Label()  # a damaged one is replaced
            label = Label(before.name if self.name is None else name, before.note if self.note is None else note)
            library.set_label(entry.scan_id, label)
        self.tell(
            {"scan": entry.scan_id, "name": label.name, "note": label.note},
            [f"{entry.scan_id}  name: {label.name or '-'}; note: {label.note or '-'}"],
        )
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class _MoveScans(OfScans):
    move: ClassVar[Callable[[Library, str], Path]]

    scans: Sequence[str] = operands("SCAN", "numbers", at_least_one=True)

    def run(self) -> Exit:
        """Move the scans. Raises UnknownScan before any was moved, ScanError, StorageError."""
        root = self.existing_root()
        library = Library(root)
        with hold_lock(root):
            for scan_id in self.scans:
                # All numbers are checked before the first move, so that a mistyped one leaves no scan moved.
                library.entry(scan_id)
            moved = [type(self).move(library, scan_id) for scan_id in self.scans]
        self.tell(
            [{"scan": folder.name, "folder": str(folder)} for folder in moved],
            (f"{folder.name}  is in {folder}" for folder in moved),
        )
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class TrashScans(_MoveScans):
    """Put scans in the trash, where they are kept."""

    move: ClassVar[Callable[[Library, str], Path]] = Library.trash


@dataclass(frozen=True, slots=True, kw_only=True)
class RestoreScans(_MoveScans):
    """Take scans out of the trash."""

    move: ClassVar[Callable[[Library, str], Path]] = Library.restore


def _check_label(which: Literal["name", "note"], text: str | None) -> str | None:
    try:
        return None if text is None else Label.checked(which, text, f"--{which}")
    except ContentError as error:
        raise UsageError(str(error)) from error


def _brief(entry: ScanEntry) -> dict[str, Any]:
    record = None if entry.manifest is None else entry.manifest.record
    points = None if record is None else record.cloud.get("points")
    return {
        "scan": entry.scan_id,
        "shelf": entry.folder_kind.value,
        "folder": str(entry.folder),
        "ok": entry.ok,
        "problems": list(entry.problems),
        "recovered": None if entry.manifest is None else entry.manifest.recovered,
        "wall_time": None if record is None else record.wall_time,
        "clock_trusted": None if record is None else record.clock_trusted,
        "grade": None if record is None or record.grade is None else record.grade.value,
        "corrected": None if record is None else record.compensated,
        "told": None if record is None else [code.value for code in record.held_against],
        "points": None if points is None else round(points),
        "object": None if record is None else record.object,
        "size_bytes": entry.size_bytes,
        "name": entry.label.name,
        "note": entry.label.note,
    }


def _state(entry: ScanEntry) -> str:
    if entry.problems:
        return "DAMAGED"
    if entry.folder_kind is not LibraryFolder.SCANS or entry.manifest is None:
        return entry.folder_kind.value
    return "recovered" if entry.manifest.recovered else "saved"


def _row(entry: ScanEntry) -> tuple[str, ...]:
    fields = _brief(entry)
    time = "?" if fields["wall_time"] is None else f"{fields['wall_time']}{'' if fields['clock_trusted'] else ' ?'}"
    numbers = [format_value("", fields[key]) for key in ("points", "object")]
    size = f"{entry.size_bytes / 1e6:.1f}"
    return (
        entry.scan_id,
        _state(entry),
        format_value("", fields["grade"]).upper(),
        time,
        *numbers,
        size,
        fields["name"] or "-",
        _remark(entry),
        fields["note"] or "",
    )


def _remark(entry: ScanEntry) -> str:
    """Return the faults that the diver read of the scan, or its state."""
    if entry.problems:
        return entry.problems[0]
    if entry.manifest is None:
        return ""
    if entry.manifest.raw_only:
        return "raw frames only"
    record = entry.manifest.record
    faults = [_words(code) for code in record.held_against if code is not FaultCode.COMPENSATED]
    return entry.manifest.reason or ", ".join(
        [*([_words(FaultCode.COMPENSATED)] if record.compensated else []), *faults]
    )


def _words(code: FaultCode) -> str:
    return "MOTION CORRECTED" if code is FaultCode.COMPENSATED else code.value.replace("_", " ")


def _flat(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values as lines ``a.b.c value``; of long lists only the length."""
    if isinstance(value, dict):
        return [line for key, item in value.items() for line in _flat(item, f"{prefix}.{key}" if prefix else str(key))]
    if isinstance(value, list):
        if len(value) > 6 or any(isinstance(item, dict | list) for item in value):
            return [(prefix, f"{len(value)} items")]
        return [(prefix, ", ".join(format_value(prefix, item) for item in value) or "-")]
    return [(prefix, format_value(prefix, value))]
