"""The verb ``archive pull``: scans off an instrument, or off its disk, onto a desk."""

from __future__ import annotations

import os
import re
import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from appliance.base import require
from appliance.cli.archive import target_folder
from appliance.cli.arguments import Verb, number, operand, option, path_option, switch
from appliance.cli.output import Exit, ProgressLine, UsageError, time_text
from appliance.desk import (
    ANSWER_S,
    LIBRARY,
    NEEDS_IT,
    PORT,
    FolderSource,
    Host,
    HowFar,
    Open,
    Pulled,
    PullOutcome,
    SshLink,
    is_linked,
    pull_scans,
)
from appliance.store import LibraryFolder, LocalFileSystem, hold_lock, make_folders

ROOTS = (".", "lib/kingfisher", "var/lib/kingfisher")
"""Places of the scans below a folder that is given: the storage root itself, the instrument's data partition, its whole
disk."""

_WITH_PORT = re.compile(r"((?:[^@]*@)?(?:[^:@\[\]]+|\[[^\]]+\])):(\d{1,5})")
"""``address:port``; an address of IPv6, which has colons of its own, stands in brackets then."""
_BRACKETS = str.maketrans("", "", "[]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pull(Verb):
    """Take what is on the instrument and not in ``--out``; FAILED if anything finished there is not here afterwards."""

    kernels: ClassVar[bool] = False

    host: str = operand("HOST", "[user@]address[:port] of the instrument, or a folder: its mounted disk, a copy")
    out: Path | None = path_option(
        "--out", "storage root at the desk, made where it is not there; one for each instrument", metavar="DIR"
    )
    identity: Path | None = path_option("--identity", "private key (default: those of ssh)")
    known_hosts: Path | None = path_option(
        "--known-hosts", "file of the host keys that are trusted (default: that of ssh)"
    )
    timeout_s: float = option(
        "--timeout-s", f"longest silence of the link ({ANSWER_S:g})", default=ANSWER_S, parse=number(2, 3600)
    )
    all: bool = switch("--all", "also the rejected ones")

    def run(self) -> Exit:
        """Raises UsageError, PullError, StorageError, MissingLibraryError."""
        target = target_folder(self.out, None)
        opened = self._opened(target)
        make_folders(LocalFileSystem(), target)
        if not os.access(target, os.W_OK | os.X_OK):
            raise UsageError(f"--out {target}: this user may not write there; give another folder, or change its owner")
        with hold_lock(target), ProgressLine() as progress:
            begun_s = time.monotonic()
            # An Event that nobody sets: it waits, and Ctrl-C ends the wait.
            wait = threading.Event().wait
            done = pull_scans(opened, target, LocalFileSystem(), every=self.all, far=_Said(progress), wait=wait)
        self._tell(done, time.monotonic() - begun_s)
        return Exit.OK if done.whole else Exit.FAILED

    def _opened(self, target: Path) -> Open:
        """Return how the instrument is reached. Raises UsageError, MissingLibraryError."""
        if "/" in self.host or Path(self.host).is_dir():
            root = _root_below(Path(self.host))
            if self.identity is not None:
                raise UsageError(f"HOST {self.host}: a folder; --identity is for an instrument on the network")
            if root.resolve() == target.resolve():
                raise UsageError(f"--out {self.out}: is where the scans are read from; give another folder")
            return lambda: nullcontext(FolderSource(root))
        if self.host.startswith("-") or not self.host.isprintable() or " " in self.host or not self.host:
            raise UsageError(f"HOST {self.host!r}: give an address, [user@]address[:port], or the path of a folder")
        if self.identity is not None and not self.identity.is_file():
            raise UsageError(f"--identity {self.identity}: no such file; give the private key's")
        require(LIBRARY, LIBRARY, NEEDS_IT)
        found = _WITH_PORT.fullmatch(self.host)
        name, port = (self.host, PORT) if found is None else (found[1], int(found[2]))
        if not 0 < port < 65_536:
            raise UsageError(f"HOST {self.host}: port {port}; allowed are 1..65535")
        return SshLink(Host(name.translate(_BRACKETS), port, self.identity, self.known_hosts), self.timeout_s)

    def _tell(self, done: Pulled, took_s: float) -> None:
        counts = {outcome: len(done.of(outcome)) for outcome in PullOutcome}
        items = [
            {"path": one.what, "outcome": one.outcome.name.lower(), "reason": one.reason, "bytes": one.size_bytes}
            for one in done.of(*PullOutcome)
        ]
        facts = {"being_written": done.being_written, "bytes": done.taken_bytes, "links": done.links, "s": took_s}
        lines = [
            f"{one.what}  {one.outcome.value}: {one.reason}"
            for one in done.of(PullOutcome.LATER, PullOutcome.DIFFERS, PullOutcome.FAILED)
        ]
        if done.being_written:
            lines.append(f"{done.being_written} still being written or undecided there; left for next time")
        told = ", ".join(f"{count} {outcome.value}" for outcome, count in counts.items() if count)
        lines.append(f"{told or 'nothing there'}; {done.taken_bytes / 1e6:.1f} MB in {time_text(took_s)}")
        self.tell(
            {**{outcome.name.lower(): count for outcome, count in counts.items()}, **facts, "items": items}, lines
        )


def _root_below(folder: Path) -> Path:
    """Return the storage root below a folder. Raises UsageError."""
    for root in ROOTS:
        scans = f"{root}/{LibraryFolder.SCANS.value}"
        if (folder / scans).is_dir() and not is_linked(folder, scans):
            return folder / root
    raise UsageError(
        f"HOST {folder}: no scans there; give the folder that holds scans/, or the instrument's mounted disk"
    )


class _Said:
    """Says how far it is and how long it will take, from the first byte of an attempt on."""

    def __init__(self, progress: ProgressLine) -> None:
        self._progress = progress
        self._begun_s = time.monotonic()

    def __call__(self, far: HowFar) -> None:
        took_s = time.monotonic() - self._begun_s
        text = f"{far.doing}, {far.done} of {far.of}"
        if not far.done_bytes:
            self._begun_s = time.monotonic()
        elif far.of_bytes:
            text += f", {far.done_bytes / 1e6:.0f} of {far.of_bytes / 1e6:.0f} MB"
            if took_s > 1.0:
                rate = far.done_bytes / took_s
                left_s = max(0, far.of_bytes - far.done_bytes) / rate
                text += f", {rate / 1e6:.1f} MB/s, {time_text(left_s)} left"
        self._progress(text)
