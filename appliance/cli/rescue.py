"""Owns the verb ``rescue``: an unchecked cloud of what was recorded of a scan that broke."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operand, option
from appliance.cli.desk import library_root, measuring, writable_cloud, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress
from appliance.cli.places import WithCalibration, scan_folder
from appliance.store import find_incomplete, load_incomplete


@dataclass(frozen=True, slots=True, kw_only=True)
class Rescue(WithCalibration):
    """Make a cloud of an incomplete recording: to be looked at, and nothing to be measured in."""

    recording: str = operand("RECORDING", "its number under ROOT/incomplete, or its folder")
    out: Path | None = option("--out", "write the cloud there (PLY)", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        wish = self.wish()
        writable_cloud(self.out)
        measuring(wish.calibration)
        with Progress() as progress:
            progress("comparing checksums")
            folder = scan_folder(self.recording) or find_incomplete(library_root(wish), self.recording)
            recording = load_incomplete(folder)
            compile_kernels()
            from appliance.desk import rescue_recording
            from appliance.store import calibration_for, open_source

            source = open_source(folder, wish, recording.scan)
            chosen = calibration_for(source, wish)
            with writing(self.out or Path(f"incomplete-{folder.name}.ply")):
                report = rescue_recording(recording, source, chosen, self.out, progress)
        say_report(report, as_json=self.json)
        return Exit.OK
