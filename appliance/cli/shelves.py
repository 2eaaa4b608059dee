"""Owns the verbs ``scans name``, ``note``, ``trash`` and ``restore``: what people do with scans at a desk.

They write, so that no instrument may run on the same root meanwhile. Nothing is deleted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from appliance.cli.output import Exit, UsageError, say, say_json
from appliance.storage.label import LONGEST_NAME, LONGEST_NOTE, Label, LabelError, checked, read
from appliance.storage.library import Library
from appliance.storage.lock import hold_lock


def name_scan(root: Path, scan_id: str, text: str, *, json: bool) -> Exit:
    """Call a scan something; an empty text takes the name away. Raises UsageError, UnknownScan, StorageError."""
    name = _checked("NAME", text, LONGEST_NAME)
    return _label(root, scan_id, lambda label: replace(label, name=name), json=json)


def note_scan(root: Path, scan_id: str, text: str, *, json: bool) -> Exit:
    """Write a note about a scan; an empty text takes it away. Raises UsageError, UnknownScan, StorageError."""
    note = _checked("NOTE", text, LONGEST_NOTE)
    return _label(root, scan_id, lambda label: replace(label, note=note), json=json)


def trash(root: Path, scan_ids: Sequence[str], *, json: bool) -> Exit:
    """Put scans away. Raises UnknownScan before any was moved, ScanError, StorageError."""
    return _move(root, scan_ids, Library(root).trash, json=json)


def restore(root: Path, scan_ids: Sequence[str], *, json: bool) -> Exit:
    """Take scans out of the trash. Raises UnknownScan before any was moved, ScanError, StorageError."""
    return _move(root, scan_ids, Library(root).restore, json=json)


def _checked(what: str, text: str, longest: int) -> str | None:
    try:
        return checked(what, text, longest)
    except LabelError as error:
        raise UsageError(str(error)) from error


def _label(root: Path, scan_id: str, change: Callable[[Label], Label], *, json: bool) -> Exit:
    library = Library(root)
    with hold_lock(root):
        entry = library.entry(scan_id)
        try:
            before = read(entry.folder)
        except LabelError:
            before = Label()  # a damaged one is written anew: that is what the person wants
        label = change(before)
        library.set_label(entry.scan_id, label)
    if json:
        say_json({"scan": entry.scan_id, "name": label.name, "note": label.note})
    else:
        say(f"{entry.scan_id}  name: {label.name or '-'}; note: {label.note or '-'}")
    return Exit.OK


def _move(root: Path, scan_ids: Sequence[str], move: Callable[[str], Path], *, json: bool) -> Exit:
    library = Library(root)
    with hold_lock(root):
        for scan_id in scan_ids:
            library.entry(scan_id)
        moved = [move(scan_id) for scan_id in scan_ids]
    if json:
        say_json([{"scan": folder.name, "folder": str(folder)} for folder in moved])
    else:
        for folder in moved:
            say(f"{folder.name}  is in {folder}")
    return Exit.OK
