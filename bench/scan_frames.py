"""Scenes of most measurements: 2 × 24 frames of 1600 × 1200 with noise, and their truth.

A tilted disc that fills three quarters of the left image, with or without a bar in front of it: made from closed forms,
so that each pixel's coordinates and correspondence are known. Noise is 1.6 grey values: 0.04 px in a coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.patterns import PatternSequence, build_sequence
from tests.support import synthetic

NOISE_DN = 1.6
RADIUS_MM = 112.0
NORMAL = np.array([-0.2, 0.15, 1.0]) / np.linalg.norm([-0.2, 0.15, 1.0])
Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ScanFrames:
    """Frames and truth; arrays are of the left camera unless stated otherwise."""

    calibration: Calibration
    sequence: PatternSequence
    frames: dict[str, NDArray[np.uint8]]
    """(24, h, w) of each side."""
    points_mm: Array
    """(h, w, 3) surface point of each pixel; NaN without one."""
    right_uv_px: Array
    """(h, w, 2) true correspondence; NaN where the pixel is dark or the right camera does not see the point lit."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A disc, and in front of it a bar parallel to it; without height there is no bar."""

    centre_mm: Array
    bar_height_mm: float
    bar_half_width_mm: float = 18.0

    def hit(self, origin: Array, direction: Array) -> tuple[Array, Bools]:
        """Return the end points (…, 3) of rays, NaN without one, and which of them are on the bar."""
        disc = self._meet(origin, direction, 0.0)
        disc[np.linalg.norm(disc - self.centre_mm, axis=-1) > RADIUS_MM] = np.nan
        if self.bar_height_mm == 0.0:
            return disc, np.zeros(disc.shape[:-1], bool)
        bar = self._meet(origin, direction, self.bar_height_mm)
        across, along = np.moveaxis((bar - self.centre_mm)[..., :2], -1, 0)
        on_bar = (np.abs(across) <= self.bar_half_width_mm) & (np.abs(along) <= 0.6 * RADIUS_MM)
        disc[on_bar] = bar[on_bar]
        return disc, np.asarray(on_bar)

    def _meet(self, origin: Array, direction: Array, height_mm: float) -> Array:
        offset_mm = float(NORMAL @ self.centre_mm) - height_mm
        return np.asarray(origin + direction * ((offset_mm - origin @ NORMAL) / (direction @ NORMAL))[..., None])


def make_scan(
    width_px: int = 1600, height_px: int = 1200, period_px: int = 16, seed: int = 1, bar_height_mm: float = 0.0
) -> ScanFrames:
    """Make the scan; some fifteen seconds at full resolution, a minute with a bar."""
    cal = synthetic.calibration(width_px, height_px)
    sequence = build_sequence(period_px)
    index = synthetic.WATER.index
    scene = Scene(cal.rig.volume_centre_mm(index), bar_height_mm)
    projector = synthetic.projector(cal)
    rng = np.random.default_rng(seed)
    frames, points, illuminated = {}, {}, {}
    for side, camera in (("left", cal.rig.left), ("right", cal.rig.right)):
        v, u = np.mgrid[0:height_px, 0:width_px].astype(float)
        surface_mm, on_bar = scene.hit(*camera.rays(np.stack([u, v], -1), index))
        pq = projector.project(surface_mm, index)
        if bar_height_mm:
            pq[hidden(scene, projector, pq, on_bar, index)] = np.nan
        stack = np.empty((len(sequence), height_px, width_px), np.uint8)
        for k, image in enumerate(synthetic.frames(sequence, pq)):
            noise = NOISE_DN * rng.standard_normal(image.shape, dtype=np.float32)
            stack[k] = np.clip(np.rint(image + noise), 0, 255)
        inside = (pq > 0.0).all(-1) & (pq[..., 0] < sequence.width_px - 1) & (pq[..., 1] < sequence.height_px - 1)
        frames[side], points[side], illuminated[side] = stack, surface_mm, np.asarray(inside)
        if side == "left":
            left_on_bar = on_bar
    right = cal.rig.right
    uv = right.project(points["left"], index)
    is_matched = illuminated["left"] & (uv > 2.0).all(-1) & (uv[..., 0] < width_px - 3) & (uv[..., 1] < height_px - 3)
    if bar_height_mm:
        is_matched &= ~hidden(scene, right, np.where(is_matched[..., None], uv, np.nan), left_on_bar, index)
    uv[~is_matched] = np.nan
    return ScanFrames(cal, sequence, frames, points["left"], uv)


def hidden(scene: Scene, eye: HousedCamera, uv_px: Array, on_bar: Bools, index: float) -> Bools:
    """Return which points, at ``uv_px`` of ``eye`` and not ``on_bar``, are hidden by the bar."""
    is_tested = np.isfinite(uv_px).all(-1) & ~on_bar
    origin, direction = eye.rays(uv_px[is_tested], index)
    behind = np.zeros(is_tested.shape, bool)
    behind[is_tested] = scene.hit(origin, direction)[1]
    return behind
