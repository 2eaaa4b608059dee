"""Calibration that states the true rig of the world ``outside`` as well as the product's file format can.

Lens and port are the rig's own; what no formula describes (fields, a dent, a stria, a wedge, a window that is bent, a pupil that
moves) goes into a fine image correction for the rays' directions and a fine ray shift for where they pass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.correction import SplineGrid
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.ray_shift import RayShift
from appliance.measure.light.water import Water
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, ray
from tests.support.truth import MIDDLE_MM, rig_to_left, true_calibration

INTERVALS = (24, 18)
"""Across and down the image: a stria of 70 px of 1600 is followed."""
FITTED_AT = (73, 55)
FAR_MM = 1e6
"""Distance of a point whose pixel depends on the ray's direction only."""
NM_LEAST, NM_MOST = 380.0, 750.0
STEPS = 60
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StatedCalibration:
    """A calibration, the water that goes with it, and how far the format is from the truth."""

    calibration: Calibration
    water: Water
    left_um: float
    """Distance of its rays from the true ones, root mean square over both images and 400 to 650 mm, µm."""


def stated_truth(rig: TrueRig, scene: Scene) -> StatedCalibration:
    """Return the best possible calibration of ``rig`` in the scene's water."""
    water = stated_water(scene)
    plain = replace(true_calibration(rig), water=water)
    sides = {side: _followed(rig, side, getattr(plain.rig, side), water.index) for side in ("left", "right")}
    calibration = replace(plain, rig=StereoRig(sides["left"], sides["right"]))
    off = np.concatenate([_off_mm(rig, side, sides[side], water.index) for side in sides])
    return StatedCalibration(calibration, water, 1000.0 * float(np.sqrt(np.mean(off**2))))


def stated_water(scene: Scene) -> Water:
    """Return the scene's water with the wavelength at which the product's formula gives the true index."""
    water = scene.water

    def at(nm: float) -> Water:
        return Water(water.temperature_c, water.salinity_psu, nm)

    low, high = NM_LEAST, NM_MOST
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        # The index falls with the wavelength.
        low, high = (middle, high) if at(middle).index > scene.index else (low, middle)
    return at(0.5 * (low + high))


def _followed(rig: TrueRig, side: str, camera: HousedCamera, index: float) -> HousedCamera:
    """Return ``camera`` with the image correction and the ray shift that fit its rays to the true ones."""
    size_px = camera.width_px, camera.height_px
    uv = _grid(size_px, FITTED_AT)
    origin, direction = _true_rays(rig, side, uv)
    shift_px = uv - camera.project(origin + direction * FAR_MM, index)
    grid = SplineGrid(size_px, INTERVALS)
    weights = grid.matrix(uv)
    # By the normal equations: many points determine each node, so that they are as accurate as a decomposition, and
    # faster.
    square = weights.T @ weights
    correction = np.linalg.solve(square, weights.T @ shift_px)
    turned = replace(camera, correction=grid.correction(correction))
    beside_mm = _beside(turned, uv, origin, direction, index)
    move = np.linalg.solve(square, weights.T @ beside_mm)
    return replace(turned, ray_shift=RayShift(*size_px, INTERVALS, tuple(move.ravel().tolist())))


def _beside(camera: HousedCamera, uv: Array, origin: Array, direction: Array, index: float) -> Array:
    """Return how far (n, 2) the true rays pass beside the camera's, in mm along its x and y in the middle of the
    volume."""
    R, t = np.asarray(camera.rotation), np.asarray(camera.translation_mm)

    def at_middle(points: Array, along: Array) -> Array:
        local, direction_local = (points - t) @ R, along @ R
        return np.asarray((local + direction_local * ((MIDDLE_MM - local[:, 2:]) / direction_local[:, 2:]))[:, :2])

    return at_middle(origin, direction) - at_middle(*camera.rays(uv, index))


def _off_mm(rig: TrueRig, side: str, camera: HousedCamera, index: float) -> Array:
    """Return distances (n,) of the stated rays from the true ones, mm, at pixels that were not used in the fit."""
    uv = _grid((camera.width_px, camera.height_px), (37, 29))
    origin, direction = _true_rays(rig, side, uv)
    ours, along = camera.rays(uv, index)
    distances = []
    for distance_mm in (400.0, 525.0, 650.0):
        point = origin + direction * distance_mm
        away = point - ours
        distances.append(np.linalg.norm(away - np.sum(away * along, -1, keepdims=True) * along, axis=-1))
    return np.concatenate(distances)


def _true_rays(rig: TrueRig, side: str, uv: Array) -> tuple[Array, Array]:
    """Return origins and unit directions (n, 3) of the true rays in the left camera frame."""
    origin, direction = ray(rig, side, uv)
    return rig_to_left(rig, origin), direction @ np.array(rig.left.R)


def _grid(size_px: tuple[int, int], count: tuple[int, int]) -> Array:
    u, v = (np.linspace(0.0, size - 1.0, many) for size, many in zip(size_px, count, strict=True))
    return np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
