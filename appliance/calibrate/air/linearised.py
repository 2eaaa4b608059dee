"""Model of a board in air as both cameras see it, with the Jacobian by rig, board shape and board pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure import RIG_PARAMETERS, HousedCamera, StereoRig, rotation_matrix

Array = NDArray[np.float64]

MIN_CORNERS = 12
ONE_ROW = 1e-3
"""Extent of corners across their longest direction, as a share of that along it, below which they are in one row."""
VALUES = 22
SHAPES = 5
"""Bow, saddle, twist, and an S along each side of the board."""
POSE_NAMES = tuple(f"the board's {name}" for name in ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z"))
"""Names of the six parameters of a board's pose."""
SHAPE_STEP_MM, SCALE_STEP = 1e-3, 1e-5
_BOARD_STEPS = np.array([1e-6] * 3 + [1e-3] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """Corners of one board in mm, and where both cameras see them at the same moment."""

    name: str
    corners_mm: Array
    """(n, 3), board frame, z = 0."""
    left_px: Array
    """(n, 2)."""
    right_px: Array
    """(n, 2). As in ``left_px``, NaN where the camera did not see the corner."""

    @classmethod
    def of(
        cls, name: str, board_mm: Array, left: Mapping[int, Array] | None, right: Mapping[int, Array] | None
    ) -> BoardView:
        """Return the view of a board with corners (n, 3) from the corners that each camera found, by number.

        A camera with too few corners to determine the pose, or with a single row of them, counts as having no view.
        """
        numbers = sorted((left or {}).keys() | (right or {}).keys())
        unseen = np.full(2, np.nan)
        sides_px = (
            np.array([(corners or {}).get(n, unseen) for n in numbers]).reshape(-1, 2) for corners in (left, right)
        )
        return cls(name, board_mm[numbers], *sides_px).without(np.zeros(len(numbers), np.bool_))

    def px(self, side: str) -> Array:
        """Return where a camera sees the corners (n, 2)."""
        return self.left_px if side == "left" else self.right_px

    def has(self, side: str) -> NDArray[np.bool_]:
        """Return which corners (n,) a camera sees."""
        return np.asarray(np.isfinite(self.px(side)[:, 0]))

    def sighting(self, side: str) -> tuple[Array, Array]:
        """Return the corners (m, 3) in mm that a camera sees, and their pixels (m, 2)."""
        rows = self.has(side)
        return self.corners_mm[rows], self.px(side)[rows]

    def without(self, bad: NDArray[np.bool_]) -> BoardView:
        """Return the view without its ``bad`` corners (n,), and without a camera whose other corners are too few."""
        corners_mm, sides_px = self.corners_mm[~bad], [self.left_px[~bad], self.right_px[~bad]]
        usable_px = [
            px if _determine_pose(corners_mm[np.isfinite(px[:, 0])]) else np.full_like(px, np.nan) for px in sides_px
        ]
        is_visible = np.isfinite(usable_px[0][:, 0]) | np.isfinite(usable_px[1][:, 0])
        return BoardView(self.name, corners_mm[is_visible], usable_px[0][is_visible], usable_px[1][is_visible])


def _determine_pose(corners_mm: Array) -> bool:
    """Tell whether corners (n, 3) determine the pose: enough of them, and not all on one line."""
    if len(corners_mm) < MIN_CORNERS:
        return False
    extents = np.linalg.svd(corners_mm - corners_mm.mean(axis=0), compute_uv=False)
    return bool(extents[1] >= ONE_ROW * extents[0])


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """Model of a bent board: amounts of five shapes in which a plate bends most easily, the same in all views."""

    middle: Array
    reach_mm: float
    """Half of the board's width."""

    def of(self, corners_mm: Array) -> Array:
        """Return the height of corners (n, 3) in mm per mm of each amount, (n, ``SHAPES``).

        With p = x/a and q = y/a about the middle: 1 − 2 (p² + q²), p² − q², 2 p q, p (1 − p²) and q (1 − q²). The last
        two are zero in the middle and at p = 1: their tilt belongs to the board's pose.
        """
        p, q = ((corners_mm[:, k] - self.middle[k]) / self.reach_mm for k in (0, 1))
        return np.stack([1.0 - 2.0 * (p * p + q * q), p * p - q * q, 2.0 * p * q, p * (1 - p * p), q * (1 - q * q)], 1)


def bend_of(views: Sequence[BoardView]) -> Bend:
    """Return the bend model of the board whose corners ``views`` contain."""
    corners_mm = np.concatenate([view.corners_mm for view in views])
    return Bend(0.5 * (corners_mm.min(axis=0) + corners_mm.max(axis=0)), float(np.ptp(corners_mm[:, 0])) / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class ViewJacobian:
    """Residuals and Jacobian of one view. Rows are left u, v of each corner, then right."""

    residual: Array
    """(4 n,): observed minus computed, px."""
    by_rig: Array
    """(4 n, 22 + ``SHAPES``): computed pixels by the parameters from air and the board's shapes."""
    by_pose: Array
    """(4 n, 6): by the board's pose."""
    by_scale: Array
    """(4 n,): by the scale of the board's print."""


def linearise_view(
    rig: StereoRig,
    changed: Sequence[StereoRig],
    board: tuple[Array, Array],
    view: BoardView,
    bend: Bend,
    amounts_mm: Array,
) -> ViewJacobian:
    """Return residuals and Jacobian of a view.

    ``changed`` is ``rig`` with each of the 22 parameters one step further.
    """
    rise = bend.of(view.corners_mm)
    corners = view.corners_mm.copy()
    corners[:, 2] += rise @ amounts_mm
    pixels = project_board(rig, board, corners)

    def by_shape(k: int) -> Array:
        raised = corners.copy()
        raised[:, 2] += SHAPE_STEP_MM * rise[:, k]
        return (project_board(rig, board, raised) - pixels) / SHAPE_STEP_MM

    by_rig = [
        (project_board(r, board, corners) - pixels) / s
        for r, s in zip(changed, RIG_PARAMETERS.steps[RIG_PARAMETERS.air], strict=True)
    ]
    by_pose = [
        (project_board(rig, move_board(board, step), corners) - pixels) / float(step.sum())
        for step in np.diag(_BOARD_STEPS)
    ]
    return ViewJacobian(
        np.concatenate([view.left_px.ravel(), view.right_px.ravel()]) - pixels,
        np.stack([*by_rig, *(by_shape(k) for k in range(SHAPES))], 1),
        np.stack(by_pose, 1),
        (project_board(rig, board, corners + SCALE_STEP * (corners - bend.middle)) - pixels) / SCALE_STEP,
    )


def project_board(rig: StereoRig, board: tuple[Array, Array], corners_mm: Array) -> Array:
    """Return the pixels (4 n,) of a board's corners in both cameras."""
    points = corners_mm @ board[0].T + board[1]
    return np.concatenate([_in_air(camera, points).ravel() for camera in (rig.left, rig.right)])


def move_board(board: tuple[Array, Array], x: Array) -> tuple[Array, Array]:
    """Return a board's pose turned by x[:3] (rad) about its own axes and shifted by x[3:] (mm)."""
    return board[0] @ rotation_matrix(x[:3]), board[1] + x[3:]


def rig_steps(rig: StereoRig, offset: Array | None = None) -> list[StereoRig]:
    """Return ``rig`` changed by ``at`` (22,) and by one more step of each of the 22 parameters."""
    start = np.zeros(VALUES) if offset is None else offset
    steps = np.diag(RIG_PARAMETERS.steps[RIG_PARAMETERS.air])
    return [RIG_PARAMETERS.changed(rig, start + step, RIG_PARAMETERS.air) for step in steps]


def _in_air(camera: HousedCamera, points: Array) -> Array:
    local = (points - np.asarray(camera.translation_mm)) @ np.asarray(camera.rotation)
    return camera.lens.to_pixels(local[:, :2] / local[:, 2:])
