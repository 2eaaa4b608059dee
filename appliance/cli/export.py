"""Owns the verb ``export``: stored scans as files that other programs read, one each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operands, option, switch
from appliance.cli.desk import measuring, scan_in, whole_scan, writable, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress, UsageError, say_json
from appliance.cli.places import WithCalibration

NAME = "{}"
"""Stands for the scan's name in ``--out``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Export(WithCalibration):
    """Points or meshes of stored scans, one file each, made from their raw frames as ``reconstruct`` does."""

    scans: Sequence[str] = operands("SCAN", "numbers or folders", at_least_one=True)
    mesh: bool = switch("--mesh", "triangles instead of points: .ply .stl .obj")
    out: str = option(
        "--out",
        "points: .ply .e57 .las .npz; {} stands for the scan's name, and must where there are many (default: {}.ply)",
        default=f"{NAME}.ply",
        parse=str,
        metavar="FILE",
    )

    def run(self) -> Exit:
        from appliance.desk import MESH_SUFFIXES, SCAN_SUFFIXES, ExportError, checked_suffix

        wish = self.wish()
        # Before minutes of work, and as what it is: a word that was typed wrong.
        try:
            checked_suffix(
                Path(self.out), MESH_SUFFIXES if self.mesh else SCAN_SUFFIXES, "a mesh" if self.mesh else "a scan"
            )
        except ExportError as error:
            raise UsageError(f"--out {error}") from error
        if len(self.scans) > 1 and NAME not in self.out:
            path = Path(self.out)
            raise UsageError(
                f"--out {self.out}: is one file, for {len(self.scans)} scans; put {NAME} where the scan's name "
                f"belongs, for example --out '{path.with_name(f'{path.stem}-{NAME}{path.suffix}')}'"
            )
        measuring(wish.calibration)
        outs: dict[Path, str] = {}
        for scan in self.scans:
            out = Path(self.out.replace(NAME, scan_in(wish, scan).name))
            writable(out)
            if out in outs:
                raise UsageError(f"{outs[out]} and {scan}: both would be written to {out}; export them one by one")
            outs[out] = scan
        reports = []
        with Progress() as progress:
            for number, (out, scan) in enumerate(outs.items(), 1):
                progress(f"comparing checksums ({number} of {len(outs)})")
                folder = whole_scan(wish, scan)
                compile_kernels()
                from appliance.desk import export_scan
                from appliance.store import calibration_for, open_source

                source = open_source(folder, wish)
                with writing(out):
                    chosen = calibration_for(source, wish)
                    reports.append(export_scan(source, chosen, out, progress, mesh=self.mesh))
        if self.json and len(reports) > 1:
            say_json(reports)
            return Exit.OK
        for report in reports:
            say_report(report, as_json=self.json)
        return Exit.OK
