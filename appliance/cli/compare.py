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
    scan_in,
    writable_as,
    writing,
)
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, ProgressLine

if TYPE_CHECKING:
    from appliance.desk import StoredObject

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
        nominal = self._nominal(root)
        what = scan_in(wish, self.what) if name is None else self.solved(wish, name)[1]
        compile_kernels()
        from appliance.desk import compare_stored

        with ProgressLine() as progress:
            compared = compare_stored(
                root, what, nominal, wish, progress, spacing_mm=self.spacing, limit_mm=self.limit, start=self.start
            )
            for out in map(Path, self.out):
                progress(f"writing {out}")
                with writing(out):
                    compared.write(out, self.tolerance)
        title, found = compared.metadata.title, compared.figures(self.tolerance)
        counts = f"{found['beyond_limit']} of them farther than {self.limit:g} mm, {found['beside_border']} beside an open border"
        lines = [f"{title} against {found['nominal']}: {found['points']} points, {counts}"]
        if found["rms_mm"] is not None:
            lines.append(
                f"deviation: mean {found['mean_mm']:+.3f}, RMS {found['rms_mm']:.3f}, {found['least_mm']:+.3f} to "
                f"{found['most_mm']:+.3f} mm"
            )
        if self.tolerance is not None:
            lines.append(f"out of ± {self.tolerance:g} mm: {found['out_of_tolerance_percent']:.2f} %")
        self.tell(found, [*lines, *(f"warning: {one}" for one in found["warnings"])])
        return Exit.OK

    def _nominal(self, root: Path) -> Path | StoredObject:
        """Return what is compared with. Raises ObjectError for an object under ``root`` that is not there, NominalError
        for a CAD model that is not, UsageError for files that cannot be written, and MissingLibraryError where what
        reads or writes them is absent: before minutes of work."""
        from appliance.base import require
        from appliance.desk import check_drawing, read_object

        require("igl", "libigl", "a comparison")
        name = object_named(self.nominal)
        nominal: Path | StoredObject = Path(self.nominal)
        if name is not None:
            require("skimage.measure", "scikit-image", "the mesh of an object")
            nominal = read_object(root, name)
        elif check_drawing(Path(self.nominal)) != ".stl":
            require("trimesh", "trimesh", "a CAD model")
        for out in map(Path, self.out):
            writable_as(out, "a comparison")
        return nominal
