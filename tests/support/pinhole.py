"""Pinholes in water: what an instrument sees that ignores its windows, fitted or recalibrated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from appliance.calibration.air import NO_PORT
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.pinhole import Lens
from appliance.optics.water import Water
from tests.support.truth import WATER


@dataclass(frozen=True, slots=True)
class Straight(Water):
    """Water that bends no ray: a pinhole knows none."""

    @property
    def index(self) -> float:
        """Of air."""
        return 1.0


STRAIGHT = Straight(WATER.temperature_c, WATER.salinity_psu, WATER.wavelength_nm)


def as_pinholes(rig: StereoRig) -> StereoRig:
    """Both cameras as pinholes, to be used in ``STRAIGHT`` water."""
    return StereoRig(as_pinhole(rig.left), as_pinhole(rig.right))


def as_pinhole(camera: HousedCamera) -> HousedCamera:
    """The pinhole with distortion that fits a housed camera best over the measuring volume."""
    v, u = np.mgrid[0 : camera.height_px : 12j, 0 : camera.width_px : 16j]
    uv = np.stack([u, v], -1).reshape(-1, 2)
    local = replace(
        camera, rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), translation_mm=(0.0, 0.0, 0.0)
    )
    origin, direction = local.rays(uv, WATER.index)
    points = np.concatenate([origin + s * direction for s in (430.0, 500.0, 570.0)])
    target = np.tile(uv, (3, 1))

    def made(x: NDArray[np.float64]) -> HousedCamera:
        lens = Lens((x[0], x[1]), (x[2], x[3]), (x[4], x[5], x[6], x[7], x[8]))
        return replace(local, lens=lens, port=NO_PORT, translation_mm=(0.0, 0.0, x[9]))

    f = camera.lens.f_px[0] * WATER.index
    start = np.array([f, f, *camera.lens.c_px, 0.0, 0.0, 0.0, 0.0, 0.0, -10.0])
    scale = np.array([f, f, 100.0, 100.0, 0.1, 0.1, 0.01, 0.01, 0.1, 10.0])
    solved = optimize.least_squares(
        lambda x: (made(x).project(points, STRAIGHT.index) - target).ravel(), start, x_scale=scale
    )
    fitted = made(solved.x)
    shift = np.asarray(camera.rotation) @ np.array(fitted.translation_mm)
    place = np.asarray(camera.translation_mm) + shift
    return replace(fitted, rotation=camera.rotation, translation_mm=(float(place[0]), float(place[1]), float(place[2])))
