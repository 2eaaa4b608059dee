"""Owns the calibration in air from views that differ: boards near and far, sharp and blurred, and some that one camera has alone.

What a view tells follows from its corners: their number and places are in the equations of the adjustment, and their noise is
estimated for each view and camera from what the adjustment leaves of it. A view that one camera has alone tells about that
camera's lens and about the board. The instrument's own calibration asks for more (``adjustment``): there whoever holds the
board can be told to hold it better.

It also owns whether the two pictures of a pair show one board: the cameras' relative pose by each pair, against that by all others.

Each camera by itself tells where it sees the board in each picture. Two pictures of one moment give the cameras' relative pose; two of
different moments give something else each time. So the true pose is the one that most pairs agree on, and a sequence in which a
picture is missing agrees again where the pictures after it are paired one further on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import (
    FAR_CORNER,
    LEAST_FAR_PX,
    MIN_CORNERS,
    MIN_VIEWS,
    NO_PORT,
    WORST_VIEW,
    Adjusted,
    AirCalibration,
    AirCalibrationError,
    BoardTolerance,
    FittedView,
    adjust,
    check_certain,
    determined_by,
    in_one_row,
)
from appliance.calibrate.air.linearised import VALUES, BoardView, bend_of, each_changed, slopes
from appliance.measure import SIDES, HousedCamera, Lens, StereoRig, matrix3, rotation_matrix

Array = NDArray[np.float64]
Place = tuple[Array, Array]
"""Rotation (3, 3) and translation (3,) in mm, board to camera."""

ELSEWHERE = 1 / 40
"""Distance in image widths between where a pair's cameras see the board from which on it is another moment's; poses of one camera
by itself agree to a tenth of that."""
MOST_SHIFT = 2
"""Pictures by which one camera's may be off the other's."""
LEAST_SHIFTED = 2
"""Pairs that must agree one further on before a picture is called missing."""
HALF = 0.5
"""Share of the pairs that must agree as they are named; where fewer do, pairs further on are asked for the pose."""
EXCHANGED = 0.3
"""A pair is exchanged if its pose is so near the inverse of the usual one, in units of the baseline."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """The cameras' pose by pairs that agree, and pairs that do not."""

    rotation: Array
    """(3, 3), of the right camera's frame in that of the left one."""
    shift_mm: Array
    """(3,)."""
    agreeing: int
    """Number of pairs that agree."""
    exchanged: frozenset[str]
    """Names of the pairs that show the pose the other way round."""
    elsewhere_px: Mapping[str, float]
    """Name of each other pair that disagrees, in order, and how far apart its two cameras see the board."""
    further_on: int
    """Number of pictures by which the right ones come later (positive) or earlier than their left ones from the first of
    ``elsewhere_px`` on; 0: it is not that."""


def pair_up(
    views: Sequence[BoardView], left: Mapping[str, Place], right: Mapping[str, Place], f_px: float, width_px: int
) -> Pairing:
    """Compare the relative poses of ``views``, in the order of their pictures: places by name, the right principal distance.

    Raises ValueError where no view has both places.
    """
    of_left = [k for k, view in enumerate(views) if view.name in left]
    seen = [_Seen.of(views, left, right, i, j) for i in of_left for j in _near(i, len(views)) if views[j].name in right]
    as_named = np.array([one.left == one.right for one in seen], np.bool_)
    if not as_named.any():
        raise ValueError("no view has both places")
    corners = np.stack([one.corners_mm for one in seen])
    there = _pinhole(np.stack([one.there_mm for one in seen]), f_px)
    # How far each pair is off, (n, n), if the cameras stood to each other as by another pair.
    off_px = np.stack([_rms_px(_pinhole((corners - one.shift_mm) @ one.rotation, f_px) - there) for one in seen])
    agrees = off_px < ELSEWHERE * width_px
    support = np.where(as_named, np.count_nonzero(agrees[:, as_named], axis=1), 0)
    if support.max() < HALF * np.count_nonzero(as_named):
        support = np.count_nonzero(agrees, axis=1)
    best = int(np.argmax(support))
    fellows = [one for one, agreed in zip(seen, agrees[best], strict=True) if agreed]
    R = rotation_matrix(np.median([np.ravel(cv2.Rodrigues(one.rotation)[0]) for one in fellows], axis=0))
    t = np.asarray(np.median([one.shift_mm for one in fellows], axis=0), np.float64)
    exchanged, elsewhere = [], {}
    for one, agreed, far_px in zip(seen, agrees[best], off_px[best], strict=True):
        name = views[one.left].name
        if one.left != one.right or agreed:
            continue
        if np.linalg.norm(one.shift_mm + R.T @ t) < EXCHANGED * np.linalg.norm(t):
            exchanged.append(name)
        else:
            elsewhere[name] = float(far_px)
    # Pictures from the first wrong pair on that no pair of their own explains, and a later or earlier one of the other camera does.
    fine = {one.left for one in fellows if one.left == one.right}
    first = min((k for k, view in enumerate(views) if view.name in elsewhere), default=len(views))
    steps = [
        one.right - one.left for one in fellows if one.left != one.right and one.left >= first and one.left not in fine
    ]
    further = max(set(steps), key=steps.count, default=0)
    enough = steps.count(further) >= max(LEAST_SHIFTED, HALF * (len(elsewhere) - MOST_SHIFT))
    agreeing = int(np.count_nonzero(agrees[best] & as_named))
    return Pairing(R, t, agreeing, frozenset(exchanged), elsewhere, further if enough else 0)


def _near(i: int, count: int) -> range:
    return range(max(0, i - MOST_SHIFT), min(count, i + MOST_SHIFT + 1))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A left and a right picture: four corners as each camera by itself places them, and the relative pose that follows."""

    left: int
    right: int
    rotation: Array
    shift_mm: Array
    corners_mm: Array
    """(4, 3), left camera's frame."""
    there_mm: Array
    """(4, 3), right camera's frame."""

    @classmethod
    def of(
        cls, views: Sequence[BoardView], left: Mapping[str, Place], right: Mapping[str, Place], i: int, j: int
    ) -> _Seen:
        (Rl, tl), (Rr, tr) = left[views[i].name], right[views[j].name]
        # Board → right → left must be board → left: R R_right = R_left, R t_right + t = t_left.
        R = Rl @ Rr.T
        few = _outermost(views[i].corners_mm)
        return cls(i, j, R, tl - R @ tr, few @ Rl.T + tl, few @ Rr.T + tr)


def _outermost(corners_mm: Array) -> Array:
    """Return the corners (4, 3) that reach farthest along both diagonals."""
    along = corners_mm[:, 0] + corners_mm[:, 1], corners_mm[:, 0] - corners_mm[:, 1]
    return corners_mm[[k for a in along for k in (int(a.argmin()), int(a.argmax()))]]


def _pinhole(points_mm: Array, f_px: float) -> Array:
    """Return pixels (…, 2) about the principal point; infinity behind the camera."""
    z = points_mm[..., 2:]
    ahead = np.where(z > 0.0, z, 1.0)
    return np.where(z > 0.0, f_px * points_mm[..., :2] / ahead, np.inf)


def _rms_px(off_px: Array) -> Array:
    """Return the root mean square distance of corners (n, 4, 2) as (n,); infinity for those behind a camera."""
    with np.errstate(invalid="ignore"):
        found = np.sqrt(np.mean(np.sum(off_px**2, axis=-1), axis=-1))
    return np.where(np.isfinite(found), found, np.inf)


MIN_PAIRS = 3
"""Fewest views that both cameras have: the pose between them is the pairs' alone."""
NOISE_ROUNDS = 3
"""Adjustments between which the noise of each view and camera is estimated anew; the third changes weights by a percent."""
BELIEVED = 12.0
"""The usual noise counts as so many coordinates in each estimate, lest few corners that happen to fit get a large weight."""
LEAST_NOISE = 0.25
"""Least noise of a view, in units of the usual: what is smaller is luck."""
GUESSES = (1.5, 0.7, 3.5)
"""Principal distances in image widths from which a lens is sought: usual, wide, and long."""
GOOD_START_PX = 2.0
"""Residual below which no other guess is tried."""
MOVED = 0.5
"""A board moved between the exposures if each camera by itself would leave less than this part of the residual."""
TO_SD = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute value."""


@dataclass(frozen=True, slots=True, eq=False)
class AnyCalibration:
    """A pair of cameras from views that differ."""

    air: AirCalibration
    """Lenses, pose, covariance. In its views a camera that has no view of the board has no corners."""
    noise_px: Mapping[str, tuple[float | None, float | None]]
    """Map from a view's name to each camera's noise of a corner as estimated, per coordinate; ``None`` where it has no view."""
    shapes_mm: Array
    """(``SHAPES``,): the board's shapes as adjusted (``linearised.Bend``)."""
    pairs: tuple[str, ...]
    """Names of the views used that both cameras have."""
    exchanged: bool
    """The camera called right stands to the left of the other."""


def view_of(
    name: str, board_mm: Array, left: Mapping[int, Array] | None, right: Mapping[int, Array] | None
) -> BoardView:
    """Return a view of a board with corners (n, 3): what each camera found, by number; NaN where it found none.

    A camera with fewer corners than tell its place, or with a single row of them, counts as having no view.
    """
    both = [{} if found is None or not _tell_place(board_mm[list(found)]) else found for found in (left, right)]
    numbers = sorted(both[0].keys() | both[1].keys())
    nowhere = np.full(2, np.nan)
    left_px, right_px = (np.array([found.get(n, nowhere) for n in numbers]).reshape(-1, 2) for found in both)
    return BoardView(name, board_mm[numbers], left_px, right_px)


def _tell_place(corners_mm: Array) -> bool:
    return len(corners_mm) >= MIN_CORNERS and not in_one_row(corners_mm)


def has(view: BoardView, side: str) -> NDArray[np.bool_]:
    """Tell which corners (n,) a camera sees."""
    return np.asarray(np.isfinite((view.left_px if side == "left" else view.right_px)[:, 0]))


def calibrate_any(
    views: Sequence[BoardView], width_px: int, height_px: int, tolerance: BoardTolerance | None = None
) -> AnyCalibration:
    """Calibrate two cameras in air from views of ``view_of``. Square pixels are assumed.

    ``views`` are in the order of their pictures. ``tolerance`` ``None``: that of a good board. Raises AirCalibrationError when too few
    views remain, when a picture is missing among them, or when they do not determine the cameras.
    """
    usable = [view for view in views if len(view.corners_mm)]
    with determined_by(usable, width_px, height_px):
        return _calibrated(usable, width_px, height_px, tolerance or BoardTolerance())


def check_pairs(views: Sequence[BoardView], width_px: int, height_px: int) -> None:
    """Raise AirCalibrationError where the first ``views`` already show that a picture is missing, before the others are looked at."""
    try:
        pairing = _start(views, width_px, height_px).pairing
    except (ValueError, cv2.error):
        return  # They tell too little yet.
    if pairing.further_on:
        _wrong_pairs(pairing)


def _calibrated(usable: list[BoardView], width_px: int, height_px: int, allowed: BoardTolerance) -> AnyCalibration:
    left_out: list[str] = []
    remarks: dict[str, tuple[str, ...]] = {view.name: _alone(view) for view in usable}
    while True:
        _check_enough(usable, left_out)
        start = _start(usable, width_px, height_px)
        wrong = _wrong_pairs(start.pairing)
        if wrong:
            left_out += wrong.values()
            usable = [view for view in usable if view.name not in wrong]
            continue
        adjusted, noise = _adjusted(start, usable, allowed)
        spread = np.array([_rms(e) for e in adjusted.residuals])
        usual, worst = float(np.median(spread)), int(np.argmax(spread))
        if spread[worst] > WORST_VIEW * usual:
            moved = _rms_alone(adjusted, worst, usable) < MOVED * spread[worst]
            # Blurred or far, a view tells less, which is what weights are for; one that moved tells something wrong.
            if moved or spread[worst] > WORST_VIEW**2 * usual:
                why = "the board moved between the cameras' exposures" if moved else "corners were mistaken"
                left_out.append(
                    f"{usable[worst].name}: residual {spread[worst]:.2f} px, the usual view has {usual:.2f} px; {why}"
                )
                del usable[worst]
                continue
        far = [_far(e) for e in adjusted.residuals]
        if not any(bad.any() for bad in far):
            break
        for k, bad in enumerate(far):
            if bad.any():
                most = float(np.nanmax(np.abs(adjusted.residuals[k][bad])))
                remarks[usable[k].name] += (f"{np.count_nonzero(bad)} corners left out, up to {most:.2f} px off",)
                usable[k] = _without(usable[k], bad)
        usable = [view for view in usable if len(view.corners_mm)]
    return _result(adjusted, usable, noise, allowed, left_out, remarks)


def _alone(view: BoardView) -> tuple[str, ...]:
    sides = [side for side in SIDES if has(view, side).any()]
    return () if len(sides) == 2 else (f"only the {sides[0]} camera has it",)


def _check_enough(views: Sequence[BoardView], left_out: Sequence[str]) -> None:
    seen = {side: sum(bool(has(view, side).any()) for view in views) for side in SIDES}
    pairs = sum(not _alone(view) for view in views)
    if min(seen.values()) >= MIN_VIEWS and pairs >= MIN_PAIRS:
        return
    raise AirCalibrationError(
        f"the left camera has {seen['left']} usable views of the board, the right one {seen['right']}, and {pairs} are of both; "
        f"{MIN_VIEWS} of each camera and {MIN_PAIRS} of both are needed; give more"
        + (f" ({'; '.join(left_out)})" if left_out else "")
    )


# ------------------------------------------------------------------------------------------ start


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    rig: StereoRig
    boards: list[Place]
    pairing: Pairing


def _start(views: Sequence[BoardView], width_px: int, height_px: int) -> _Start:
    """Return OpenCV's separate calibrations, each from all that its camera saw, and the relative pose of the pairs that agree."""
    left, at_left = _lens([(v, has(v, "left"), v.left_px) for v in views], width_px, height_px)
    right, at_right = _lens([(v, has(v, "right"), v.right_px) for v in views], width_px, height_px)
    pairing = pair_up(views, at_left, at_right, right.lens.f_px[0], width_px)
    R, t = pairing.rotation, pairing.shift_mm
    rig = StereoRig(left, replace(right, rotation=matrix3(R), translation_mm=(float(t[0]), float(t[1]), float(t[2]))))
    boards = [
        at_left[v.name] if v.name in at_left else (R @ at_right[v.name][0], R @ at_right[v.name][1] + t) for v in views
    ]
    return _Start(rig, boards, pairing)


def _wrong_pairs(pairing: Pairing) -> dict[str, str]:
    """Return why pairs are not used, by name. Raises AirCalibrationError where a picture is missing, or hardly any pairs agree."""
    places = "the left and the right picture show the board at different places"
    elsewhere = pairing.elsewhere_px
    if elsewhere and (pairing.further_on or pairing.agreeing < MIN_PAIRS):
        name, far_px = next(iter(elsewhere.items()))
        later, side = ("later", "left") if pairing.further_on > 0 else ("earlier", "right")
        why = (
            f"from there on left pictures belong to right ones {abs(pairing.further_on)} {later}, so a {side} picture is missing there or before; "
            "add it, or remove the other one of its pair, and number the pictures after it anew"
            if pairing.further_on
            else f"only {pairing.agreeing} agree on how the cameras stand to each other, {MIN_PAIRS} must; give pictures that were taken at "
            "the same moment"
        )
        raise AirCalibrationError(
            f"pair {name}: {places}, {far_px:.0f} px apart, and so do {len(elsewhere) - 1} other pairs: {why}"
        )
    return {
        **{
            name: f"{name}: its left and right pictures are exchanged; name them the other way round"
            for name in pairing.exchanged
        },
        **{
            name: f"{name}: {places}, {far_px:.0f} px apart; they were not taken at the same moment"
            for name, far_px in elsewhere.items()
        },
    }


def _lens(
    seen: Sequence[tuple[BoardView, NDArray[np.bool_], Array]], width_px: int, height_px: int
) -> tuple[HousedCamera, dict[str, Place]]:
    """Return one camera by itself, and where it sees each board, by the view's name."""
    with_board = [(view, rows, px) for view, rows, px in seen if rows.any()]
    corners = [view.corners_mm[rows].astype(np.float32) for view, rows, _ in with_board]
    pixels = [px[rows].astype(np.float32).reshape(-1, 1, 2) for _, rows, px in with_board]
    # Square pixels: f_y = f_x. Without it a board that never leans about one axis lets the ratio drift.
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    best = None
    for guess in GUESSES:
        f_px = guess * width_px
        matrix = np.array([[f_px, 0, (width_px - 1) / 2], [0, f_px, (height_px - 1) / 2], [0, 0, 1]])
        found = cv2.calibrateCamera(corners, pixels, (width_px, height_px), matrix, np.zeros(5), flags=flags)
        if best is None or found[0] < best[0]:
            best = found
        if best[0] < GOOD_START_PX:
            break
    assert best is not None
    _, matrix, brown, turns, shifts = best
    k1, k2, p1, p2, k3 = (float(k) for k in np.ravel(brown)[:5])
    lens = Lens((float(matrix[0, 0]),) * 2, (float(matrix[0, 2]), float(matrix[1, 2])), (k1, k2, p1, p2, k3))
    places = {
        view.name: (rotation_matrix(np.ravel(r)), np.asarray(np.ravel(t), np.float64))
        for (view, _, _), r, t in zip(with_board, turns, shifts, strict=True)
    }
    return HousedCamera(width_px, height_px, lens, NO_PORT), places


# ------------------------------------------------------------------------------------------ weights


def _adjusted(start: _Start, views: Sequence[BoardView], allowed: BoardTolerance) -> tuple[Adjusted, list[Array]]:
    """Return the adjustment with each view weighted, and the noise (2,) of each, left and right; NaN where it has no view."""
    noise = [np.where([has(v, side).any() for side in SIDES], 1.0, np.nan) for v in views]
    rig, boards = start.rig, start.boards
    adjusted: Adjusted | None = None
    for _ in range(NOISE_ROUNDS):
        usual = float(np.nanmedian(noise))
        adjusted = adjust(
            rig, boards, views, allowed, [_weights(v, sd, usual) for v, sd in zip(views, noise, strict=True)]
        )
        rig, boards = adjusted.rig, adjusted.boards
        noise = _noise(adjusted.residuals)
    assert adjusted is not None
    return adjusted, noise


def _weights(view: BoardView, noise_px: Array, usual_px: float) -> Array:
    """Return the weight of each coordinate (4 n,), zero where it was not seen."""
    parts = []
    for sd, side in zip(noise_px, SIDES, strict=True):
        rows = has(view, side)
        parts.append(np.repeat(np.where(rows, usual_px / sd if np.isfinite(sd) else 0.0, 0.0), 2))
    return np.concatenate(parts)


def _noise(residuals: Sequence[Array]) -> list[Array]:
    """Estimate the noise of a coordinate (2,) in each view, left and right, from residuals (n, 4); NaN where it has no view.

    A variance component for each, s² = (ν s₀² + Σ e²) / (ν + 2 n − 3): three of a pair's six values of place per camera.
    """
    found = []
    usual = float(
        np.sqrt(np.nanmedian([np.nanmean(part**2) for e in residuals for part in _sides(e) if np.isfinite(part).any()]))
    )
    for e in residuals:
        sd = []
        for part in _sides(e):
            count = np.count_nonzero(np.isfinite(part))
            variance = (BELIEVED * usual**2 + float(np.nansum(part**2))) / (BELIEVED + count - 3)
            sd.append(max(float(np.sqrt(variance)), LEAST_NOISE * usual) if count else np.nan)
        found.append(np.array(sd))
    return found


def _sides(residual: Array) -> tuple[Array, Array]:
    return residual[:, :2], residual[:, 2:]


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _rms_alone(adjusted: Adjusted, k: int, views: Sequence[BoardView]) -> float:
    """Return what would be left of view ``k`` if each camera might put the board where it likes: RMS per coordinate."""
    view, rig = views[k], adjusted.rig
    found = slopes(rig, each_changed(rig), adjusted.boards[k], view, bend_of(views), adjusted.shapes_mm)
    left = []
    for rows in np.split(np.arange(len(found.residual)), 2):
        seen = rows[np.isfinite(found.residual[rows])]
        if len(seen):
            B, r = found.by_place[seen], found.residual[seen]
            left.append(r - B @ np.linalg.lstsq(B, r)[0])
    return _rms(np.concatenate(left))


def _far(residual: Array) -> NDArray[np.bool_]:
    """Tell which corners (n,) are too far off, by residuals (n, 4), to be noise of their view and camera."""
    bad = np.zeros(len(residual), np.bool_)
    for part in _sides(residual):
        size = np.abs(part)
        if np.isfinite(size).any():
            # By the median, which the far ones themselves hardly change.
            limit = max(FAR_CORNER * TO_SD * float(np.nanmedian(size)), LEAST_FAR_PX)
            with np.errstate(invalid="ignore"):
                bad |= np.any(size > limit, axis=1)
    return bad


def _without(view: BoardView, bad: NDArray[np.bool_]) -> BoardView:
    """Return a view without its ``bad`` corners (n,), and without a camera whose other corners do not tell its place."""
    corners_mm, both = view.corners_mm[~bad], [view.left_px[~bad], view.right_px[~bad]]
    told = [px if _tell_place(corners_mm[np.isfinite(px[:, 0])]) else np.full_like(px, np.nan) for px in both]
    seen = np.isfinite(told[0][:, 0]) | np.isfinite(told[1][:, 0])
    return BoardView(view.name, corners_mm[seen], told[0][seen], told[1][seen])


# ------------------------------------------------------------------------------------------ result


def _result(
    adjusted: Adjusted,
    views: Sequence[BoardView],
    noise: Sequence[Array],
    allowed: BoardTolerance,
    left_out: Sequence[str],
    remarks: Mapping[str, tuple[str, ...]],
) -> AnyCalibration:
    usual = float(np.nanmedian(noise))
    weighted = [
        e.T.ravel() * np.repeat(usual / np.repeat(sd, 2), len(e))
        for e, sd in zip(adjusted.residuals, noise, strict=True)
    ]
    every, plain = np.concatenate(weighted), np.concatenate([e.ravel() for e in adjusted.residuals])
    count = np.count_nonzero(np.isfinite(every))
    variance = float(np.nansum(every**2)) / (count - VALUES - 6 * len(views))
    covariance = np.asarray(np.linalg.inv(adjusted.information)[:VALUES, :VALUES] * variance, np.float64)
    check_certain(adjusted.rig, covariance)
    # Scale of the print: no image tells it, and every parameter that is a length follows it.
    covariance += allowed.scale**2 * np.outer(adjusted.by_scale, adjusted.by_scale)
    fitted = []
    for view, e in zip(views, adjusted.residuals, strict=True):
        left, right = has(view, "left"), has(view, "right")
        fitted.append(
            FittedView(
                view.name, view.left_px[left], view.right_px[right], e[left, :2], e[right, 2:], remarks[view.name]
            )
        )
    residual_px = float(np.sqrt(np.nanmean(plain**2)))
    bow_mm = float(adjusted.shapes_mm[0])
    air = AirCalibration(adjusted.rig, covariance, residual_px, bow_mm, tuple(left_out), tuple(fitted))
    known = {
        view.name: (None if np.isnan(sd[0]) else float(sd[0]), None if np.isnan(sd[1]) else float(sd[1]))
        for view, sd in zip(views, noise, strict=True)
    }
    t = np.array(adjusted.rig.right.translation_mm)
    # Across and to the left: cameras above each other are neither exchanged nor not.
    exchanged = bool(t[0] < -0.5 * np.linalg.norm(t))
    return AnyCalibration(
        air, known, adjusted.shapes_mm, tuple(view.name for view in views if not _alone(view)), exchanged
    )
