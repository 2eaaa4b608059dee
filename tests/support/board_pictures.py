"""Boards as the cameras of a rig see them: rendered pictures, and the corners that the product finds in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.board import BoardDesign, find_board
from appliance.calibrate.air.linearised import BoardView
from hw_sim.objects.motion import pose_matrix
from hw_sim.objects.print import corners_mm
from hw_sim.objects.shapes import BOARD_HALF_X_MM
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, in_air, project
from hw_sim.water.medium import AIR, Water

BOARD = BoardDesign()
EXPOSURE_S = 0.007
Pose = tuple[float, float, float, float, float, float]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Pictures:
    """One board, both cameras."""

    pose: Pose
    left: Image
    right: Image


def poses_in_air(count: int, seed: int) -> list[Pose]:
    """Boards as somebody holds them: everywhere in view, leant by up to 30°, turned anyhow."""
    return _poses([40.0, 30.0], (470.0, 640.0), count, seed)


def poses_in_water(count: int, seed: int) -> list[Pose]:
    """The same within the measuring volume."""
    return _poses([30.0, 25.0], (470.0, 590.0), count, seed)


def _poses(reach_mm: list[float], depth_mm: tuple[float, float], count: int, seed: int) -> list[Pose]:
    rng = np.random.default_rng([seed, 91])
    found = []
    for _ in range(count):
        x, y = rng.uniform(-1.0, 1.0, 2) * reach_mm
        z = rng.uniform(*depth_mm)
        rx, ry, rz = rng.uniform([-30.0, -30.0, -180.0], [30.0, 30.0, 180.0])
        found.append((float(x), float(y), float(z), float(rx), float(ry), float(rz)))
    return found


def picture(renderer: Renderer, pose: Pose, water: Water, seed: int, exposure_s: float = EXPOSURE_S) -> Pictures:
    """A board in bright room light; the projector is dark."""
    renderer.scene = Scene(object="board", pose=pose, water=water, ambient=1.0)
    left, right = (
        renderer.expose(side, [], 0.0, exposure_s, 0.0, (False, False), 2 * seed + k)
        for k, side in enumerate(("left", "right"))
    )
    return Pictures(pose, left, right)


def views_of_boards(truth: TrueRig, count: int = 20, seed: int = 1, nearer: float = 1.0) -> list[BoardView]:
    """Boards in air, on the day of the calibration in air, as the product finds them in pictures, with the corners that both cameras see: a second of CPU each.

    ``truth`` is the rig in water; ``hw_sim.truth.in_air`` says what it was before. ``nearer``: at that share of the usual places.
    """
    renderer, found = Renderer(in_air(truth), Scene(object="board")), []
    for k, (x, y, z, *turn) in enumerate(poses_in_air(count, seed)):
        pose = (nearer * x, nearer * y, nearer * z, turn[0], turn[1], turn[2])
        pictures = picture(renderer, pose, AIR, 1000 * seed + k)
        view, reasons = find_board(f"board {k}", {"left": pictures.left, "right": pictures.right}, BOARD, strict=True)
        assert not reasons
        found.append(view.without(~(view.has("left") & view.has("right"))))
    return found


def true_corners_px(rig: TrueRig, side: str, pose: Pose, corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a camera of ``rig`` (in air: ``in_air``) truly sees corners (n, 3) given in the board's own frame, mm."""
    middle = corners_mm().mean(axis=0) + 0.5 * np.array([BOARD.across, BOARD.down, 0.0]) * BOARD.square_mm
    local = (corners - middle) * rig.artefacts.board_scale
    r2 = np.sum(local[:, :2] ** 2, axis=1)
    local[:, 2] = rig.artefacts.board_bow_mm * (1.0 - 2.0 * r2 / BOARD_HALF_X_MM**2)
    R, t = pose_matrix(pose)
    return project(rig, side, local @ R.T + t)
