"""Table of file formats, one row each, and checks of a suffix.

The module is light, so that a wrong suffix is reported at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.base import require


class ExportError(Exception):
    """A file cannot be made; the text names it, the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of file, by its suffix.

    Its module has ``write_points``, ``write_grid``, ``write_scans`` or ``write_mesh``, each of a path, the content and its metadata,
    for each of ``contents``.
    """

    suffix: str
    module: str
    """Name of the module beside this one."""
    contents: tuple[str, ...]
    """``points``: of a scan or a surface; ``grid``: of a scan, pixel by pixel; ``scans``: of an object, each with its pose; ``mesh``."""
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
SCAN_SUFFIXES = tuple(row.suffix for row in FORMATS if row.contents != ("mesh",))
OBJECT_SCANS_SUFFIXES = tuple(row.suffix for row in FORMATS if "scans" in row.contents)
SURFACE_SUFFIXES = tuple(row.suffix for row in FORMATS if "points" in row.contents)
MESH_SUFFIXES = tuple(row.suffix for row in FORMATS if "mesh" in row.contents)

_TRIANGLES = tuple(suffix for suffix in MESH_SUFFIXES if suffix not in SCAN_SUFFIXES)
"""Suffixes that only meshes have."""
SUFFIXES_BY_CONTENT = {
    "a scan": (*SCAN_SUFFIXES, *_TRIANGLES),
    "a mesh": MESH_SUFFIXES,
    "a cloud": SCAN_SUFFIXES,
    "an object": tuple(dict.fromkeys((*SURFACE_SUFFIXES, *_TRIANGLES, *OBJECT_SCANS_SUFFIXES))),
    "a comparison": (*SURFACE_SUFFIXES, ".html"),
}
"""Allowed suffixes by the content that a verb writes."""


def has_triangles(path: Path, preferred: bool = False) -> bool:
    """Return whether a mesh is written to ``path``; ``preferred``: also if its suffix leaves the choice."""
    suffix = path.suffix.lower()
    return suffix in MESH_SUFFIXES if preferred else suffix in _TRIANGLES


def check_file(path: Path, what: str) -> None:
    """Check before minutes of work that a file can be written.

    Raises ExportError for a suffix that ``what`` (a key of ``SUFFIXES_BY_CONTENT``) does not allow, and MissingLibraryError
    where the library that writes it is absent.
    """
    check_suffix(path, SUFFIXES_BY_CONTENT[what], what)
    require_library(path)


def check_suffix(path: Path, allowed: tuple[str, ...], what: str) -> str:
    """Return the suffix of ``path`` in lower case.

    Raises ExportError for a suffix that is not among those ``allowed`` for ``what``.
    """
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise ExportError(
            f"{path}: {what} is written as {', '.join(allowed)}, not as {path.suffix or 'a file without suffix'}; "
            f"give for example {path.with_suffix(allowed[0]).name}"
        )
    return suffix


def require_library(path: Path) -> None:
    """Raise MissingLibraryError where the library that writes files with the suffix of ``path`` is absent.

    It is called before minutes of work.
    """
    suffix = path.suffix.lower()
    if suffix == ".html":
        require("plotly", "plotly", "a page with a surface that can be turned")
    for row in FORMATS:
        if row.suffix == suffix and row.library is not None:
            require(row.library, row.library, f"{'an' if suffix == '.e57' else 'a'} {suffix[1:].upper()} file")
