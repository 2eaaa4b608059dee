"""Owns the verbs ``measure``: what a stored scan says about the instrument itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from appliance.cli.arguments import operand, operands, option, switch
from appliance.cli.desk import scan_in, whole_scan, writable, writing
from appliance.cli.kernels import compile_kernels
from appliance.cli.listing import say_report
from appliance.cli.output import Exit, Progress, UsageError, say, say_json, table
from appliance.cli.places import WithRoot
from appliance.measure import of_side
from appliance.store import LocalFileSystem, ScanError, make_folders, replace_file

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
        _never_replaced(self.out)
        scan_in(wish, self.scan)
        compile_kernels()
        from appliance.calibrate import ResponseError
        from appliance.desk import response_of_scan
        from appliance.measure import RESPONSE
        from appliance.store import Instrument, instrument_of, open_source

        with Progress() as progress:
            progress("comparing checksums")
            source = open_source(whole_scan(wish, self.scan), wish)
            folder, rig = source.scan.folder, instrument_of((source,), wish)
            path = self.out or Instrument(rig).response_file
            _never_replaced(path)  # once more: the default place is known only now
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
            make_folders(LocalFileSystem(), path.parent)
            replace_file(LocalFileSystem(), path, RESPONSE.encode(found))
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
    """Each camera's noise in a scan, beside what was expected of it. ``--install`` never replaces a file."""

    scan: str = operand("SCAN", "its number or its folder")
    install: bool = switch("--install", "expect it of this instrument's points from its next start on")

    def run(self) -> Exit:
        wish = self.wish()
        scan_in(wish, self.scan)
        compile_kernels()
        from appliance.calibrate import NoiseError
        from appliance.desk import noise_of_scan, noise_to_store
        from appliance.measure import NOISE
        from appliance.store import Instrument, instrument_of, open_source

        with Progress() as progress:
            progress("comparing checksums")
            source = open_source(whole_scan(wish, self.scan), wish)
            folder, rig = source.scan.folder, instrument_of((source,), wish)
            path = Instrument(rig).noise_file
            if self.install:
                _never_replaced(path, "--install", "the cameras' noise")
                _root_there(rig.storage.root)
            progress("comparing sine images")
            try:
                found = noise_of_scan(source.rig, folder)
                to_store = noise_to_store(rig, folder, found)
            except NoiseError as error:
                raise ScanError(f"{folder}: {error}") from error
        if self.install:
            with writing(path):
                make_folders(LocalFileSystem(), path.parent)
                replace_file(LocalFileSystem(), path, NOISE.encode(to_store))
        report: dict[str, dict[str, float]] = {}
        for side, (measured, expected) in found.items():
            light_dn, variance_dn2 = measured.variance_at_dn2
            figures = of_side(to_store.cameras, side)
            report[side] = {
                "light_dn": light_dn,
                "noise_dn": math.sqrt(variance_dn2),
                "expected_dn": math.sqrt(expected.variance_dn2(light_dn)),
                "electrons_at_255": measured.full_well_e,
                "expected_electrons_at_255": LEVELS / expected.dn_per_e,
                "full_well_e": figures.full_well_e,
                "read_noise_e": figures.read_noise_e,
                "black_level_dn": figures.black_level_dn,
                "pixels": measured.pixels,
            }
        if self.json:
            say_json(report)
        else:
            names = list(report["left"])
            # One row for each figure: as columns they are wider than a terminal.
            say(table(("", *report), [(n, *(f"{said[n]:.5g}" for said in report.values())) for n in names]))
            if self.install:
                say(f"installed: {path}")
        return Exit.OK


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureExposures(WithRoot):
    """Tell which exposures leave this projector's fringes straight, from a scan at each; FAILED where none does."""

    scans: Sequence[str] = operands(
        "SCAN", "numbers or folders: a surface that fills the image, each with another exposure", at_least_one=True
    )

    def run(self) -> Exit:
        wish = self.wish()
        for scan in self.scans:
            scan_in(wish, scan)
        compile_kernels()
        from appliance.desk import exposure_found
        from appliance.store import instrument_of, open_source

        with Progress() as progress:
            sources = []
            for number, scan in enumerate(self.scans):
                progress("comparing checksums", number / len(self.scans))
                sources.append(open_source(whole_scan(wish, scan), wish))
            instrument_of(sources, wish)  # refuses scans of several instruments
            found = []
            for number, source in enumerate(sources):
                progress("decoding", number / len(sources))
                found.append(exposure_found(source))
        delays_us = sorted({one.trigger_delay_us for one in found})
        if len(delays_us) > 1:
            raise ScanError(
                f"{', '.join(self.scans)}: taken with trigger delays of {' and '.join(map(str, delays_us))} us; an exposure sees other "
                "bits where it begins at another moment; give scans of one board.trigger_delay_us"
            )
        # An exposure is as good as its worst scan.
        times_ms = {one.exposure.time_us / 1000.0: True for one in found}
        for one in found:
            times_ms[one.exposure.time_us / 1000.0] &= one.straight
        straight_ms = sorted(time for time, good in times_ms.items() if good)
        rows = [
            {
                "scan": one.scan_id,
                "exposure_ms": one.exposure.time_us / 1000.0,
                "gain_db": one.exposure.gain_db,
                "bend_px": one.bend_px,
                "noise_px": one.noise_px,
                "noisier": one.noisier,
                "straight": one.straight,
            }
            for one in sorted(found, key=lambda one: one.exposure.time_us)
        ]
        if self.json:
            say_json({"trigger_delay_us": delays_us[0], "exposures_ms": straight_ms, "scans": rows})
        else:
            names = list(rows[0])
            say(table([n.upper().replace("_", " ") for n in names], [[_shown(row[n]) for n in names] for row in rows]))
            if straight_ms:
                say(f"for [scan] of the rig file: exposures_ms = {straight_ms}")
            else:
                say("none of them leaves fringes straight; try longer ones")
        return Exit.OK if straight_ms else Exit.FAILED


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _never_replaced(path: Path | None, option: str = "--out", what: str = "a response") -> None:
    if path is not None and path.exists():
        remedy = "move it away, or give a new name" if option == "--out" else "move it away"
        raise UsageError(f"{option} {path}: exists already; {what} is never replaced; {remedy}")


def _root_there(root: Path) -> None:
    # Missing folders below it are made: a root that was mistyped would become a new instrument's without a word.
    if not root.is_dir():
        raise UsageError(f"--root {root}: no such folder; give the instrument's")
