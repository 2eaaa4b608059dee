"""Owns the verbs ``scans name``, ``note``, ``trash`` and ``restore``: what people do with scans at a desk.

They write, so that no instrument may run on the same root meanwhile. Nothing is deleted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from appliance.base import ContentError
from appliance.cli.arguments import operand, operands
from appliance.cli.output import Exit, UsageError, say, say_json
from appliance.cli.places import WithRoot
from appliance.store import LONGEST_NAME, LONGEST_NOTE, Label, Library, checked_label, hold_lock, read_label


@dataclass(frozen=True, slots=True, kw_only=True)
class NameScan(WithRoot):
    """Call a scan something; an empty text takes the name away."""

    kernels: ClassVar[bool] = False

    scan: str = operand("SCAN", "its number")
    text: str = operand("NAME", f"up to {LONGEST_NAME} characters; empty: none")

    def run(self) -> Exit:
        """Raises UsageError, UnknownScan, StorageError."""
        root, name = self.existing_root(), _checked("NAME", self.text, LONGEST_NAME)
        return _label(root, self.scan, lambda label: replace(label, name=name), json=self.json)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteScan(WithRoot):
    """Write a note about a scan; an empty text takes it away."""

    kernels: ClassVar[bool] = False

    scan: str = operand("SCAN", "its number")
    text: str = operand("NOTE", f"up to {LONGEST_NOTE} characters; empty: none")

    def run(self) -> Exit:
        """Raises UsageError, UnknownScan, StorageError."""
        root, note = self.existing_root(), _checked("NOTE", self.text, LONGEST_NOTE)
        return _label(root, self.scan, lambda label: replace(label, note=note), json=self.json)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrashScans(WithRoot):
    """Put scans away."""

    kernels: ClassVar[bool] = False

    scans: Sequence[str] = operands("SCAN", "numbers", at_least_one=True)

    def run(self) -> Exit:
        """Raises UnknownScan before any was moved, ScanError, StorageError."""
        root = self.existing_root()
        return _move(root, self.scans, Library(root).trash, json=self.json)


@dataclass(frozen=True, slots=True, kw_only=True)
class RestoreScans(WithRoot):
    """Take scans out of the trash."""

    kernels: ClassVar[bool] = False

    scans: Sequence[str] = operands("SCAN", "numbers", at_least_one=True)

    def run(self) -> Exit:
        """Raises UnknownScan before any was moved, ScanError, StorageError."""
        root = self.existing_root()
        return _move(root, self.scans, Library(root).restore, json=self.json)


def _checked(what: str, text: str, longest: int) -> str | None:
    try:
        return checked_label(what, text, longest)
    except ContentError as error:
        raise UsageError(str(error)) from error


def _label(root: Path, scan_id: str, change: Callable[[Label], Label], *, json: bool) -> Exit:
    library = Library(root)
    with hold_lock(root):
        entry = library.entry(scan_id)
        try:
            # Name and note are one file: changing the one keeps the other.
            before = read_label(entry.folder)
        except ContentError:
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
            # All numbers before the first move: a typing error in the last one must not leave half of them moved.
            library.entry(scan_id)
        moved = [move(scan_id) for scan_id in scan_ids]
    if json:
        say_json([{"scan": folder.name, "folder": str(folder)} for folder in moved])
    else:
        for folder in moved:
            say(f"{folder.name}  is in {folder}")
    return Exit.OK
