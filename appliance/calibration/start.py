"""Owns what is known before any recording in water: lenses and pose from air, ports from the drawing."""

from __future__ import annotations

from dataclasses import replace

from appliance.calibration.air import AirCalibration
from appliance.calibration.file import Calibration
from appliance.optics.model import StereoRig

METHOD = "air"


def start_from_air(
    air: AirCalibration, drawn: Calibration, made_from: tuple[str, ...] = ("boards in air",)
) -> Calibration:
    """The calibration that every adjustment in water begins with: ``drawn``'s ports, all else and its covariance from air."""
    left, right = (
        replace(measured, port=design.port)
        for measured, design in ((air.rig.left, drawn.rig.left), (air.rig.right, drawn.rig.right))
    )
    symmetric = 0.5 * (air.covariance + air.covariance.T)
    return replace(
        drawn,
        method=METHOD,
        made_from=made_from,
        rig=StereoRig(left, right),
        residual_px=air.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
    )
