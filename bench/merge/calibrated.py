"""Distortion of points by the instrument's own calibration: rigs of the world ``outside``, against the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from appliance.calibrate.water.artefact import nearest_points
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.method import Method
from appliance.measure.calibration.depth_error import BORDER
from appliance.measure.points.organised import OrganisedCloud
from bench.outside.rigs import SETS, drawn, recorded
from bench.outside.stated import stated_truth
from hw_sim.scene import Scene
from tests.support.calibrating import air_of, start_of

Array = NDArray[np.float64]
NEAREST_MM, FARTHEST_MM = 400.0, 700.0
ACROSS, DOWN, DEEP = 33, 25, 7
BESIDE = 1.25
"""The lattice reaches beyond the view by this factor."""


@dataclass(frozen=True, slots=True, eq=False)
class Distortion:
    """Displacement of points by one calibrated rig, without a rigid motion of all."""

    moved: RegularGridInterpolator
    """Displacement (3,), mm, by x/z, y/z and 1/z."""
    scale: float
    """Length over true length in the entire volume: the error of single scans."""
    stated_mm2: Array | None
    """Stated covariance of the common depth error, (32, 32), by the shapes of ``measure/calibration/depth_error.py``.
    """

    def of(self, cloud: OrganisedCloud) -> OrganisedCloud:
        """Return a cloud as this calibration would have made it."""
        points = cloud.points_mm.astype(np.float64)
        is_point = np.isfinite(points[..., 2])
        p = points[is_point]
        displaced = points.copy()
        displaced[is_point] = p + self.moved(np.stack([p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], 1.0 / p[:, 2]], 1))
        return replace(cloud, points_mm=displaced.astype(np.float32))


def distortion(seed: int, recordings: int) -> Distortion:
    """Return the distortion of a rig of the world ``outside``, calibrated in air and from ``recordings`` in water."""
    rig = drawn(SETS["all"], seed)
    calibration = calibrate(Method.SPLINE, recorded(rig.wet, recordings), start_of(air_of(rig.dry))).calibration
    stated = stated_truth(rig.wet, Scene())
    u = np.linspace(-BESIDE * BORDER, BESIDE * BORDER, ACROSS)
    v = np.linspace(-0.75 * BESIDE * BORDER, 0.75 * BESIDE * BORDER, DOWN)
    inverse = np.linspace(1.0 / FARTHEST_MM, 1.0 / NEAREST_MM, DEEP)
    grid = np.stack(np.meshgrid(u, v, inverse, indexing="ij"), -1)
    true = np.concatenate([grid[..., :2], np.ones((*grid.shape[:3], 1))], -1) / grid[..., 2:]
    flat = true.reshape(-1, 3)
    true_rig, own_rig, index = stated.calibration.rig, calibration.rig, stated.water.index
    pixels = [camera.project(flat, index) for camera in (true_rig.left, true_rig.right)]
    rays = [
        camera.rays(uv, calibration.water.index)
        for camera, uv in zip((own_rig.left, own_rig.right), pixels, strict=True)
    ]
    met = nearest_points(*rays[0], *rays[1])
    scale, rotation, shift = _similarity(flat, met)
    off = (met - shift) @ rotation - flat
    stated_mm2 = None if calibration.depth_error_mm2 is None else np.array(calibration.depth_error_mm2)
    return Distortion(
        RegularGridInterpolator((u, v, inverse), off.reshape(true.shape), bounds_error=False, fill_value=None),
        scale,
        stated_mm2,
    )


def _similarity(p: Array, q: Array) -> tuple[float, Array, Array]:
    """Return scale s, rotation R and shift t with q ≈ s R p + t about the volume's middle (S. Umeyama 1991).

    Points that are not seen are left out.
    """
    is_used = np.isfinite(p).all(1) & np.isfinite(q).all(1) & (np.abs(p[:, 2] - 540.0) < 60.0)
    p, q = p[is_used], q[is_used]
    a, b = p - p.mean(0), q - q.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    return float((s * sign).sum() / (a**2).sum()), rotation, np.asarray(q.mean(0) - p.mean(0) @ rotation.T)
