"""Calibration in water from a list of scans: reconstruct each, extract its recording, adjust all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from appliance import __version__
from appliance.base import Progress, part_of
from appliance.calibrate.stored_recordings import cameras_of, recording_of_scan
from appliance.calibrate.water import report
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.extract import BarCertificate
from appliance.calibrate.water.method import Method, WaterResult
from appliance.measure import Artefact, Calibration, NotFound
from appliance.store import ListedScan, ListError, Rig, ScanList, SourceScan

RECONSTRUCTED = 0.8
"""Share of the progress for reconstructing the scans."""


@dataclass(frozen=True, slots=True, eq=False)
class WaterCalibration:
    """Result of a calibration from a list of recordings."""

    result: WaterResult
    start: Calibration
    facts: Mapping[str, Any]
    """Operator, serials, version and dates, JSON-ready."""
    left_out: Mapping[str, str]
    """Scans whose artefact was not found, with the reason in words."""

    def as_json(self) -> dict[str, Any]:
        """Return the report for programs."""
        return report.as_json(self.result, self.start, self.facts, self.left_out)

    def as_html(self) -> str:
        """Return the report for people."""
        return report.as_html(self.result, self.start, self.facts, self.left_out)


def check_list(listed: ScanList) -> None:
    """Raise ListError for an artefact that cannot calibrate, before any work is done."""
    for entry in listed.entries:
        if entry.artefact is Artefact.FRUSTUM:
            raise ListError(
                f"scan {entry.scan} shows a frustum, which is for evaluation only; allowed are ball bars "
                "and planes; remove it from the list"
            )


def run_water_calibration(
    rig: Rig,
    listed: ScanList,
    sources: Sequence[SourceScan],
    start: Calibration,
    method: Method,
    made_at: str,
    progress: Progress,
) -> WaterCalibration:
    """Reconstruct every scan of the list and calibrate.

    ``sources`` are the scans in the order of the list, with whole raw frames. ``made_at`` is the date for the file, ISO
    8601. Raises ListError, ScanError, RecordingError.
    """
    check_list(listed)
    serials = cameras_of([source.scan.folder for source in sources], start)
    recordings, left_out = [], {}
    for k, (entry, source) in enumerate(zip(listed.entries, sources, strict=True)):
        folder = source.scan.folder
        begin, end = (RECONSTRUCTED * number / len(sources) for number in (k, k + 1))
        step = part_of(progress, begin, end, folder.name)
        recording = recording_of_scan(folder, _certificate(entry), start, source.rig, step)
        if isinstance(recording, NotFound):
            left_out[folder.name] = recording.reason
        else:
            recordings.append(recording)
    # Reported, because a calibration from recordings in different water relies on the formula of the index.
    waters = {(r.water.temperature_c, r.water.salinity_psu) for r in recordings}
    result = calibrate(method, recordings, start, part_of(progress, RECONSTRUCTED, 1.0))
    # The solver does not know the date and the cameras, which belong to the file.
    calibration, *before = (
        replace(solved, made_at=made_at, camera_serials=serials)
        for solved in (result.calibration, *result.before.values())
    )
    result = replace(result, calibration=calibration, before=dict(zip(result.before, before, strict=True)))
    facts = {
        "operator": listed.operator,
        "rig_serial": rig.rig.serial,
        "made_at": made_at,
        "software_version": __version__,
        "waters": len(waters),
        "artefact_serials": ", ".join(sorted({e.serial for e in listed.entries if e.serial is not None})) or None,
    }
    return WaterCalibration(result, start, facts, left_out)


def _certificate(entry: ListedScan) -> BarCertificate | None:
    if entry.artefact is Artefact.PLANE:
        return None
    # A number that the certificate does not state keeps the usual standard uncertainty of such a bar.
    usual = BarCertificate(entry.calibrated_mm["length"], radius_mm=entry.radius_mm)
    stated = {"length_sd_mm": entry.length_sd_mm, "radius_sd_mm": entry.radius_sd_mm}
    return replace(usual, **{name: value for name, value in stated.items() if value is not None})
