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

    Its module has ``write_points``, ``write_grid``, ``write_scans`` or ``write_mesh``, each of a path, the content and what is said
    about it, for each of ``contents``.
    """

    suffix: str
    module: str
    """Name of the module beside this one."""
    contents: tuple[str, ...]
    """``points``: of a scan or a surface; ``grid``: of a scan, pixel by pixel; ``scans``: of an object, each with its place; ``mesh``."""
    library: str | None = None
    """Name of the library that writes it; ``None``: ours."""


FORMATS = (
    Format(".ply", "ply", ("points", "mesh")),
    Format(".e57", "e57", ("points", "scans"), "pye57"),
    Format(".las", "las", ("points",), "laspy"),
    Format(".npz", "npz", ("grid", "scans")),
    Format(".stl", "stl", ("mesh",)),
    Format(".obj", "obj", ("mesh",)),
)
SCAN_SUFFIXES = tuple(one.suffix for one in FORMATS if one.contents != ("mesh",))
OBJECT_SCANS_SUFFIXES = tuple(one.suffix for one in FORMATS if "scans" in one.contents)
SURFACE_SUFFIXES = tuple(one.suffix for one in FORMATS if "points" in one.contents)
MESH_SUFFIXES = tuple(one.suffix for one in FORMATS if "mesh" in one.contents)

_TRIANGLES = tuple(suffix for suffix in MESH_SUFFIXES if suffix not in SCAN_SUFFIXES)
"""Suffixes that only meshes have."""
SUFFIXES_BY_CONTENT = {
    "a scan": (*SCAN_SUFFIXES, *_TRIANGLES),
    "a mesh": MESH_SUFFIXES,
    "a cloud": SCAN_SUFFIXES,
    "an object": tuple(dict.fromkeys((*SURFACE_SUFFIXES, *_TRIANGLES, *OBJECT_SCANS_SUFFIXES))),
    "a comparison": (*SURFACE_SUFFIXES, ".html"),
}
"""Suffixes by the thing that a verb is asked to write."""


def has_triangles(path: Path, wanted: bool = False) -> bool:
    """Return whether a mesh is written to ``path``; ``wanted``: also where its suffix leaves the choice."""
    suffix = path.suffix.lower()
    return suffix in MESH_SUFFIXES if wanted else suffix in _TRIANGLES


def check_file(path: Path, what: str) -> None:
    """Raises ExportError for a suffix that ``what`` (``WRITTEN``) is not written with, and MissingLibraryError where
    what writes it is absent: before minutes of work."""
    check_suffix(path, SUFFIXES_BY_CONTENT[what], what)
    require_library(path)


def check_suffix(path: Path, allowed: tuple[str, ...], what: str) -> str:
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
