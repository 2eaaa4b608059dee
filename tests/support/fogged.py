"""What a rendered scan tells of the windows, from what both cameras decode alone."""

from __future__ import annotations

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdicts.window import Windows, look_at_windows
from tests.support.rendered import RenderedScan


def windows_of(scan: RenderedScan) -> Windows:
    """The scan needs no calibration."""
    decoded = {}
    for side, frames in scan.frames.items():
        height_px, width_px = frames.shape[1:]
        decoded[side] = decoder = CameraDecoder(scan.sequence, width_px, height_px)
        for k in range(len(scan.sequence)):
            decoder.push(frames, k)
        decoder.finish()
    return look_at_windows(ScanImages(scan.sequence, scan.frames, decoded))
