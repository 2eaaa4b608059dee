"""Owns which suffix means which format, and what is refused by a suffix alone: light, so that a wrong one is told at once."""

from __future__ import annotations

from pathlib import Path

from appliance.base import require


class ExportError(Exception):
    """A file cannot be made; the text says which, why, and what to do."""


SCAN_SUFFIXES = (".ply", ".e57", ".las", ".npz")
SURFACE_SUFFIXES = (".ply", ".e57", ".las")
MESH_SUFFIXES = (".ply", ".stl", ".obj")


def checked_suffix(path: Path, allowed: tuple[str, ...], what: str) -> str:
    """Return the suffix of ``path`` in lower case. Raises ExportError for one that is none of those ``allowed`` for ``what``."""
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise ExportError(
            f"{path}: {what} is written as {', '.join(allowed)}, not as {path.suffix or 'a file without suffix'}; "
            f"give for example {path.with_suffix(allowed[0]).name}"
        )
    return suffix


def require_library(path: Path) -> None:
    """Raises MissingLibraryError where the library that writes files with the suffix of ``path`` is absent: before minutes of work."""
    libraries = {
        ".e57": ("pye57", "an E57 file"),
        ".las": ("laspy", "a LAS file"),
        ".html": ("plotly", "a page with a surface that can be turned"),
    }
    if path.suffix.lower() in libraries:
        module, what = libraries[path.suffix.lower()]
        require(module, module, what)
