"""Owns what the command line prints: results on stdout, progress and errors on stderr, one line per error."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, TextIO

PROGRESS_AFTER_S = 1.0


class Exit(IntEnum):
    """Exit codes, the same for every verb."""

    OK = 0
    FAILED = 1
    """The request was understood but could not be carried out: a device, the disk, an unknown scan."""
    USAGE = 2
    """Wrong arguments or a wrong rig file."""
    SCRIPT_FAILED = 3
    """The diver's script of ``kingfisher sim`` did not come to its end."""
    DAMAGED = 4
    """``scans verify`` found a damaged scan."""
    LEFT_OUT = 5
    """``object solve`` placed some scans and left others out."""
    INTERRUPTED = 130
    """Ctrl-C."""


class UsageError(Exception):
    """An argument cannot be used; the text names it, its value, what is allowed and the remedy."""


def say(text: str) -> None:
    """Print one result on stdout."""
    sys.stdout.write(text + "\n")


def say_json(value: Any) -> None:
    """Print one JSON document on stdout."""
    say(json.dumps(value, indent=1, ensure_ascii=False))


def complain(text: str, *, as_json: bool) -> None:
    """Print one error on stderr, in one line."""
    line = " ".join(text.split())
    sys.stderr.write((json.dumps({"error": line}, ensure_ascii=False) if as_json else f"kingfisher: {line}") + "\n")


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return columns padded to their widest cell; the last one is not padded."""
    lines = [list(header), *(list(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    widths[-1] = 0
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


@contextmanager
def log_lines(*, as_json: bool, service: bool) -> Iterator[None]:
    """Inside, what the program logs goes to stderr, one line each: warnings, and of a service its news, too."""
    log = logging.getLogger()
    before = log.level
    handler = logging.StreamHandler()
    handler.setFormatter(_JsonLine() if as_json else logging.Formatter("kingfisher: %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO if service else logging.WARNING)
    compiler = logging.getLogger("appliance.cli.kernels")
    compiler.setLevel(logging.INFO)  # a minute of silence is a warning of its own
    try:
        yield
    finally:
        compiler.setLevel(logging.NOTSET)
        log.setLevel(before)
        log.removeHandler(handler)


class _JsonLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return json.dumps({record.levelname.lower(): record.getMessage()}, ensure_ascii=False)


class Progress:
    """A line on a terminal for work that takes more than a second; nothing anywhere else. A context manager."""

    def __init__(self, stream: TextIO | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream or sys.stderr
        self._now_s = now_s
        self._start_s = now_s()
        self._shown = 0

    def __call__(self, what: str, fraction: float | None = None) -> None:
        """Say what is being done now, and how much of the whole is done (0..1)."""
        # In a file or a pipe a line that rewrites itself would be one long line of carriage returns.
        if not self._stream.isatty() or self._now_s() - self._start_s < PROGRESS_AFTER_S:
            return
        text = what if fraction is None else f"{what} {100 * fraction:3.0f} %"
        self._stream.write("\r" + text.ljust(self._shown))
        self._stream.flush()
        self._shown = len(text)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            self._stream.write("\r" + " " * self._shown + "\r")
            self._stream.flush()
