"""Owns the number of the next scan: it never repeats, not even when its file or the newest scans are gone.

The file and the folders vote; the higher wins. The clock has no part in it.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable
from pathlib import Path

from appliance.store.atomic import StorageError, replace_file
from appliance.store.filesystem import FileSystem

FILE_NAME = "next-id"
LARGEST = 999_999_999_999
"""Folder names have room for it; a scan every second for 30,000 years."""
_LINE = re.compile(rb"(\d{1,13}) ([0-9a-f]{8})\n")


def spell_id(number: int) -> str:
    """Return a scan's number as six digits, more when they are needed."""
    return f"{number:06d}"


def take(fs: FileSystem, root: Path, used: Iterable[int]) -> int:
    """Return a number that was never taken; durably gone on return. Raises StorageError."""
    # The file alone would do; the folders' numbers are looked at, too, in case the file is lost or damaged. A number
    # that was taken for a scan that failed is only in the file.
    number = max(1, _stored(root / FILE_NAME), max(used, default=0) + 1)
    if number > LARGEST:
        raise StorageError("cannot count on in", root, f"{LARGEST} is the last number", "start a new storage folder")
    replace_file(fs, root / FILE_NAME, _line(number + 1))
    return number


def _line(next_number: int) -> bytes:
    digits = str(next_number).encode()
    return b"%s %08x\n" % (digits, zlib.crc32(digits))


def _stored(path: Path) -> int:
    """Return the next number by the file; 1 when the file is missing or damaged."""
    try:
        found = _LINE.fullmatch(path.read_bytes())
    except OSError:
        return 1
    if found is None or int(found[2], 16) != zlib.crc32(found[1]):
        return 1
    return int(found[1])
