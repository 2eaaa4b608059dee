"""Owns how one recording is taken: into a draft that is gone on with, compared as it lies on the desk's disk, published
by one rename.

    <root>/scans/.000123.pulling     being taken: the manifest first, then files that keep what came of them
    <root>/scans/000123              whole: every byte is what the manifest says

Drafts are the only files here that are ever removed: a file in one that turns out not to be what the manifest says is
taken anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from appliance.base import ContentError
from appliance.store.archive import problems_of
from appliance.store.atomic import LocalFileSystem, StorageError, checked_stamp
from appliance.store.incomplete import INCOMPLETE, INCOMPLETE_OF
from appliance.store.label import LABEL, LABEL_FILE
from appliance.store.manifest import INCOMPLETE_MANIFEST_FILE, MANIFEST, MANIFEST_FILE, Manifest
from appliance.store.names import is_component
from appliance.store.packed import packed_path
from appliance.store.pull.source import NotThere, RemoteEntry, Source, Unreadable, text_of
from appliance.store.scan import ScanError, wrong_files

TIMES = 3
"""Number of times that a recording whose bytes do not fit is read."""
ROOM_LEFT_BYTES = 1_000_000
"""Room that a recording must leave on the desk's disk."""


class PullOutcome(Enum):
    """Outcomes for one recording."""

    TAKEN = "taken"
    ALREADY = "already there"
    LATER = "left for next time"
    DIFFERS = "differs"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """A recording as it lies on the instrument."""

    path: str
    """Its folder there, below the storage root; the same here."""
    about: bytes
    """Content of its manifest, or of what stands in its place."""
    about_name: str
    files: tuple[RemoteEntry, ...]
    """All files but the manifest and the label."""
    label_bytes: int
    """Length of the label; 0 where there is none."""
    manifest: Manifest

    @property
    def size_bytes(self) -> int:
        """Bytes that there are to take."""
        return sum(one.size_bytes for one in self.files) + self.label_bytes


class NotYet(Exception):
    """A recording is not to be taken now; the outcome and the reason."""

    def __init__(self, outcome: PullOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


@contextmanager
def given() -> Iterator[None]:
    """Turns what a source does not give into the outcome that tells it. Raises NotYet."""
    try:
        yield
    except NotThere as error:
        raise NotYet(PullOutcome.LATER, f"was moved or changed there meanwhile ({error})") from error
    except Unreadable as error:
        raise NotYet(PullOutcome.FAILED, f"cannot be read there: {error}") from error


def find(source: Source, path: str) -> FoundRecording:
    """Look at a recording there. Raises NotYet, LinkLost."""
    try:
        with given():
            entries = {one.name: one for one in source.listing(path) if not one.folder and is_component(one.name)}
            about_name = next((one for one in (MANIFEST_FILE, INCOMPLETE_MANIFEST_FILE) if one in entries), None)
            if about_name is None:
                raise NotYet(PullOutcome.FAILED, f"{path}: has no manifest there; look at it on the instrument")
            about = text_of(source, f"{path}/{about_name}", MANIFEST.max_bytes)
        manifest = _manifest(about, about_name, path)
    except (ContentError, ScanError) as error:
        raise NotYet(PullOutcome.FAILED, f"its manifest cannot be used there: {error}") from error
    if manifest.scan_id != Path(path).name.partition("-")[0]:
        raise NotYet(PullOutcome.FAILED, f"{path}: its manifest is of scan {manifest.scan_id}")
    lacking = [name for name in manifest.files if entries.keys().isdisjoint((name, _packed_name(name)))]
    if lacking:
        raise NotYet(PullOutcome.FAILED, f"{path}: {', '.join(sorted(lacking))} missing there")
    files = tuple(one for name, one in entries.items() if name not in (about_name, LABEL_FILE))
    label_bytes = entries[LABEL_FILE].size_bytes if LABEL_FILE in entries else 0
    return FoundRecording(path, about, about_name, files, label_bytes, manifest)


def present(found: FoundRecording, source: Source, fs: LocalFileSystem, target: Path) -> None:
    """Say what ``target``, which is there, is beside what was found: raises NotYet, always; LinkLost, StorageError.

    The same recording with more in it (a cloud that was made at the desk) is the same recording. A label that is not
    here is taken; nothing else is touched.
    """
    with StorageError.naming("cannot read", target):
        path = target / found.about_name
        ours = path.read_bytes() if path.exists() else b""
    try:
        here = dict(_manifest(ours, found.about_name, str(target)).files)
    except (ContentError, ScanError):
        here = {}
    other = sorted(name for name, stamp in found.manifest.files.items() if here.get(name) != stamp)
    if ours != found.about and (other or not here):
        raise NotYet(
            PullOutcome.DIFFERS,
            f"{'; '.join(other) or 'its manifest'}: not the same at both ends, and left alone ({target}); one "
            "instrument, one "
            "folder: give another DIR for another instrument, or move the folder away to have the instrument's",
        )
    if found.about_name == MANIFEST_FILE:
        wrong = wrong_files(target, MANIFEST.decode(ours, str(target)), checksums=False)
        if wrong:
            raise NotYet(
                PullOutcome.FAILED, f"is here, and damaged ({target}): {_told(wrong)}; move it away, and call again"
            )
    _take_label(found, source, fs, target)
    raise NotYet(PullOutcome.ALREADY, "")


def draft_folder(target: Path) -> Path:
    """Return where ``target`` is put together."""
    return target.with_name(f".{target.name}.pulling")


def already_here_bytes(found: FoundRecording, target: Path) -> int:
    """Return how much of a recording an earlier call has taken. Raises StorageError."""
    with StorageError.naming("cannot read", target):
        paths = (draft_folder(target) / one.name for one in found.files)
        return sum(path.stat().st_size for path in paths if path.exists())


def take(found: FoundRecording, source: Source, fs: LocalFileSystem, target: Path, came: Callable[[int], None]) -> None:
    """Take a recording that is not here; ``came`` hears of each piece's bytes. Durable and whole on return.

    Raises NotYet where it is not to be had whole now, LinkLost, StorageError. The draft stays for the next call.
    """
    draft = draft_folder(target)
    fs.make_folders(draft)
    wrong: dict[str, str] = {}
    for _ in range(TIMES):
        _begin(found, fs, draft)
        _require_room(found, fs, target)
        for entry in found.files:
            _take_file(source, f"{found.path}/{entry.name}", entry.size_bytes, fs, draft / entry.name, came)
        came(_take_label(found, source, fs, draft))
        wrong = _wrong(found, draft)
        if not wrong:
            fs.move_folder(draft, target)
            return
        for name in wrong:
            fs.discard(draft / name)
            fs.discard(draft / _packed_name(name))
        found = find(source, found.path)  # it may have been changed meanwhile
    raise NotYet(PullOutcome.FAILED, f"damaged on the instrument: {_told(wrong)} (read {TIMES} times)")


def _begin(found: FoundRecording, fs: LocalFileSystem, draft: Path) -> None:
    """Leave in a draft only what the manifest proves in the end: half a file of something else is found out there, and
    taken anew."""
    with StorageError.naming("cannot read", draft):
        names = {path.name for path in draft.iterdir()}
    for name in names.difference(found.manifest.files, map(_packed_name, found.manifest.files)):
        fs.discard(draft / name)
    # Its sync of the folder makes the removals durable, too.
    fs.replace_file(draft / found.about_name, found.about)


def _require_room(found: FoundRecording, fs: LocalFileSystem, target: Path) -> None:
    with StorageError.naming("cannot ask for the room on", target.parent):
        free_bytes = fs.free_bytes(target.parent)
    missing = found.size_bytes - already_here_bytes(found, target) + ROOM_LEFT_BYTES - free_bytes
    if missing > 0:
        raise StorageError(
            "cannot take a scan to",
            target.parent,
            f"the disk lacks {missing / 1e6:.1f} MB for the next one",
            "free space on it, and call again: what was taken stays",
        )


def _take_file(
    source: Source, there: str, size_bytes: int, fs: LocalFileSystem, path: Path, came: Callable[[int], None]
) -> None:
    with StorageError.naming("cannot write", path):
        begun = path.exists()
        here = path.stat().st_size if begun else 0
        file = fs.append(path) if begun else fs.create(path)
        try:
            # Each piece is written as it comes: what came before a link broke is kept, and the next call asks for what
            # follows.
            with given():
                for data in source.read(there, here, size_bytes):
                    file.write(data)
                    came(len(data))
            # Also where nothing was missing: whoever wrote the last piece may have ended before its sync.
            file.sync()
        finally:
            file.close()


def _take_label(found: FoundRecording, source: Source, fs: LocalFileSystem, folder: Path) -> int:
    """Take a name and a note that are not here, and return their bytes.

    Raises NotYet where both ends have one, and another.
    """
    if not found.label_bytes:
        return 0
    with given():
        theirs = text_of(source, f"{found.path}/{LABEL_FILE}", LABEL.max_bytes)
    path = folder / LABEL_FILE
    with StorageError.naming("cannot read", path):
        ours = path.read_bytes() if path.exists() else None
    if ours is None:
        fs.replace_file(path, theirs)
    elif ours != theirs:
        raise NotYet(PullOutcome.DIFFERS, f"its name or note is another one at both ends ({path}), and left alone")
    return len(theirs)


def _wrong(found: FoundRecording, draft: Path) -> dict[str, str]:
    """Return what is not as the manifest says, by name, every byte read back from the disk; packed frames are decoded."""
    if found.about_name == MANIFEST_FILE:
        return problems_of(draft)
    with StorageError.naming("cannot read", draft):
        return {
            name: "damaged (its checksum does not fit)"
            for name, stamp in found.manifest.files.items()
            if checked_stamp(draft / name) != stamp
        }


def _manifest(about: bytes, name: str, where: str) -> Manifest:
    return MANIFEST.decode(about, where) if name == MANIFEST_FILE else INCOMPLETE.decode(about, where, INCOMPLETE_OF)


def _packed_name(name: str) -> str:
    return packed_path(Path(name)).name


def _told(wrong: dict[str, str]) -> str:
    return "; ".join(f"{name}: {what}" for name, what in sorted(wrong.items()))
