"""Owns what is measured about the instrument from a scan it stored, besides its calibration."""

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
"""Factor by which points may be noisier for the exposure they were taken with: of a response as other projectors have,
1.01."""


def response_of_scan(rig: Rig, folder: Path, progress: Progress) -> tuple[StoredResponse, MeasuredResponse]:
    """Return the projector's response from the raw frames of a stored scan, ready for its file, and what else the
    scan says.

    Raises ScanError, ResponseError.
    """
    scan = StoredScan.load(folder, only_raw=True)
    record, sequence = scan.manifest.record, scan.sequence
    # A scan drawn for a response shows what is left of it: without that very response its codes are not known.
    drawn_for = _drawn_for(rig, scan.manifest.scan_id, record.response_hash)
    seen = []
    for k, side in enumerate(SIDES):
        frames = scan.frames[side]
        decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
        for index in range(len(sequence)):
            progress(f"decoding {side}", 0.5 * (k + index / len(sequence)))
            decoder.push(frames, index)
        decoder.finish()
        seen.append(CameraImages(frames, decoder.p_px, decoder.q_px))
    measured = measure_response(sequence, seen, drawn_for)
    taken_us = Instrument(rig).exposure_of_scan(record).time_us, rig.board.trigger_delay_us
    found = StoredResponse(
        rig.rig.serial, (scan.manifest.scan_id,), measured.residual, measured.response.harmonics, *taken_us
    )
    return found, measured


@dataclass(frozen=True, slots=True)
class ExposureFound:
    """One scan's word on the exposure it was taken with."""

    scan_id: str
    exposure: Exposure
    trigger_delay_us: int
    bend_px: float
    """RMS of what the response bends coordinates by, in pattern px."""
    noise_px: float
    """Standard deviation of a coordinate without it."""
    noisier: float
    """Factor by which points are noisier for it once it is taken out."""

    @property
    def straight(self) -> bool:
        """True if fringes are straight enough for scans with this exposure."""
        return self.noisier <= MOST_NOISIER


def exposure_found(source: SourceScan) -> ExposureFound:
    """Return how straight the fringes of a stored scan are.

    Raises ScanError, also for one that shows too little to tell.
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
            f"{scan.folder}: too few points to tell how straight its fringes are; scan a surface that fills the image"
        )
    return ExposureFound(
        scan.manifest.scan_id,
        Instrument(source.rig).exposure_of_scan(record),
        source.rig.board.trigger_delay_us,
        bend.rms_px,
        bend.noise_px,
        math.sqrt(bend.variance_factor(sequence.period_px)),
    )


def noise_of_scan(rig: Rig, folder: Path) -> dict[str, tuple[MeasuredNoise, CameraNoise]]:
    """Return by side the camera's noise in a stored scan, and what the rig file makes expect.

    Raises ScanError, NoiseError.
    """
    scan = StoredScan.load(folder, only_raw=True)
    sequence = scan.sequence
    # The gain is the scan's own where it says so; full well, read noise and black level are the camera's and stand in
    # the rig file only.
    expected = Instrument(rig).noise(Instrument(rig).exposure_of_scan(scan.manifest.record))
    return {
        "left": (measure_noise(sequence, scan.frames["left"]), expected.left),
        "right": (measure_noise(sequence, scan.frames["right"]), expected.right),
    }


def noise_to_store(rig: Rig, folder: Path, found: dict[str, tuple[MeasuredNoise, CameraNoise]]) -> StoredNoise:
    """Return what ``noise_of_scan`` found in a stored scan as figures of the instrument's cameras, ready for their
    file.

    Raises ScanError, and NoiseError for figures that no camera has.
    """
    manifest = StoredScan.load(folder, only_raw=True).manifest
    exposure, cameras = Instrument(rig).exposure_of_scan(manifest.record), rig.camera
    figures = []
    for side in SIDES:
        camera = of_side(cameras, side)
        # Both cameras are set to the scan's gain; what the right one's differs by in the rig file is kept.
        gain_db = exposure.gain_db + camera.gain_db - cameras.left.gain_db
        one = found[side][0].figures(camera.serial, gain_db)
        for name, limits in LIMITS.items():
            value = getattr(one, name)
            if not limits.takes(value):
                raise NoiseError(
                    f"{name} of the {side} camera would be {value:.4g}; allowed are {limits.allowed}; scan something "
                    "light and "
                    "dark with still hands, in the dark"
                )
        figures.append(one)
    return StoredNoise(rig.rig.serial, (manifest.scan_id,), BothFigures(*figures))


def _drawn_for(rig: Rig, scan_id: str, response_hash: str | None) -> Response | None:
    """Return the response that a scan's patterns were drawn for."""
    if response_hash is None:
        return None
    response = Instrument(rig).response()
    if response is None or response.hash != response_hash:
        raise ResponseError(
            f"scan {scan_id} was drawn for another response than that in {Instrument(rig).response_file}; bring that "
            "file "
            "back, or record a scan without one"
        )
    return response
