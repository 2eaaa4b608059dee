"""Owns how one recording is taken: into a draft that is gone on with, compared as it lies on the desk's disk, published by one rename.

    <root>/scans/.000123.pulling     being taken; files keep what came of them
    <root>/scans/000123              whole: every byte is what the manifest says

Drafts are the only files here that are ever removed: a file in one that turns out not to be what the manifest says is taken anew.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from appliance.offline.pull.source import NotThere, RemoteEntry, Source, Unreadable, text_of
from appliance.storage import incomplete, packed
from appliance.storage import label as labels
from appliance.storage import manifest as form
from appliance.storage import scan as stored
from appliance.storage.archive import problems_of
from appliance.storage.atomic import Stamp, StorageError, checked_stamp, discard, move_folder, refused, replace_file
from appliance.storage.filesystem import AppendingFileSystem
from appliance.storage.manifest import Manifest, ManifestError
from appliance.storage.names import is_component
from appliance.storage.scan import ScanError

DRAFT = "pulling"
TIMES = 3
"""Number of times that a recording that is changed while it is taken, or whose bytes do not fit, is begun again."""
MOST_FILES = 200
ROOM_LEFT_BYTES = 1_000_000
"""Room that a recording must leave on the desk's disk."""
_BLOCK_BYTES = 1024 * 1024


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
    stamps: dict[str, Stamp]

    @property
    def size_bytes(self) -> int:
        """Bytes that there are to take."""
        return sum(one.size_bytes for one in self.files)


class NotYet(Exception):
    """A recording is not to be taken now; the outcome and the reason."""

    def __init__(self, outcome: PullOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


def find(source: Source, path: str) -> FoundRecording:
    """Look at a recording there. Raises NotYet, LinkLost."""
    try:
        entries = source.listing(path)
        about_name = form.FILE_NAME
        if form.FILE_NAME not in {one.name for one in entries}:
            about_name = form.INCOMPLETE_NAME
        about = text_of(source, f"{path}/{about_name}", form.MAX_BYTES)
    except NotThere:
        raise NotYet(PullOutcome.FAILED, f"{path}: has no manifest there; look at it on the instrument") from None
    except Unreadable as error:
        raise NotYet(PullOutcome.FAILED, f"cannot be read there: {error}") from error
    files = tuple(one for one in entries if not one.folder and is_component(one.name))
    if len(files) > MOST_FILES:
        raise NotYet(PullOutcome.FAILED, f"{path}: {len(files)} files; a recording has at most {MOST_FILES}")
    stamps = _stamps(about, about_name, path)
    names = {one.name for one in files}
    lacking = [name for name in stamps if name not in names and packed.packed_path(Path(name)).name not in names]
    if lacking:
        raise NotYet(PullOutcome.FAILED, f"{path}: {', '.join(sorted(lacking))} missing there")
    return FoundRecording(path, about, about_name, files, stamps)


def present(found: FoundRecording, source: Source, fs: AppendingFileSystem, target: Path) -> None:
    """Say what ``target``, which is there, is beside what was found: raises NotYet, always; LinkLost, StorageError.

    The same recording with more in it (a cloud that was made at the desk) is the same recording. A label that is not here is
    taken; nothing else is touched.
    """
    with refused("cannot read", target):
        try:
            ours = (target / found.about_name).read_bytes()
        except FileNotFoundError:
            ours = b""
    here = {} if not ours else _stamps_here(ours, found.about_name, target)
    if ours != found.about:
        other = sorted(name for name, stamp in found.stamps.items() if here.get(name) != stamp)
        if other or not here:
            what = "; ".join(other) or "its manifest"
            raise NotYet(
                PullOutcome.DIFFERS,
                f"{what}: not the same at both ends, and left alone ({target}); one instrument, one folder: give another DIR "
                "for another instrument, or move the folder away to have the instrument's",
            )
    if found.about_name == form.FILE_NAME:
        wrong = stored.wrong_files(target, form.decode(ours, str(target)), checksums=False)
        if wrong:
            told = "; ".join(f"{name}: {what}" for name, what in sorted(wrong.items()))
            raise NotYet(PullOutcome.FAILED, f"is here, and damaged ({target}): {told}; move it away, and call again")
    _take_label(found, source, fs, target)
    raise NotYet(PullOutcome.ALREADY, "")


def draft_folder(target: Path) -> Path:
    """Return where ``target`` is put together."""
    return target.with_name(f".{target.name}.{DRAFT}")


def already_here_bytes(target: Path) -> int:
    """Return how much of a recording an earlier call has taken."""
    with suppress(OSError):
        return sum(path.stat().st_size for path in draft_folder(target).iterdir())
    return 0


def take(
    found: FoundRecording, source: Source, fs: AppendingFileSystem, target: Path, came: Callable[[int], None]
) -> None:
    """Take a recording that is not here; ``came`` hears of each piece's bytes. Durable and whole on return.

    Raises NotYet where it is not to be had whole now, LinkLost, StorageError. The draft stays for the next call.
    """
    draft = draft_folder(target)
    if not draft.is_dir():
        with refused("cannot make", draft):
            fs.make_folder(draft)
            fs.sync_folder(draft.parent)
    wrong: dict[str, str] = {}
    for _ in range(TIMES):
        _begin(found, fs, draft)
        _require_room(found, fs, draft)
        for entry in found.files:
            if entry.name != found.about_name:
                _take_file(found, entry, source, fs, draft, came)
        replace_file(fs, draft / found.about_name, found.about)
        now = _again(source, found)
        if now != found:
            found = now  # it was changed meanwhile: what stayed the same is kept
            continue
        wrong = _wrong(found, draft)
        if not wrong:
            discard(fs, draft / _WANTED)
            move_folder(fs, draft, target)
            return
        for name in wrong:
            _forget(fs, draft, name)
    if wrong:
        told = "; ".join(f"{name}: {what}" for name, what in sorted(wrong.items()))
        raise NotYet(PullOutcome.FAILED, f"damaged on the instrument: {told} (read {TIMES} times)")
    raise NotYet(PullOutcome.LATER, "is being changed there")


# ---------------------------------------------------------------------------------------- the draft


def _begin(found: FoundRecording, fs: AppendingFileSystem, draft: Path) -> None:
    """Forget in a draft what is not of this recording as it is now."""
    with refused("cannot read", draft):
        names = [path.name for path in draft.iterdir()]
        there = next(((draft / name).read_bytes() for name in (_WANTED,) if name in names), None)
    wanted = _listed(found)
    if there is not None and there == wanted:
        return
    before = (
        {}
        if there is None
        else dict(line.rpartition(" ")[::2] for line in there.decode("utf-8", "replace").splitlines())
    )
    keep = dict(line.rpartition(" ")[::2] for line in wanted.decode().splitlines())
    for name in names:
        # Half a file counts only where it was half of the same file.
        if name != _WANTED and (name not in keep or before.get(name) != keep[name]):
            with refused("cannot remove the unfinished", draft / name):
                fs.remove(draft / name)
    replace_file(fs, draft / _WANTED, wanted)


_WANTED = ".wanted"
"""File beside those of a draft that says which bytes each is to have, so that half a file is gone on with only where it is half of the same."""


def _listed(found: FoundRecording) -> bytes:
    lines = []
    for one in found.files:
        stamp = found.stamps.get(one.name)
        lines.append(f"{one.name} {one.size_bytes}-{stamp.sha256 if stamp is not None else one.changed_s}")
    return "".join(line + "\n" for line in lines).encode()


def _require_room(found: FoundRecording, fs: AppendingFileSystem, draft: Path) -> None:
    with refused("cannot ask for the room on", draft):
        here = sum(path.stat().st_size for path in draft.iterdir() if path.name != _WANTED)
        missing = found.size_bytes - here + ROOM_LEFT_BYTES - fs.free_bytes(draft)
    if missing > 0:
        raise StorageError(
            "cannot take a scan to", draft.parent, f"the disk lacks {missing / 1e6:.1f} MB for the next one",
            "free space on it, and call again: what was taken stays",
        )  # fmt: skip


def _take_file(
    found: FoundRecording,
    entry: RemoteEntry,
    source: Source,
    fs: AppendingFileSystem,
    draft: Path,
    came: Callable[[int], None],
) -> None:
    path = draft / entry.name
    with refused("cannot read", path):
        here = path.stat().st_size if path.exists() else 0
    if here > entry.size_bytes:
        _forget(fs, draft, entry.name)
        here = 0
    if here == entry.size_bytes and path.exists():
        return
    with refused("cannot write", path):
        file = fs.append(path) if path.exists() else fs.create(path)
        try:
            block = bytearray()
            try:
                for data in source.read(f"{found.path}/{entry.name}", here, entry.size_bytes):
                    block += data
                    if len(block) >= _BLOCK_BYTES:
                        # Let go of before it is written: what the disk refused in part is not written a second time.
                        whole, block = block, bytearray()
                        file.write(whole)
                        came(len(whole))
            except (NotThere, Unreadable) as error:
                raise NotYet(PullOutcome.FAILED, f"cannot be read there: {error}") from error
            finally:
                # What came before a link broke is kept, too: the next call asks for what follows.
                file.write(block)
                came(len(block))
            file.sync()
        finally:
            file.close()


def _wrong(found: FoundRecording, draft: Path) -> dict[str, str]:
    """Return what is not as the manifest says, by name, every byte read back from the disk; packed frames are decoded."""
    with refused("cannot read", draft):
        wrong = {
            one.name: f"{(draft / one.name).stat().st_size} bytes instead of {one.size_bytes}"
            for one in found.files
            if (draft / one.name).stat().st_size != one.size_bytes
        }
        if not wrong and found.about_name == form.FILE_NAME:
            wrong = problems_of(draft)
        elif not wrong:
            wrong = {
                name: "damaged (its checksum does not fit)"
                for name, stamp in found.stamps.items()
                if checked_stamp(draft / name) != stamp
            }
    return wrong


def _forget(fs: AppendingFileSystem, draft: Path, name: str) -> None:
    for path in (draft / name, packed.packed_path(draft / name)):
        discard(fs, path)


def _again(source: Source, found: FoundRecording) -> FoundRecording:
    try:
        return find(source, found.path)
    except NotYet as error:
        raise NotYet(PullOutcome.LATER, f"was moved or changed there meanwhile ({error})") from error


def _take_label(found: FoundRecording, source: Source, fs: AppendingFileSystem, target: Path) -> None:
    """Take a name and a note that are not here. Raises NotYet where both ends have one, and another."""
    entry = next((one for one in found.files if one.name == labels.FILE_NAME), None)
    if entry is None:
        return
    try:
        theirs = text_of(source, f"{found.path}/{labels.FILE_NAME}", labels.MAX_BYTES)
    except (NotThere, Unreadable) as error:
        raise NotYet(PullOutcome.FAILED, f"its label cannot be read there: {error}") from error
    path = target / labels.FILE_NAME
    with refused("cannot read", path):
        ours = path.read_bytes() if path.exists() else None
    if ours is None:
        replace_file(fs, path, theirs)
    elif ours != theirs:
        raise NotYet(PullOutcome.DIFFERS, f"its name or note is another one at both ends ({path}), and left alone")


# ------------------------------------------------------------------------------------ what it must be


def _stamps(about: bytes, name: str, path: str) -> dict[str, Stamp]:
    """Return what the manifest there says of each file. Raises NotYet for one that cannot be used."""
    try:
        manifest = _manifest(about, name, path)
    except (ManifestError, ScanError) as error:
        raise NotYet(PullOutcome.FAILED, f"its manifest cannot be used there: {error}") from error
    if manifest.scan_id != Path(path).name.partition("-")[0]:
        raise NotYet(PullOutcome.FAILED, f"{path}: its manifest is of scan {manifest.scan_id}")
    return dict(manifest.files)


def _stamps_here(about: bytes, name: str, target: Path) -> dict[str, Stamp]:
    try:
        return dict(_manifest(about, name, str(target)).files)
    except (ManifestError, ScanError):
        return {}


def _manifest(about: bytes, name: str, where: str) -> Manifest:
    if name == form.FILE_NAME:
        return form.decode(about, where)
    return incomplete.decode(about, where)[0]
