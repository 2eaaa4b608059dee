"""Owns the table of formats, one row each, and what is refused by a suffix alone: light, so that a wrong one is told at
once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.base import require


class ExportError(Exception):
    """A file cannot be made; the text says which, why, and what to do."""


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of file, by its suffix.

    Its module has ``write_points``, ``write_grid`` or ``write_mesh``, each of a path, the content and what is said
    about it, for each of ``contents``.
    """

    suffix: str
    module: str
    """Name of the module beside this one."""
    contents: tuple[str, ...]
    """``points``: of a scan or a surface; ``grid``: of a scan, pixel by pixel; ``mesh``."""
    library: str | None = None
    """Name of the library that writes it; ``None``: ours."""


FORMATS = (
    Format(".ply", "ply", ("points", "mesh")),
    Format(".e57", "e57", ("points",), "pye57"),
    Format(".las", "las", ("points",), "laspy"),
    Format(".npz", "npz", ("grid",)),
    Format(".stl", "stl", ("mesh",)),
    Format(".obj", "obj", ("mesh",)),
)
SCAN_SUFFIXES = tuple(one.suffix for one in FORMATS if one.contents != ("mesh",))
SURFACE_SUFFIXES = tuple(one.suffix for one in FORMATS if "points" in one.contents)
MESH_SUFFIXES = tuple(one.suffix for one in FORMATS if "mesh" in one.contents)


def checked_suffix(path: Path, allowed: tuple[str, ...], what: str) -> str:
    """Return the suffix of ``path`` in lower case.

    Raises ExportError for one that is none of those ``allowed`` for ``what``.
    """
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise ExportError(
            f"{path}: {what} is written as {', '.join(allowed)}, not as {path.suffix or 'a file without suffix'}; "
            f"give for example {path.with_suffix(allowed[0]).name}"
        )
    return suffix


def require_library(path: Path) -> None:
    """Raises MissingLibraryError where the library that writes files with the suffix of ``path`` is absent: before
    minutes of work."""
    suffix = path.suffix.lower()
    if suffix == ".html":
        require("plotly", "plotly", "a page with a surface that can be turned")
    for one in FORMATS:
        if one.suffix == suffix and one.library is not None:
            require(one.library, one.library, f"{'an' if suffix == '.e57' else 'a'} {suffix[1:].upper()} file")
