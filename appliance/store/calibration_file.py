"""A calibration read from its file."""

from __future__ import annotations

from pathlib import Path

from appliance.base import read_bounded
from appliance.measure import CALIBRATION, Calibration, CalibrationError, decode_calibration


def load_calibration(path: Path | str) -> Calibration:
    """Read a calibration file. Raises CalibrationError also for a missing or unreadable file."""
    try:
        data = read_bounded(Path(path), CALIBRATION.max_bytes)
    except OSError as error:
        raise CalibrationError(
            f"calibration {path}: cannot be read ({error.strerror}); calibrate, or copy the instrument's file there"
        ) from error
    return decode_calibration(data, f"calibration {path}")
