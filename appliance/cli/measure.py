"""The verb ``calibration measure``: noise, response and exposures of the instrument from stored scans."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import operand, operands, path_option, switch
from appliance.cli.desk import check_writable, open_scans, writing
from appliance.cli.output import Exit, ProgressLine, UsageError, table
from appliance.cli.places import WithRoot
from appliance.store import LocalFileSystem, ScanError

if TYPE_CHECKING:
    from appliance.store import ScanOptions, SourceScan

SHOWN_HARMONICS = 6
LEVELS = 255.0
NAMES = {"noise": "the cameras' noise", "response": "a response", "exposures": "the exposures"}


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureInstrument(WithRoot):
    """Measure noise of both cameras, the projector's response, or the usable exposures; a file is never replaced.

    Noise is compared with the data sheets. The response needs a scan of a plane. Exposures need a scan at each, and
    show which of them leave fringes straight (FAILED if none does).
    """

    what: str = operand("WHAT", ", ".join(NAMES), choices=tuple(NAMES))
    scans: Sequence[str] = operands(
        "SCAN",
        "number or folder of a scan; for exposures, several scans of a surface that fills the image",
        at_least_one=True,
    )
    install: bool = switch("--install", "use it on this instrument from its next start on", either="file")
    out: Path | None = path_option("--out", "write noise or response to a file", either="file")

    def run(self) -> Exit:
        options = self.scan_options()
        check_writable(self.out)
        if self.out is not None:
            self._refuse_replacing(self.out)
        if self.what == "exposures":
            if self.install or self.out is not None:
                raise UsageError(
                    "--install and --out: are for noise and response; leave them out, and copy exposures into the "
                    "rig file"
                )
        elif len(self.scans) > 1:
            raise UsageError(f"{' '.join(self.scans)}: the {self.what} is measured in one scan; give one")
        with open_scans(options, self.scans) as (sources, progress):
            match self.what:
                case "noise":
                    return self._noise(sources[0], options, progress)
                case "response":
                    return self._response(sources[0], options, progress)
                case _:
                    return self._exposures(sources, options, progress)

    def _noise(self, source: SourceScan, options: ScanOptions, progress: ProgressLine) -> Exit:
        from appliance.calibrate import NoiseError
        from appliance.desk import noise_of_scan, noise_to_store
        from appliance.measure import NOISE, of_side
        from appliance.store import Instrument, SourceScan

        folder, rig = source.scan.folder, SourceScan.instrument_of((source,), options)
        path = self._target(rig.storage.root, Instrument(rig).noise_file)
        progress("comparing sine images")
        try:
            noise = noise_of_scan(source.rig, folder)
            to_store = noise_to_store(rig, folder, noise)
        except NoiseError as error:
            raise ScanError(f"{folder}: {error}") from error
        _write(path, NOISE.encode(to_store))
        report: dict[str, dict[str, float]] = {}
        for side, (measured, expected) in noise.items():
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
        # One row for each figure, because columns would be wider than a terminal.
        rows = [(name, *(f"{figures[name]:.5g}" for figures in report.values())) for name in report["left"]]
        self.tell(report, [table(("", *report), rows), *([] if path is None else [f"written: {path}"])])
        return Exit.OK

    def _response(self, source: SourceScan, options: ScanOptions, progress: ProgressLine) -> Exit:
        from appliance.calibrate import ResponseError
        from appliance.desk import response_of_scan
        from appliance.measure import RESPONSE
        from appliance.store import Instrument, SourceScan

        folder, rig = source.scan.folder, SourceScan.instrument_of((source,), options)
        path = self._target(rig.storage.root, Instrument(rig).response_file)
        try:
            response_file, measured = response_of_scan(rig, folder, progress)
        except ResponseError as error:
            raise ScanError(f"{folder}: {error}") from error
        _write(path, RESPONSE.encode(response_file))
        fringes = measured.fringe_harmonics
        self.tell(
            {
                "file": None if path is None else str(path),
                "scan": response_file.made_from[0],
                "pixels": measured.pixels,
                "residual_percent": 100.0 * measured.residual,
                # Relative to the fundamental: order k of the fringe's Fourier series in percent, from the second on.
                "harmonics_percent": [100.0 * b / fringes[1] for b in fringes[2:SHOWN_HARMONICS]],
                "phase_error_deg": math.degrees(measured.phase_error_rad),
                "hash": response_file.response.hash,
            }
        )
        return Exit.OK

    def _exposures(self, sources: Sequence[SourceScan], options: ScanOptions, progress: ProgressLine) -> Exit:
        from appliance.desk import check_exposure
        from appliance.store import SourceScan

        SourceScan.instrument_of(sources, options)  # refuses scans of several instruments
        exposures = []
        for number, source in enumerate(sources):
            progress("decoding", number / len(sources))
            exposures.append(check_exposure(source))
        delays_us = sorted({item.trigger_delay_us for item in exposures})
        if len(delays_us) > 1:
            raise ScanError(
                f"{', '.join(self.scans)}: taken with trigger delays of {' and '.join(map(str, delays_us))} us; the "
                "delay decides which bits an exposure contains; give scans of one board.trigger_delay_us"
            )
        # An exposure is as good as its worst scan.
        times_ms = {item.exposure.time_us / 1000.0: True for item in exposures}
        for item in exposures:
            times_ms[item.exposure.time_us / 1000.0] &= item.straight
        straight_ms = sorted(time for time, good in times_ms.items() if good)
        rows: list[Mapping[str, object]] = [
            {
                "scan": item.scan_id,
                "exposure_ms": item.exposure.time_us / 1000.0,
                "gain_db": item.exposure.gain_db,
                "bend_px": item.bend_px,
                "noise_px": item.noise_px,
                "noisier": item.noisier,
                "straight": item.straight,
            }
            for item in sorted(exposures, key=lambda item: item.exposure.time_us)
        ]
        names = list(rows[0])
        end = f"for [scan] of the rig file: exposures_ms = {straight_ms}"
        self.tell(
            {"trigger_delay_us": delays_us[0], "exposures_ms": straight_ms, "scans": rows},
            [
                table(
                    [n.upper().replace("_", " ") for n in names],
                    [[_format_cell(row[n]) for n in names] for row in rows],
                ),
                end if straight_ms else "no exposure keeps the fringes sinusoidal; try longer ones",
            ],
        )
        return Exit.OK if straight_ms else Exit.FAILED

    def _target(self, root: Path, file: Path) -> Path | None:
        """Return the file to write, ``None`` for no file. Raises UsageError."""
        if not self.install:
            return self.out
        self._refuse_replacing(file)
        # Missing folders below it are made, so that a mistyped root would silently become that of a new instrument.
        if not root.is_dir():
            raise UsageError(f"--root {root}: no such folder; give the instrument's, or a file with --out FILE")
        return file

    def _refuse_replacing(self, path: Path) -> None:
        if path.exists():
            remedy = "move it away" if self.install else "move it away, or give a new name"
            raise UsageError(
                f"{'--install' if self.install else '--out'} {path}: exists already; {NAMES[self.what]} is never "
                f"replaced; {remedy}"
            )


def _write(path: Path | None, content: bytes) -> None:
    if path is not None:
        with writing(path):
            LocalFileSystem().make_folders(path.parent)
            LocalFileSystem().replace_file(path, content)


def _format_cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
