"""Owns the way from a stored scan of an artefact to a recording that calibrates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from appliance.calibration.extract import CALIBRATING_GAP_MM, Certificate, extract
from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording
from appliance.evaluation.points import NotFound
from appliance.reconstruct.quality import QualityLimits
from appliance.service.desk import decoded_cloud_of
from appliance.storage import scan as stored


def recording_of_scan(
    folder: Path, certificate: Certificate | None, start: Calibration, progress: Callable[[str], None]
) -> Recording | NotFound:
    """The recording of a stored scan: of a ball bar with its certificate, of a plane with ``None``.

    ``start`` has the lenses and pose of the calibration in air and the ports as drawn. The water is the scan's. The
    answer is ``NotFound`` with the reason in words where the artefact is not seen well enough. Raises ScanError.
    """
    scan = stored.load(folder)
    pipeline, cloud, water = decoded_cloud_of(scan, start, progress, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM))
    progress("looking for the artefact")
    left, right = pipeline.decoded("left"), pipeline.decoded("right")
    return extract(scan.manifest.scan_id, certificate, cloud, left, right, start, water)
