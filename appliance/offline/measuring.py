"""Owns what is measured about the instrument from a scan it stored, besides its calibration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from appliance.calibration.photon_transfer import MeasuredNoise, measure_noise
from appliance.calibration.response.file import StoredResponse
from appliance.calibration.response.measure import CameraImages, MeasuredResponse, ResponseError, measure_response
from appliance.config import Rig
from appliance.instrument import RESPONSE_FILE, exposure_of_scan, noise_of, response_of
from appliance.patterns.response import Response
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder
from appliance.scan.noise import CameraNoise
from appliance.scan.sides import SIDES
from appliance.storage import scan as stored


def response_of_scan(
    rig: Rig, folder: Path, progress: Callable[[str, float], None]
) -> tuple[StoredResponse, MeasuredResponse]:
    """Return the projector's response from the raw frames of a stored scan, ready for its file, and what else the
    scan says.

    Raises ScanError, ResponseError.
    """
    scan = stored.load(folder, only_raw=True)
    record = scan.manifest.record
    sequence = build_sequence(record.sequence.period_px, record.sequence.width_px, record.sequence.height_px)
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
    return StoredResponse(rig.rig.serial, (scan.manifest.scan_id,), measured.residual, measured.response), measured


def noise_of_scan(rig: Rig, folder: Path) -> dict[str, tuple[MeasuredNoise, CameraNoise]]:
    """Return by side the camera's noise in a stored scan, and what the rig file makes expect.

    Raises ScanError, NoiseError.
    """
    scan = stored.load(folder, only_raw=True)
    made = scan.manifest.record.sequence
    sequence = build_sequence(made.period_px, made.width_px, made.height_px)
    # The gain is the scan's own where it says so; full well, read noise and black level are the camera's and stand in
    # the rig file only.
    expected = noise_of(rig, exposure_of_scan(scan.manifest.record, rig))
    return {
        "left": (measure_noise(sequence, scan.frames["left"]), expected.left),
        "right": (measure_noise(sequence, scan.frames["right"]), expected.right),
    }


def _drawn_for(rig: Rig, scan_id: str, response_hash: str | None) -> Response | None:
    """Return the response that a scan's patterns were drawn for."""
    if response_hash is None:
        return None
    response = response_of(rig)
    if response is None or response.hash != response_hash:
        raise ResponseError(
            f"scan {scan_id} was drawn for another response than that in {rig.storage.root / RESPONSE_FILE}; bring that file "
            "back, or record a scan without one"
        )
    return response
