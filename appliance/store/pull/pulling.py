"""The scan transfer: one recording after the other, over a link that is opened again when it breaks.

Each attempt lists everything anew and skips finished recordings, so that a second attempt, a second call and a call
after a loss of power do the same. No file is deleted or replaced at either end.
"""

from __future__ import annotations

import logging
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from appliance.base import require
from appliance.store.atomic import LocalFileSystem
from appliance.store.incomplete import INCOMPLETE_FOLDER
from appliance.store.library import LibraryFolder
from appliance.store.lock import hold_lock
from appliance.store.names import CALIBRATION_FILE, OBJECTS, by_number, is_component, scan_number
from appliance.store.pull.source import (
    LIBRARY,
    NEEDS_IT,
    PORT,
    FolderSource,
    LinkLost,
    NotThere,
    PullError,
    Source,
    SshLink,
    Unreadable,
    is_linked,
    text_of,
)
from appliance.store.pull.taking import (
    NotYet,
    PullOutcome,
    RemoteRecording,
    compare_present,
    find,
    outcomes_of_source,
    present_bytes,
    take,
)

WAITS_S = (1.0, 2.0, 4.0, 8.0, 15.0)
"""Waits before the second attempt, the third, …"""
ATTEMPTS = len(WAITS_S) + 1
"""Number of links in a row without progress, after which the call ends."""
SMALL_BYTES = 50_000_000
"""Largest file beside the scans that is taken."""
DEEPEST = 4
INSTRUMENT = "instrument"
"""Folder here with the instrument's rig file."""
RIG_PLACES = (f"../{INSTRUMENT}/rig.toml", f"{INSTRUMENT}/rig.toml", "../../etc/kingfisher/rig.toml")
"""Places of the rig file: on the instrument's server, in an earlier copy of its scans, and on the instrument's disk."""
_SMALL = (".json", ".html", ".toml")
ROOTS = (".", "lib/kingfisher", "var/lib/kingfisher")
"""Places of the storage root below a given folder: the folder itself, in the data partition, on the whole disk."""
_WITH_PORT = re.compile(r"((?:[^@]*@)?(?:[^:@\[\]]+|\[[^\]]+\])):(\d{1,5})")
"""``address:port``; an address of IPv6, which has colons of its own, stands in brackets then."""
_BRACKETS = str.maketrans("", "", "[]")
log = logging.getLogger(__name__)

Open = Callable[[], AbstractContextManager[Source]]


@dataclass(frozen=True, slots=True)
class PullItem:
    """Result for one recording, or for one file beside them."""

    what: str
    outcome: PullOutcome
    reason: str = ""
    size_bytes: int = 0


@dataclass(slots=True)
class PullResult:
    """Result of one scan transfer."""

    came: dict[str, PullItem] = field(default_factory=dict)
    """Results by path below the storage root."""
    being_written: int = 0
    """Recordings that are still being written there, or wait for the diver's decision."""
    taken_bytes: int = 0
    """Bytes that came over the link."""
    links: int = 0
    """Number of times that a link was opened."""
    recordings: dict[str, RemoteRecording] = field(default_factory=dict)
    """Missing recordings whose manifests were read, so that a bad link does not read a thousand of them twice."""

    def add(self, what: str, outcome: PullOutcome, reason: str = "", size_bytes: int = 0) -> None:
        self.came[what] = PullItem(what, outcome, reason, size_bytes)

    def of(self, *outcomes: PullOutcome) -> list[PullItem]:
        """Return the items with these outcomes, by folder, and scans in a folder by their numbers."""

        def by_folder(item: PullItem) -> tuple[str, tuple[float, str]]:
            folder, _, name = item.what.rpartition("/")
            return folder, by_number(name)

        return sorted((item for item in self.came.values() if item.outcome in outcomes), key=by_folder)

    def report(self) -> dict[str, Any]:
        """Return the call in numbers and by item, JSON-ready."""
        items = [
            {"path": item.what, "outcome": item.outcome.name.lower(), "reason": item.reason, "bytes": item.size_bytes}
            for item in self.of(*PullOutcome)
        ]
        counts = {outcome.name.lower(): len(self.of(outcome)) for outcome in PullOutcome}
        facts = {"being_written": self.being_written, "bytes": self.taken_bytes, "links": self.links}
        return {**counts, **facts, "items": items}

    def lines(self) -> list[str]:
        """Return a line for each item that did not come, and a last one that sums up the others."""
        lines = [
            f"{item.what}  {item.outcome.value}: {item.reason}"
            for item in self.of(PullOutcome.LATER, PullOutcome.DIFFERS, PullOutcome.FAILED)
        ]
        if self.being_written:
            lines.append(
                f"{self.being_written} still being written or not yet kept on the instrument; left for the next call"
            )
        summary = ", ".join(f"{count} {item.value}" for item in PullOutcome if (count := len(self.of(item))))
        return [*lines, f"{summary or 'nothing there'}; {self.taken_bytes / 1e6:.1f} MB"]

    @property
    def is_complete(self) -> bool:
        """True if every finished recording there is here."""
        return all(item.outcome in (PullOutcome.TAKEN, PullOutcome.ALREADY) for item in self.came.values())


Far = Callable[[str, int, int, int, int], None]
"""Progress: the step, the number of recordings so far and in all, and the number of bytes so far and in all."""


class PullWordError(PullError):
    """Error of an argument that names no place to take scans from, or to."""


def pull_scans(
    host: str,
    out: Path,
    far: Far,
    *,
    every: bool = False,
    identity: Path | None = None,
    known_hosts: Path | None = None,
    limit_s: float,
) -> PullResult:
    """Copy the finished scans of ``host`` that are missing here into the storage root ``out``.

    ``host``: [user@]address[:port] of an instrument, or a folder. ``out`` is made. ``limit_s``: longest silence of the
    link. Raises PullWordError before any file is made, MissingLibraryError, and as ``pull_from``.
    """
    fs, target = LocalFileSystem(), out.absolute()
    opened = _opener(host, out, identity, known_hosts, limit_s)
    fs.make_folders(target)
    if not os.access(target, os.W_OK | os.X_OK):
        raise PullWordError(f"--out {target}: no permission to write; give another folder, or change its owner")
    with hold_lock(target):
        # An Event that is never set: it waits, and Ctrl-C ends the wait.
        return pull_from(opened, target, fs, every=every, far=far, wait=threading.Event().wait)


def _opener(host: str, out: Path, identity: Path | None, known_hosts: Path | None, limit_s: float) -> Open:
    """Return the function that opens the source that ``host`` names.

    Raises PullWordError, MissingLibraryError.
    """
    if "/" in host or Path(host).is_dir():
        root = _root_below(Path(host))
        if identity is not None:
            raise PullWordError(f"HOST {host}: a folder; --identity is for an instrument on the network")
        if root.resolve() == out.resolve():
            raise PullWordError(f"--out {out}: is the folder that the scans are read from; give another folder")
        return lambda: nullcontext(FolderSource(root))
    if host.startswith("-") or not host.isprintable() or " " in host or not host:
        raise PullWordError(f"HOST {host!r}: give an address, [user@]address[:port], or the path of a folder")
    if identity is not None and not identity.is_file():
        raise PullWordError(f"--identity {identity}: no such file; give the private key's")
    require(LIBRARY, LIBRARY, NEEDS_IT)
    match = _WITH_PORT.fullmatch(host)
    name, port = (host, PORT) if match is None else (match[1], int(match[2]))
    if not 0 < port < 65_536:
        raise PullWordError(f"HOST {host}: port {port}; allowed are 1..65535")
    return SshLink(name.translate(_BRACKETS), port, identity, known_hosts, limit_s)


def _root_below(folder: Path) -> Path:
    """Return the storage root below a folder. Raises PullWordError."""
    for root in ROOTS:
        scans = f"{root}/{LibraryFolder.SCANS.value}"
        if (folder / scans).is_dir() and not is_linked(folder, scans):
            return folder / root
    raise PullWordError(
        f"HOST {folder}: no scans there; give the folder that holds scans/, or the instrument's mounted disk"
    )


def pull_from(
    opened: Open, target: Path, fs: LocalFileSystem, *, every: bool, far: Far, wait: Callable[[float], object]
) -> PullResult:
    """Copy the finished scans that are missing here into the storage root ``target``.

    ``every``: rejected scans, too. Raises PullError where no scan can be had from there, also when the link breaks
    again and again; StorageError. Scans that were taken before stay, and so do the drafts.
    """
    done = PullResult()
    empty = 0
    while True:
        before = done.taken_bytes, len(done.came), len(done.recordings)
        try:
            done.links += 1
            with opened() as source:
                _attempt(source, target, fs, done, every=every, far=far)
            return done
        except LinkLost as lost:
            # Only attempts without progress count: over a link that breaks every minute the work still comes to its
            # end.
            empty = empty + 1 if (done.taken_bytes, len(done.came), len(done.recordings)) == before else 1
            if empty >= ATTEMPTS:
                count = len(done.of(PullOutcome.TAKEN))
                raise PullError(
                    f"{lost}after {ATTEMPTS} attempts. {count} scans and {done.taken_bytes / 1e6:.1f} MB "
                    "are copied and stay; call again to continue"
                ) from lost
            # Waits grow: an instrument that starts again needs a minute, a cable that moved a second.
            log.warning("the connection broke; trying again in %g s", WAITS_S[empty - 1])
            wait(WAITS_S[empty - 1])


def _attempt(source: Source, target: Path, fs: LocalFileSystem, done: PullResult, *, every: bool, far: Far) -> None:
    folder_names = [LibraryFolder.SCANS.value, INCOMPLETE_FOLDER] + ([LibraryFolder.REJECTED.value] if every else [])
    paths = list(_recordings(source, folder_names, done))
    _beside(source, target, fs, done)
    missing: list[RemoteRecording] = []
    for k, path in enumerate(paths):
        far(f"looking at {path}", k, len(paths), 0, 0)
        if path in done.came:
            continue
        try:
            recording = done.recordings[path] if path in done.recordings else find(source, path)
            local_folder = _here(target, path)
            if local_folder is None:
                done.recordings[path] = recording
                missing.append(recording)
            else:
                compare_present(recording, source, fs, local_folder)
        except NotYet as reason:
            done.add(path, reason.outcome, str(reason))
    of_bytes = sum(
        max(0, recording.size_bytes - present_bytes(recording, target / recording.path)) for recording in missing
    )
    begun_bytes = done.taken_bytes
    for k, recording in enumerate(missing):

        def came(length: int, k: int = k, path: str = recording.path) -> None:
            done.taken_bytes += length
            far(f"copying {path}", k, len(missing), done.taken_bytes - begun_bytes, of_bytes)

        try:
            take(recording, source, fs, target / recording.path, came)
            done.add(recording.path, PullOutcome.TAKEN, "", recording.size_bytes)
        except NotYet as reason:
            done.add(recording.path, reason.outcome, str(reason))


def _recordings(source: Source, folder_names: list[str], done: PullResult) -> Iterator[str]:
    """Yield the paths of the finished recordings there, and count the unfinished ones."""
    done.being_written = 0
    for folder_name in folder_names:
        try:
            entries = source.listing(folder_name)
        except NotThere:
            if folder_name == LibraryFolder.SCANS.value:
                raise PullError("it has no folder `scans`; give the folder that holds it, or another host") from None
            continue
        except Unreadable as error:
            raise PullError(f"its list of scans cannot be read: {error}") from error
        for entry in sorted(entries, key=lambda entry: by_number(entry.name)):
            if entry.folder and scan_number(entry.name) is not None:
                yield f"{folder_name}/{entry.name}"
            elif entry.folder and entry.name.startswith(".") and scan_number(entry.name[1:]) is not None:
                done.being_written += 1


def _here(target: Path, path: str) -> Path | None:
    """Return the folder of a recording that is here already, or ``None``.

    A scan may also lie in another kind of folder, where a person put it since.
    """
    folder_kind, _, name = path.partition("/")
    folder_kinds = (
        [folder_kind] if folder_kind == INCOMPLETE_FOLDER else [folder_kind, *(kind.value for kind in LibraryFolder)]
    )
    return next((folder for kind in folder_kinds if (folder := target / kind / name).is_dir()), None)


# --------------------------------------------------------------------- calibrations, objects, rig file


def _beside(source: Source, target: Path, fs: LocalFileSystem, done: PullResult) -> None:
    """Take the small files beside the scans.

    One that differs from the file here is written beside it, under a name with its checksum.
    """
    files = {
        path: path for folder in (CALIBRATION_FILE.parent.name, OBJECTS) for path in _small_files(source, folder, done)
    }
    for place in RIG_PLACES:
        parent, _, name = place.rpartition("/")
        try:
            if any(entry.name == name and not entry.folder for entry in source.listing(parent)):
                files[f"{INSTRUMENT}/{name}"] = place
                break
        except (NotThere, Unreadable):
            continue
    for path, place in files.items():
        if path in done.came:
            continue
        try:
            with outcomes_of_source():
                data = text_of(source, place, SMALL_BYTES)
        except NotYet as reason:
            done.add(path, reason.outcome, str(reason))
            continue
        done.taken_bytes += len(data)
        copy, written = fs.add_beside(target / path, data)
        if copy is None:
            done.add(
                path,
                PullOutcome.DIFFERS,
                "two copies here differ; move away the one with a checksum in its name",
            )
        elif written:
            done.add(path, PullOutcome.TAKEN, "" if copy == target / path else f"as {copy.name}", len(data))
        else:
            done.add(path, PullOutcome.ALREADY)


def _small_files(source: Source, folder: str, done: PullResult, depth: int = 1) -> Iterator[str]:
    try:
        entries = [entry for entry in source.listing(folder) if is_component(entry.name)]
    except NotThere:
        return
    except Unreadable as error:
        done.add(folder, PullOutcome.FAILED, f"cannot be read on the instrument: {error}")
        return
    for entry in entries:
        if entry.folder and depth < DEEPEST:
            yield from _small_files(source, f"{folder}/{entry.name}", done, depth + 1)
        elif not entry.folder and PurePosixPath(entry.name).suffix in _SMALL:
            yield f"{folder}/{entry.name}"
