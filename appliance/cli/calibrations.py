"""Owns the verbs ``calibration show`` and ``calibration nominal``: looking at calibrations, and the drawing's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operand, option
from appliance.cli.desk import writable, writing
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, UsageError, say, say_json
from appliance.cli.places import WithRoot
from appliance.store import CALIBRATIONS, CURRENT_CALIBRATION


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowCalibration(WithRoot):
    """The calibration in use, or that of a file."""

    file: Path | None = operand("FILE", None, parse=Path, optional=True)

    def run(self) -> Exit:
        rig, root, file = self.rooted_rig(), self.named_root(), self.file
        if file is None and root is not None and self.rig is None:
            # Whoever names a root asks for what lies there, whichever instrument the packaged rig file draws.
            file = root / CALIBRATIONS / CURRENT_CALIBRATION
        if file is not None:
            from appliance.store import load_calibration

            load_calibration(file)  # one that cannot be read is told before what describes it is loaded
        from appliance.calibrate import describe_calibration

        content = describe_calibration(rig, file)
        say_report(content, as_json=self.json)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalCalibration(WithRoot):
    """Write the calibration that follows from the rig file's design. Never replaces a file."""

    out: Path | None = option("--out", "default: beside the instrument's calibrations", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        rig = self.rooted_rig()
        writable(self.out)
        from appliance.calibrate import write_nominal_calibration
        from appliance.store import Instrument

        path = self.out or Instrument(rig).nominal_file
        if path.exists():
            raise UsageError(f"--out {path}: exists already; a calibration is never replaced; give a new name")
        with writing(path):
            write_nominal_calibration(rig, path)
        if self.json:
            say_json({"file": str(path)})
        else:
            say(str(path))
        return Exit.OK
