"""Frames of a known surface, made with plain float64 NumPy from the product's own optics: for exactness, not for truth.

The simulated world is the judge of the instrument; this only makes frames whose coordinates are known to 1e-9, so that
decoding, matching and triangulation can be held against closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.design import Design, design_calibration
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Pipeline

WATER = Water(20.0, 0.0, 530.0)
LEANING = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)


def calibration(width_px: int = 400, height_px: int = 300) -> Calibration:
    design = Design(11.5, 4.5 * 1600 / width_px, 230.0, 12.41, 30.0, 5.0, 1.77)
    return design_calibration(design, "KF-TEST", width_px, height_px, WATER)


def projector(cal: Calibration) -> HousedCamera:
    """A projector in the middle of the baseline, as a camera in the left frame."""
    toe = math.radians(12.41)
    c, s = math.cos(toe), math.sin(toe)
    rotation = ((c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c))
    f = 16.9 / 0.0108
    middle = 0.5 * np.asarray(cal.rig.right.translation_mm)
    return HousedCamera(
        1024,
        768,
        Lens((f, f), (511.5, 383.5)),
        Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77),
        rotation,
        (float(middle[0]), float(middle[1]), float(middle[2])),
    )


def plane_points(camera: HousedCamera, normal: NDArray[np.float64], offset_mm: float) -> NDArray[np.float64]:
    """Where every pixel's ray meets the plane normal·X = offset: (h, w, 3) mm."""
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    origin, direction = camera.rays(np.stack([u, v], -1), WATER.index)
    return np.asarray(origin + direction * ((offset_mm - origin @ normal) / (direction @ normal))[..., None])


def frames(
    sequence: PatternSequence, pq: NDArray[np.float64], mean: float = 110.0, amplitude: float = 80.0
) -> NDArray[np.float64]:
    """Ideal intensities (n, h, w) float64 of pattern coordinates (h, w, 2); NaN coordinates are dark."""
    out = np.empty((len(sequence), *pq.shape[:2]))
    for k, pattern in enumerate(sequence.patterns):
        x = pq[..., 0 if pattern.direction is Direction.X else 1]
        codes = pattern.codes().astype(float)
        if pattern.kind.value == "sine":
            phase = 2 * np.pi * (x + 0.5) / pattern.period_px + pattern.index * np.pi / 2
            image = mean + amplitude * np.cos(phase)
        else:
            nearest = np.clip(np.rint(np.nan_to_num(x)), 0, pattern.size_px - 1).astype(int)
            image = np.where(codes[nearest] > 128, mean + amplitude, mean - amplitude)
        lit = np.isfinite(pq).all(-1) & (pq[..., 0] > -0.5) & (pq[..., 0] < sequence.width_px - 0.5)
        lit &= (pq[..., 1] > -0.5) & (pq[..., 1] < sequence.height_px - 0.5)
        out[k] = np.where(lit, image, 3.0)
    return out


def wall_px(
    cal: Calibration, normal: NDArray[np.float64] = LEANING, nearer_mm: float = 0.0
) -> dict[str, NDArray[np.float64]]:
    """Pattern coordinates (h, w, 2) that each camera sees on a wall in the middle of the volume, or so much nearer."""
    offset_mm = float(normal @ cal.rig.volume_centre_mm(WATER.index)) - nearer_mm
    return {
        side: projector(cal).project(plane_points(camera, normal, offset_mm), WATER.index)
        for side, camera in (("left", cal.rig.left), ("right", cal.rig.right))
    }


def wall(
    cal: Calibration, sequence: PatternSequence, normal: NDArray[np.float64] = LEANING, nearer_mm: float = 0.0
) -> dict[str, NDArray[np.uint8]]:
    """Both cameras' frames (n, h, w) of such a wall; rounding is their only noise."""
    return {
        side: np.rint(frames(sequence, pq)).astype(np.uint8) for side, pq in wall_px(cal, normal, nearer_mm).items()
    }


def push_all(pipeline: Pipeline, seen: Mapping[str, NDArray[np.uint8]]) -> None:
    """Push both cameras' frames as they come from an instrument."""
    for k in range(len(pipeline.sequence)):
        for side, stack in seen.items():
            pipeline.push(side, stack, k)
