"""The true rig in the product's words: a calibration equal to the truth, for tests of everything but calibrating.

Lens field and wedge have no place in the product's model; ``modelled`` rigs have neither.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.correction import SplineGrid
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.water import Water
from hw_sim.truth import TrueEye, TrueRig, ray

WATER = Water(20.0, 0.0, 530.0)
MIDDLE_MM = 522.5
"""Depth of the volume's middle in the rig frame."""
FITTED_AT = 60
INTERVALS = (20, 15)
"""Of the fitted correction: fields of order 11 are followed to 1.5 % of their height (6 × 5 intervals leave a third of them)."""


def true_calibration(truth: TrueRig, serial: str = "KF-SIM") -> Calibration:
    """The calibration that states the truth about ``truth`` (as far as the product's model can)."""
    return Calibration(
        rig_serial=serial,
        method="truth",
        made_at="unknown",
        made_from=(f"the true rig, set {truth.set}, seed {truth.seed}",),
        water=WATER,
        rig=StereoRig(_camera(truth.left, truth.left), _camera(truth.right, truth.left)),
    )


def complete_calibration(truth: TrueRig) -> Calibration:
    """As ``true_calibration``, with what no formula describes (lens field, flaws, wedge) as an image correction: exact in the
    middle of the volume, and within some thousandths of a px over its depth."""
    plain = true_calibration(truth)
    left, right = plain.rig.left, plain.rig.right
    rig = StereoRig(_corrected(truth, "left", left), _corrected(truth, "right", right))
    return replace(plain, rig=rig)


def rig_to_left(truth: TrueRig, points_rig_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3) of the rig frame in the left camera frame."""
    return np.asarray((points_rig_mm - np.array(truth.left.t_mm)) @ np.array(truth.left.R))


def left_to_rig(truth: TrueRig, points_mm: NDArray[np.floating]) -> NDArray[np.float64]:
    """Points (n, 3) of the left camera frame in the rig frame."""
    return np.asarray(np.asarray(points_mm, np.float64) @ np.array(truth.left.R).T + np.array(truth.left.t_mm))


def _corrected(truth: TrueRig, side: str, camera: HousedCamera) -> HousedCamera:
    size_px = camera.width_px, camera.height_px
    u, v = (np.linspace(0.0, size - 1.0, FITTED_AT) for size in size_px)
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    origin, direction = ray(truth, side, uv)
    points = rig_to_left(truth, origin + direction * ((MIDDLE_MM - origin[:, 2:]) / direction[:, 2:]))
    shift = uv - camera.project(points, truth.n_water)
    grid = SplineGrid(size_px, INTERVALS)
    weights = grid.matrix(uv)
    coefficients, *_ = np.linalg.lstsq(weights, shift, rcond=None)
    return replace(camera, correction=grid.correction(coefficients))


def _camera(eye: TrueEye, left: TrueEye) -> HousedCamera:
    R = np.array(left.R).T @ np.array(eye.R)
    t = np.array(left.R).T @ (np.array(eye.t_mm) - np.array(left.t_mm))
    rotation = tuple((float(a), float(b), float(c)) for a, b, c in R)
    return HousedCamera(
        eye.width_px,
        eye.height_px,
        Lens(eye.f_px, eye.c_px, eye.distortion),
        Port(eye.port.normal, eye.port.d_mm, eye.port.th_mm, eye.port.n_g),
        (rotation[0], rotation[1], rotation[2]),
        (float(t[0]), float(t[1]), float(t[2])),
    )
