"""Names that become part of a path, and the number of the next scan.

Names come from manifests, objects, archives, other storage roots and other computers, and are not always written by
this program. So a name is checked where it is read, before it is joined to a folder: it is one component, neither
hidden nor read as an option by other programs, and valid on every file system.

The number of the next scan never repeats, not even when its file or the newest scans are gone: it is the higher of the
file's and that after the folders'. The clock has no part in it.
"""

from __future__ import annotations

import math
import re
import unicodedata
import zlib
from collections.abc import Iterable
from pathlib import Path

from appliance.store.atomic import FileSystem, StorageError

NUMBER_FILE = "next-id"
LARGEST_NUMBER = 999_999_999_999
"""Folder names have room for it; a scan every second for 30,000 years."""
_LINE = re.compile(rb"(\d{1,13}) ([0-9a-f]{8})\n")


def spell_id(number: int) -> str:
    """Return a scan's number as six digits, more when they are needed."""
    return f"{number:06d}"


def take_number(fs: FileSystem, root: Path, used: Iterable[int]) -> int:
    """Reserve a number that was never used, durably, and return it. Raises StorageError."""
    # The file alone would do; the folders' numbers count in case it is lost or damaged. The number of a scan that
    # failed is only in the file.
    number = max(1, _stored(root / NUMBER_FILE), max(used, default=0) + 1)
    if number > LARGEST_NUMBER:
        raise StorageError(
            "cannot number on in", root, f"{LARGEST_NUMBER} is the last number", "start a new storage folder"
        )
    fs.replace_file(root / NUMBER_FILE, _line(number + 1))
    return number


def _line(next_number: int) -> bytes:
    digits = str(next_number).encode()
    return b"%s %08x\n" % (digits, zlib.crc32(digits))


def _stored(path: Path) -> int:
    """Return the next number by the file; 1 when the file is missing or damaged."""
    try:
        match = _LINE.fullmatch(path.read_bytes())
    except OSError:
        return 1
    if match is None or int(match[2], 16) != zlib.crc32(match[1]):
        return 1
    return int(match[1])


CALIBRATION_FILE, AIR_FILE = Path("calibration", "current.json"), Path("calibration", "air.json")
"""Places below a storage root of the calibration in use, and of the one in air that others begin with."""
OBJECTS = "objects"
"""Folder below a storage root with its objects."""
MOST_CHARACTERS, MOST_BYTES = 100, 200
"""Longest name: file systems take 255 bytes, of which our own endings and drafts need some."""
_RESERVED = frozenset('/\\:*?"<>|')
"""Path separators, and characters that Windows refuses."""
_SCAN_FOLDER = re.compile(r"([0-9]{6,12})(-[0-9]{1,9})?")
_OBJECT = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}")
_KEPT = re.compile(r"[0-9]{4,9}-[A-Za-z0-9_-]{1,40}\.json")


def component(name: str, what: str) -> str:
    """Return ``name`` if it is one component of a path, else raise ValueError.

    ``what`` is the kind of the name, for the message.
    """
    if not is_component(name):
        raise ValueError(
            f"{what} is {name!r:.60}; allowed are 1 to {MOST_CHARACTERS} printable characters, none of "
            f"{' '.join(sorted(_RESERVED))}, "
            "not beginning with a dot, a dash or a blank and not ending with a dot or a blank"
        )
    return name


def is_component(name: str) -> bool:
    """Return True if ``name`` is one component of a path that is neither hidden nor looks like an option."""
    # `isprintable` takes no NUL, no line end, no escape code, and none of the marks that turn the direction of writing.
    return (
        0 < len(name) <= MOST_CHARACTERS
        and name.isprintable()
        and _RESERVED.isdisjoint(name)
        and len(name.encode("utf-8", "replace")) <= MOST_BYTES
        and not name.startswith((".", "-", " ", "~"))
        and not name.endswith((".", " "))
        # Two spellings of one name would be two folders here and one elsewhere.
        and unicodedata.is_normalized("NFC", name)
    )


def scan_number(folder: str) -> str | None:
    """Return the number in the name of a scan's folder; ``None`` for any other.

    The ending of ``000007-2`` tells apart two of one number.
    """
    match = _SCAN_FOLDER.fullmatch(folder)
    return None if match is None else match[1]


def by_number(folder: str) -> tuple[float, str]:
    """Return the sort key of a scan's name: 1000000 comes after 999999, names of another form last."""
    number = scan_number(folder)
    return (math.inf if number is None else int(number)), folder


def is_object(name: str) -> bool:
    """Return True if ``name`` can name an object, whose folder and files are called so."""
    return _OBJECT.fullmatch(name) is not None and not name.endswith((" ", "."))


def is_kept_calibration(name: str) -> bool:
    """Return True if ``name`` is the file name of a kept calibration, without any folder."""
    return _KEPT.fullmatch(name) is not None
