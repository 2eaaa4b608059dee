"""Owns the calibration in air: the pinhole stereo pair with distortion from board corners, and how sure it is.

OpenCV's calibration gives the start and names bad views; one joint adjustment of both cameras, their relative pose
and all boards gives the values and the covariance of the twenty-two parameters that the bundle in water needs as its
prior. Boards are eliminated one by one (Schur complement), so that the number of views costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.parameters import AIR, COUNT, STEPS, matrix3, rig_with, rotation_of
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.pinhole import Lens
from appliance.optics.port import Port

Array = NDArray[np.float64]

MIN_CORNERS = 12
MIN_VIEWS = 6
WORST_VIEW = 3.0
"""A view whose residual is this many times the median view's is left out."""
STEPS_AT_MOST = 30
SMALL = 1e-4
"""The adjustment has converged when no parameter moves by more than this share of its standard deviation."""
NO_PORT = Port((0.0, 0.0, 1.0), 0.0, 0.0, 1.0)
_BOARD_STEPS = np.array([1e-6] * 3 + [1e-3] * 3)


class AirCalibrationError(Exception):
    """The views do not suffice for a calibration in air; the text says why and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """One board seen by both cameras at once: its corners in mm, and where each camera sees the same corners."""

    name: str
    corners_mm: Array
    """(n, 3), board frame, z = 0."""
    left_px: Array
    """(n, 2)."""
    right_px: Array
    """(n, 2)."""


@dataclass(frozen=True, slots=True, eq=False)
class AirCalibration:
    """The pair in air: both lenses and the right camera's pose, with covariance."""

    rig: StereoRig
    """Its ports have no thickness and no distance: air."""
    covariance: Array
    """(22, 22), in the units and order of ``parameters.NAMES[AIR]``."""
    residual_px: float
    """RMS per coordinate."""
    left_out: tuple[str, ...]
    """Views that were not used, each with the reason in words."""


def calibrate_air(views: Sequence[BoardView], width_px: int, height_px: int) -> AirCalibration:
    """Calibrate the pair in air from boards (twenty or so, tilted by up to 35°, filling the images).

    Square pixels are assumed. Raises AirCalibrationError when too few views remain.
    """
    usable, left_out = [], []
    for view in views:
        if len(view.corners_mm) < MIN_CORNERS:
            left_out.append(
                f"{view.name}: {len(view.corners_mm)} corners seen by both cameras, {MIN_CORNERS} are needed"
            )
        else:
            usable.append(view)
    while True:
        if len(usable) < MIN_VIEWS:
            reasons = "; ".join(left_out) or "none was left out"
            raise AirCalibrationError(
                f"{len(usable)} usable views of the board; {MIN_VIEWS} are needed; record more ({reasons})"
            )
        rig, boards = _start(usable, width_px, height_px)
        rig, boards, information, per_view = _adjust(rig, boards, usable)
        worst = int(np.argmax(per_view))
        usual = float(np.median(per_view))
        if per_view[worst] <= WORST_VIEW * max(usual, 1e-6):
            break
        left_out.append(
            f"{usable[worst].name}: residual {per_view[worst]:.2f} px, the usual view has {usual:.2f} px; "
            f"the board moved between the cameras' exposures, or corners were mistaken"
        )
        del usable[worst]
    corners = sum(len(view.corners_mm) for view in usable)
    squares = float(sum(p**2 * len(v.corners_mm) * 4 for p, v in zip(per_view, usable, strict=True)))
    variance = squares / (4 * corners - 22 - 6 * len(usable))
    covariance = np.asarray(np.linalg.inv(information) * variance, np.float64)
    return AirCalibration(rig, covariance, float(np.sqrt(squares / (4 * corners))), tuple(left_out))


def _start(views: Sequence[BoardView], width_px: int, height_px: int) -> tuple[StereoRig, list[tuple[Array, Array]]]:
    """OpenCV's separate calibrations, and the median relative pose."""
    guess = np.array([[1.5 * width_px, 0, (width_px - 1) / 2], [0, 1.5 * width_px, (height_px - 1) / 2], [0, 0, 1]])
    corners = [v.corners_mm.astype(np.float32) for v in views]
    cameras, poses = [], []
    for side in ("left_px", "right_px"):
        seen = [np.asarray(getattr(v, side), np.float32).reshape(-1, 1, 2) for v in views]
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
        _, matrix, brown, turns, shifts = cv2.calibrateCamera(
            corners, seen, (width_px, height_px), guess.copy(), np.zeros(5), flags=flags
        )
        k1, k2, p1, p2, k3 = (float(k) for k in np.ravel(brown)[:5])
        lens = Lens((float(matrix[0, 0]),) * 2, (float(matrix[0, 2]), float(matrix[1, 2])), (k1, k2, p1, p2, k3))
        cameras.append(HousedCamera(width_px, height_px, lens, NO_PORT))
        poses.append(
            [
                (rotation_of(np.ravel(r)), np.asarray(np.ravel(t), np.float64))
                for r, t in zip(turns, shifts, strict=True)
            ]
        )
    # Board → right → left must be board → left: R R_right = R_left, R t_right + t = t_left.
    vectors, shifts_mm = [], []
    for (Rl, tl), (Rr, tr) in zip(*poses, strict=True):
        R = Rl @ Rr.T
        vectors.append(np.ravel(cv2.Rodrigues(R)[0]))
        shifts_mm.append(tl - R @ tr)
    R = rotation_of(np.median(vectors, axis=0))
    t = np.median(shifts_mm, axis=0)
    right = replace(cameras[1], rotation=matrix3(R), translation_mm=(float(t[0]), float(t[1]), float(t[2])))
    return StereoRig(cameras[0], right), poses[0]


def _seen(rig: StereoRig, board: tuple[Array, Array], corners_mm: Array) -> Array:
    """Pixels (4 n,) of a board in both cameras."""
    points = corners_mm @ board[0].T + board[1]
    return np.concatenate([_in_air(camera, points).ravel() for camera in (rig.left, rig.right)])


def _in_air(camera: HousedCamera, points: Array) -> Array:
    local = (points - np.asarray(camera.translation_mm)) @ np.asarray(camera.rotation)
    return camera.lens.to_pixels(local[:, :2] / local[:, 2:])


def _moved(board: tuple[Array, Array], x: Array) -> tuple[Array, Array]:
    return board[0] @ rotation_of(x[:3]), board[1] + x[3:]


def _adjust(
    rig: StereoRig, boards: list[tuple[Array, Array]], views: Sequence[BoardView]
) -> tuple[StereoRig, list[tuple[Array, Array]], Array, Array]:
    """Gauss–Newton. Returns rig, boards, the information matrix (22, 22) for unit noise and residuals per view."""
    for _ in range(STEPS_AT_MOST):
        information, gradient = np.zeros((22, 22)), np.zeros(22)
        changed = []
        for k in range(AIR.start, AIR.stop):
            x = np.zeros(COUNT)
            x[k] = STEPS[k]
            changed.append(rig_with(rig, x))
        blocks, per_view = [], []
        for view, board in zip(views, boards, strict=True):
            now = _seen(rig, board, view.corners_mm)
            residual = np.concatenate([view.left_px.ravel(), view.right_px.ravel()]) - now
            A = np.stack(
                [(_seen(r, board, view.corners_mm) - now) / s for r, s in zip(changed, STEPS[AIR], strict=True)], 1
            )
            B = np.stack(
                [
                    (_seen(rig, _moved(board, np.eye(6)[i] * s), view.corners_mm) - now) / s
                    for i, s in enumerate(_BOARD_STEPS)
                ],
                1,
            )
            BB, BA, Br = B.T @ B, B.T @ A, B.T @ residual
            information += A.T @ A - BA.T @ np.linalg.solve(BB, BA)
            gradient += A.T @ residual - BA.T @ np.linalg.solve(BB, Br)
            blocks.append((BB, BA, Br))
            per_view.append(float(np.sqrt(np.mean(residual**2))))
        step = np.linalg.solve(information, gradient)
        full = np.zeros(COUNT)
        full[AIR] = step
        rig = rig_with(rig, full)
        boards = [
            _moved(board, np.linalg.solve(BB, Br - BA @ step))
            for board, (BB, BA, Br) in zip(boards, blocks, strict=True)
        ]
        sd = np.sqrt(np.diag(np.linalg.inv(information))) * float(np.median(per_view))
        if float(np.max(np.abs(step) / sd)) < SMALL:
            break
    return rig, boards, information, np.array(per_view)
