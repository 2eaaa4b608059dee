"""Owns how the instrument's own calibration distorts its points: rigs of the world ``outside``, calibrated as users do it, against the truth."""

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
    """Places where points appear that truly lie elsewhere, for one calibrated rig; a rigid motion of all is taken out: frames are free."""

    moved: RegularGridInterpolator
    """Displacement (3,), mm, by x/z, y/z and 1/z."""
    scale: float
    """Length over true length, of the volume as a whole: the single scans' own error."""
    stated_mm2: Array | None
    """What the calibration states of the depth error that all scans share, (32, 32), by the shapes of ``measure/calibration/depth_error.py``."""

    def of(self, cloud: OrganisedCloud) -> OrganisedCloud:
        """Return a cloud as this calibration would have made it."""
        points = cloud.points_mm.astype(np.float64)
        there = np.isfinite(points[..., 2])
        p = points[there]
        found = points.copy()
        found[there] = p + self.moved(np.stack([p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], 1.0 / p[:, 2]], 1))
        return replace(cloud, points_mm=found.astype(np.float32))


def distortion(seed: int, recordings: int) -> Distortion:
    """Return the distortion of a rig of the world ``outside``, calibrated in air and from so many recordings in water."""
    rig = drawn(SETS["all"], seed)
    made = calibrate(Method.SPLINE, recorded(rig.wet, recordings), start_of(air_of(rig.dry))).calibration
    stated = stated_truth(rig.wet, Scene())
    u = np.linspace(-BESIDE * BORDER, BESIDE * BORDER, ACROSS)
    v = np.linspace(-0.75 * BESIDE * BORDER, 0.75 * BESIDE * BORDER, DOWN)
    inverse = np.linspace(1.0 / FARTHEST_MM, 1.0 / NEAREST_MM, DEEP)
    grid = np.stack(np.meshgrid(u, v, inverse, indexing="ij"), -1)
    true = np.concatenate([grid[..., :2], np.ones((*grid.shape[:3], 1))], -1) / grid[..., 2:]
    flat = true.reshape(-1, 3)
    true_rig, own, index = stated.calibration.rig, made.rig, stated.water.index
    seen = [camera.project(flat, index) for camera in (true_rig.left, true_rig.right)]
    rays = [camera.rays(uv, made.water.index) for camera, uv in zip((own.left, own.right), seen, strict=True)]
    met = nearest_points(*rays[0], *rays[1])
    scale, rotation, shift = _similarity(flat, met)
    off = (met - shift) @ rotation - flat
    stated_mm2 = None if made.depth_error_mm2 is None else np.array(made.depth_error_mm2)
    return Distortion(
        RegularGridInterpolator((u, v, inverse), off.reshape(true.shape), bounds_error=False, fill_value=None),
        scale,
        stated_mm2,
    )


def _similarity(p: Array, q: Array) -> tuple[float, Array, Array]:
    """Return scale s, rotation R and shift t with q ≈ s R p + t about the volume's middle (S. Umeyama 1991); unseen points left out."""
    known = np.isfinite(p).all(1) & np.isfinite(q).all(1) & (np.abs(p[:, 2] - 540.0) < 60.0)
    p, q = p[known], q[known]
    a, b = p - p.mean(0), q - q.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    return float((s * sign).sum() / (a**2).sum()), rotation, np.asarray(q.mean(0) - p.mean(0) @ rotation.T)
