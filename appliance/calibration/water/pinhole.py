"""Owns the two pinholes that stand for a camera behind its port: the usual approximations, kept to be compared with.

Refracted rays have no common point. Within the measuring volume a pinhole with another principal distance, more
distortion and a projection centre moved along the axis comes near; outside of it, and in other water, it does not.
One is mapped through the ports as drawn. The other is calibrated from boards recorded in water, by the same adjustment
as in air, as if no window were there: principal distance and distortion swallow the refraction as well as they can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.air.adjustment import BoardView, calibrate_air
from appliance.calibration.file import Calibration
from appliance.optics.model import IDENTITY, HousedCamera, StereoRig
from appliance.optics.pinhole import Lens, distort
from appliance.optics.volume import WorkingVolume
from appliance.optics.water import Water

Array = NDArray[np.float64]

DEPTHS_MM = (430.0, 480.0, 530.0, 580.0)
"""Depths along the rays, from the window, of the standard housing: its measuring volume and some more behind it."""
GRID = (25, 19)
METHOD = "pinhole in water"


def mapped_through_ports(start: Calibration, water: Water) -> Calibration:
    """Return the pinholes nearest to the refracted rays of ``start``, lens by lens; right in ``water`` only."""
    volume = start.rig.volume
    left, right = (_mapped(camera, volume, water) for camera in (start.rig.left, start.rig.right))
    return replace(
        start,
        method="pinhole, mapped through the ports as drawn",
        water=water,
        rig=replace(start.rig, left=left, right=right),
        residual_px=None,
        air_covariance=None,
    )


def _mapped(camera: HousedCamera, volume: WorkingVolume, water: Water) -> HousedCamera:
    bare = replace(camera, rotation=IDENTITY, translation_mm=(0.0, 0.0, 0.0))
    v, u = np.meshgrid(
        np.linspace(0.0, camera.height_px - 1.0, GRID[1]),
        np.linspace(0.0, camera.width_px - 1.0, GRID[0]),
        indexing="ij",
    )
    uv = np.stack([u.ravel(), v.ravel()], -1)
    origin, direction = bare.rays(uv, water.index)
    points = np.concatenate([origin + volume.scaled(s) * direction for s in DEPTHS_MM])
    wanted = np.tile(uv, (len(DEPTHS_MM), 1))
    f_px, ratio = camera.lens.f_px[0], camera.lens.f_px[1] / camera.lens.f_px[0]

    def lens_of(x: Array) -> tuple[Lens, float]:
        k1, k2, p1, p2, k3 = (float(k) for k in x[3:8])
        f = float(x[0]) * f_px
        return Lens((f, f * ratio), (float(x[1]), float(x[2])), (k1, k2, p1, p2, k3)), float(x[8])

    def miss(x: Array) -> Array:
        lens, back_mm = lens_of(x)
        # Seen from the middle of the volume, refracted rays seem to come from a centre behind the true one, and the
        # focal length is longer by the index: both are the start of the search.
        xy = points[:, :2] / (points[:, 2:] + back_mm)
        seen = distort(xy, lens.distortion) * np.asarray(lens.f_px) + np.asarray(lens.c_px)
        return np.asarray((seen - wanted).ravel())

    import scipy.optimize  # half a second that a start of the service does not need

    start = np.array([water.index, *camera.lens.c_px, *camera.lens.distortion, 0.3 * camera.port.distance_mm])
    found = scipy.optimize.least_squares(miss, start, x_scale=[1e-3, 1.0, 1.0, 1e-2, 1e-2, 1e-4, 1e-4, 1e-2, 1.0])
    lens, back_mm = lens_of(found.x)
    centre = np.asarray(camera.translation_mm) - back_mm * np.asarray(camera.rotation)[:, 2]
    return replace(
        camera,
        lens=lens,
        translation_mm=(float(centre[0]), float(centre[1]), float(centre[2])),
        lens_in_water=True,
    )


def calibrate_pinhole_in_water(
    views: Sequence[BoardView],
    rig_serial: str,
    water: Water,
    width_px: int,
    height_px: int,
    made_at: datetime | None = None,
) -> Calibration:
    """Return pinholes with distortion from boards recorded in ``water`` (fifteen or so, over the whole measuring
    volume).

    ``made_at`` ``None`` leaves the date unknown. Raises AirCalibrationError when too few views are usable.
    """
    found = calibrate_air(views, width_px, height_px, with_field=False)
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
