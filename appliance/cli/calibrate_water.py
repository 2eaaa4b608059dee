"""The verb ``calibration water``: a calibration from stored scans in water."""

from __future__ import annotations

import json as json_form
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from appliance.base import part_of
from appliance.calibrate import BEFORE_OPERATOR, Method
from appliance.cli.arguments import operand, option, path_option, switch
from appliance.cli.desk import check_writable, open_scans, scan_in_list, write_files
from appliance.cli.output import Exit, UsageError
from appliance.cli.places import WithRoot
from appliance.store import hold_lock

DEFAULT_OUT = Path("calibration-water.json")
SCANS_CHECKED = 0.1
"""Share of the progress for comparing checksums."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateWater(WithRoot):
    """Calibrate from the list's scans; FAILED if an artefact was not found, after all else was done without it."""

    list: Path = operand("LIST", "the list of scans and their artefacts, as for evaluate", parse=Path)
    method: str = option(
        "--method",
        "paper: as published, for comparison; it also writes its pinholes FILE-pm.json and its ports FILE-rm.json; "
        "default: %(default)s",
        default=Method.SPLINE.value,
        choices=[m.value for m in Method],
    )
    calibration: Path | None = path_option(
        "--calibration", "the calibration to start from (default: the instrument's air calibration)"
    )
    out: Path | None = path_option("--out", "the calibration; beside it FILE-report.html and .json")
    install: bool = switch("--install", "use it from now on; the former one is kept")

    def run(self) -> Exit:
        options = self.scan_options()
        method = Method(self.method)
        target = self.out or DEFAULT_OUT
        page, data = (target.with_name(f"{target.stem}-report{ending}") for ending in (".html", ".json"))
        # Arguments are checked before the checksums, which take seconds per scan.
        before = BEFORE_OPERATOR if method is Method.PAPER else ()
        targets = {name: target.with_name(f"{target.stem}-{name}.json") for name in before}
        for path in (target, page, data, *targets.values()):
            check_writable(path)
        for path in (target, *targets.values()):
            if path.exists():
                raise UsageError(
                    f"--out {target}: {path} exists already; a calibration is never replaced; give a new name"
                )
        if data.absolute() == self.list.absolute():
            raise UsageError(f"--out {target}: {data} is the list of scans; give another name")
        from appliance.store import ScanList

        scans = ScanList.read(self.list)
        places = [scan_in_list(self.list, entry.scan) for entry in scans.entries]
        made_at = datetime.now(UTC).isoformat(timespec="seconds")

        def check() -> None:
            from appliance.calibrate import check_list

            check_list(scans)

        with open_scans(options, places, SCANS_CHECKED, check) as (sources, progress):
            from appliance.calibrate import Calibrations, reject_nominal_start, run_water_calibration, start_of
            from appliance.measure import encode_calibration
            from appliance.store import SourceScan

            rig = SourceScan.instrument_of(sources, options)
            reject_nominal_start(rig, self.calibration)
            start = start_of(rig, self.calibration)
            for source in sources:
                source.refuse_misfit(start, f"start {self.calibration or rig.storage.root}", foreign=False, start=True)

            step = part_of(progress, SCANS_CHECKED, 1.0)
            water_calibration = run_water_calibration(rig, scans, sources, start, method, made_at, step)
        content = water_calibration.as_json()
        text = json_form.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        files = {page: water_calibration.as_html().encode(), data: text.encode()}
        for name, path in targets.items():
            files[path] = encode_calibration(water_calibration.result.before[name])
        files[target] = encode_calibration(water_calibration.result.calibration)
        # The calibration is written last, so that an existing one always has its report.
        write_files(files)
        # Without one of its scans it may be a good calibration, but not the requested one: a person has to decide.
        installed = self.install and not water_calibration.left_out
        if installed:
            with hold_lock(rig.storage.root):
                Calibrations(rig.storage.root, rig.rig.serial).install(
                    water_calibration.result.calibration, made_at[:10]
                )
        lines = _lines(content, page, target)
        if self.install:
            lines.append(
                "installed; `kingfisher calibration use` undoes it" if installed else "not installed: scans are missing"
            )
        self.tell({**content, "installed": installed}, lines)
        return Exit.FAILED if water_calibration.left_out else Exit.OK


def _lines(content: dict[str, Any], page: Path, calibration: Path) -> list[str]:
    numbers = ("residual_px", "systematic_px", "expected_length_percent", "expected_flat_percent")
    ports = {side: port["after"] for side, port in content["ports"].items()}
    return [
        *(f"{scan} not used: {reason}" for scan, reason in content["left_out"].items()),
        *(f"warning: {warning}" for warning in content["warnings"]),
        *(
            f"{recording['name']:<24} {recording['points']} points, {recording['residual_px']:.4f} px"
            for recording in content["recordings"]
        ),
        *(f"{key:<24} {'-' if content[key] is None else f'{content[key]:.4f}'}" for key in numbers),
        *(
            f"{side + ' port':<24} d {port['distance_mm']:.3f} mm, tilt {port['tilt_x_deg']:+.3f}° "
            f"{port['tilt_y_deg']:+.3f}°"
            for side, port in ports.items()
        ),
        *([f"{'not observable':<24} {', '.join(content['unobserved'])}"] if content["unobserved"] else []),
        f"{'report':<24} {page}",
        f"{'calibration':<24} {calibration}",
    ]
