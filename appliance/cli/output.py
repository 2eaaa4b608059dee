"""Printing: results on stdout, progress and errors on stderr, one line per error.

Texts come from manifests, objects and file names by strangers. All of them are printed by ``plain``, so that none of
their characters moves a cursor, turns the direction of writing, or begins a line.
"""

from __future__ import annotations

import io
import json
import logging
import re
import sys
import time
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import IntEnum
from typing import Any, TextIO

PROGRESS_AFTER_S = 1.0
LINE_AFTER_S, LINE_EVERY_S = 4.0, 8.0
"""Seconds before the first line of progress and between two lines without a terminal; calls come every second or two.
"""
DIGITS = 4
"""Significant digits of a measured value: a noise of 0.02489 mm is measured to two, a distance of 500.13 mm to four."""
_MORE = {"index": 6, "baseline": 6, "principal": 6, "latitude": 6}
"""Significant digits of values that are measured to more, by a word of the name."""
_WHOLE_FROM = 1000.0
HASH_DIGITS = 12
_HASH = re.compile(r"[0-9a-f]{64}")
_ODD = re.compile(r"[^ -~]")

log = logging.getLogger(__name__)
"""Logger for waiting times, which every verb prints (``log_lines``)."""


class Exit(IntEnum):
    """Exit codes, the same for every verb."""

    OK = 0
    FAILED = 1
    """The request was understood but could not be carried out: a device, the disk, an unknown scan."""
    USAGE = 2
    """Wrong arguments or a wrong rig file."""
    SCRIPT_FAILED = 3
    """The diver's script of ``kingfisher sim`` failed."""
    DAMAGED = 4
    """``scans verify`` found a damaged scan."""
    LEFT_OUT = 5
    """``object solve`` placed some scans and left others out."""
    INTERRUPTED = 130
    """Ctrl-C."""


class UsageError(Exception):
    """Error of an argument; the text names it, its value, the allowed values and the remedy."""


class OutputError(Exception):
    """Error of writing results to standard output; the text says why."""


def plain(text: str, *, lines: bool = False) -> str:
    r"""Return ``text`` with every unreadable character as ``\uXXXX``, which is also JSON's form.

    ``lines``: line ends stay.
    """
    return _ODD.sub(lambda match: _escape_unreadable(match[0], lines=lines), text)


def _escape_unreadable(character: str, *, lines: bool) -> str:
    # Python counts as not printable: Unicode's controls, formats, surrogates, unassigned characters, line ends, and
    # blanks of other widths, which may stay.
    if character.isprintable() or unicodedata.category(character) == "Zs" or (lines and character == "\n"):
        return character
    return _escape(character)


def _escape(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[k]:02x}{units[k + 1]:02x}" for k in range(0, len(units), 2))


def use_any_encoding() -> None:
    """Escape characters that the terminal's encoding lacks, as on stderr, instead of raising an error."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def say(text: str) -> None:
    """Print one line of results on stdout. Raises OutputError, BrokenPipeError."""
    write(text + "\n")


def write(text: str) -> None:
    """Write text with its line ends to stdout. Raises OutputError, BrokenPipeError."""
    with _writing():
        stdout().write(plain(text, lines=True))


def flush() -> None:
    """Flush stdout. Raises OutputError, BrokenPipeError."""
    if sys.stdout is not None and not sys.stdout.closed:
        with _writing():
            sys.stdout.flush()


def stdout() -> TextIO:
    """Return standard output. Raises OutputError if it was closed before the program began."""
    if sys.stdout is None:
        raise OutputError("results cannot be written: standard output is closed; open it, or redirect it to a file")
    return sys.stdout


@contextmanager
def _writing() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        # Otherwise the interpreter would write the buffer again at its end, with a traceback.
        with suppress(OSError):
            sys.stdout.close()
        raise OutputError(
            f"results cannot be written to standard output: {error.strerror or error}; redirect it elsewhere"
        ) from error


def say_json(value: Any) -> None:
    """Print one JSON document on stdout."""
    say(json.dumps(value, indent=1, ensure_ascii=False))


def complain(text: str, *, as_json: bool) -> None:
    """Print one error on stderr, in one line."""
    line = " ".join(text.split())
    if sys.stderr is None:
        return
    try:
        sys.stderr.write(
            plain(json.dumps({"error": line}, ensure_ascii=False) if as_json else f"kingfisher: {line}") + "\n"
        )
    except OSError:
        # The exit code still reports the error. The interpreter would change it if it failed to write the buffer at its
        # end.
        with suppress(OSError):
            sys.stderr.close()


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return columns padded to their widest cell, each row in one line; the last column is not padded."""
    lines = [[plain(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    widths[-1] = 0
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def format_value(key: str, value: object) -> str:
    """Return a value for people: ``-`` for none, ``none`` for an empty list, 12 digits of a hash."""
    match value:
        case None | "":
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return format_number(key, value)
        case str():
            return value[:HASH_DIGITS] if _HASH.fullmatch(value) else value
        case Mapping():
            return ", ".join(f"{name} {format_value(str(name), item)}" for name, item in value.items()) or "none"
        case Sequence():
            return "; ".join(format_value(key, item) for item in value) or "none"
        case _:
            return str(value)


def format_number(key: str, value: float) -> str:
    """Return a float with ``DIGITS`` significant digits, or no decimals from 1000 on.

    Percent have two decimals.
    """
    if key.endswith("_percent") and abs(value) >= 1.0:
        return f"{value:.2f}"
    digits = next((more for word, more in _MORE.items() if word in key), DIGITS)
    # `g` would write 12345 as 1.234e+04, which is hard to read as a number of µm.
    if abs(value) >= 10.0 ** (digits - 1) and abs(value) >= _WHOLE_FROM:
        return f"{value:.{max(0, digits - len(str(int(abs(value)))))}f}"
    return f"{value:.{digits}g}"


def say_report(report: Mapping[str, object]) -> None:
    """Print one line per value, with the names in a column."""
    width = max(24, *(len(key) for key in report))
    for key, value in report.items():
        say(f"{key:<{width}} {format_value(key, value)}")


def time_text(seconds: float) -> str:
    """Return a remaining time for people."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


@contextmanager
def log_lines(*, as_json: bool, service: bool) -> Iterator[None]:
    """Print log entries inside the block on stderr, one line each: warnings, and for a service also information."""
    root = logging.getLogger()
    before = root.level
    handler = logging.StreamHandler()
    handler.setFormatter(_Line(as_json=as_json))
    root.addHandler(handler)
    root.setLevel(logging.INFO if service else logging.WARNING)
    log.setLevel(logging.INFO)  # waiting times are always printed
    try:
        yield
    finally:
        log.setLevel(logging.NOTSET)
        root.setLevel(before)
        root.removeHandler(handler)


class _Line(logging.Formatter):
    """Formatter of log entries as one line, in JSON with the level if ``as_json``."""

    def __init__(self, *, as_json: bool) -> None:
        super().__init__("kingfisher: %(message)s")
        self._as_json = as_json

    def format(self, record: logging.LogRecord) -> str:
        if self._as_json:
            return plain(json.dumps({record.levelname.lower(): record.getMessage()}, ensure_ascii=False))
        return plain(super().format(record), lines=True)


class ProgressLine:
    """Progress of the work: one changing line on a terminal, else lines some seconds apart. A context manager."""

    def __init__(
        self,
        stream: TextIO | None = None,
        now_s: Callable[[], float] = time.monotonic,
        line: Callable[[str], None] = log.info,
        after_s: tuple[float, float] = (PROGRESS_AFTER_S, LINE_AFTER_S),
    ) -> None:
        """Stay silent for ``after_s``: seconds on a terminal, and elsewhere."""
        self._stream = stream or sys.stderr
        self._now_s = now_s
        self._line = line
        self._terminal = self._stream is not None and self._stream.isatty()
        self._next_s = now_s() + after_s[0 if self._terminal else 1]
        self._shown = 0

    def __call__(self, step: str, fraction: float | None = None) -> None:
        """Show the present step, and which part of the work is done (0..1)."""
        if self._now_s() < self._next_s:
            return
        text = plain(step if fraction is None else f"{step} {100 * fraction:3.0f} %")
        if not self._terminal:
            # In a file or a pipe, a line that is overwritten would become one long line of carriage returns.
            self._line(text)
            self._next_s = self._now_s() + LINE_EVERY_S
            return
        self._stream.write("\r" + text.ljust(self._shown))
        self._stream.flush()
        self._shown = len(text)

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            self._stream.write("\r" + " " * self._shown + "\r")
            self._stream.flush()
