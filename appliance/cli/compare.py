"""Owns the verbs that compare: a scan, or an object, with what it was to be."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import number, operand, option, repeated
from appliance.cli.desk import library_root, measuring, scan_in, whole_scan, writable, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, Progress, UsageError, say, say_json
from appliance.cli.places import WithCalibration

if TYPE_CHECKING:
    from appliance.desk import About, FusedCloud, NominalSurface, StoredObject
    from appliance.measure import Rigid
    from appliance.store import Wish

_PLACE = 6
_NOMINAL = "a CAD model in mm (.stl .obj .ply), or the name of another object"
_FARTHEST_MM = 1e11
_FILES = tuple(
    f".{one}"
    for one in [
        "stl",
        "obj",
        "ply",
        "step",
        "stp",
        "iges",
        "igs",
        "3mf",
        "off",
        "glb",
        "gltf",
        "dxf",
        "x_t",
        "sldprt",
        "ipt",
        "brep",
    ]
)
"""Suffixes of CAD models, and of those that must be converted first: an object's name may have a dot, too."""


def _six(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != _PLACE or not all(abs(value) < _FARTHEST_MM for value in values):
        raise argparse.ArgumentTypeError(
            f"{text}: allowed are six numbers with commas: x,y,z in mm and the turn as axis times angle in degrees"
        )
    return values


def _is_file(nominal: str) -> bool:
    """Tell whether ``nominal`` is a CAD model's file, and no object's name."""
    path = Path(nominal)
    return path.suffix.lower() in _FILES or path.exists()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Comparing(WithCalibration):
    out: tuple[str, ...] = repeated(
        "--out",
        "points with their deviation, in the CAD model's frame (.ply .e57 .las), or a page with map and histogram (.html); may be repeated",
        metavar="FILE",
    )
    tolerance: float | None = option(
        "--tolerance", "mm that a deviation may have: more is counted", parse=number(0.001, 100.0, "mm"), metavar="MM"
    )
    limit: float = option(
        "--limit",
        "mm beyond which a point is none of the CAD model's (5)",
        default=5.0,
        parse=number(0.1, 100.0, "mm"),
        metavar="MM",
    )
    start: tuple[float, ...] | None = option(
        "--start",
        "roughly where it lies in the CAD model's frame, instead of searching: x,y,z in mm, turn as axis times angle in degrees",
        parse=_six,
        metavar="X,Y,Z,RX,RY,RZ",
    )
    spacing: float = option(
        "--spacing",
        "mm between the points that are compared (0.3)",
        default=0.3,
        parse=number(0.02, 20.0, "mm"),
        metavar="MM",
    )

    def compared(self, nominal: NominalSurface, surface: FusedCloud, about: About, stored: StoredObject | None) -> Exit:
        """Compare, write what was asked for, and say what came of it."""
        from appliance.desk import compare, errors_of, figures_of, write_comparison

        with Progress() as progress:
            progress(f"laying it onto {nominal.name}")
            found = compare(surface, nominal, self.limit, self._start(), None if stored is None else errors_of(stored))
            for out in self.out:
                progress(f"writing {out}")
                with writing(Path(out)):
                    write_comparison(Path(out), found, about, self.tolerance, stored)
        figures = figures_of(found, self.tolerance)
        if self.json:
            say_json(figures)
            return Exit.OK
        summary = found.deviation.summary
        say(
            f"{about.title} against {nominal.name}: {summary.points} points, {summary.beyond} of them farther than {self.limit:g} mm, "
            f"{summary.beside} beside an open border"
        )
        if summary.rms_mm is not None:
            say(
                f"deviation: mean {summary.mean_mm:+.3f}, RMS {summary.rms_mm:.3f}, {summary.least_mm:+.3f} to {summary.most_mm:+.3f} mm"
            )
        if self.tolerance is not None:
            say(f"out of ± {self.tolerance:g} mm: {figures['out_of_tolerance_percent']:.2f} %")
        for one in found.warnings:
            say(f"warning: {one}")
        return Exit.OK

    def checked(self, nominal: str, root: Path) -> None:
        """Raises ObjectError for an object under ``root`` that is not there, UsageError for files that cannot be written, and MissingLibraryError where what reads ``nominal`` or writes them is absent: before
        minutes of work."""
        from appliance.base import require
        from appliance.desk import SURFACE_SUFFIXES, ExportError, checked_drawing, checked_suffix, require_library

        require("igl", "libigl", "a comparison")
        if _is_file(nominal):
            # Before a scan is opened: a format that is not read, a file that is not there.
            if checked_drawing(Path(nominal)) != ".stl":
                require("trimesh", "trimesh", "a CAD model")
        else:
            require("skimage.measure", "scikit-image", "the mesh of an object")
            from appliance.desk import read_object

            read_object(root, nominal)

        for out in map(Path, self.out):
            writable(out)
            try:
                checked_suffix(out, (*SURFACE_SUFFIXES, ".html"), "a comparison")
            except ExportError as error:
                raise UsageError(f"--out {error}") from error
            require_library(out)

    def _start(self) -> Rigid | None:
        import numpy as np

        from appliance.measure import Rigid, rotation_matrix

        if self.start is None:
            return None
        return Rigid(rotation_matrix(np.radians(self.start[3:])), np.array(self.start[:3]))

    def surface_named(self, named: str, root: Path, wish: Wish, progress: Progress) -> NominalSurface:
        """Return the CAD model or the object called ``named``. Raises NominalError, ObjectError."""
        from appliance.desk import (
            VOXEL_MM,
            NominalSurface,
            errors_of,
            laid_onto_something,
            mesh_of_surface,
            nominal_of_mesh,
            read_nominal,
            read_object,
            surface_of,
        )

        path = Path(named)
        if _is_file(named):
            return NominalSurface(path.name, read_nominal(path))
        other = read_object(root, named)
        # What the two are laid onto each other by, no error of the other's frame is left in.
        surface = laid_onto_something(surface_of(root, other, wish, progress, self.spacing), errors_of(other))
        mesh = mesh_of_surface(surface, max(VOXEL_MM, 2.0 * self.spacing))
        return NominalSurface(f"object {other.name}", nominal_of_mesh(mesh), mesh.sigma_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareObject(_Comparing):
    """The distances of a solved object's surface from a CAD model, or from another object."""

    name: str = operand("NAME", "the object's name")
    nominal: str = operand("MODEL", _NOMINAL)

    def run(self) -> Exit:
        from appliance.desk import read_object

        wish = self.wish()
        measuring(wish.calibration)
        root = library_root(wish)
        self.checked(self.nominal, root)
        stored = read_object(root, self.name)
        compile_kernels()
        from appliance.desk import about_object, surface_of

        with Progress() as progress:
            nominal = self.surface_named(self.nominal, root, wish, progress)
            surface = surface_of(root, stored, wish, progress, self.spacing)
        return self.compared(nominal, surface, about_object(stored), stored)


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareScan(_Comparing):
    """The distances of one scan's points from a CAD model, or from an object."""

    scan: str = operand("SCAN", "its number or its folder")
    nominal: str = operand("MODEL", _NOMINAL)

    def run(self) -> Exit:
        wish = self.wish()
        measuring(wish.calibration)
        root = library_root(wish)
        scan_in(wish, self.scan)
        self.checked(self.nominal, root)
        with Progress() as progress:
            folder = whole_scan(wish, self.scan)
            compile_kernels()
            import numpy as np

            from appliance.desk import CAMERA_FRAME, About, PlacedScan, fuse, organised_scan
            from appliance.store import calibration_for, open_source

            nominal = self.surface_named(self.nominal, root, wish, progress)
            source = open_source(folder, wish)
            made = organised_scan(source, calibration_for(source, wish), progress)
            # One scan has no other to be placed beside.
            placed = PlacedScan(made.cloud, np.eye(3), np.zeros(3), pose_sigma_mm=0.0)
            surface = fuse([placed], self.spacing)
        return self.compared(nominal, surface, About(f"scan {source.scan.manifest.scan_id}", CAMERA_FRAME), None)
