"""Owns the verb ``export``: a stored scan as a file that other programs read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operand, option, switch
from appliance.cli.desk import measuring, whole_scan, writable, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress, UsageError
from appliance.cli.places import WithCalibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Export(WithCalibration):
    """A stored scan's points or mesh, made from its raw frames as ``reconstruct`` does."""

    scan: str = operand("SCAN", "its number or its folder")
    mesh: bool = switch("--mesh", "triangles instead of points: .ply .stl .obj")
    out: Path | None = option(
        "--out", "points: .ply .e57 .las .npz (default: NAME.ply here)", parse=Path, metavar="FILE"
    )

    def run(self) -> Exit:
        from appliance.export.suffixes import MESH_SUFFIXES, SCAN_SUFFIXES, ExportError, checked_suffix

        wish = self.wish()
        writable(self.out)
        if self.out is not None:
            # Before minutes of work, and as what it is: a word that was typed wrong.
            try:
                checked_suffix(
                    self.out, MESH_SUFFIXES if self.mesh else SCAN_SUFFIXES, "a mesh" if self.mesh else "a scan"
                )
            except ExportError as error:
                raise UsageError(f"--out {error}") from error
        measuring(wish.calibration)
        with Progress() as progress:
            progress("comparing checksums")
            folder = whole_scan(wish, self.scan)
            compile_kernels()
            from appliance.offline.export import export_scan
            from appliance.offline.origin import calibration_for, open_source

            source = open_source(folder, wish)
            out = self.out or Path(f"{folder.name}.ply")
            with writing(out):
                report = export_scan(source, calibration_for(source, wish), out, progress, mesh=self.mesh)
        say_report(report, as_json=self.json)
        return Exit.OK
