"""Extraction of a recording for a calibration from a stored scan of an artefact."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from appliance.base import Progress
from appliance.calibrate.recordings import CamerasDiffer, Recording
from appliance.calibrate.water.extract import CALIBRATING_GAP_MM, BarCertificate, extract
from appliance.measure import Calibration, NotFound, QualityLimits, exchanged
from appliance.store import RIG_FILE, ConfigError, Instrument, Rig, ScanError, StoredScan, load_rig, reprocess_scan


def cameras_of(folders: Iterable[Path], start: Calibration) -> tuple[str, str] | None:
    """Return the serial numbers of the left and right camera that recorded these scans; ``None`` for no scan.

    Raises CamerasDiffer where scans are of different cameras, or ``start`` is of others, CalibrationError or ScanError
    for a scan whose rig file cannot be read.
    """
    serials: tuple[str, str] | None = None
    earlier: Path | None = None
    for folder in folders:
        current = _cameras(folder)
        if serials is not None and earlier is not None and (conflict := exchanged(serials, current)) is not None:
            raise CamerasDiffer(
                f"scans {earlier.name} and {folder.name} are of different cameras ({conflict.reason}); "
                "calibrate with scans of one stereo pair of cameras"
            )
        serials, earlier = current, folder
    # Checked last, so that scans that disagree with each other are named first: that is the more likely cause.
    mismatch = exchanged(start.camera_serials, serials)
    if mismatch is not None:
        raise CamerasDiffer(
            f"the scans are of other cameras than the start ({mismatch.reason}); calibrate in air again"
        )
    return serials


def _cameras(folder: Path) -> tuple[str, str]:
    """Return the serial numbers in the rig file that a scan carries."""
    try:
        camera = load_rig(folder / RIG_FILE).camera
    except ConfigError as error:
        raise ScanError(f"{folder}: {error}") from error
    return camera.left.serial, camera.right.serial


def recording_of_scan(
    folder: Path, certificate: BarCertificate | None, start: Calibration, rig: Rig, progress: Progress
) -> Recording | NotFound:
    """Return the recording of a stored scan: of a ball bar with its certificate, of a plane with ``None``.

    ``start`` has lenses and pose of the air calibration and nominal ports. The water is that of the scan. Returns
    ``NotFound`` with the reason in words where too little of the artefact is visible. Raises ScanError.
    """
    scan = StoredScan.load(folder, only_raw=True)
    settings = Instrument(rig).settings_of_scan(scan.manifest.record)
    # The ports are still nominal. The instrument's own limit of the ray gap would remove just those pixels that can
    # correct them.
    reprocessed = reprocess_scan(scan, start, settings, progress, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM))
    if reprocessed.unfit is not None:
        return NotFound(f"{reprocessed.unfit.code.value}: {reprocessed.unfit.detail}; record it again")
    progress("detecting the artefact")
    left, right = reprocessed.pipeline.decoded("left"), reprocessed.pipeline.decoded("right")
    return extract(scan.manifest.scan_id, certificate, reprocessed.cloud, left, right, start, reprocessed.water)
