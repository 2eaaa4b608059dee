"""Poses of artefacts: a fixed set for calibration, and others for the judgement."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.motion import pose_matrix
from hw_sim.objects.shapes import (
    BALL_DISTANCE_MM,
    BALL_RADIUS_MM,
    FRUSTUM_BASE_MM,
    FRUSTUM_HEIGHT_MM,
    FRUSTUM_TOP_MM,
)
from hw_sim.truth import TrueRig, project

Array = NDArray[np.float64]
Pose = tuple[float, float, float, float, float, float]
"""x, y, z in mm and turns about x, y, z in degrees, rig frame."""

CALIBRATION_BARS: tuple[Pose, ...] = (
    (-15.0, -20.0, 505.0, 0.0, 35.0, 20.0),
    (15.0, 20.0, 540.0, 0.0, -35.0, 70.0),
    (5.0, 15.0, 490.0, 0.0, 20.0, -60.0),
    (-5.0, -10.0, 555.0, 0.0, -20.0, -20.0),
)
"""The first two belong to the published four recordings, tilted in depth."""
CALIBRATION_PLANES: tuple[Pose, ...] = (
    (0.0, 0.0, 478.0, 8.0, -10.0, 0.0),
    (0.0, 0.0, 570.0, -10.0, 8.0, 0.0),
    (0.0, 0.0, 500.0, 15.0, 5.0, 0.0),
    (0.0, 0.0, 520.0, -15.0, 12.0, 0.0),
    (0.0, 0.0, 540.0, 3.0, -18.0, 0.0),
    (0.0, 0.0, 555.0, 12.0, 15.0, 0.0),
)
EYES = ("left", "right", "projector")
EDGE_SHARE = 0.005
"""Least distance from the edges, as a share of the image's width, of objects that must be entirely visible."""
MOST_DRAWS = 10_000


def unseen(truth: TrueRig, bars: int, planes: int, frustums: int) -> list[tuple[str, Pose]]:
    """Return objects and poses for judging, the same for each seed of a rig.

    Bars and frustums are entirely in every image.
    """
    rng = np.random.default_rng([truth.seed, 77])
    poses: list[tuple[str, Pose]] = []
    poses += [("ballbar", _drawn(truth, _bar, _ends_of_balls(), rng)) for _ in range(bars)]
    poses += [("plane", _plane(rng)) for _ in range(planes)]
    poses += [("frustum", _drawn(truth, _frustum, _corners(), rng)) for _ in range(frustums)]
    return poses


def _drawn(
    truth: TrueRig, draw: Callable[[np.random.Generator], Pose], points: Array, rng: np.random.Generator
) -> Pose:
    for _ in range(MOST_DRAWS):
        pose = draw(rng)
        if _whole(truth, pose, points):
            return pose
    raise RuntimeError(f"no pose out of {MOST_DRAWS} shows the whole artefact to rig {truth.set} {truth.seed}")


def _bar(rng: np.random.Generator) -> Pose:
    return (*_place(rng, 20.0, 15.0, 485.0, 560.0), 0.0, float(rng.uniform(-40, 40)), float(rng.uniform(-90, 90)))


def _plane(rng: np.random.Generator) -> Pose:
    return (*_place(rng, 5.0, 5.0, 470.0, 575.0), float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20)), 0.0)


def _frustum(rng: np.random.Generator) -> Pose:
    turns = float(rng.uniform(-8, 8)), float(rng.uniform(-10, 10)), float(rng.uniform(-180, 180))
    return (*_place(rng, 8.0, 6.0, 530.0, 565.0), *turns)


def _place(
    rng: np.random.Generator, x_mm: float, y_mm: float, near_mm: float, far_mm: float
) -> tuple[float, float, float]:
    return (
        float(rng.uniform(-x_mm, x_mm)),
        float(rng.uniform(-y_mm, y_mm)),
        float(rng.uniform(near_mm, far_mm)),
    )


def _ends_of_balls() -> Array:
    """Return points (n, 3) of the object frame around both balls."""
    reach = BALL_RADIUS_MM
    around = reach * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    return np.concatenate([around + np.array([x, 0.0, 0.0]) for x in (-0.5 * BALL_DISTANCE_MM, 0.5 * BALL_DISTANCE_MM)])


def _corners() -> Array:
    square = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]], float)
    top = np.column_stack([square * FRUSTUM_TOP_MM / 2, np.full(4, -FRUSTUM_HEIGHT_MM)])
    return np.concatenate([top, np.column_stack([square * FRUSTUM_BASE_MM / 2, np.zeros(4)])])


def _whole(truth: TrueRig, pose: Pose, points: Array) -> bool:
    R, t = pose_matrix(pose)
    for name in EYES:
        eye = truth.eye(name)
        uv = project(truth, name, points @ R.T + t)
        edge = EDGE_SHARE * eye.width_px
        with np.errstate(invalid="ignore"):
            inside = (uv >= edge) & (uv <= [eye.width_px - 1 - edge, eye.height_px - 1 - edge])
        if not inside.all():
            return False
    return True
