"""Owns the options of an object's files, and the files: which suffix means what, what is refused before the work, and one pass for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import number, option, repeated, switch
from appliance.cli.desk import writable, writing
from appliance.cli.output import Progress, UsageError
from appliance.cli.places import WithCalibration

if TYPE_CHECKING:
    from appliance.desk import PlacedGrid, StoredObject
    from appliance.store import Wish

PAGE, GRIDS, POSED, TRIANGLES = ".html", ".npz", ".e57", (".stl", ".obj")
SPACING_MM = 0.3
"""Distance of an object's points: that of a scan's in the middle of the volume is 0.16."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectFiles(WithCalibration):
    """A verb that writes files of an object."""

    out: tuple[str, ...] = repeated(
        "--out",
        "one surface of all scans as points (.ply .e57 .las) or mesh (.stl .obj, .ply with --mesh), a page about it (.html), or its placed "
        "scans on their pixel grids (.npz); may be repeated",
        metavar="FILE",
    )
    spacing: float = option(
        "--spacing", "mm between its points (0.3)", default=SPACING_MM, parse=number(0.02, 20.0, "mm"), metavar="MM"
    )
    mesh: bool = switch("--mesh", "triangles instead of points in .ply files, with sigma and grey of each corner")
    single_scans: bool = switch(
        "--scans", "single scans in .e57 files, each with its pose, instead of one surface of all"
    )
    close_holes: float | None = option(
        "--close-holes",
        "close holes of the mesh that are no wider; what is filled in was not measured, and has no sigma",
        parse=number(0.1, 1000.0, "mm"),
        metavar="MM",
    )

    def checked_outs(self, outs: Sequence[Path]) -> Sequence[Path]:
        """Return ``outs``. Raises UsageError for a file that cannot be written, and MissingLibraryError, before minutes of work."""
        from appliance.base import require
        from appliance.desk import SURFACE_SUFFIXES, ExportError, checked_suffix, require_library

        for out in outs:
            writable(out)
            try:
                checked_suffix(out, (*SURFACE_SUFFIXES, *TRIANGLES, GRIDS, PAGE), "an object")
            except ExportError as error:
                raise UsageError(f"--out {error}") from error
            require_library(out)
        # An option that would do nothing is a word that was meant otherwise.
        meshes = [out for out in outs if self._meshed(out)]
        if meshes:
            require("skimage.measure", "scikit-image", "the mesh of an object")
        for given, what in (
            (self.mesh, "--mesh: is for .ply files"),
            (self.close_holes is not None, "--close-holes: is for meshes"),
        ):
            if given and not meshes:
                raise UsageError(f"{what}, and none is written; give --out FILE.ply --mesh, or --out FILE.stl")
        if self.single_scans and not any(out.suffix.lower() == POSED for out in outs):
            raise UsageError("--scans: is for .e57 files, and none is written; give --out FILE.e57")
        return outs

    def write(self, root: Path, solved: StoredObject, wish: Wish, outs: Sequence[Path]) -> None:
        """Write the files of a solved object; the surface and its mesh are made once, when they are first wanted. Raises StorageError, ScanError."""
        if not outs:
            return
        from appliance.desk import (
            VOXEL_MM,
            about_object,
            mesh_of_surface,
            report_of,
            surface_of,
            write_mesh,
            write_placed,
            write_report,
            write_surface,
        )

        with Progress() as progress:
            # Pages, points and meshes are of one surface: it is fused once, or never.
            surface = mesh = None
            for out in outs:
                if out.suffix.lower() == GRIDS or (self.single_scans and out.suffix.lower() == POSED):
                    with writing(out):
                        write_placed(out, _grids(root, solved, wish, progress), about_object(solved))
                    continue
                surface = surface_of(root, solved, wish, progress, self.spacing) if surface is None else surface
                progress(f"writing {out.name}")
                with writing(out):
                    if out.suffix.lower() == PAGE:
                        write_report(out, report_of(solved, surface))
                    elif self._meshed(out):
                        # It takes as long as everything before.
                        if mesh is None:
                            voxel_mm = max(VOXEL_MM, 2.0 * self.spacing)
                            mesh = mesh_of_surface(surface, voxel_mm, self.close_holes or 0.0)
                        write_mesh(out, mesh, about_object(solved))
                    else:
                        write_surface(out, surface, about_object(solved))

    def _meshed(self, out: Path) -> bool:
        return out.suffix.lower() in TRIANGLES or (self.mesh and out.suffix.lower() == ".ply")


def _grids(root: Path, solved: StoredObject, wish: Wish, progress: Progress) -> Iterator[PlacedGrid]:
    """Yield the scans that have a place, one at a time."""
    import numpy as np

    from appliance.desk import PlacedGrid, placed_scans

    places = {} if solved.places is None else solved.places.places
    for (name, place), scan in zip(places.items(), placed_scans(root, solved, wish, progress), strict=True):
        yield PlacedGrid(
            name, scan.cloud, scan.rotation, scan.translation_mm, np.array(place.covariance), np.array(place.middle_mm)
        )
