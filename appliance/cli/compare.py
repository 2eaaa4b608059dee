"""The verb ``compare``: how far a scan, or an object, lies from what it was to be."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import number, operand, option, repeated
from appliance.cli.desk import (
    WithObjects,
    library_root,
    object_named,
    opened_scans,
    scan_in,
    writable_as,
    writing,
)
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine

if TYPE_CHECKING:
    from appliance.desk import About, FusedCloud, NominalSurface, StoredObject
    from appliance.measure import Rigid
    from appliance.store import Wish

_PLACE = 6
_FARTHEST_MM = 1e11


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Compare(WithObjects):
    """Measure the distances of a scan's points, or of a solved object's surface, from a CAD model or another object."""

    what: str = operand("WHAT", "a scan, by its number or folder, or object:NAME")
    nominal: str = operand("NOMINAL", "a CAD model in mm (.stl .obj .ply), or object:NAME")
    out: tuple[str, ...] = repeated(
        "--out",
        "points with their deviation, in the CAD model's frame (.ply .e57 .las), or a page with map and histogram "
        "(.html); may be repeated",
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
        "roughly where it lies in the CAD model's frame, instead of searching: x,y,z in mm, turn as axis times angle "
        "in degrees",
        parse=_six,
        metavar="X,Y,Z,RX,RY,RZ",
    )

    def run(self) -> Exit:
        wish = self.wish()
        root, name = library_root(wish), object_named(self.what)
        if name is None:
            scan_in(wish, self.what)
        self._check(root)
        stored = None if name is None else self.solved(wish, name)[1]
        compile_kernels()
        from appliance.desk import compare, errors_of, figures_of, write_comparison

        with ProgressLine() as progress:
            nominal = self._nominal_surface(root, wish, progress)
            surface, about = self._surface(root, stored, wish, progress)
            progress(f"laying it onto {nominal.name}")
            found = compare(surface, nominal, self.limit, self._start(), None if stored is None else errors_of(stored))
            for out in map(Path, self.out):
                progress(f"writing {out}")
                with writing(out):
                    write_comparison(out, found, about, self.tolerance, stored)
        figures = figures_of(found, self.tolerance)
        summary = found.deviation.summary
        counts = f"{summary.beyond} of them farther than {self.limit:g} mm, {summary.beside} beside an open border"
        lines = [f"{about.title} against {nominal.name}: {summary.points} points, {counts}"]
        if summary.rms_mm is not None:
            lines.append(
                f"deviation: mean {summary.mean_mm:+.3f}, RMS {summary.rms_mm:.3f}, {summary.least_mm:+.3f} to "
                f"{summary.most_mm:+.3f} mm"
            )
        if self.tolerance is not None:
            lines.append(f"out of ± {self.tolerance:g} mm: {figures['out_of_tolerance_percent']:.2f} %")
        self.tell(figures, [*lines, *(f"warning: {one}" for one in found.warnings)])
        return Exit.OK

    def _check(self, root: Path) -> None:
        """Raises ObjectError for an object under ``root`` that is not there, NominalError for a CAD model that is not,
        UsageError for files that cannot be written, and MissingLibraryError where what reads or writes them is absent:
        before minutes of work."""
        from appliance.base import require
        from appliance.desk import checked_drawing, read_object

        require("igl", "libigl", "a comparison")
        name = object_named(self.nominal)
        if name is not None:
            require("skimage.measure", "scikit-image", "the mesh of an object")
            read_object(root, name)
        elif checked_drawing(Path(self.nominal)) != ".stl":
            require("trimesh", "trimesh", "a CAD model")
        for out in map(Path, self.out):
            writable_as(out, "a comparison")

    def _start(self) -> Rigid | None:
        import numpy as np

        from appliance.measure import Rigid, rotation_matrix

        if self.start is None:
            return None
        return Rigid(rotation_matrix(np.radians(self.start[3:])), np.array(self.start[:3]))

    def _surface(
        self, root: Path, stored: StoredObject | None, wish: Wish, progress: ProgressLine
    ) -> tuple[FusedCloud, About]:
        """Return the points that are compared, of the object or of the scan."""
        import numpy as np

        from appliance.desk import CAMERA_FRAME, About, PlacedScan, about_object, fuse, organised_scan, surface_of

        if stored is not None:
            return surface_of(root, stored, wish, progress, self.spacing), about_object(stored)
        with opened_scans(wish, (self.what,)) as ((source,), _):
            made = organised_scan(source, source.calibration_for(wish), progress)
        # One scan has no other to be placed beside.
        placed = PlacedScan(made.cloud, np.eye(3), np.zeros(3), pose_sigma_mm=0.0)
        return fuse([placed], self.spacing), About(f"scan {source.scan.manifest.scan_id}", CAMERA_FRAME)

    def _nominal_surface(self, root: Path, wish: Wish, progress: ProgressLine) -> NominalSurface:
        """Return what is compared with. Raises NominalError, ObjectError."""
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

        name = object_named(self.nominal)
        if name is None:
            return NominalSurface(Path(self.nominal).name, read_nominal(Path(self.nominal)))
        other = read_object(root, name)
        # What the two are laid onto each other by, no error of the other's frame is left in.
        surface = laid_onto_something(surface_of(root, other, wish, progress, self.spacing), errors_of(other))
        mesh = mesh_of_surface(surface, max(VOXEL_MM, 2.0 * self.spacing))
        return NominalSurface(f"object {other.name}", nominal_of_mesh(mesh), mesh.sigma_mm)
