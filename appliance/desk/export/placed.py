"""Owns the files of an object's single scans, each unmoved, with where it lies in the object: a NumPy archive, or an
E57 file with a pose for each.

In the archive stands for each scan on its pixel grid, under its name (``000003/x_mm``), what ``npz.py`` has of one
scan, and

    rotation (3, 3), translation_mm (3,)    float64: a point p of the scan is at rotation · p + translation_mm in the object's frame
    place_covariance (6, 6)                 float64: of the turn (rad) and the shift (mm) about its own middle, what may bend the object included
    middle_mm (3,)                          float64: that middle, in the object's frame

and once ``scans``, the names in their order, and ``about``. ``numpy.load`` reads it without pickles, and only what is
asked for. One scan is held at a time.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.export.content import About, points_of_scan
from appliance.desk.export.e57 import E57Scan, write_e57
from appliance.desk.export.formats import checked_suffix
from appliance.desk.export.npz import arrays_of
from appliance.measure import OrganisedCloud
from appliance.store import LocalFileSystem

SUFFIXES = (".npz", ".e57")
_LEVEL = 1
"""Level of deflate: noise is not made smaller by trying harder."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedGrid:
    """One scan of an object and where it lies."""

    name: str
    cloud: OrganisedCloud
    rotation: NDArray[np.float64]
    translation_mm: NDArray[np.float64]
    covariance: NDArray[np.float64]
    """(6, 6), as the module's head says."""
    middle_mm: NDArray[np.float64]


def write_placed(path: Path, grids: Iterable[PlacedGrid], about: About) -> None:
    """Write the scans (``SUFFIXES``), whole or not at all; one is held at a time.

    Raises ExportError, StorageError, MissingLibraryError where the format's library is absent, and what ``grids``
    raises.
    """
    if checked_suffix(path, SUFFIXES, "the scans of an object") == ".npz":
        LocalFileSystem().replace_by(path, partial(_write, grids=grids, about=about))
        return
    scans = (
        E57Scan(replace(points_of_scan(grid.cloud), origin_mm=grid.translation_mm), grid.name, grid.rotation)
        for grid in grids
    )
    LocalFileSystem().replace_by(path, partial(write_e57, scans=scans, about=about))


def _write(path: Path, grids: Iterable[PlacedGrid], about: About) -> None:
    names = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for grid in grids:
            names.append(grid.name)
            placed = {
                "rotation": grid.rotation,
                "translation_mm": grid.translation_mm,
                "place_covariance": grid.covariance,
                "middle_mm": grid.middle_mm,
            }
            for name, values in {**arrays_of(grid.cloud), **placed}.items():
                _add(archive, f"{grid.name}/{name}", values)
        _add(archive, "scans", np.array(names))
        said = {"title": about.title, "frame": about.frame, "unit": "mm", "notes": list(about.notes)}
        _add(archive, "about", np.array(json.dumps(said, ensure_ascii=False)))


def _add(archive: zipfile.ZipFile, name: str, values: NDArray[Any]) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        # In order C, which a view of one axis is not; a text stays without an axis.
        np.lib.format.write_array(member, np.asarray(values, order="C"), allow_pickle=False)
