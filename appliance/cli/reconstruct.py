"""Owns the verbs ``reconstruct`` and ``scans merge``: clouds of stored scans, made again from their raw frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operand, option, switch
from appliance.cli.desk import measuring, scan_in, whole_scan, writable_cloud, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress
from appliance.cli.places import WithCalibration


@dataclass(frozen=True, slots=True, kw_only=True)
class Reconstruct(WithCalibration):
    """A stored scan's cloud from its raw frames; ``salvage``: of what is left of it."""

    scan: str = operand("SCAN", "its number or its folder")
    salvage: bool = switch("--salvage", "do without a damaged frame; the cloud says so")
    out: Path | None = option("--out", "write the cloud there (PLY)", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        wish = self.wish()
        writable_cloud(self.out)
        measuring(wish.calibration)
        with Progress() as progress:
            progress("comparing checksums")
            # Salvaging wants damaged scans, and looks for the damage by itself.
            folder = scan_in(wish, self.scan) if self.salvage else whole_scan(wish, self.scan)
            compile_kernels()
            from appliance.desk import reconstruct_scan, salvage
            from appliance.store import calibration_for, open_source

            salvaged = salvage(folder) if self.salvage else None
            source = open_source(folder, wish, None if salvaged is None else salvaged.scan)
            chosen = calibration_for(source, wish)
            # The name that the cloud gets without --out, too, so that an error speaks of that file.
            with writing(self.out or Path(f"{folder.name}.ply")):
                report = reconstruct_scan(source, chosen, self.out, progress, salvaged)
        say_report(report, as_json=self.json)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeScans(WithCalibration):
    """One cloud of two stored scans with different exposures."""

    first: str = operand("SCAN", "its number or its folder")
    second: str = operand("SCAN", "the other one; their order does not matter")
    out: Path | None = option("--out", "default: NUMBER+NUMBER.ply here", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        wish = self.wish()
        writable_cloud(self.out)
        measuring(wish.calibration)
        with Progress() as progress:
            progress("comparing checksums")
            for scan in (self.first, self.second):
                scan_in(wish, scan)  # both, before every byte of one is read
            first, second = (whole_scan(wish, scan) for scan in (self.first, self.second))
            compile_kernels()
            from appliance.desk import merge_scans
            from appliance.store import instrument_of, one_calibration, open_source

            sources = (open_source(first, wish), open_source(second, wish))
            instrument_of(sources, wish)  # refuses two
            chosen = one_calibration(sources, wish)
            with writing(self.out or Path(f"{first.name}+{second.name}.ply")):
                report = merge_scans(sources, chosen, self.out, progress)
        say_report(report, as_json=self.json)
        return Exit.OK
