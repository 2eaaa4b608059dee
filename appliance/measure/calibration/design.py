"""The nominal calibration by the design, for an instrument that has not been measured yet."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import HousedCamera, Matrix3, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.light.water import Water

METHOD = "design"


@dataclass(frozen=True, slots=True)
class Design:
    """The optical design: two equal cameras with symmetric toe-in, each behind a perpendicular port."""

    principal_distance_mm: float
    pixel_um: float
    baseline_mm: float
    toe_in_deg: float
    port_distance_mm: float
    port_thickness_mm: float
    port_index: float


def design_calibration(
    design: Design,
    rig_serial: str,
    width_px: int,
    height_px: int,
    water: Water,
    volume: WorkingVolume = STANDARD,
) -> Calibration:
    """Return the calibration of an instrument as designed; its method is ``design``."""
    f_px = design.principal_distance_mm * 1000.0 / design.pixel_um
    lens = Lens((f_px, f_px), ((width_px - 1) / 2.0, (height_px - 1) / 2.0))
    port = Port((0.0, 0.0, 1.0), design.port_distance_mm, design.port_thickness_mm, design.port_index)
    toe = math.radians(design.toe_in_deg)
    # Rig frame → left frame is the inverse of the left camera's toe-in; the right camera has the opposite one.
    left_to_rig = _about_y(toe)
    right_to_rig = _about_y(-toe)
    rotation = left_to_rig.T @ right_to_rig
    translation = left_to_rig.T @ np.array([design.baseline_mm, 0.0, 0.0])
    right = HousedCamera(
        width_px,
        height_px,
        lens,
        port,
        _matrix(rotation),
        (float(translation[0]), float(translation[1]), float(translation[2])),
    )
    return Calibration(
        rig_serial=rig_serial,
        method=METHOD,
        made_at="unknown",
        made_from=("the optical design in the rig file",),
        water=water,
        rig=StereoRig(HousedCamera(width_px, height_px, lens, port), right, volume),
    )


def _about_y(angle_rad: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _matrix(R: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Matrix3:
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in R)
    return (a, b, c)
