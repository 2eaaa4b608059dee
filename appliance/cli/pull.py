"""The verb ``archive pull``: copy scans from an instrument, or from its disk, to a desk."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from appliance.cli.archive import target_folder
from appliance.cli.arguments import Verb, number, operand, option, path_option, switch
from appliance.cli.output import Exit, ProgressLine, time_text
from appliance.store import pull_scans

ANSWER_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pull(Verb):
    """Copy the scans of an instrument that ``--out`` lacks; FAILED if any complete one is still missing."""

    kernels: ClassVar[bool] = False

    host: str = operand("HOST", "[user@]address[:port] of the instrument, or a folder: its mounted disk, or a copy")
    out: Path | None = path_option(
        "--out", "storage root at the desk, one for each instrument; made if it does not exist", metavar="DIR"
    )
    identity: Path | None = path_option("--identity", "private key (default: those of ssh)")
    known_hosts: Path | None = path_option(
        "--known-hosts", "file of the host keys that are trusted (default: that of ssh)"
    )
    timeout_s: float = option(
        "--timeout-s", f"longest time without data ({ANSWER_S:g})", default=ANSWER_S, parse=number(2, 3600)
    )
    all: bool = switch("--all", "also rejected scans")

    def run(self) -> Exit:
        """Copy the scans. Raises UsageError, PullError, StorageError, MissingLibraryError."""
        target = target_folder(self.out, None)
        with ProgressLine() as progress:
            start_s = time.monotonic()
            result = pull_scans(
                self.host,
                self.out or target,
                _PullProgress(progress),
                every=self.all,
                identity=self.identity,
                known_hosts=self.known_hosts,
                limit_s=self.timeout_s,
            )
        duration_s = time.monotonic() - start_s
        *lines, last = result.lines()
        self.tell({**result.report(), "s": duration_s}, [*lines, f"{last} in {time_text(duration_s)}"])
        return Exit.OK if result.is_complete else Exit.FAILED


class _PullProgress:
    """Progress and remaining time of a transfer, from the first byte of an attempt."""

    def __init__(self, progress: ProgressLine) -> None:
        self._progress = progress
        self._begun_s = time.monotonic()

    def __call__(self, doing: str, done: int, total: int, done_bytes: int, total_bytes: int) -> None:
        duration_s = time.monotonic() - self._begun_s
        text = f"{doing}, {done} of {total}"
        if not done_bytes:
            self._begun_s = time.monotonic()
        elif total_bytes:
            text += f", {done_bytes / 1e6:.0f} of {total_bytes / 1e6:.0f} MB"
            if duration_s > 1.0:
                rate = done_bytes / duration_s
                left_s = max(0, total_bytes - done_bytes) / rate
                text += f", {rate / 1e6:.1f} MB/s, {time_text(left_s)} left"
        self._progress(text)
