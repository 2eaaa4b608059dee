"""Start of a water calibration: lenses and extrinsics from air, nominal ports."""

from __future__ import annotations

from dataclasses import replace

from appliance.calibrate.air.calibrate import AirCalibration
from appliance.calibrate.recordings import RecordingError
from appliance.measure import IN_AIR, Calibration


def start_from_air(
    air: AirCalibration, nominal: Calibration, made_from: tuple[str, ...] = ("boards in air",)
) -> Calibration:
    """Return the calibration from which every adjustment in water starts.

    Ports are those of ``drawn``; all else, its covariance and the lenses' fields are from air.
    """
    left, right = (
        replace(measured, port=design.port)
        for measured, design in ((air.rig.left, nominal.rig.left), (air.rig.right, nominal.rig.right))
    )
    symmetric = 0.5 * (air.covariance + air.covariance.T)
    return replace(
        nominal,
        method=IN_AIR,
        made_from=made_from,
        rig=replace(nominal.rig, left=left, right=right),
        residual_px=air.residual_px,
        air_covariance=tuple(tuple(float(v) for v in row) for row in symmetric),
        air_field=air.field,
    )


def check_start(start: Calibration) -> None:
    """Raise RecordingError unless ``start`` has plain lenses behind ports, as from air or nominal."""
    for side, camera in (("left", start.rig.left), ("right", start.rig.right)):
        if camera.lens_in_water or camera.correction is not None or camera.ray_shift is not None:
            raise RecordingError(
                f"the {side} camera of {start.method} has an image correction, which a start must not have; "
                "give the air calibration, or copy it to calibration/air.json"
            )
