"""Owns the verbs that calibrate from stored scans in water, and the one that brings the calibration of before back."""

from __future__ import annotations

import json as json_form
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

from appliance.calibrate import BEFORE_OPERATOR, Method
from appliance.cli.arguments import operand, option, switch
from appliance.cli.desk import place_of, scan_in, whole_scan, writable, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit, Progress, UsageError, say, say_json
from appliance.cli.places import WithRoot
from appliance.store import LocalFileSystem, hold_lock, replace_file

DEFAULT_OUT = Path("calibration-water.json")
SCANS_CHECKED = 0.1
"""The part of the progress that comparing checksums gets."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateWater(WithRoot):
    """Calibrate from the list's scans; FAILED if an artefact was not found, after all else was done without it."""

    list: Path = operand("LIST", "which artefact each scan shows, as for evaluate", parse=Path)
    method: str = option(
        "--method",
        "paper as published, for comparison: beside FILE its pinholes FILE-pm.json and its ports FILE-rm.json; default: %(default)s",
        default=Method.SPLINE.value,
        choices=[m.value for m in Method],
    )
    start: Path | None = option("--start", "default: the instrument's calibration in air", parse=Path, metavar="FILE")
    out: Path | None = option(
        "--out", "the calibration; beside it FILE-report.html and .json", parse=Path, metavar="FILE"
    )
    install: bool = switch("--install", "use it from now on; the one of before is kept")

    def run(self) -> Exit:
        wish = self.wish()
        method = Method(self.method)
        target = self.out or DEFAULT_OUT
        page, data = (target.with_name(f"{target.stem}-report{ending}") for ending in (".html", ".json"))
        # All that can be refused is refused before the checksums are read: those alone take seconds per scan.
        before = BEFORE_OPERATOR if method is Method.PAPER else ()
        targets = {name: target.with_name(f"{target.stem}-{name}.json") for name in before}
        for path in (target, page, data, *targets.values()):
            writable(path)
        for path in (target, *targets.values()):
            if path.exists():
                raise UsageError(
                    f"--out {target}: {path} exists already; a calibration is never replaced; give a new name"
                )
        if data.absolute() == self.list.absolute():
            raise UsageError(f"--out {target}: {data} is the list itself; give another name")
        from appliance.store import read_list

        scans = read_list(self.list)
        for entry in scans.entries:  # a wrong number is told before minutes of compiling, and of comparing checksums
            scan_in(wish, place_of(self.list, entry.scan))
        compile_kernels()
        from appliance.calibrate import Calibrations, check_list, refuse_drawing, run_water_calibration, start_of
        from appliance.measure import encode_calibration
        from appliance.store import instrument_of, open_source, refuse_misfit

        check_list(scans)
        made_at = datetime.now(UTC).isoformat(timespec="seconds")
        with Progress() as progress:
            sources = []
            for k, entry in enumerate(scans.entries):
                progress(f"comparing checksums of {entry.scan}", SCANS_CHECKED * k / len(scans.entries))
                sources.append(open_source(whole_scan(wish, place_of(self.list, entry.scan)), wish))

            rig = instrument_of(sources, wish)
            refuse_drawing(rig, self.start)
            start = start_of(rig, self.start)
            for source in sources:
                refuse_misfit(start, f"start {self.start or rig.storage.root}", source, foreign=False, start=True)

            def step(what: str, part: float) -> None:
                progress(what, SCANS_CHECKED + (1.0 - SCANS_CHECKED) * part)

            made = run_water_calibration(rig, scans, sources, start, method, made_at, step)
        content = made.as_json()
        text = json_form.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        files = {page: made.as_html().encode(), data: text.encode()}
        for name, path in targets.items():
            files[path] = encode_calibration(made.result.before[name])
        files[target] = encode_calibration(made.result.calibration)
        # The report first, the calibration last: one that is there has its report beside it.
        for path, written in files.items():
            with writing(path):
                replace_file(LocalFileSystem(), path, written)
        # Made without one of its scans it may be a good calibration, but not the one that was asked for: a person has
        # to decide.
        installed = self.install and not made.left_out
        if installed:
            with hold_lock(rig.storage.root):
                Calibrations(rig.storage.root, rig.rig.serial).install(made.result.calibration, _day(made_at))
        if self.json:
            say_json({**content, "installed": installed})
        else:
            _tell(content, page, target)
            if self.install:
                say(
                    "installed; `kingfisher calibrate restore` undoes it"
                    if installed
                    else "not installed: scans are missing"
                )
        return Exit.FAILED if made.left_out else Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class RestoreCalibration(WithRoot):
    """Put a calibration of before in use again; what was in use is kept, so that the same verb undoes it."""

    kernels: ClassVar[bool] = False

    name: str | None = operand("NAME", "a file of calibration/kept (default: the last one)", optional=True)

    def run(self) -> Exit:
        rig = self.rooted_rig()
        from appliance.calibrate import Calibrations, SessionError
        from appliance.store import load_calibration

        now = datetime.now(UTC).isoformat(timespec="seconds")
        with hold_lock(rig.storage.root):
            try:
                path = Calibrations(rig.storage.root, rig.rig.serial).bring_back(self.name, _day(now))
            except SessionError as error:
                raise UsageError(f"calibrate restore: {error}") from error
        found = load_calibration(path)
        if self.json:
            say_json({"file": str(path), "calibration": found.hash, "method": found.method, "made_at": found.made_at})
        else:
            say(f"in use again: {path}, {found.method}, made {found.made_at}")
        return Exit.OK


def _day(moment: str) -> str:
    return moment[:10]


def _tell(content: dict[str, Any], page: Path, calibration: Path) -> None:
    for scan, reason in content["left_out"].items():
        say(f"{scan} not used: {reason}")
    for warning in content["warnings"]:
        say(f"warning: {warning}")
    for recording in content["recordings"]:
        say(f"{recording['name']:<24} {recording['points']} points, {recording['residual_px']:.4f} px")
    for key in ("residual_px", "systematic_px", "expected_length_percent", "expected_flat_percent"):
        value = content[key]
        say(f"{key:<24} {'-' if value is None else f'{value:.4f}'}")
    for side, port in content["ports"].items():
        after = port["after"]
        say(
            f"{side + ' port':<24} d {after['distance_mm']:.3f} mm, "
            f"tilt {after['tilt_x_deg']:+.3f}° {after['tilt_y_deg']:+.3f}°"
        )
    if content["unobserved"]:
        say(f"{'not seen':<24} {', '.join(content['unobserved'])}")
    say(f"{'report':<24} {page}")
    say(f"{'calibration':<24} {calibration}")
