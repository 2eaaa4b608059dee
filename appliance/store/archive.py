"""Owns how scans come into an archive and out of it: whole or not at all, compared byte for byte, and no source goes
before that.

An archive is a storage root like any other, with the frames of its scans packed (``appliance.store.packed``):

    <archive>/scans/000123            packed; every other file as it was, the manifest byte for byte the same
    <archive>/scans/.000123.packing   being written; the next call removes it
    <source>/scans/.000123.archived   a source that was compared and is being removed; the next call goes on with it

Nothing that is there is replaced, in an archive or in a root that is unpacked into: people work in both. One process
writes to each (``appliance.store.lock``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path

from appliance.base import Progress
from appliance.store import manifest as form
from appliance.store import packed
from appliance.store import scan as stored
from appliance.store.atomic import Bytes, FileSystem, LocalFileSystem, Stamp, StorageError, checked_stamp
from appliance.store.library import Library, LibraryFolder, ScanEntry, shelves_of
from appliance.store.lock import hold_lock
from appliance.store.names import CALIBRATION_FILE, OBJECTS, scan_number
from appliance.store.packed import PackedError, packed_path
from appliance.store.scan import FRAME_FILES, ScanError, StoredScan

_DRAFT, _LEAVING = "packing", "archived"
_BESIDE = (CALIBRATION_FILE.parent.name, OBJECTS)
"""Folders of a storage root whose JSON files go with its scans."""


class Copied(Enum):
    """Outcomes for one scan that was to be written."""

    WRITTEN = "written"
    ALREADY = "already there"


@dataclass(frozen=True, slots=True)
class CopiedScan:
    """Outcome for one scan."""

    scan: str
    """Name of its folder."""
    done: Copied | None
    """``None``: it failed."""
    reason: str | None
    """Reason of a failure; ``None``: there is none."""
    size_bytes: int
    """Bytes of it at its source."""
    there_bytes: int = 0
    """Bytes of it where it was written."""


@dataclass(frozen=True, slots=True)
class BesideFile:
    """A calibration's or object's file that is another one in the source and in the target."""

    path: str
    """Its path below both storage roots; the target's own was left alone."""
    copy: Path | None
    """The source's, in the target; ``None`` where that name has other content, too."""


@dataclass(frozen=True, slots=True)
class ArchiveReport:
    """Outcome of packing or unpacking a storage root."""

    scans: tuple[CopiedScan, ...]
    different: tuple[BesideFile, ...]

    @property
    def whole(self) -> bool:
        """True if nothing failed."""
        return all(one.done is not None for one in self.scans) and all(one.copy is not None for one in self.different)

    @property
    def counts(self) -> dict[str, int]:
        """Number of scans by outcome, in words."""
        done = [None if one.done is None else one.done.value for one in self.scans]
        return {**{what.value: done.count(what.value) for what in Copied}, "failed": done.count(None)}


def pack_archive(source: Path, archive: Path, *, every: bool, remove: bool, progress: Progress) -> ArchiveReport:
    """Pack the scans of the storage root ``source`` into ``archive``, which is made; a scan that cannot be used does
    not keep the others from it.

    ``every``: the rejected ones, too. ``remove``: each leaves ``source`` once its copy was compared with it. Raises
    StorageError, MissingLibraryError.
    """
    shelves, fs = shelves_of(every=every), LocalFileSystem()
    fs.make_folders(archive)
    with ExitStack() as held:
        held.enter_context(hold_lock(archive))
        make_shelves(fs, archive, shelves)
        left: dict[str, str] = {}
        if remove:
            # No instrument may write there meanwhile; without removals it may, since only finished scans are read.
            held.enter_context(hold_lock(source))
            left = finish_removals(fs, source, shelves)
        different = copy_beside(fs, source, archive)

        def pack(folder: Path, target: Path) -> Copied:
            done = pack_scan(fs, folder, target)
            if remove:
                remove_source(fs, folder, target)
            return done

        stay = [CopiedScan(name, None, reason, 0) for name, reason in left.items()]
        packed_now = _each(Library(source).folders(every=every), pack, archive, progress)
        return ArchiveReport((*stay, *packed_now), tuple(different))


def unpack_archive(archive: Path, out: Path, scans: Sequence[str], progress: Progress) -> ArchiveReport:
    """Unpack ``scans`` of an archive by their numbers, all where none is named, into the storage root ``out``, which is
    made; one that cannot be used does not keep the others from it.

    Raises UnknownScan, StorageError, MissingLibraryError.
    """
    library, fs = Library(archive), LocalFileSystem()
    folders = [library.entry(scan).folder for scan in scans] or library.folders(every=True)
    fs.make_folders(out)
    with hold_lock(out):
        make_shelves(fs, out, shelves_of(every=True))
        different = copy_beside(fs, archive, out)
        return ArchiveReport(tuple(_each(folders, partial(unpack_scan, fs), out, progress)), tuple(different))


def _each(
    folders: Sequence[Path], work: Callable[[Path, Path], Copied], out: Path, progress: Progress
) -> Iterator[CopiedScan]:
    for k, folder in enumerate(folders):
        progress(folder.name, k / len(folders))
        size = _size(folder)  # before: a source may be gone afterwards
        target = out / folder.parent.name / folder.name
        try:
            done = work(folder, target)
        except ScanError as error:
            yield CopiedScan(folder.name, None, str(error), size)
        else:
            yield CopiedScan(folder.name, done, None, size, _size(target))


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())


def make_shelves(fs: FileSystem, root: Path, shelves: Iterable[LibraryFolder]) -> None:
    """Make the folders that scans come into, and remove what an interrupted call left half written. Raises
    StorageError.

    Under the lock of ``root`` alone: what another call has half written is no leftover.
    """
    for folder in (root, *(root / shelf.value for shelf in shelves)):
        fs.make_folders(folder)
        for draft in _hidden(folder, _DRAFT):
            fs.remove_folder(draft)


def copy_beside(fs: FileSystem, source: Path, target: Path) -> list[BesideFile]:
    """Copy calibrations and objects from one storage root to another, and return what is another one there. Raises
    StorageError.

    Nothing is replaced: the target's calibration stays in use, and what was worked out in it stays; the source's file
    lies beside it.
    """
    different = []
    for name in _BESIDE:
        for path in sorted((source / name).rglob("*.json")):
            with StorageError.naming("cannot copy", path):
                content = path.read_bytes()
            plain = target / path.relative_to(source)
            copy, _ = fs.add_beside(plain, content)
            if copy != plain:
                different.append(BesideFile(path.relative_to(source).as_posix(), copy))
    return different


def pack_scan(fs: FileSystem, source: Path, target: Path) -> Copied:
    """Pack the scan in ``source`` as ``target``, which is compared with it before it gets its name.

    Raises ScanError for a damaged source or where ``target`` is another scan, StorageError, MissingLibraryError.
    """
    manifest = StoredScan.manifest_of(source)
    if target.exists():
        return _present(fs, source, target)
    wrong = stored.wrong_files(source, manifest, checksums=True)
    if wrong:
        # A damaged scan stays where it is: packed, it would look like one that was compared.
        raise ScanError(f"{source}: {_told(wrong)}; not packed: bring it back from a copy first")
    draft = _draft(target)
    parts: dict[str, Iterable[Bytes]] = {}
    for path in _files(source):
        if path.name in FRAME_FILES:
            parts[packed_path(path).name] = _packed_parts(path, manifest)
        else:
            parts[path.name] = (path.read_bytes(),)
    _write(fs, draft, parts)
    return _published(fs, source, draft, target)


def unpack_scan(fs: FileSystem, source: Path, target: Path) -> Copied:
    """Unpack the scan in ``source`` as ``target``: the folder that was packed, byte for byte.

    Raises ScanError for damaged frames or where ``target`` is another scan, StorageError, MissingLibraryError.
    """
    StoredScan.manifest_of(source)
    if target.exists():
        return _present(fs, source, target)
    draft = _draft(target)
    parts: dict[str, Iterable[Bytes]] = {}
    for path in _files(source):
        plain = path.with_name(path.name.removesuffix(packed.SUFFIX))
        if stored.is_packed(source, plain.name):
            parts[plain.name] = _plain_parts(path)
        else:
            parts[path.name] = (path.read_bytes(),)
    _write(fs, draft, parts)
    return _published(fs, source, draft, target)


def problems_of(folder: Path) -> dict[str, str]:
    """Return what is wrong with a scan, by file, every frame decoded and its bytes compared with the checksum of before
    it was packed.

    Raises ScanError without a readable manifest, MissingLibraryError.
    """
    manifest = StoredScan.manifest_of(folder)
    wrong = stored.wrong_files(folder, manifest, checksums=True)
    for name in FRAME_FILES:
        if name in wrong or not stored.is_packed(folder, name):
            continue
        try:
            if packed.stamp_of(folder / name) != manifest.files[name]:
                wrong[name] = "decodes to other frames"
        except PackedError as error:
            wrong[name] = str(error)
        except OSError as error:
            wrong[name] = error.strerror or str(error)
    return wrong


def verified(folder: Path) -> ScanEntry:
    """Return one scan by its folder, every byte of it read and packed frames decoded; its problems name the damaged
    frames where it is known which they are.

    Raises MissingLibraryError.
    """
    entry = ScanEntry.of(folder, checksums=True)
    if entry.manifest is not None and any(folder.glob("*.jls")):
        wrong = (f"{name}: {what}" for name, what in problems_of(folder).items())
        entry = replace(entry, problems=tuple(dict.fromkeys((*entry.problems, *wrong))))
    if entry.ok or entry.manifest is None:
        return entry
    from appliance.store.damage import damaged_frames

    # The checksum of the file said that something is wrong; the CRC of each frame says in which image (ADR 0033).
    frames = {one.file: str(one) for one in damaged_frames(folder, entry.manifest)}
    return replace(entry, problems=tuple(frames.get(text.partition(":")[0], text) for text in entry.problems))


def remove_source(fs: FileSystem, source: Path, copy: Path) -> None:
    """Remove the scan in ``source`` after everything in it was found in ``copy``, byte for byte; frames are decoded for
    it.

    Raises ScanError, and nothing is removed, where anything differs; StorageError.
    """
    compared = _refuse_difference(source, copy)
    leaving = source.with_name(f".{source.name}.{_LEAVING}")
    # Under its new name it is in no list, so that half of it is never taken for a scan; what is left is removed by the
    # next call.
    fs.move_folder(source, leaving)
    with StorageError.naming("cannot list", leaving):
        now = sorted(path.name for path in leaving.iterdir())
    if now != [path.name for path in compared]:
        fs.move_folder(leaving, source)
        raise ScanError(f"{source}: was changed while it was compared; nothing was removed: call again")
    fs.remove_folder(leaving)


def finish_removals(fs: FileSystem, root: Path, shelves: Iterable[LibraryFolder]) -> dict[str, str]:
    """Remove what is left of sources whose removal was interrupted: they were compared before. Raises StorageError.

    Returns what is left alone, by folder, and why: something in it that no call has ever packed.
    """
    left = {}
    for shelf in shelves:
        for folder in _hidden(root / shelf.value, _LEAVING):
            try:
                _files(folder)
            except ScanError as error:
                left[folder.name] = f"{error}. The scan itself was packed and compared before"
            else:
                fs.remove_folder(folder)
    return left


def _present(fs: FileSystem, source: Path, target: Path) -> Copied:
    """Return ALREADY where ``target`` is the scan of ``source``; a label or another file that it lacks is added.

    Raises ScanError, also where such a file is another one at both ends, and StorageError.
    """
    ours, theirs = (folder / form.MANIFEST_FILE for folder in (source, target))
    with StorageError.naming("cannot compare", target):
        same = theirs.is_file() and ours.read_bytes() == theirs.read_bytes()
    if not same:
        raise ScanError(f"{target}: is there and is another scan than {source}; give another folder with --out")
    manifest = StoredScan.manifest_of(source)
    wrong = stored.wrong_files(target, manifest, checksums=False)
    if wrong:
        raise ScanError(f"{target}: {_told(wrong)}; move it away, and call again")
    other = []
    for path in _files(source):
        # Names and notes are written after the dive, also after the scan was packed, and in an archive as well.
        if (
            path.name not in manifest.files
            and not path.name.endswith(packed.SUFFIX)
            and path.name != form.MANIFEST_FILE
        ):
            with StorageError.naming("cannot copy", path):
                content, copy = path.read_bytes(), target / path.name
                there = copy.read_bytes() if copy.exists() else None
            if there is None:
                fs.replace_file(copy, content)
            elif there != content:
                other.append(path.name)
    if other:
        raise ScanError(
            f"{', '.join(other)} DIFFERS at both ends, and was left alone ({source}, {target}); make it the same at "
            "both, or move away "
            "the one that is not wanted"
        )
    return Copied.ALREADY


def _published(fs: FileSystem, source: Path, draft: Path, target: Path) -> Copied:
    try:
        _refuse_difference(source, draft)
    except ScanError:
        fs.remove_folder(draft)
        raise
    fs.move_folder(draft, target)
    return Copied.WRITTEN


def _refuse_difference(source: Path, copy: Path) -> list[Path]:
    """Return the files of ``source``.

    Raises ScanError where one has not the same bytes in ``copy``, frames as they decode.
    """
    files = _files(source)
    for path in files:
        name = path.name.removesuffix(packed.SUFFIX)
        try:
            frames = name in FRAME_FILES
            same = _stamp(source / name, frames=frames) == _stamp(copy / name, frames=frames)
        except (PackedError, OSError) as error:
            raise ScanError(f"{copy / name}: cannot be compared with {path} ({error}); nothing was removed") from error
        if not same:
            raise ScanError(f"{copy / name}: is not what {path} is; nothing was removed")
    return files


def _stamp(path: Path, *, frames: bool) -> Stamp:
    return packed.stamp_of(path) if frames else checked_stamp(path)


def _write(fs: FileSystem, draft: Path, parts: dict[str, Iterable[Bytes]]) -> None:
    with StorageError.naming("cannot make", draft):
        fs.make_folder(draft)
    try:
        # The manifest last, as in every folder of a scan: without it, nobody takes the folder for one.
        for name in sorted(parts, key=lambda one: (one == form.MANIFEST_FILE, one)):
            fs.write_new(draft / name, parts[name])
    except BaseException:
        with suppress(StorageError):  # half a copy on a full disk helps nobody; what stays is removed by the next call
            for name in parts:
                fs.discard(draft / name)
            fs.discard(draft)
        raise


def _packed_parts(path: Path, manifest: form.Manifest) -> Iterator[Bytes]:
    # A generator, so that the frames of one camera at a time are in memory.
    frames = stored.map_frames(path, len(manifest.record.sequence.patterns))
    with path.open("rb") as file:
        header = file.read(path.stat().st_size - frames.size)
    yield from packed.pack(header, frames, manifest.files[path.name], path.name)


def _plain_parts(path: Path) -> Iterator[Bytes]:
    try:
        yield from packed.read_index(path).parts()
    except PackedError as error:
        raise ScanError(f"{path}: {error}; bring it back from a copy") from error


def _draft(target: Path) -> Path:
    return target.with_name(f".{target.name}.{_DRAFT}")


def _files(folder: Path) -> list[Path]:
    """Return all that is in a scan's folder. Raises ScanError where anything is no file: it would not be packed."""
    with StorageError.naming("cannot list", folder):
        found = sorted(folder.iterdir())
        other = [path.name for path in found if not path.is_file()]
    if other:
        raise ScanError(
            f"{folder}: {', '.join(other)}: no file, and only files are packed; move it out, and call again"
        )
    return found


def _hidden(folder: Path, ending: str) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(one for one in folder.glob(f".*.{ending}") if scan_number(one.name[1 : -len(ending) - 1]) is not None)


def _told(wrong: dict[str, str]) -> str:
    return "; ".join(f"{name}: {what}" for name, what in sorted(wrong.items()))
