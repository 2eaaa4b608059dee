"""Reading files that come from outside: regular ones only, and no more than a stated number of bytes.

Descriptions, lists, rig files, tables, cameras' files, calibrations and pictures have names that people type. Opening a
pipe would wait for ever, and a device or a film would be read until memory ends; both are refused before a byte is
read. A refusal is an ``OSError`` with its reason in ``strerror``, like those of the file system.
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
"""Largest integer of TOML 1.0, which has 64 bits.

Python would read one of any length, and fail when it computes with it.
"""


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a regular file.

    Raises OSError for any other kind, and for one of more than ``most_bytes``.
    """
    # Without waiting: opening a pipe that has no writer would last for ever.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        _refuse_kind(path, status.st_mode)
        # A file may grow while it is read, and those of /proc have no size.
        data = b"" if status.st_size > most_bytes else file.read(most_bytes + 1)
    if status.st_size > most_bytes or len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"larger than {most_bytes} bytes", str(path))
    return data


def refuse_irregular(path: Path, most_bytes: int | None = None) -> None:
    """Raise OSError unless ``path`` is a regular file of at most ``most_bytes``.

    For libraries that open a file themselves.
    """
    status = path.stat()
    _refuse_kind(path, status.st_mode)
    if most_bytes is not None and status.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"larger than {most_bytes} bytes", str(path))


def _refuse_kind(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((name for is_one, name in _KINDS if is_one(mode)), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, allowed are regular files", str(path))


def read_text(path: Path, most_bytes: int) -> str:
    """Return the text of a regular file in UTF-8, without a byte-order mark at its beginning.

    Raises OSError like ``read_bounded``, and UnicodeDecodeError.
    """
    return read_bounded(path, most_bytes).decode("utf-8-sig")


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML 1.0 text.

    Raises ValueError, also for integers of more than 64 bits and for tables that are nested too deeply.
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
    """Yield the integers in tables and lists, with their keys."""
    if isinstance(value, dict):
        for name, element in value.items():
            yield from _integers(element, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for element in value:
            yield from _integers(element, key)
    elif isinstance(value, int):
        yield key, value
