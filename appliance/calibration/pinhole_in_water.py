"""Owns the calibration of pinholes in water, as if no window were there: kept to be compared with.

The same adjustment as in air, from boards recorded in water: principal distance and distortion swallow the refraction
as well as they can. It holds near the distances of the boards, and only in the water they were recorded in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

from appliance.calibration.air import BoardView, calibrate_air
from appliance.calibration.file import Calibration
from appliance.optics.model import StereoRig
from appliance.optics.water import Water

METHOD = "pinhole in water"


def calibrate_pinhole_in_water(
    views: Sequence[BoardView],
    rig_serial: str,
    water: Water,
    width_px: int,
    height_px: int,
    made_at: datetime | None = None,
) -> Calibration:
    """Pinholes with distortion from boards recorded in ``water`` (fifteen or so, over the whole measuring volume).

    ``made_at`` ``None`` leaves the date unknown. Raises AirCalibrationError when too few views are usable.
    """
    found = calibrate_air(views, width_px, height_px)
    rig = StereoRig(replace(found.rig.left, lens_in_water=True), replace(found.rig.right, lens_in_water=True))
    return Calibration(
        rig_serial=rig_serial,
        method=METHOD,
        made_at="unknown" if made_at is None else made_at.astimezone(UTC).isoformat(timespec="seconds"),
        made_from=(
            *(f"board {view.name}" for view in found.views),
            *(f"left out: {reason}" for reason in found.left_out),
        ),
        water=water,
        rig=rig,
        residual_px=found.residual_px,
    )
