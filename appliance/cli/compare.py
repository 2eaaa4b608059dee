"""The verb ``compare``: deviations of a scan or an object from its nominal surface."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import number, operand, option, repeated
from appliance.cli.desk import (
    WithObjects,
    check_writable_as,
    find_scan,
    library_root,
    object_name,
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
            f"{text}: allowed are six numbers with commas: x,y,z in mm and the rotation vector in degrees"
        )
    return values


@dataclass(frozen=True, slots=True, kw_only=True)
class Compare(WithObjects):
    """Measure the deviations of a scan or a solved object from a CAD model or another object."""

    what: str = operand("WHAT", "a scan, by its number or folder, or object:NAME")
    nominal: str = operand("NOMINAL", "a CAD model in mm (.stl .obj .ply), or object:NAME")
    out: tuple[str, ...] = repeated(
        "--out",
        "points with their deviation, in the CAD model's frame (.ply .e57 .las), or a page with map and histogram "
        "(.html); may be repeated",
        metavar="FILE",
    )
    tolerance: float | None = option(
        "--tolerance", "tolerance in mm: larger deviations are counted", parse=number(0.001, 100.0, "mm"), metavar="MM"
    )
    limit: float = option(
        "--limit",
        "largest distance in mm at which a point belongs to the CAD model (5)",
        default=5.0,
        parse=number(0.1, 100.0, "mm"),
        metavar="MM",
    )
    start: tuple[float, ...] | None = option(
        "--start",
        "approximate pose in the CAD model's frame, instead of a search: x,y,z in mm, rotation vector in degrees",
        parse=_six,
        metavar="X,Y,Z,RX,RY,RZ",
    )

    def run(self) -> Exit:
        options = self.scan_options()
        root, name = library_root(options), object_name(self.what)
        if name is None:
            find_scan(options, self.what)
        nominal = self._nominal(root)
        subject = find_scan(options, self.what) if name is None else self.solved(options, name)[1]
        compile_kernels()
        from appliance.desk import compare_stored

        with ProgressLine() as progress:
            compared = compare_stored(
                root,
                subject,
                nominal,
                options,
                progress,
                spacing_mm=self.spacing,
                limit_mm=self.limit,
                start=self.start,
            )
            for out in map(Path, self.out):
                progress(f"writing {out}")
                with writing(out):
                    compared.write(out, self.tolerance)
        title, figures = compared.metadata.title, compared.figures(self.tolerance)
        counts = (
            f"{figures['beyond_limit']} of them farther than {self.limit:g} mm, "
            f"{figures['beside_border']} beside an open border"
        )
        lines = [f"{title} against {figures['nominal']}: {figures['points']} points, {counts}"]
        if figures["rms_mm"] is not None:
            lines.append(
                f"deviation: mean {figures['mean_mm']:+.3f}, RMS {figures['rms_mm']:.3f}, {figures['least_mm']:+.3f} "
                "to "
                f"{figures['most_mm']:+.3f} mm"
            )
        if self.tolerance is not None:
            lines.append(f"out of ± {self.tolerance:g} mm: {figures['out_of_tolerance_percent']:.2f} %")
        self.tell(figures, [*lines, *(f"warning: {text}" for text in figures["warnings"])])
        return Exit.OK

    def _nominal(self, root: Path) -> Path | StoredObject:
        """Return the nominal surface, after checks of all inputs that could fail after minutes of work.

        Raises ObjectError for an unknown object under ``root``, NominalError for a CAD model that cannot be read,
        UsageError for files that cannot be written, MissingLibraryError for a library that they need.
        """
        from appliance.base import require
        from appliance.desk import check_drawing, read_object

        require("igl", "libigl", "a comparison")
        name = object_name(self.nominal)
        nominal: Path | StoredObject = Path(self.nominal)
        if name is not None:
            require("skimage.measure", "scikit-image", "the mesh of an object")
            nominal = read_object(root, name)
        elif check_drawing(Path(self.nominal)) != ".stl":
            require("trimesh", "trimesh", "a CAD model")
        for out in map(Path, self.out):
            check_writable_as(out, "a comparison")
        return nominal
