"""Measurements of the instrument's response and noise from a stored scan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from appliance.base import Progress
from appliance.calibrate import (
    CameraImages,
    MeasuredNoise,
    MeasuredResponse,
    NoiseError,
    ResponseError,
    measure_noise,
    measure_response,
)
from appliance.measure import (
    LIMITS,
    SIDES,
    BothFigures,
    CameraDecoder,
    CameraNoise,
    Exposure,
    Response,
    StoredNoise,
    StoredResponse,
    measure_bend,
    of_side,
)
from appliance.store import Instrument, Rig, ScanError, SourceScan, StoredScan

MOST_NOISIER = 1.1
"""Largest factor by which the exposure of a scan may make points noisier; with usual projectors it is 1.01."""


def response_of_scan(rig: Rig, folder: Path, progress: Progress) -> tuple[StoredResponse, MeasuredResponse]:
    """Return the projector's response from the raw frames of a stored scan, for its file, and its details.

    Raises ScanError, ResponseError.
    """
    scan = StoredScan.load(folder, only_raw=True)
    record, sequence = scan.manifest.record, scan.sequence
    # A scan with patterns for a response shows its residual: only with that response are the codes known.
    drawn_for = _response_of_patterns(rig, scan.manifest.scan_id, record.response_hash)
    camera_images = []
    for k, side in enumerate(SIDES):
        frames = scan.frames[side]
        decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
        for index in range(len(sequence)):
            progress(f"decoding {side}", 0.5 * (k + index / len(sequence)))
            decoder.push(frames, index)
        decoder.finish()
        camera_images.append(CameraImages(frames, decoder.p_px, decoder.q_px))
    measured = measure_response(sequence, camera_images, drawn_for)
    times_us = Instrument(rig).exposure_of_scan(record).time_us, rig.board.trigger_delay_us
    stored = StoredResponse(
        rig.rig.serial, (scan.manifest.scan_id,), measured.residual, measured.response.harmonics, *times_us
    )
    return stored, measured


@dataclass(frozen=True, slots=True)
class ExposureCheck:
    """Ripple that the exposure of one scan leaves in its coordinates."""

    scan_id: str
    exposure: Exposure
    trigger_delay_us: int
    bend_px: float
    """RMS of the ripple in the coordinates, in pattern px."""
    noise_px: float
    """Standard deviation of a coordinate without the ripple."""
    noisier: float
    """Factor by which points are noisier after the ripple is removed."""

    @property
    def straight(self) -> bool:
        """True if fringes are straight enough for scans with this exposure."""
        return self.noisier <= MOST_NOISIER


def check_exposure(source: SourceScan) -> ExposureCheck:
    """Return the ripple in the fringes of a stored scan.

    Raises ScanError, also for a scan with too few points.
    """
    scan = StoredScan.load(source.scan.folder, only_raw=True)
    record, sequence = scan.manifest.record, scan.sequence
    decoders = []
    for side in SIDES:
        frames = scan.frames[side]
        decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
        for index in range(len(sequence)):
            decoder.push(frames, index)
        decoder.finish()
        decoders.append(decoder)
    bend = measure_bend(decoders, sequence.period_px)
    if not bend.noise_px > 0.0:
        raise ScanError(
            f"{scan.folder}: too few points to judge the shape of its fringes; scan a surface that fills the image"
        )
    return ExposureCheck(
        scan.manifest.scan_id,
        Instrument(source.rig).exposure_of_scan(record),
        source.rig.board.trigger_delay_us,
        bend.rms_px,
        bend.noise_px,
        math.sqrt(bend.variance_factor(sequence.period_px)),
    )


def noise_of_scan(rig: Rig, folder: Path) -> dict[str, tuple[MeasuredNoise, CameraNoise]]:
    """Return, by side, the camera's noise in a stored scan and the noise that the rig file states.

    Raises ScanError, NoiseError.
    """
    scan = StoredScan.load(folder, only_raw=True)
    sequence = scan.sequence
    # The gain is the scan's own if it states one; full well, read noise and black level are in the rig file only.
    expected = Instrument(rig).noise(Instrument(rig).exposure_of_scan(scan.manifest.record))
    return {
        "left": (measure_noise(sequence, scan.frames["left"]), expected.left),
        "right": (measure_noise(sequence, scan.frames["right"]), expected.right),
    }


def noise_to_store(rig: Rig, folder: Path, noise_by_side: dict[str, tuple[MeasuredNoise, CameraNoise]]) -> StoredNoise:
    """Return the results of ``noise_of_scan`` as figures of the instrument's cameras, for their file.

    Raises ScanError, and NoiseError for figures that no camera has.
    """
    manifest = StoredScan.load(folder, only_raw=True).manifest
    exposure, cameras = Instrument(rig).exposure_of_scan(manifest.record), rig.camera
    figures = []
    for side in SIDES:
        camera = of_side(cameras, side)
        # Both cameras have the scan's gain, plus the difference of the right camera in the rig file.
        gain_db = exposure.gain_db + camera.gain_db - cameras.left.gain_db
        camera_figures = noise_by_side[side][0].figures(camera.serial, gain_db)
        for name, limits in LIMITS.items():
            value = getattr(camera_figures, name)
            if not limits.takes(value):
                raise NoiseError(
                    f"{name} of the {side} camera would be {value:.4g}; allowed are {limits.allowed}; scan an "
                    "object with light and dark parts, at rest and in the dark"
                )
        figures.append(camera_figures)
    return StoredNoise(rig.rig.serial, (manifest.scan_id,), BothFigures(*figures))


def _response_of_patterns(rig: Rig, scan_id: str, response_hash: str | None) -> Response | None:
    """Return the response for which the patterns of a scan were drawn."""
    if response_hash is None:
        return None
    response = Instrument(rig).response()
    if response is None or response.hash != response_hash:
        raise ResponseError(
            f"scan {scan_id} has patterns for another response than that in {Instrument(rig).response_file}; "
            "restore that file, or record a scan without one"
        )
    return response
