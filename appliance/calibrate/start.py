"""Owns what a calibration in water begins with: a file that was named, the calibration in air, or the one in use."""

from __future__ import annotations

from pathlib import Path

from appliance.calibrate.water.start import check_start
from appliance.measure import Calibration, CalibrationError
from appliance.store import Instrument, Rig, load_calibration


def start_of(rig: Rig, path: Path | None = None) -> Calibration:
    """Return what a calibration in water begins with: ``path``, else the calibration in air, else the one in use.

    Raises CalibrationError for a file that cannot be used, RecordingError for one in use that is no start.
    """
    in_air = Instrument(rig).air_file
    if path is not None:
        start = Instrument(rig).with_volume(load_calibration(path))
        problem = Instrument(rig).of_another(
            start
        )  # the size is compared with that of the scans, and so are the cameras
    elif in_air.exists():
        start = Instrument(rig).with_volume(load_calibration(in_air))
        problem = Instrument(rig).misfit(start)
    else:
        start, problem = Instrument(rig).calibration()[0], None
    if problem is not None:
        raise CalibrationError(f"{path or in_air}: {problem}; calibrate in air, or take another file")
    check_start(start)
    return start


def refuse_drawing(rig: Rig, path: Path | None) -> None:
    """Raises CalibrationError where calibrating in water would begin with the drawing without anybody having said so."""
    if path is None and not (Instrument(rig).air_file).exists() and not (Instrument(rig).calibration_file).exists():
        raise CalibrationError(
            f"{Instrument(rig).air_file}: missing; calibrate in air (`kingfisher calibration air`), or give with --calibration FILE "
            "what to begin with, be it the drawing (`kingfisher calibration show nominal --out FILE`)"
        )
