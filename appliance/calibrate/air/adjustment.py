"""Owns the calibration in air: the pinhole stereo pair with distortion from board corners, and how sure it is.

OpenCV's calibration gives the start and names bad views; one joint adjustment of both cameras, their relative pose
and all boards gives the values and the covariance of the twenty-two parameters that the bundle in water needs as its
prior. Boards are eliminated one by one (Schur complement), so that the number of views costs little.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.coverage import check_tilts
from appliance.calibrate.air.free_form import adjust_with_field
from appliance.calibrate.air.joint import BoardTolerance, adjust
from appliance.calibrate.air.linearised import VALUES, BoardView
from appliance.measure import (
    AIR,
    PARAMETER_NAMES,
    AirField,
    HousedCamera,
    Lens,
    Port,
    StereoRig,
    UndeterminedError,
    matrix3,
    rotation_matrix,
)

Array = NDArray[np.float64]

MIN_CORNERS = 12
MIN_VIEWS = 6
WORST_VIEW = 3.0
"""A view whose residual is this many times the median view's is left out."""
FAR_CORNER, LEAST_FAR_PX = 6.0, 0.1
"""A corner that is off by so many times the usual view's residual, and so many pixels, is left out alone."""
FEW = 0.2
"""Share of a view's corners that may be bad; with more, the view is bad."""
HALF = 0.55
"""A view with less than this part of the corners that the fullest view has is remarked upon."""
ONE_ROW = 1e-3
"""Spread of corners across their longest direction, as a share of that along it, below which they are in one row."""
VAGUE = 0.05
"""Standard deviation of a principal distance, as a share of it, from which on it counts as not determined."""
NO_PORT = Port((0.0, 0.0, 1.0), 0.0, 0.0, 1.0)


__all__ = ["AirCalibration", "AirCalibrationError", "BoardTolerance", "BoardView", "FittedView", "calibrate_air"]


class AirCalibrationError(Exception):
    """The views do not suffice for a calibration in air; the text says why and what to do."""


@contextmanager
def determined_by(views: Sequence[BoardView], width_px: int, height_px: int) -> Iterator[None]:
    """Raise AirCalibrationError that names what ``views`` lack: at once where tilts are missing, else where the adjustment inside
    leaves something free."""
    tilts, enough = check_tilts(views, width_px, height_px)
    # Of too few views their number is said first.
    if not enough and len(views) >= MIN_VIEWS:
        raise AirCalibrationError(f"tilt missing: {tilts}")
    try:
        yield
    except UndeterminedError as error:
        raise AirCalibrationError(
            f"the views do not determine {', '.join(error.names)}: {tilts}; hold it near and far, and in every corner"
        ) from error
    except cv2.error as error:
        raise AirCalibrationError(
            f"OpenCV finds no lens that fits the views ({' '.join(str(error).split())[:120]}): {tilts}"
        ) from error


def check_certain(rig: StereoRig, covariance: Array) -> None:
    """Raise UndeterminedError where ``covariance`` (22, 22) leaves a principal distance or the baseline open."""
    base_mm = float(np.linalg.norm(rig.right.translation_mm))
    known = {0: rig.left.lens.f_px[0], 8: rig.right.lens.f_px[0], **dict.fromkeys((19, 20, 21), base_mm)}
    vague = [
        f"{PARAMETER_NAMES[AIR][k]} better than ± {np.sqrt(covariance[k, k]):.3g} of {of:.4g}"
        for k, of in known.items()
        if not np.sqrt(covariance[k, k]) < VAGUE * abs(of)
    ]
    if vague:
        raise UndeterminedError(vague)


@dataclass(frozen=True, slots=True, eq=False)
class FittedView:
    """A view that was used, and what the adjustment left of it."""

    name: str
    left_px: Array
    """(n, 2): where corners were seen."""
    right_px: Array
    """(n, 2): the same corners."""
    left_residual_px: Array
    """(n, 2): seen less computed."""
    right_residual_px: Array
    """(n, 2)."""
    remarks: tuple[str, ...] = ()
    """Oddities of the calibration, in words."""

    @property
    def residual_px(self) -> float:
        """RMS per coordinate."""
        return float(np.sqrt(np.mean(np.concatenate([self.left_residual_px, self.right_residual_px]) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class AirCalibration:
    """The pair in air: both lenses and the right camera's pose, with covariance."""

    rig: StereoRig
    """Rig whose ports have no thickness and no distance: air."""
    covariance: Array
    """(22, 22), in the units and order of ``parameters.NAMES[AIR]``: noise of the corners, tolerance of the board. What a
    lens does beyond the model is not in it."""
    residual_px: float
    """RMS per coordinate."""
    board_bow_mm: float
    """Bow of the board as adjusted: how far its middle stands back, z = bow (1 − 2 r²/a²)."""
    left_out: tuple[str, ...]
    """Views that were not used, each with the reason in words."""
    views: tuple[FittedView, ...]
    """Views that were used."""
    field: AirField | None = None
    """Field of each lens beyond ``rig``, adjusted together with all else; ``None`` if it was not asked for."""


def calibrate_air(
    views: Sequence[BoardView],
    width_px: int,
    height_px: int,
    tolerance: BoardTolerance | None = None,
    with_field: bool = True,
) -> AirCalibration:
    """Calibrate the pair in air from boards (twenty or so, tilted by up to 35°, filling the images).

    Square pixels are assumed. ``tolerance`` ``None``: that of a good board. ``with_field``: adjust the lenses' fields, too,
    which takes a second. Raises AirCalibrationError when too few views remain, or these do not determine the cameras.
    """
    usable, left_out = [], []
    for view in views:
        if len(view.corners_mm) < MIN_CORNERS:
            left_out.append(
                f"{view.name}: {len(view.corners_mm)} corners seen by both cameras, {MIN_CORNERS} are needed"
            )
        elif in_one_row(view.corners_mm):
            left_out.append(f"{view.name}: the corners seen by both cameras are in one row; show more of the board")
        else:
            usable.append(view)
    with determined_by(usable, width_px, height_px):
        return _calibrated(usable, left_out, (width_px, height_px), tolerance or BoardTolerance(), with_field)


def in_one_row(corners_mm: Array) -> bool:
    """Tell whether corners (n, 3) lie on one line, about which the board's turn cannot be seen."""
    across = np.linalg.svd(corners_mm - corners_mm.mean(axis=0), compute_uv=False)
    return bool(across[1] < ONE_ROW * across[0])


def _calibrated(
    usable: list[BoardView],
    left_out: list[str],
    size_px: tuple[int, int],
    allowed: BoardTolerance,
    with_field: bool,
) -> AirCalibration:
    width_px, height_px = size_px
    most = max((len(view.corners_mm) for view in usable), default=0)
    remarks = {view.name: _thin(view, most) for view in usable}
    # Outliers are taken out one view at a time, the worst first, and everything is adjusted anew: one bad view bends
    # all others, and most of what looks bad beside it is good without it.
    while True:
        if len(usable) < MIN_VIEWS:
            reasons = "; ".join(left_out) or "none was left out"
            raise AirCalibrationError(
                f"{len(usable)} usable views of the board; {MIN_VIEWS} are needed; record more ({reasons})"
            )
        rig, boards = _start(usable, width_px, height_px)
        adjusted = adjust(rig, boards, usable, allowed)
        residuals = adjusted.residuals
        per_view = np.array([float(np.sqrt(np.mean(e**2))) for e in residuals])
        worst = int(np.argmax(per_view))
        usual = float(np.median(per_view))
        if per_view[worst] > WORST_VIEW * max(usual, 1e-6):
            bad = _bad_corners(residuals[worst], usual)
            # Many bad corners are a board that moved, a few are glare or a finger: these cost only the corners.
            if np.count_nonzero(bad) > FEW * len(bad) or len(bad) - np.count_nonzero(bad) < MIN_CORNERS:
                left_out.append(
                    f"{usable[worst].name}: residual {per_view[worst]:.2f} px, the usual view has {usual:.2f} px; "
                    f"the board moved between the cameras' exposures, or corners were mistaken"
                )
                del usable[worst]
                continue
        wrong = [_bad_corners(e, usual) for e in residuals]
        if not any(bad.any() for bad in wrong):
            break
        for k, bad in enumerate(wrong):
            if bad.any():
                far = float(np.abs(residuals[k][bad]).max())
                text = f"{np.count_nonzero(bad)} corners left out, up to {far:.2f} px off: glare, dirt, or a finger"
                remarks[usable[k].name] += (text,)
                usable[k] = _without(usable[k], bad)
        if any(len(view.corners_mm) < MIN_CORNERS for view in usable):
            few = [view for view in usable if len(view.corners_mm) < MIN_CORNERS]
            left_out += [f"{view.name}: only {len(view.corners_mm)} good corners are left" for view in few]
            usable = [view for view in usable if len(view.corners_mm) >= MIN_CORNERS]
    # Degrees of freedom: four numbers per corner, less 22 parameters of the rig and six of each view. The covariance is
    # that of unit weight times this variance.
    corners = sum(len(view.corners_mm) for view in usable)
    squares = float(sum(np.sum(e**2) for e in residuals))
    variance = squares / (4 * corners - VALUES - 6 * len(usable))
    covariance = np.asarray(np.linalg.inv(adjusted.information)[:22, :22] * variance, np.float64)
    check_certain(adjusted.rig, covariance)
    # Scale of the print: no image tells it, and every parameter that is a length follows it. It enters as one fully
    # correlated error.
    covariance += allowed.scale**2 * np.outer(adjusted.by_scale, adjusted.by_scale)
    fitted = tuple(
        FittedView(v.name, v.left_px, v.right_px, e[:, :2], e[:, 2:], remarks[v.name])
        for v, e in zip(usable, residuals, strict=True)
    )
    residual_px = float(np.sqrt(squares / (4 * corners)))
    field = None
    if with_field:
        field = adjust_with_field(
            adjusted.rig,
            adjusted.boards,
            usable,
            adjusted.shapes_mm,
            allowed.bow_mm,
            allowed.scale,
            float(np.sqrt(variance)),
        )
    bow_mm = float(adjusted.shapes_mm[0])
    return AirCalibration(adjusted.rig, covariance, residual_px, bow_mm, tuple(left_out), fitted, field)


def _thin(view: BoardView, most: int) -> tuple[str, ...]:
    """Return a remark on a view that shows much less of the board than the others."""
    count = len(view.corners_mm)
    if count >= HALF * most:
        return ()
    return (f"{count} corners are seen by both cameras, other views have up to {most}: the board is half hidden",)


def _bad_corners(residual: Array, usual_px: float) -> NDArray[np.bool_]:
    """Tell which corners (n,) of a view, residuals (n, 4), are too far off to be noise."""
    return np.asarray(np.abs(residual).max(axis=1) > max(FAR_CORNER * usual_px, LEAST_FAR_PX))


def _without(view: BoardView, bad: NDArray[np.bool_]) -> BoardView:
    return BoardView(view.name, view.corners_mm[~bad], view.left_px[~bad], view.right_px[~bad])


def _start(views: Sequence[BoardView], width_px: int, height_px: int) -> tuple[StereoRig, list[tuple[Array, Array]]]:
    """Return OpenCV's separate calibrations, and the median relative pose."""
    guess = np.array([[1.5 * width_px, 0, (width_px - 1) / 2], [0, 1.5 * width_px, (height_px - 1) / 2], [0, 0, 1]])
    corners = [v.corners_mm.astype(np.float32) for v in views]
    cameras, poses = [], []
    for side in ("left_px", "right_px"):
        seen = [np.asarray(getattr(v, side), np.float32).reshape(-1, 1, 2) for v in views]
        # Square pixels: f_y = f_x. Without it a board that never leans about one axis lets the ratio drift.
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
        _, matrix, brown, turns, shifts = cv2.calibrateCamera(
            corners, seen, (width_px, height_px), guess.copy(), np.zeros(5), flags=flags
        )
        k1, k2, p1, p2, k3 = (float(k) for k in np.ravel(brown)[:5])
        lens = Lens((float(matrix[0, 0]),) * 2, (float(matrix[0, 2]), float(matrix[1, 2])), (k1, k2, p1, p2, k3))
        cameras.append(HousedCamera(width_px, height_px, lens, NO_PORT))
        poses.append(
            [
                (rotation_matrix(np.ravel(r)), np.asarray(np.ravel(t), np.float64))
                for r, t in zip(turns, shifts, strict=True)
            ]
        )
    # Board → right → left must be board → left: R R_right = R_left, R t_right + t = t_left.
    vectors, shifts_mm = [], []
    for (Rl, tl), (Rr, tr) in zip(*poses, strict=True):
        R = Rl @ Rr.T
        vectors.append(np.ravel(cv2.Rodrigues(R)[0]))
        shifts_mm.append(tl - R @ tr)
    # The median over views is only a start for the joint adjustment, and one mistaken view must not spoil it.
    R = rotation_matrix(np.median(vectors, axis=0))
    t = np.median(shifts_mm, axis=0)
    right = replace(cameras[1], rotation=matrix3(R), translation_mm=(float(t[0]), float(t[1]), float(t[2])))
    return StereoRig(cameras[0], right), poses[0]
