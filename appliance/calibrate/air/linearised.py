"""Owns how a board in air looks to both cameras, and how that changes with rig, board and place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure import RIG_PARAMETERS, HousedCamera, StereoRig, rotation_matrix

Array = NDArray[np.float64]

MIN_CORNERS = 12
ONE_ROW = 1e-3
"""Spread of corners across their longest direction, as a share of that along it, below which they are in one row."""
VALUES = 22
SHAPES = 5
"""Bow, saddle, twist, and an S along each side of the board."""
PLACE = tuple(f"the board's {name}" for name in ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z"))
"""Names of the six values of a board's place."""
SHAPE_STEP_MM, SCALE_STEP = 1e-3, 1e-5
_BOARD_STEPS = np.array([1e-6] * 3 + [1e-3] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """One board seen by both cameras at once: its corners in mm, and where each camera sees the same corners."""

    name: str
    corners_mm: Array
    """(n, 3), board frame, z = 0."""
    left_px: Array
    """(n, 2)."""
    right_px: Array
    """(n, 2). In both: NaN where the camera did not see the corner."""

    @classmethod
    def of(
        cls, name: str, board_mm: Array, left: Mapping[int, Array] | None, right: Mapping[int, Array] | None
    ) -> BoardView:
        """Return a view of a board with corners (n, 3): what each camera found, by number.

        A camera with fewer corners than tell its place, or with a single row of them, counts as having no view.
        """
        numbers = sorted((left or {}).keys() | (right or {}).keys())
        nowhere = np.full(2, np.nan)
        both = (np.array([(found or {}).get(n, nowhere) for n in numbers]).reshape(-1, 2) for found in (left, right))
        return cls(name, board_mm[numbers], *both).without(np.zeros(len(numbers), np.bool_))

    def px(self, side: str) -> Array:
        """Return where a camera sees the corners (n, 2)."""
        return self.left_px if side == "left" else self.right_px

    def has(self, side: str) -> NDArray[np.bool_]:
        """Tell which corners (n,) a camera sees."""
        return np.asarray(np.isfinite(self.px(side)[:, 0]))

    def sighting(self, side: str) -> tuple[Array, Array]:
        """Return the corners (m, 3) in mm that a camera sees, and where, (m, 2) px."""
        rows = self.has(side)
        return self.corners_mm[rows], self.px(side)[rows]

    def without(self, bad: NDArray[np.bool_]) -> BoardView:
        """Return the view without its ``bad`` corners (n,), and without a camera whose other corners do not tell its
        place."""
        corners_mm, both = self.corners_mm[~bad], [self.left_px[~bad], self.right_px[~bad]]
        told = [px if _tell_place(corners_mm[np.isfinite(px[:, 0])]) else np.full_like(px, np.nan) for px in both]
        seen = np.isfinite(told[0][:, 0]) | np.isfinite(told[1][:, 0])
        return BoardView(self.name, corners_mm[seen], told[0][seen], told[1][seen])


def _tell_place(corners_mm: Array) -> bool:
    """Tell whether corners (n, 3) are enough, and not on one line, about which the board's turn cannot be seen."""
    if len(corners_mm) < MIN_CORNERS:
        return False
    across = np.linalg.svd(corners_mm - corners_mm.mean(axis=0), compute_uv=False)
    return bool(across[1] >= ONE_ROW * across[0])


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """Model of a bent board: five amounts, the same in all views, in the shapes that a plate takes first."""

    middle: Array
    reach_mm: float
    """Half of the board's width."""

    def of(self, corners_mm: Array) -> Array:
        """Return the rise of corners (n, 3) in mm per mm of each amount, (n, ``SHAPES``).

        With p = x/a and q = y/a about the middle: 1 − 2 (p² + q²), p² − q², 2 p q, p (1 − p²) and q (1 − q²). The last
        two are zero in the middle and at p = 1: what they have of a lean belongs to the board's place.
        """
        p, q = ((corners_mm[:, k] - self.middle[k]) / self.reach_mm for k in (0, 1))
        return np.stack([1.0 - 2.0 * (p * p + q * q), p * p - q * q, 2.0 * p * q, p * (1 - p * p), q * (1 - q * q)], 1)


def bend_of(views: Sequence[BoardView]) -> Bend:
    """Return the shapes of the board of which ``views`` saw corners."""
    every = np.concatenate([view.corners_mm for view in views])
    return Bend(0.5 * (every.min(axis=0) + every.max(axis=0)), float(np.ptp(every[:, 0])) / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class ViewSlopes:
    """One view: its residuals and their slopes. Rows are left u, v of each corner, then right."""

    residual: Array
    """(4 n,): seen less computed, px."""
    by_rig: Array
    """(4 n, 22 + ``SHAPES``): of what is computed, by the values from air and the board's shapes."""
    by_place: Array
    """(4 n, 6)."""
    by_scale: Array
    """(4 n,): by the scale of the board's print."""


def slopes(
    rig: StereoRig,
    changed: Sequence[StereoRig],
    board: tuple[Array, Array],
    view: BoardView,
    bend: Bend,
    amounts_mm: Array,
) -> ViewSlopes:
    """Return the residuals of a view and their slopes; ``changed`` is ``rig`` with each of the 22 values a step
    further."""
    rise = bend.of(view.corners_mm)
    corners = view.corners_mm.copy()
    corners[:, 2] += rise @ amounts_mm
    now = seen(rig, board, corners)

    def bent(k: int) -> Array:
        more = corners.copy()
        more[:, 2] += SHAPE_STEP_MM * rise[:, k]
        return (seen(rig, board, more) - now) / SHAPE_STEP_MM

    by_rig = [
        (seen(r, board, corners) - now) / s
        for r, s in zip(changed, RIG_PARAMETERS.steps[RIG_PARAMETERS.air], strict=True)
    ]
    by_place = [(seen(rig, moved(board, step), corners) - now) / float(step.sum()) for step in np.diag(_BOARD_STEPS)]
    return ViewSlopes(
        np.concatenate([view.left_px.ravel(), view.right_px.ravel()]) - now,
        np.stack([*by_rig, *(bent(k) for k in range(SHAPES))], 1),
        np.stack(by_place, 1),
        (seen(rig, board, corners + SCALE_STEP * (corners - bend.middle)) - now) / SCALE_STEP,
    )


def seen(rig: StereoRig, board: tuple[Array, Array], corners_mm: Array) -> Array:
    """Return pixels (4 n,) of a board in both cameras."""
    points = corners_mm @ board[0].T + board[1]
    return np.concatenate([_in_air(camera, points).ravel() for camera in (rig.left, rig.right)])


def moved(board: tuple[Array, Array], x: Array) -> tuple[Array, Array]:
    """Return a board's place turned by x[:3] (rad) about its own axes and shifted by x[3:] (mm)."""
    return board[0] @ rotation_matrix(x[:3]), board[1] + x[3:]


def each_changed(rig: StereoRig, at: Array | None = None) -> list[StereoRig]:
    """Return ``rig`` changed by ``at`` (22,), and by each of the 22 values a step more."""
    start = np.zeros(VALUES) if at is None else at
    steps = np.diag(RIG_PARAMETERS.steps[RIG_PARAMETERS.air])
    return [RIG_PARAMETERS.changed(rig, start + step, RIG_PARAMETERS.air) for step in steps]


def _in_air(camera: HousedCamera, points: Array) -> Array:
    local = (points - np.asarray(camera.translation_mm)) @ np.asarray(camera.rotation)
    return camera.lens.to_pixels(local[:, :2] / local[:, 2:])
