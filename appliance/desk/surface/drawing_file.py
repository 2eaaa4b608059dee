"""Checks of a CAD model's file before it is opened: its format, that it is a file, and its size.

The module loads no other that computes, so that a wrong word is reported at once.
"""

from __future__ import annotations

from pathlib import Path

from appliance.base import refuse_irregular

SUFFIXES = (".stl", ".obj", ".ply")
MAX_BYTES = 2 * 1024**3
"""Largest file that is read: 42 million triangles of binary STL."""


class NominalError(Exception):
    """A file holds no nominal surface; the text names it, and says why."""


def check_drawing(path: Path) -> str:
    """Return the suffix of a CAD model in lower case.

    Raises NominalError for a format that is not read, a missing file, another kind of file or one too large. It is not
    opened.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise NominalError(
            f"{path}: a CAD model is read from {', '.join(SUFFIXES)}, in mm; convert {suffix or 'it'} to one of these"
        )
    try:
        refuse_irregular(path, MAX_BYTES)
    except OSError as error:
        raise NominalError(f"{path}: cannot be read ({error.strerror or error})") from error
    return suffix
