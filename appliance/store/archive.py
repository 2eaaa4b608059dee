"""Packing scans into an archive and unpacking them: whole or not at all, and compared byte for byte.

An archive is a storage root like any other, with the frames of its scans packed (``appliance.store.packed``):

    <archive>/scans/000123            packed; every other file as it was, the manifest byte for byte the same
    <archive>/scans/.000123.packing   being written; the next call removes it
    <source>/scans/.000123.archived   a source that was compared and is being removed; the next call goes on with it

No existing file is replaced, in an archive or in a root that is unpacked into: people work in both. A source is removed
only after its copy was compared. One process writes to each (``appliance.store.lock``).
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
from appliance.store.library import Library, LibraryFolder, ScanEntry, folder_kinds
from appliance.store.lock import hold_lock
from appliance.store.names import CALIBRATION_FILE, OBJECTS, scan_number
from appliance.store.packed import PackedError, packed_path
from appliance.store.scan import FRAME_FILES, ScanError, StoredScan

_DRAFT, _LEAVING = "packing", "archived"
_BESIDE = (CALIBRATION_FILE.parent.name, OBJECTS)
"""Folders of a storage root whose JSON files go with its scans."""


class CopyOutcome(Enum):
    """Outcomes for one scan that was to be written."""

    WRITTEN = "written"
    ALREADY = "already there"


@dataclass(frozen=True, slots=True)
class ScanCopy:
    """Outcome for one scan."""

    scan: str
    """Name of its folder."""
    outcome: CopyOutcome | None
    """``None``: the scan failed."""
    reason: str | None
    """Reason of the failure; ``None``: the scan did not fail."""
    size_bytes: int
    """Size at its source."""
    target_bytes: int = 0
    """Size where it was written."""


@dataclass(frozen=True, slots=True)
class BesideFile:
    """A calibration's or object's file that is another one in the source and in the target."""

    path: str
    """Its path below both storage roots; the target's file was left alone."""
    copy: Path | None
    """The source's file in the target; ``None`` where that name has other content, too."""


@dataclass(frozen=True, slots=True)
class ArchiveReport:
    """Outcome of packing or unpacking a storage root."""

    scans: tuple[ScanCopy, ...]
    different: tuple[BesideFile, ...]

    @property
    def is_complete(self) -> bool:
        """True if no scan and no other file failed."""
        return all(scan.outcome is not None for scan in self.scans) and all(
            scan.copy is not None for scan in self.different
        )

    @property
    def counts(self) -> dict[str, int]:
        """Number of scans by outcome, in words."""
        outcomes = [None if scan.outcome is None else scan.outcome.value for scan in self.scans]
        return {**{kind.value: outcomes.count(kind.value) for kind in CopyOutcome}, "failed": outcomes.count(None)}


def pack_archive(source: Path, archive: Path, *, every: bool, remove: bool, progress: Progress) -> ArchiveReport:
    """Pack the scans of the storage root ``source`` into ``archive``, which is made.

    A scan that cannot be used is reported and the others are packed. ``every``: rejected scans, too. ``remove``: each
    scan is removed from ``source`` after its copy was compared with it. Raises StorageError, MissingLibraryError.
    """
    kinds, fs = folder_kinds(every=every), LocalFileSystem()
    fs.make_folders(archive)
    with ExitStack() as locks:
        locks.enter_context(hold_lock(archive))
        make_scan_folders(fs, archive, kinds)
        reasons: dict[str, str] = {}
        if remove:
            # Removals need the source's lock. Without them an instrument may write there: only finished scans are read.
            locks.enter_context(hold_lock(source))
            reasons = finish_removals(fs, source, kinds)
        different = copy_beside(fs, source, archive)

        def pack(folder: Path, target: Path) -> CopyOutcome:
            outcome = pack_scan(fs, folder, target)
            if remove:
                remove_source(fs, folder, target)
            return outcome

        unremoved = [ScanCopy(name, None, reason, 0) for name, reason in reasons.items()]
        packed_now = _each(Library(source).folders(every=every), pack, archive, progress)
        return ArchiveReport((*unremoved, *packed_now), tuple(different))


def unpack_archive(archive: Path, out: Path, scans: Sequence[str], progress: Progress) -> ArchiveReport:
    """Unpack ``scans`` of an archive, by default all, into the storage root ``out``, which is made.

    ``scans`` are numbers. One that cannot be used is reported and the others are unpacked. Raises UnknownScan,
    StorageError, MissingLibraryError.
    """
    library, fs = Library(archive), LocalFileSystem()
    folders = [library.entry(scan).folder for scan in scans] or library.folders(every=True)
    fs.make_folders(out)
    with hold_lock(out):
        make_scan_folders(fs, out, folder_kinds(every=True))
        different = copy_beside(fs, archive, out)
        return ArchiveReport(tuple(_each(folders, partial(unpack_scan, fs), out, progress)), tuple(different))


def _each(
    folders: Sequence[Path], work: Callable[[Path, Path], CopyOutcome], out: Path, progress: Progress
) -> Iterator[ScanCopy]:
    for k, folder in enumerate(folders):
        progress(folder.name, k / len(folders))
        size = _size(folder)  # before the work, which may remove the source
        target = out / folder.parent.name / folder.name
        try:
            outcome = work(folder, target)
        except ScanError as error:
            yield ScanCopy(folder.name, None, str(error), size)
        else:
            yield ScanCopy(folder.name, outcome, None, size, _size(target))


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir() if path.is_file())


def make_scan_folders(fs: FileSystem, root: Path, kinds: Iterable[LibraryFolder]) -> None:
    """Make the folders for scans, and remove the drafts of an interrupted call. Raises StorageError.

    Call it only under the lock of ``root``: another call's draft is no leftover.
    """
    for folder in (root, *(root / kind.value for kind in kinds)):
        fs.make_folders(folder)
        for draft in _hidden(folder, _DRAFT):
            fs.remove_folder(draft)


def copy_beside(fs: FileSystem, source: Path, target: Path) -> list[BesideFile]:
    """Copy calibrations and objects from one storage root to another, and return the files that differ.

    No file is replaced: the target keeps its calibration and its results; the source's file is written beside it.
    Raises StorageError.
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


def pack_scan(fs: FileSystem, source: Path, target: Path) -> CopyOutcome:
    """Pack the scan in ``source`` as ``target``, and compare both before ``target`` gets its name.

    Raises ScanError for a damaged source or where ``target`` is another scan, StorageError, MissingLibraryError.
    """
    manifest = StoredScan.manifest_of(source)
    if target.exists():
        return _compare_present(fs, source, target)
    wrong = stored.wrong_files(source, manifest, checksums=True)
    if wrong:
        # A damaged scan stays where it is: packed, it would look like one that was compared.
        raise ScanError(f"{source}: {_problem_list(wrong)}; not packed: restore it from a copy first")
    draft = _draft(target)
    parts: dict[str, Iterable[Bytes]] = {}
    for path in _files(source):
        if path.name in FRAME_FILES:
            parts[packed_path(path).name] = _packed_parts(path, manifest)
        else:
            parts[path.name] = (path.read_bytes(),)
    _write(fs, draft, parts)
    return _publish(fs, source, draft, target)


def unpack_scan(fs: FileSystem, source: Path, target: Path) -> CopyOutcome:
    """Unpack the scan in ``source`` as ``target``: the folder that was packed, byte for byte.

    Raises ScanError for damaged frames or where ``target`` is another scan, StorageError, MissingLibraryError.
    """
    StoredScan.manifest_of(source)
    if target.exists():
        return _compare_present(fs, source, target)
    draft = _draft(target)
    parts: dict[str, Iterable[Bytes]] = {}
    for path in _files(source):
        plain = path.with_name(path.name.removesuffix(packed.SUFFIX))
        if stored.is_packed(source, plain.name):
            parts[plain.name] = _plain_parts(path)
        else:
            parts[path.name] = (path.read_bytes(),)
    _write(fs, draft, parts)
    return _publish(fs, source, draft, target)


def problems_of(folder: Path) -> dict[str, str]:
    """Return the problems of a scan by file, after every frame was decoded.

    The decoded bytes are compared with the checksums from before packing. Raises ScanError without a readable manifest,
    MissingLibraryError.
    """
    manifest = StoredScan.manifest_of(folder)
    wrong = stored.wrong_files(folder, manifest, checksums=True)
    for name in FRAME_FILES:
        if name in wrong or not stored.is_packed(folder, name):
            continue
        try:
            if packed.stamp_of(folder / name) != manifest.files[name]:
                wrong[name] = "decodes to different frames"
        except PackedError as error:
            wrong[name] = str(error)
        except OSError as error:
            wrong[name] = error.strerror or str(error)
    return wrong


def verified_entry(folder: Path) -> ScanEntry:
    """Return the entry of a scan's folder after reading every byte and decoding packed frames.

    Its problems name the damaged frames where these are known. Raises MissingLibraryError.
    """
    entry = ScanEntry.of(folder, checksums=True)
    if entry.manifest is not None and any(folder.glob("*.jls")):
        wrong = (f"{name}: {problem}" for name, problem in problems_of(folder).items())
        entry = replace(entry, problems=tuple(dict.fromkeys((*entry.problems, *wrong))))
    if entry.ok or entry.manifest is None:
        return entry
    from appliance.store.damage import damaged_frames

    # The checksum of a file tells that it is damaged; the CRC of each frame tells which image is (ADR 0033).
    frames = {damage.file: str(damage) for damage in damaged_frames(folder, entry.manifest)}
    return replace(entry, problems=tuple(frames.get(text.partition(":")[0], text) for text in entry.problems))


def remove_source(fs: FileSystem, source: Path, copy: Path) -> None:
    """Remove the scan in ``source`` after it was compared with ``copy``, byte for byte and frames decoded.

    Raises ScanError where a file differs, and then removes none; StorageError.
    """
    compared = _refuse_difference(source, copy)
    leaving = source.with_name(f".{source.name}.{_LEAVING}")
    # Under its new name it is in no list, so that half of it is never taken for a scan. The next call finishes an
    # interrupted removal.
    fs.move_folder(source, leaving)
    with StorageError.naming("cannot list", leaving):
        now = sorted(path.name for path in leaving.iterdir())
    if now != [path.name for path in compared]:
        fs.move_folder(leaving, source)
        raise ScanError(f"{source}: changed during the comparison; nothing is removed; call again")
    fs.remove_folder(leaving)


def finish_removals(fs: FileSystem, root: Path, kinds: Iterable[LibraryFolder]) -> dict[str, str]:
    """Finish interrupted removals of sources; those were compared before. Raises StorageError.

    Return the folders that are left alone and why: they hold a file that no call has ever packed.
    """
    left = {}
    for kind in kinds:
        for folder in _hidden(root / kind.value, _LEAVING):
            try:
                _files(folder)
            except ScanError as error:
                left[folder.name] = f"{error}; the scan is packed and compared; remove its folder yourself"
            else:
                fs.remove_folder(folder)
    return left


def _compare_present(fs: FileSystem, source: Path, target: Path) -> CopyOutcome:
    """Return ALREADY where ``target`` is the scan of ``source``.

    Add a label or another file that it lacks. Raises ScanError, also where such a file differs at both ends, and
    StorageError.
    """
    ours, theirs = (folder / form.MANIFEST_FILE for folder in (source, target))
    with StorageError.naming("cannot compare", target):
        same = theirs.is_file() and ours.read_bytes() == theirs.read_bytes()
    if not same:
        raise ScanError(f"{target}: exists and is another scan than {source}; give another folder with --out")
    manifest = StoredScan.manifest_of(source)
    wrong = stored.wrong_files(target, manifest, checksums=False)
    if wrong:
        raise ScanError(f"{target}: {_problem_list(wrong)}; move it away, and call again")
    different = []
    for path in _files(source):
        # Labels are written after the dive, also after the scan was packed, and in an archive as well.
        if (
            path.name not in manifest.files
            and not path.name.endswith(packed.SUFFIX)
            and path.name != form.MANIFEST_FILE
        ):
            with StorageError.naming("cannot copy", path):
                content, copy = path.read_bytes(), target / path.name
                present = copy.read_bytes() if copy.exists() else None
            if present is None:
                fs.replace_file(copy, content)
            elif present != content:
                different.append(path.name)
    if different:
        raise ScanError(
            f"{', '.join(different)} DIFFERS in source and target, and is not copied ({source}, {target}); "
            "make both the same, or move away the unwanted one"
        )
    return CopyOutcome.ALREADY


def _publish(fs: FileSystem, source: Path, draft: Path, target: Path) -> CopyOutcome:
    try:
        _refuse_difference(source, draft)
    except ScanError:
        fs.remove_folder(draft)
        raise
    fs.move_folder(draft, target)
    return CopyOutcome.WRITTEN


def _refuse_difference(source: Path, copy: Path) -> list[Path]:
    """Compare every file of ``source`` with that of ``copy``, and return the files of ``source``.

    Frames are compared as they decode. Raises ScanError where the bytes differ.
    """
    files = _files(source)
    for path in files:
        name = path.name.removesuffix(packed.SUFFIX)
        try:
            frames = name in FRAME_FILES
            same = _stamp(source / name, frames=frames) == _stamp(copy / name, frames=frames)
        except (PackedError, OSError) as error:
            raise ScanError(f"{copy / name}: cannot be compared with {path} ({error}); nothing is removed") from error
        if not same:
            raise ScanError(f"{copy / name}: differs from {path}; nothing is removed")
    return files


def _stamp(path: Path, *, frames: bool) -> Stamp:
    return packed.stamp_of(path) if frames else checked_stamp(path)


def _write(fs: FileSystem, draft: Path, parts: dict[str, Iterable[Bytes]]) -> None:
    with StorageError.naming("cannot make", draft):
        fs.make_folder(draft)
    try:
        # The manifest last, as in every folder of a scan: without it the folder does not count as one.
        for name in sorted(parts, key=lambda file_name: (file_name == form.MANIFEST_FILE, file_name)):
            fs.write_new(draft / name, parts[name])
    except BaseException:
        with suppress(StorageError):  # free the full disk of half a copy; if a file stays, the next call removes it
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
        raise ScanError(f"{path}: {error}; restore it from a copy") from error


def _draft(target: Path) -> Path:
    return target.with_name(f".{target.name}.{_DRAFT}")


def _files(folder: Path) -> list[Path]:
    """Return all files of a scan's folder.

    Raises ScanError where an entry is no file: it would not be packed.
    """
    with StorageError.naming("cannot list", folder):
        paths = sorted(folder.iterdir())
        non_files = [path.name for path in paths if not path.is_file()]
    if non_files:
        raise ScanError(
            f"{folder}: {', '.join(non_files)}: not a regular file, and only files are packed; move it out, "
            "and call again"
        )
    return paths


def _hidden(folder: Path, ending: str) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(
        path for path in folder.glob(f".*.{ending}") if scan_number(path.name[1 : -len(ending) - 1]) is not None
    )


def _problem_list(wrong: dict[str, str]) -> str:
    return "; ".join(f"{name}: {problem}" for name, problem in sorted(wrong.items()))
