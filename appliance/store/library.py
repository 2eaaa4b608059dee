"""The library: all scans of an instrument, and their recovery after a loss of power.

    <root>/scans/000123       published
    <root>/scans/.000123      being written, or waiting for the diver's decision
    <root>/rejected/000123    rejected by the diver, kept all the same
    <root>/set-aside/000123   unfinished after a loss of power
    <root>/trash/000123       put away at the desk; made when it is first needed
    <root>/next-id            see ``appliance.store.names``
    <root>/room               space for the next scan, see ``appliance.store.room``

A scan may belong to an object; its manifest then has the object's number. A number is never given twice:
``choices.json`` remembers the largest one. If that file is lost or from elsewhere, the manifests are read instead: the
newest scan with a number has the largest one.

No scan is deleted here. One process writes (``appliance.store.lock``), from one thread at a time; any number may read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.base import ContentError
from appliance.store import manifest as form
from appliance.store import names, scan
from appliance.store.atomic import FileSystem, LocalFileSystem, StorageError
from appliance.store.label import NO_LABEL, Label
from appliance.store.manifest import Decision, Manifest, ScanRecord
from appliance.store.names import by_number, scan_number
from appliance.store.scan import StoredScan

if TYPE_CHECKING:  # NumPy is loaded where pixels and points are: a list of scans touches none
    import numpy as np
    from numpy.typing import NDArray

    from appliance.store.ply import PointCloud


LOOKED_AT = 500
"""Number of newest manifests that are read for the largest number of an object: the time of a start must not grow with
every dive."""


class LibraryFolder(Enum):
    """Folders that a finished scan can lie in; the values are folder names."""

    SCANS = "scans"
    REJECTED = "rejected"
    SET_ASIDE = "set-aside"
    TRASH = "trash"


def folder_kinds(*, every: bool) -> tuple[LibraryFolder, ...]:
    """Return the kinds of folders to work through; with ``every`` that of rejected scans, too."""
    return (LibraryFolder.SCANS, LibraryFolder.REJECTED) if every else (LibraryFolder.SCANS,)


@dataclass(frozen=True, slots=True)
class ScanEntry:
    """One scan in the list. A damaged one is listed like the others, with its problems."""

    scan_id: str
    folder_kind: LibraryFolder
    folder: Path
    manifest: Manifest | None
    problems: tuple[str, ...]
    size_bytes: int
    label: Label = NO_LABEL

    @property
    def ok(self) -> bool:
        """True if the scan has no problems."""
        return not self.problems

    @classmethod
    def of(cls, folder: Path, *, checksums: bool) -> ScanEntry:
        """Return the entry of a scan's folder, in a library or copied elsewhere.

        ``checksums``: every byte is read. A folder outside of any library counts as one of published scans, and may
        have any name. A number as its name must be the scan's own.
        """
        path = folder.absolute()
        folder_kind = next((kind for kind in LibraryFolder if kind.value == path.parent.name), LibraryFolder.SCANS)
        size_bytes = _size(folder)
        try:
            manifest = form.read(folder)
        except ContentError as error:
            return cls(path.name, folder_kind, folder, None, (str(error),), size_bytes)
        wrong = scan.wrong_files(folder, manifest, checksums=checksums)
        problems = [f"{name}: {what}" for name, what in wrong.items()]
        if _numbered(path) not in (None, manifest.scan_id):
            problems.append(f"its manifest is of scan {manifest.scan_id}")
        label = NO_LABEL
        try:
            label = Label.read(folder)
        except ContentError as error:
            if checksums:  # no damage to the scan: reported only where every byte is read
                problems.append(str(error))
        return cls(path.name, folder_kind, folder, manifest, tuple(problems), size_bytes, label)

    @property
    def preview_file(self) -> Path | None:
        """The scan's preview image; ``None`` where it has none, as a scan that was kept without a cloud."""
        if self.manifest is None or scan.PREVIEW_FILE not in self.manifest.files:
            return None
        return self.folder / scan.PREVIEW_FILE


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of ``recover``: the scans that were published, rejected or set aside, by id, and the errors."""

    recovered: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()
    set_aside: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()


class UnknownScan(Exception):
    """Error of a number that no scan has."""


class Library:
    """The scans below one storage root. Raises StorageError when a call to the disk fails."""

    def __init__(self, root: Path, fs: FileSystem | None = None) -> None:
        """Set the storage root; the disk is not touched until ``prepare`` or a reading method is called."""
        self.root = root
        self._fs: FileSystem = fs or LocalFileSystem()

    # ------------------------------------------------------------------------------------- writing

    def prepare(self) -> None:
        """Make the folders that are missing, durably. Raises StorageError."""
        for folder in (
            self.root,
            *(self._folder_of(folder_kind) for folder_kind in LibraryFolder if folder_kind is not LibraryFolder.TRASH),
        ):
            self._fs.make_folders(folder)

    def begin(
        self, frames: Mapping[str, NDArray[np.uint8]], record: ScanRecord, origin: scan.ScanOrigin
    ) -> PendingScan:
        """Make a scan's raw frames and their ``origin`` durable, but do not list the scan yet.

        ``frames``: by side, (n, h, w) uint8; not used after return. On failure this scan leaves no file, the frames are
        still the caller's, and ``begin`` may be called again. Raises StorageError, ValueError.
        """
        # The number is durably taken before the first file is written: after any failure below it is not given to
        # another scan.
        scan_id = names.spell_id(names.take_number(self._fs, self.root, self._numbers()))
        folder = self._folder_of(LibraryFolder.SCANS) / f".{scan_id}"
        try:
            manifest = scan.write_raw(self._fs, folder, scan_id, frames, record, origin)
            with StorageError.naming("cannot make durable", folder):
                # The hidden name becomes durable here; the files inside are durable already (``write_raw``).
                self._fs.sync_folder(folder.parent)
        except (StorageError, ValueError):
            with suppress(StorageError):
                # The frames are still in memory and are tried again under a new number; half a folder would only take
                # space.
                scan.discard_raw(self._fs, folder)
            raise
        return PendingScan(self._fs, self.root, folder, manifest)

    def recover(self) -> Recovery:
        """Recover the scans that an earlier process left unfinished; call once at the start, before ``begin``.

        A folder whose manifest and checksums are right becomes a scan, marked as recovered. Any other is set aside. No
        file is deleted, and if one folder cannot be moved the others still are.
        """
        outcomes: dict[str, list[str]] = {"recovered": [], "rejected": [], "set_aside": [], "failed": []}
        # Hidden folders are scans that were not published before the power was lost.
        for folder in sorted(self._folders(LibraryFolder.SCANS, hidden=True)):
            scan_id = folder.name.removeprefix(".")
            try:
                outcomes[self._recover(folder, scan_id)].append(scan_id)
            except StorageError as error:
                outcomes["failed"].append(str(error))
        return Recovery(**{name: tuple(ids) for name, ids in outcomes.items()})

    def _recover(self, folder: Path, scan_id: str) -> str:
        manifest = self._recovered_manifest(folder)
        if manifest is None:
            self._fs.move_folder(folder, self._free_name(LibraryFolder.SET_ASIDE, scan_id))
            return "set_aside"
        for path in sorted(folder.iterdir()):
            if path.name not in manifest.files and path.name != form.MANIFEST_FILE:
                with StorageError.naming(
                    "cannot rename", path
                ):  # half of a cloud or a manifest: kept, but not listed in the manifest
                    self._fs.rename(path, path.with_name(f"{path.name.removeprefix('.')}.partial"))
        # The manifest says "recovered" before the folder is published, not after: a second loss of power in between
        # finds the same state again.
        self._fs.replace_file(folder / form.MANIFEST_FILE, form.encode(manifest))
        rejected = manifest.decision is Decision.REJECTED
        target = self._folder_of(LibraryFolder.REJECTED if rejected else LibraryFolder.SCANS) / scan_id
        # Only a copy made by hand can have the same number; neither of both is overwritten.
        if target.exists():
            self._fs.move_folder(folder, self._free_name(LibraryFolder.SET_ASIDE, scan_id))
            return "set_aside"
        self._fs.move_folder(folder, target)
        return "rejected" if rejected else "recovered"

    def _recovered_manifest(self, folder: Path) -> Manifest | None:
        """Return the folder's manifest, marked as recovered and with intact files only.

        It is ``None`` unless all raw frames are intact.
        """
        try:
            manifest = form.read(folder)
        except ContentError:
            return None
        # Every byte is read: after a loss of power a file may have its length and hold zeros.
        wrong = scan.wrong_files(folder, manifest, checksums=True)
        if manifest.scan_id != folder.name.removeprefix(".") or any(name in wrong for name in scan.RAW_FILES):
            return None
        if any(name in wrong for name in scan.SECOND_FILES):
            # One exposure is a scan, half of a second one is useless.
            manifest = replace(manifest, record=replace(manifest.record, second=None))
            wrong |= dict.fromkeys(scan.SECOND_FILES, "of no use alone")
        files = {name: stamp for name, stamp in manifest.files.items() if name not in wrong}
        return replace(manifest, files=files, recovered=True)

    def trash(self, scan_id: str) -> Path:
        """Move a scan to the trash, where it keeps its number and every byte, and return its new folder.

        Raises UnknownScan, ScanError for one that lies in the trash already or is set aside, StorageError.
        """
        folder_kind, folder = self._find(scan_id)
        if folder_kind is LibraryFolder.TRASH:
            raise scan.ScanError(f"scan {folder.name} is in the trash already; `kingfisher scans restore` takes it out")
        if folder_kind is LibraryFolder.SET_ASIDE:
            raise scan.ScanError(f"scan {folder.name} is set aside: it is incomplete and in no list; leave it")
        return self._move(folder, self._folder_of(LibraryFolder.TRASH) / folder.name)

    def restore(self, scan_id: str) -> Path:
        """Move a scan out of the trash, to where its manifest says that it belongs, and return its new folder.

        Raises UnknownScan for one that is not in the trash, ScanError where another of its number lies there,
        StorageError.
        """
        folder = self._find_on(LibraryFolder.TRASH, scan_id)
        if folder is None:
            raise UnknownScan(
                f"no scan {scan_id!r} in the trash of {self.root}; `kingfisher scans list trash --root {self.root}` "
                "lists the trash"
            )
        return self._move(folder, self._folder_of(_kind_before_trash(folder)) / folder.name)

    def _move(self, folder: Path, target: Path) -> Path:
        # The trash is made when it is first needed.
        self._fs.make_folders(target.parent)
        if target.exists():
            raise scan.ScanError(f"scan {folder.name}: {target} exists already; move one of them elsewhere")
        self._fs.move_folder(folder, target)
        return target

    def set_label(self, scan_id: str, label: Label) -> None:
        """Give a scan a label, durably; its other files do not change.

        Raises UnknownScan, StorageError.
        """
        label.write(self._fs, self._find(scan_id)[1])

    # ------------------------------------------------------------------------------------- reading

    def entries(self, folder_kind: LibraryFolder = LibraryFolder.SCANS) -> list[ScanEntry]:
        """Return all scans in a kind of folder by number; lengths are checked, checksums are not (``verify``)."""
        return [ScanEntry.of(folder, checksums=False) for folder in self._sorted(folder_kind)]

    def entry(self, scan_id: str) -> ScanEntry:
        """Return one scan by its number, in any folder. Raises UnknownScan."""
        return ScanEntry.of(self._find(scan_id)[1], checksums=False)

    def verify(self, scan_id: str) -> ScanEntry:
        """Return the entry of a scan like ``entry``, but read every byte. Raises UnknownScan."""
        return ScanEntry.of(self._find(scan_id)[1], checksums=True)

    def load(self, scan_id: str) -> scan.StoredScan:
        """Open a scan. Raises UnknownScan, ScanError."""
        return StoredScan.load(self._find(scan_id)[1])

    def count(self) -> int:
        """Return the number of published scans."""
        return sum(1 for _ in self._folders(LibraryFolder.SCANS))

    def ids(self) -> list[str]:
        """Return numbers of all published scans, the oldest first."""
        return [folder.name for folder in self._sorted(LibraryFolder.SCANS)]

    def last_id(self) -> str | None:
        """Return the number of the newest published scan."""
        return next(reversed(self.ids()), None)

    def scans_left(self, scan_bytes: int, reserve_bytes: int) -> int | None:
        """Return how many more scans of that size fit above the reserve; ``None`` if the disk does not tell."""
        try:
            free = self._fs.free_bytes(self.root)
        except OSError:
            return None
        return max(0, (free - reserve_bytes) // scan_bytes)

    # ------------------------------------------------------------------------------------- folders

    def _folder_of(self, folder_kind: LibraryFolder) -> Path:
        return self.root / folder_kind.value

    def _folders(self, folder_kind: LibraryFolder, *, hidden: bool = False) -> Iterator[Path]:
        with StorageError.naming("cannot list", self._folder_of(folder_kind)):
            try:
                children = list(self._folder_of(folder_kind).iterdir())
            except FileNotFoundError:
                return
        for child in children:
            if child.name.startswith(".") == hidden and _numbered(child) is not None and child.is_dir():
                yield child

    def _sorted(self, folder_kind: LibraryFolder) -> list[Path]:
        return sorted(self._folders(folder_kind), key=lambda folder: by_number(folder.name))

    def _numbers(self) -> Iterator[int]:
        for folder_kind in LibraryFolder:
            for hidden in (False, True):
                yield from (_number(folder) for folder in self._folders(folder_kind, hidden=hidden))

    def _free_name(self, folder_kind: LibraryFolder, scan_id: str) -> Path:
        # A folder that was set aside is never overwritten by another one with its number.
        names = (scan_id, *(f"{scan_id}-{k}" for k in range(2, 1000)))
        return next(path for name in names if not (path := self._folder_of(folder_kind) / name).exists())

    def _find(self, scan_id: str) -> tuple[LibraryFolder, Path]:
        for folder_kind in LibraryFolder:
            folder = self._find_on(folder_kind, scan_id)
            if folder is not None:
                return folder_kind, folder
        raise UnknownScan(
            f"no scan {scan_id!r} under {self.root}; `kingfisher scans list --all --root {self.root}` lists all scans"
        )

    def _find_on(self, folder_kind: LibraryFolder, scan_id: str) -> Path | None:
        for folder in self._sorted(folder_kind):
            # isascii: no folder's name has digits of other scripts. Compared as texts: int() refuses thousands of
            # digits.
            plain_number = (
                scan_id.isascii() and scan_id.isdigit() and (scan_id.lstrip("0") or "0") == str(_number(folder))
            )
            if folder.name == scan_id or plain_number:
                return folder
        return None

    def largest_object(self) -> int:
        """Return the largest object number that one of the newest scans has, in any folder; 0 if none has one.

        Raises OSError.
        """
        folders = [folder for folder_kind in LibraryFolder for folder in self._folders(folder_kind)]
        for folder in sorted(folders, key=_number, reverse=True)[:LOOKED_AT]:
            try:
                number = form.read(folder).record.object
            except ContentError:
                continue  # damaged: the next older one counts
            if number is not None:
                return number
        return 0

    def scans_of_object(self, number: int) -> list[str]:
        """Return the published scans that belong to an object, by their numbers in the order they were taken."""
        return [
            entry.scan_id
            for entry in self.entries(LibraryFolder.SCANS)
            if entry.manifest is not None and entry.manifest.record.object == number
        ]

    def objects(self) -> list[int]:
        """Return the object numbers of all published scans, ascending."""
        entries = self.entries(LibraryFolder.SCANS)
        numbers = {None if entry.manifest is None else entry.manifest.record.object for entry in entries}
        return sorted(number for number in numbers if number is not None)

    def folders(self, *, every: bool) -> list[Path]:
        """Return the folders of all published scans, and with ``every`` of the rejected ones, in order."""
        return [folder for folder_kind in folder_kinds(every=every) for folder in self._sorted(folder_kind)]


def _kind_before_trash(folder: Path) -> LibraryFolder:
    """Return the kind of folder in which a scan lay before the trash; SCANS for a damaged one."""
    try:
        return LibraryFolder.REJECTED if form.read(folder).decision is Decision.REJECTED else LibraryFolder.SCANS
    except ContentError:
        return LibraryFolder.SCANS


def _number(folder: Path) -> int:
    number = _numbered(folder)
    if number is None:
        raise ValueError(f"{folder} is no scan's folder")
    return int(number)


def _numbered(folder: Path) -> str | None:
    """Return the number in a folder's name, hidden or not; ``None`` if it is no scan's."""
    return scan_number(folder.name.removeprefix("."))


def _size(folder: Path) -> int:
    try:
        return sum(path.stat().st_size for path in folder.iterdir())
    except OSError:
        return 0  # the list goes on; the fault is among the entry's problems


class PendingScan:
    """A scan whose raw frames are durable and that waits for the diver's decision. One thread at a time."""

    def __init__(self, fs: FileSystem, root: Path, folder: Path, manifest: Manifest) -> None:
        self._fs = fs
        self._root = root
        self._folder = folder
        self._manifest = manifest
        self._done = False

    @property
    def scan_id(self) -> str:
        """Number of the scan, six digits; also the name of its folder once published."""
        return self._manifest.scan_id

    @property
    def folder(self) -> Path:
        """Return the path at which the scan lies now."""
        return self._folder

    def add_second(self, frames: Mapping[str, NDArray[np.uint8]], record: ScanRecord) -> None:
        """Make a second exposure's frames durable beside the first one's; ``record`` describes both.

        On failure the scan keeps its first exposure alone, and the call may be repeated. Raises StorageError,
        ValueError.
        """
        if not self._done:
            self._manifest = scan.add_second(self._fs, self._folder, self._manifest, frames, record)

    def publish(self, record: ScanRecord, cloud: PointCloud | None = None, preview_png: bytes | None = None) -> Path:
        """Add cloud and preview and publish the scan; on return it is durable.

        May be called again after StorageError; a published scan's folder is only returned. Raises StorageError,
        ValueError.
        """
        return self._end(LibraryFolder.SCANS, Decision.KEPT, record, cloud, preview_png, "")

    def reject(self, reason: str, record: ScanRecord | None = None) -> Path:
        """Move the scan to the rejected ones; no file is deleted. A published scan is left alone.

        Raises StorageError; may be called again then.
        """
        return self._end(LibraryFolder.REJECTED, Decision.REJECTED, record or self._manifest.record, None, None, reason)

    def _end(
        self,
        folder_kind: LibraryFolder,
        decision: Decision,
        record: ScanRecord,
        cloud: PointCloud | None,
        preview_png: bytes | None,
        reason: str,
    ) -> Path:
        if self._done:
            return self._folder
        # After a failure all files but the raw frames are written anew: a failed fsync may have dropped them.
        final = scan.finish_scan(self._fs, self._folder, self._manifest, decision, record, cloud, preview_png, reason)
        target = self._root / folder_kind.value / self.scan_id
        if self._folder != target:
            try:
                self._fs.move_folder(self._folder, target)
            finally:
                if target.exists() and not self._folder.exists():
                    self._folder = target  # also when the disk failed after the rename
        else:
            with StorageError.naming("cannot publish", target):
                self._fs.sync_folder(target.parent)
        self._manifest = final
        self._done = True
        return target
