"""Owns the verbs ``measure``: what a stored scan says about the instrument itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operand, option
from appliance.cli.desk import whole_scan, writable, writing
from appliance.cli.kernels import compile_desk_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress, UsageError, say, say_json, table
from appliance.cli.places import WithRoot
from appliance.offline.origin import instrument_of, open_source
from appliance.storage.atomic import replace_file
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.scan import ScanError

SHOWN_HARMONICS = 6
LEVELS = 255.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureResponse(WithRoot):
    """The projector's response from a scan of a plane, written to its file. Never replaces one."""

    scan: str = operand("SCAN", "its number or its folder")
    out: Path | None = option("--out", "default: where the instrument looks for it", parse=Path, metavar="FILE")

    def run(self) -> Exit:
        wish = self.wish()
        writable(self.out)
        compile_desk_kernels()  # before anything brings compiled kernels
        from appliance.calibration.response.file import encode
        from appliance.calibration.response.measure import ResponseError
        from appliance.instrument import RESPONSE_FILE
        from appliance.offline.measuring import response_of_scan

        # Asked again below for the default place, which is known only once the scan has said of which instrument it is.
        _never_replaced(self.out)
        with Progress() as progress:
            progress("comparing checksums")
            source = open_source(whole_scan(wish, self.scan), wish)
            folder, rig = source.scan.folder, instrument_of((source,), wish)
            path = self.out or rig.storage.root / RESPONSE_FILE
            _never_replaced(path)
            # Below, missing folders are made: a root that was mistyped would become a new instrument's without a word.
            if not rig.storage.root.is_dir():
                raise UsageError(
                    f"--root {rig.storage.root}: no such folder; give the instrument's, or a file with --out FILE"
                )
            try:
                found, measured = response_of_scan(rig, folder, progress)
            except ResponseError as error:
                raise ScanError(f"{folder}: {error}") from error
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(LocalFileSystem(), path, encode(found))
        fringes = measured.fringe_harmonics
        report = {
            "file": str(path),
            "scan": found.made_from[0],
            "pixels": measured.pixels,
            "residual_percent": 100.0 * measured.residual,
            # Relative to the fundamental: order k of the fringe's Fourier series in percent, from the second on.
            "harmonics_percent": [100.0 * b / fringes[1] for b in fringes[2:SHOWN_HARMONICS]],
            "phase_error_deg": math.degrees(measured.phase_error_rad),
            "hash": found.response.hash,
        }
        say_report(report, as_json=self.json)
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureNoise(WithRoot):
    """Each camera's noise in a scan, beside what the rig file's data sheet makes expect."""

    scan: str = operand("SCAN", "its number or its folder")

    def run(self) -> Exit:
        wish = self.wish()
        compile_desk_kernels()  # before anything brings compiled kernels
        from appliance.calibration.photon_transfer import NoiseError
        from appliance.offline.measuring import noise_of_scan

        with Progress() as progress:
            progress("comparing checksums")
            source = open_source(whole_scan(wish, self.scan), wish)
            folder = source.scan.folder
            progress("comparing sine images")
            try:
                found = noise_of_scan(source.rig, folder)
            except NoiseError as error:
                raise ScanError(f"{folder}: {error}") from error
        report = {}
        for side, (measured, expected) in found.items():
            light_dn, variance_dn2 = measured.variance_at_dn2
            report[side] = {
                "light_dn": light_dn,
                "noise_dn": math.sqrt(variance_dn2),
                "expected_dn": math.sqrt(expected.variance_dn2(light_dn)),
                "electrons_at_255": measured.full_well_e,
                "expected_electrons_at_255": LEVELS / expected.dn_per_e,
                "pixels": measured.pixels,
            }
        if self.json:
            say_json(report)
        else:
            names = list(report["left"])
            say(
                table(("CAMERA", *names), [(side, *(f"{said[n]:.5g}" for n in names)) for side, said in report.items()])
            )
        return Exit.OK


def _never_replaced(path: Path | None) -> None:
    if path is not None and path.exists():
        raise UsageError(
            f"--out {path}: exists already; a response is never replaced; move it away, or give a new name"
        )
