"""Owns a whole call: what is there and not here, one recording after the other, and that a link that breaks is opened
again.

An attempt looks at everything anew and skips what is done, so that a second attempt, a second call and a call after a
loss of power are the same thing. Nothing is deleted or replaced at either end.
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
    FoundRecording,
    NotYet,
    PullOutcome,
    already_here_bytes,
    find,
    given,
    present,
    take,
)

WAITS_S = (1.0, 2.0, 4.0, 8.0, 15.0)
"""Waits before the second attempt, the third, …"""
ATTEMPTS = len(WAITS_S) + 1
"""Number of times in a row that a link is opened without anything coming over it, before the call ends."""
SMALL_BYTES = 50_000_000
"""Largest file beside the scans that is taken."""
DEEPEST = 4
INSTRUMENT = "instrument"
"""Folder here with what the instrument says of itself: its rig file."""
RIG_PLACES = (f"../{INSTRUMENT}/rig.toml", f"{INSTRUMENT}/rig.toml", "../../etc/kingfisher/rig.toml")
"""Places of the rig file: as the instrument's server shows it, in what was pulled before, and on the instrument's own
disk."""
_SMALL = (".json", ".html", ".toml")
ROOTS = (".", "lib/kingfisher", "var/lib/kingfisher")
"""Places of the scans below a folder that is given: the storage root itself, the instrument's data partition, its whole
disk."""
_WITH_PORT = re.compile(r"((?:[^@]*@)?(?:[^:@\[\]]+|\[[^\]]+\])):(\d{1,5})")
"""``address:port``; an address of IPv6, which has colons of its own, stands in brackets then."""
_BRACKETS = str.maketrans("", "", "[]")
log = logging.getLogger(__name__)

Open = Callable[[], AbstractContextManager[Source]]


@dataclass(frozen=True, slots=True)
class Came:
    """Result of one recording or one file beside them."""

    what: str
    outcome: PullOutcome
    reason: str = ""
    size_bytes: int = 0


@dataclass(slots=True)
class Pulled:
    """Result of a call."""

    came: dict[str, Came] = field(default_factory=dict)
    """Results by path below the storage root."""
    being_written: int = 0
    """Recordings that are still being written there, or wait for the diver's decision."""
    taken_bytes: int = 0
    """Bytes that came over the link."""
    links: int = 0
    """Number of times that a link was opened."""
    seen: dict[str, FoundRecording] = field(default_factory=dict)
    """Recordings that were looked at and are not here: over a bad link, a thousand manifests are not read twice."""

    def add(self, what: str, outcome: PullOutcome, reason: str = "", size_bytes: int = 0) -> None:
        self.came[what] = Came(what, outcome, reason, size_bytes)

    def of(self, *outcomes: PullOutcome) -> list[Came]:
        """Return what came out so, by folder, and scans of one by their numbers."""

        def by_shelf(one: Came) -> tuple[str, tuple[float, str]]:
            folder, _, name = one.what.rpartition("/")
            return folder, by_number(name)

        return sorted((one for one in self.came.values() if one.outcome in outcomes), key=by_shelf)

    def report(self) -> dict[str, Any]:
        """Return the call in numbers and by item, JSON-ready."""
        items = [
            {"path": one.what, "outcome": one.outcome.name.lower(), "reason": one.reason, "bytes": one.size_bytes}
            for one in self.of(*PullOutcome)
        ]
        counts = {outcome.name.lower(): len(self.of(outcome)) for outcome in PullOutcome}
        facts = {"being_written": self.being_written, "bytes": self.taken_bytes, "links": self.links}
        return {**counts, **facts, "items": items}

    def lines(self) -> list[str]:
        """Return what is to be told of what did not come, a line each, and last what did."""
        lines = [
            f"{one.what}  {one.outcome.value}: {one.reason}"
            for one in self.of(PullOutcome.LATER, PullOutcome.DIFFERS, PullOutcome.FAILED)
        ]
        if self.being_written:
            lines.append(f"{self.being_written} still being written or undecided there; left for next time")
        told = ", ".join(f"{count} {one.value}" for one in PullOutcome if (count := len(self.of(one))))
        return [*lines, f"{told or 'nothing there'}; {self.taken_bytes / 1e6:.1f} MB"]

    @property
    def whole(self) -> bool:
        """True if everything that is finished there is here."""
        return all(one.outcome in (PullOutcome.TAKEN, PullOutcome.ALREADY) for one in self.came.values())


Far = Callable[[str, int, int, int, int], None]
"""Hears what is done, how many recordings of how many, and how many bytes of how many."""


class PullWordError(PullError):
    """A word of the call names no place that scans can be taken from, or to."""


def pull_scans(
    host: str,
    out: Path,
    far: Far,
    *,
    every: bool = False,
    identity: Path | None = None,
    known_hosts: Path | None = None,
    limit_s: float,
) -> Pulled:
    """Take what is finished at ``host`` and not here to the storage root ``out``, which is made where it is not there.

    ``host``: [user@]address[:port] of an instrument, or a folder. ``limit_s``: longest silence of the link.

    Raises PullWordError before anything is made, MissingLibraryError, and as ``pull_from``.
    """
    fs, target = LocalFileSystem(), out.absolute()
    opened = _opened(host, out, identity, known_hosts, limit_s)
    fs.make_folders(target)
    if not os.access(target, os.W_OK | os.X_OK):
        raise PullWordError(f"--out {target}: this user may not write there; give another folder, or change its owner")
    with hold_lock(target):
        # An Event that nobody sets: it waits, and Ctrl-C ends the wait.
        return pull_from(opened, target, fs, every=every, far=far, wait=threading.Event().wait)


def _opened(host: str, out: Path, identity: Path | None, known_hosts: Path | None, limit_s: float) -> Open:
    """Return how the place is reached that the words mean. Raises PullWordError, MissingLibraryError."""
    if "/" in host or Path(host).is_dir():
        root = _root_below(Path(host))
        if identity is not None:
            raise PullWordError(f"HOST {host}: a folder; --identity is for an instrument on the network")
        if root.resolve() == out.resolve():
            raise PullWordError(f"--out {out}: is where the scans are read from; give another folder")
        return lambda: nullcontext(FolderSource(root))
    if host.startswith("-") or not host.isprintable() or " " in host or not host:
        raise PullWordError(f"HOST {host!r}: give an address, [user@]address[:port], or the path of a folder")
    if identity is not None and not identity.is_file():
        raise PullWordError(f"--identity {identity}: no such file; give the private key's")
    require(LIBRARY, LIBRARY, NEEDS_IT)
    found = _WITH_PORT.fullmatch(host)
    name, port = (host, PORT) if found is None else (found[1], int(found[2]))
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
) -> Pulled:
    """Take what is finished there and not here to the storage root ``target``, which is there. ``every``: also rejected
    scans.

    Raises PullError where nothing can be had from there, also when the link breaks again and again; StorageError.
    Everything that was taken before stays, and so do the drafts.
    """
    done = Pulled()
    empty = 0
    while True:
        before = done.taken_bytes, len(done.came), len(done.seen)
        try:
            done.links += 1
            with opened() as source:
                _attempt(source, target, fs, done, every=every, far=far)
            return done
        except LinkLost as lost:
            # Counted as long as nothing comes: a link that breaks every minute still ends the work one day.
            empty = empty + 1 if (done.taken_bytes, len(done.came), len(done.seen)) == before else 1
            if empty >= ATTEMPTS:
                whole = len(done.of(PullOutcome.TAKEN))
                raise PullError(
                    f"{lost}; tried {ATTEMPTS} times. {whole} scans and {done.taken_bytes / 1e6:.1f} MB were taken and "
                    "stay; "
                    "call again, and it goes on there"
                ) from lost
            # Ever longer: an instrument that starts again needs a minute, a cable that moved a second.
            log.warning("the link broke; trying again in %g s", WAITS_S[empty - 1])
            wait(WAITS_S[empty - 1])


def _attempt(source: Source, target: Path, fs: LocalFileSystem, done: Pulled, *, every: bool, far: Far) -> None:
    shelves = [LibraryFolder.SCANS.value, INCOMPLETE_FOLDER] + ([LibraryFolder.REJECTED.value] if every else [])
    paths = list(_recordings(source, shelves, done))
    _beside(source, target, fs, done)
    wanted: list[FoundRecording] = []
    for k, path in enumerate(paths):
        far(f"looking at {path}", k, len(paths), 0, 0)
        if path in done.came:
            continue
        try:
            found = done.seen[path] if path in done.seen else find(source, path)
            there = _here(target, path)
            if there is None:
                done.seen[path] = found
                wanted.append(found)
            else:
                present(found, source, fs, there)
        except NotYet as why:
            done.add(path, why.outcome, str(why))
    of_bytes = sum(max(0, one.size_bytes - already_here_bytes(one, target / one.path)) for one in wanted)
    begun_bytes = done.taken_bytes
    for k, one in enumerate(wanted):

        def came(length: int, k: int = k, path: str = one.path) -> None:
            done.taken_bytes += length
            far(f"taking {path}", k, len(wanted), done.taken_bytes - begun_bytes, of_bytes)

        try:
            take(one, source, fs, target / one.path, came)
            done.add(one.path, PullOutcome.TAKEN, "", one.size_bytes)
        except NotYet as why:
            done.add(one.path, why.outcome, str(why))


def _recordings(source: Source, shelves: list[str], done: Pulled) -> Iterator[str]:
    """Give the paths of what is finished there, and count what is not."""
    done.being_written = 0
    for shelf in shelves:
        try:
            entries = source.listing(shelf)
        except NotThere:
            if shelf == LibraryFolder.SCANS.value:
                raise PullError(
                    "there is no folder `scans` there; give the folder that holds it, or another host"
                ) from None
            continue
        except Unreadable as error:
            raise PullError(f"the list of scans cannot be read there: {error}") from error
        for one in sorted(entries, key=lambda entry: by_number(entry.name)):
            if one.folder and scan_number(one.name) is not None:
                yield f"{shelf}/{one.name}"
            elif one.folder and one.name.startswith(".") and scan_number(one.name[1:]) is not None:
                done.being_written += 1


def _here(target: Path, path: str) -> Path | None:
    """Return where a recording lies here already: at its place, or, a scan, wherever somebody put it since."""
    shelf, _, name = path.partition("/")
    shelves = [shelf] if shelf == INCOMPLETE_FOLDER else [shelf, *(one.value for one in LibraryFolder)]
    return next((folder for one in shelves if (folder := target / one / name).is_dir()), None)


# --------------------------------------------------------------------- calibrations, objects, rig file


def _beside(source: Source, target: Path, fs: LocalFileSystem, done: Pulled) -> None:
    """Take the small files beside the scans.

    One that is another here goes beside it, under a name with its checksum.
    """
    files = {
        path: path for folder in (CALIBRATION_FILE.parent.name, OBJECTS) for path in _small_files(source, folder, done)
    }
    for place in RIG_PLACES:
        parent, _, name = place.rpartition("/")
        try:
            if any(one.name == name and not one.folder for one in source.listing(parent)):
                files[f"{INSTRUMENT}/{name}"] = place
                break
        except (NotThere, Unreadable):
            continue
    for path, place in files.items():
        if path in done.came:
            continue
        try:
            with given():
                data = text_of(source, place, SMALL_BYTES)
        except NotYet as why:
            done.add(path, why.outcome, str(why))
            continue
        done.taken_bytes += len(data)
        copy, written = fs.add_beside(target / path, data)
        if copy is None:
            done.add(
                path,
                PullOutcome.DIFFERS,
                "is here twice with other content; move away the one with a checksum in its name",
            )
        elif written:
            done.add(path, PullOutcome.TAKEN, "" if copy == target / path else f"as {copy.name}", len(data))
        else:
            done.add(path, PullOutcome.ALREADY)


def _small_files(source: Source, folder: str, done: Pulled, depth: int = 1) -> Iterator[str]:
    try:
        entries = [one for one in source.listing(folder) if is_component(one.name)]
    except NotThere:
        return
    except Unreadable as error:
        done.add(folder, PullOutcome.FAILED, f"cannot be read there: {error}")
        return
    for one in entries:
        if one.folder and depth < DEEPEST:
            yield from _small_files(source, f"{folder}/{one.name}", done, depth + 1)
        elif not one.folder and PurePosixPath(one.name).suffix in _SMALL:
            yield f"{folder}/{one.name}"
