"""Owns the way from a stored scan of an artefact to a recording that calibrates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from appliance.calibration.extract import CALIBRATING_GAP_MM, Certificate, extract
from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording
from appliance.config import Rig
from appliance.evaluation.points import NotFound
from appliance.reconstruct.quality import QualityLimits
from appliance.service.desk import rework
from appliance.service.instrument import taking_of_scan
from appliance.storage import scan as stored


def recording_of_scan(
    folder: Path, certificate: Certificate | None, start: Calibration, rig: Rig, progress: Callable[[str], None]
) -> Recording | NotFound:
    """The recording of a stored scan: of a ball bar with its certificate, of a plane with ``None``.

    ``start`` has the lenses and pose of the calibration in air and the ports as drawn. The water is the scan's. The
    answer is ``NotFound`` with the reason in words where the artefact is not seen well enough. Raises ScanError.
    """
    scan = stored.load(folder)
    taking = taking_of_scan(scan.manifest.record, rig)
    reworked = rework(scan, start, taking, progress, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM))
    if reworked.unfit is not None:
        return NotFound(f"{reworked.unfit.code.value}: {reworked.unfit.detail}; record it again")
    progress("looking for the artefact")
    left, right = reworked.pipeline.decoded("left"), reworked.pipeline.decoded("right")
    return extract(scan.manifest.scan_id, certificate, reworked.cloud, left, right, start, reworked.water)
