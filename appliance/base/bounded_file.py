"""Owns how a file is read that somebody else wrote: a regular one, at once, of no more than a stated number of bytes.

Descriptions, lists, rig files, tables, cameras' files, calibrations and pictures have names that people type. A pipe
would be waited for, a device or a film read until memory ends; both are refused before a byte is read. What is refused
is an ``OSError`` with its reason in ``strerror``, like whatever else a file system refuses.
"""

from __future__ import annotations

import errno
import os
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISDIR, "a folder"),
)
MOST_INTEGER = 2**63 - 1
"""Largest whole number of TOML 1.0, which has 64 bits; Python would read one of any length, and fail when it is
computed with."""


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a regular file.

    Raises OSError for any other kind, and for one of more than ``most_bytes``.
    """
    # Without waiting: opening a pipe that nobody writes to would last for ever.
    number = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(number, "rb") as file:
        about = os.fstat(number)
        _refuse_kind(path, about.st_mode)
        # A file may grow while it is read, and those of /proc have no size.
        data = b"" if about.st_size > most_bytes else file.read(most_bytes + 1)
    if about.st_size > most_bytes or len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"larger than {most_bytes} bytes", str(path))
    return data


def refuse_irregular(path: Path, most_bytes: int | None = None) -> None:
    """Raise OSError for anything but a regular file, and for one of more than ``most_bytes``; for libraries that open a
    file themselves."""
    about = path.stat()
    _refuse_kind(path, about.st_mode)
    if most_bytes is not None and about.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"larger than {most_bytes} bytes", str(path))


def _refuse_kind(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((name for is_one, name in _KINDS if is_one(mode)), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, allowed are regular files", str(path))


def read_text(path: Path, most_bytes: int) -> str:
    """Return the text of a regular file in UTF-8, without the byte-order mark that some editors put before it.

    Raises OSError like ``read_bounded``, and UnicodeDecodeError.
    """
    return read_bounded(path, most_bytes).decode("utf-8-sig")


def parse_toml(text: str) -> dict[str, Any]:
    """Return what TOML 1.0 holds.

    Raises ValueError, also for whole numbers of more than 64 bits and for tables too deep to be read.
    """
    try:
        content = tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("tables or lists are nested too deeply") from error
    for key, number in _integers(content, ""):
        if not -MOST_INTEGER - 1 <= number <= MOST_INTEGER:
            raise ValueError(f"{key} is a whole number of {number.bit_length()} bits; allowed are 64")
    return content


def _integers(value: Any, key: str) -> Iterator[tuple[str, int]]:
    """Yield the whole numbers in tables and lists, with their keys."""
    if isinstance(value, dict):
        for name, one in value.items():
            yield from _integers(one, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for one in value:
            yield from _integers(one, key)
    elif isinstance(value, int):
        yield key, value
