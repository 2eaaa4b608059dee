"""Taking one recording into a draft, which may be continued, is compared and then renamed.

    <root>/scans/.000123.pulling     being taken: the manifest first, then files, also partial ones
    <root>/scans/000123              complete: every byte is as the manifest says

Drafts are the only files here that are ever removed: a file of a draft that differs from its manifest is taken anew.
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
"""Number of attempts to read a recording whose checksums do not fit."""
ROOM_LEFT_BYTES = 1_000_000
"""Free space that a recording must leave on the desk's disk."""


class PullOutcome(Enum):
    """Outcomes for one recording."""

    TAKEN = "taken"
    ALREADY = "already there"
    LATER = "left for next time"
    DIFFERS = "differs"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class RemoteRecording:
    """A recording on the instrument."""

    path: str
    """Its folder there, below the storage root; the same here."""
    manifest_content: bytes
    """Content of its manifest file."""
    manifest_name: str
    files: tuple[RemoteEntry, ...]
    """All files but the manifest and the label."""
    label_bytes: int
    """Length of the label; 0 where there is none."""
    manifest: Manifest

    @property
    def size_bytes(self) -> int:
        """Number of bytes to take."""
        return sum(entry.size_bytes for entry in self.files) + self.label_bytes


class NotYet(Exception):
    """Exception of a recording that is not taken now, with the outcome and the reason."""

    def __init__(self, outcome: PullOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome = outcome


@contextmanager
def outcomes_of_source() -> Iterator[None]:
    """Turn the errors of a source into outcomes. Raises NotYet."""
    try:
        yield
    except NotThere as error:
        raise NotYet(PullOutcome.LATER, f"was moved or changed on the instrument during copying ({error})") from error
    except Unreadable as error:
        raise NotYet(PullOutcome.FAILED, f"cannot be read on the instrument: {error}") from error


def find(source: Source, path: str) -> RemoteRecording:
    """Read the manifest and the listing of a recording there. Raises NotYet, LinkLost."""
    try:
        with outcomes_of_source():
            entries = {
                entry.name: entry for entry in source.listing(path) if not entry.folder and is_component(entry.name)
            }
            manifest_name = next((name for name in (MANIFEST_FILE, INCOMPLETE_MANIFEST_FILE) if name in entries), None)
            if manifest_name is None:
                raise NotYet(PullOutcome.FAILED, f"{path}: has no manifest; check it on the instrument")
            content = text_of(source, f"{path}/{manifest_name}", MANIFEST.max_bytes)
        manifest = _manifest(content, manifest_name, path)
    except (ContentError, ScanError) as error:
        raise NotYet(PullOutcome.FAILED, f"its manifest is not usable: {error}") from error
    if manifest.scan_id != Path(path).name.partition("-")[0]:
        raise NotYet(PullOutcome.FAILED, f"{path}: its manifest is of scan {manifest.scan_id}")
    missing = [name for name in manifest.files if entries.keys().isdisjoint((name, _packed_name(name)))]
    if missing:
        raise NotYet(PullOutcome.FAILED, f"{path}: {', '.join(sorted(missing))} missing on the instrument")
    files = tuple(entry for name, entry in entries.items() if name not in (manifest_name, LABEL_FILE))
    label_bytes = entries[LABEL_FILE].size_bytes if LABEL_FILE in entries else 0
    return RemoteRecording(path, content, manifest_name, files, label_bytes, manifest)


def compare_present(recording: RemoteRecording, source: Source, fs: LocalFileSystem, target: Path) -> None:
    """Compare an existing ``target`` with the recording there, and always raise NotYet with the outcome.

    The same recording with more files (a cloud that was made at the desk) is the same recording. A missing label is
    taken; other files are left alone. Raises LinkLost, StorageError, too.
    """
    with StorageError.naming("cannot read", target):
        path = target / recording.manifest_name
        ours = path.read_bytes() if path.exists() else b""
    try:
        local_files = dict(_manifest(ours, recording.manifest_name, str(target)).files)
    except (ContentError, ScanError):
        local_files = {}
    different = sorted(name for name, stamp in recording.manifest.files.items() if local_files.get(name) != stamp)
    if ours != recording.manifest_content and (different or not local_files):
        raise NotYet(
            PullOutcome.DIFFERS,
            f"{'; '.join(different) or 'its manifest'}: differs from the copy here, and is not copied "
            f"({target}); give another DIR for another instrument, or move the copy away to copy the instrument's",
        )
    if recording.manifest_name == MANIFEST_FILE:
        wrong = wrong_files(target, MANIFEST.decode(ours, str(target)), checksums=False)
        if wrong:
            raise NotYet(
                PullOutcome.FAILED,
                f"the copy here is damaged ({target}): {_problem_list(wrong)}; move it away, and call again",
            )
    _take_label(recording, source, fs, target)
    raise NotYet(PullOutcome.ALREADY, "")


def draft_folder(target: Path) -> Path:
    """Return the folder in which ``target`` is put together."""
    return target.with_name(f".{target.name}.pulling")


def present_bytes(recording: RemoteRecording, target: Path) -> int:
    """Return how many bytes of a recording an earlier call has taken. Raises StorageError."""
    with StorageError.naming("cannot read", target):
        paths = (draft_folder(target) / entry.name for entry in recording.files)
        return sum(path.stat().st_size for path in paths if path.exists())


def take(
    recording: RemoteRecording, source: Source, fs: LocalFileSystem, target: Path, came: Callable[[int], None]
) -> None:
    """Take a recording that is not here; on return it is complete and durable.

    ``came`` is called with the bytes of each piece. Raises NotYet where it cannot be had completely now, LinkLost,
    StorageError. The draft stays for the next call.
    """
    draft = draft_folder(target)
    fs.make_folders(draft)
    wrong: dict[str, str] = {}
    for _ in range(TIMES):
        _begin(recording, fs, draft)
        _require_room(recording, fs, target)
        for entry in recording.files:
            _take_file(source, f"{recording.path}/{entry.name}", entry.size_bytes, fs, draft / entry.name, came)
        came(_take_label(recording, source, fs, draft))
        wrong = _wrong(recording, draft)
        if not wrong:
            fs.move_folder(draft, target)
            return
        for name in wrong:
            fs.discard(draft / name)
            fs.discard(draft / _packed_name(name))
        recording = find(source, recording.path)  # it may have been changed meanwhile
    raise NotYet(PullOutcome.FAILED, f"damaged on the instrument: {_problem_list(wrong)} (read {TIMES} times)")


def _begin(recording: RemoteRecording, fs: LocalFileSystem, draft: Path) -> None:
    """Remove from a draft the files that its manifest does not list, and write the manifest.

    Listed files may still be of another recording: their checksums show that later.
    """
    with StorageError.naming("cannot read", draft):
        names = {path.name for path in draft.iterdir()}
    for name in names.difference(recording.manifest.files, map(_packed_name, recording.manifest.files)):
        fs.discard(draft / name)
    # Its sync of the folder makes the removals durable, too.
    fs.replace_file(draft / recording.manifest_name, recording.manifest_content)


def _require_room(recording: RemoteRecording, fs: LocalFileSystem, target: Path) -> None:
    with StorageError.naming("cannot read the free space of", target.parent):
        free_bytes = fs.free_bytes(target.parent)
    missing = recording.size_bytes - present_bytes(recording, target) + ROOM_LEFT_BYTES - free_bytes
    if missing > 0:
        raise StorageError(
            "cannot copy a scan to",
            target.parent,
            f"the disk lacks {missing / 1e6:.1f} MB for the next one",
            "free space on it, and call again; copied scans stay",
        )


def _take_file(
    source: Source, remote_path: str, size_bytes: int, fs: LocalFileSystem, path: Path, came: Callable[[int], None]
) -> None:
    with StorageError.naming("cannot write", path):
        begun = path.exists()
        present_bytes = path.stat().st_size if begun else 0
        file = fs.append(path) if begun else fs.create(path)
        try:
            # Each piece is written as it comes, so that after a broken link the next call requests only the remainder.
            with outcomes_of_source():
                for data in source.read(remote_path, present_bytes, size_bytes):
                    file.write(data)
                    came(len(data))
            # Also where no byte was missing: the process that wrote the last piece may have ended before its sync.
            file.sync()
        finally:
            file.close()


def _take_label(recording: RemoteRecording, source: Source, fs: LocalFileSystem, folder: Path) -> int:
    """Take a label that is missing here, and return its bytes.

    Raises NotYet where the labels at both ends differ.
    """
    if not recording.label_bytes:
        return 0
    with outcomes_of_source():
        theirs = text_of(source, f"{recording.path}/{LABEL_FILE}", LABEL.max_bytes)
    path = folder / LABEL_FILE
    with StorageError.naming("cannot read", path):
        ours = path.read_bytes() if path.exists() else None
    if ours is None:
        fs.replace_file(path, theirs)
    elif ours != theirs:
        raise NotYet(
            PullOutcome.DIFFERS,
            f"its name or note differs from the copy here ({path}), and is not copied; make both the same",
        )
    return len(theirs)


def _wrong(recording: RemoteRecording, draft: Path) -> dict[str, str]:
    """Return the problems of a draft by file name; every byte is read and packed frames are decoded."""
    if recording.manifest_name == MANIFEST_FILE:
        return problems_of(draft)
    with StorageError.naming("cannot read", draft):
        return {
            name: "damaged (its checksum does not fit)"
            for name, stamp in recording.manifest.files.items()
            if checked_stamp(draft / name) != stamp
        }


def _manifest(content: bytes, name: str, where: str) -> Manifest:
    return (
        MANIFEST.decode(content, where) if name == MANIFEST_FILE else INCOMPLETE.decode(content, where, INCOMPLETE_OF)
    )


def _packed_name(name: str) -> str:
    return packed_path(Path(name)).name


def _problem_list(wrong: dict[str, str]) -> str:
    return "; ".join(f"{name}: {problem}" for name, problem in sorted(wrong.items()))
