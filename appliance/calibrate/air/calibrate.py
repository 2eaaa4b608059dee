"""Owns the calibration in air: both lenses and their relative pose from views of a board, and how sure they are.

Views may differ: boards near and far, sharp and blurred, and some that one camera has alone.

What a view tells follows from its corners: their number and places are in the equations of the adjustment, and their
noise is estimated for each view and camera from what the adjustment leaves of it. A view that one camera has alone
tells about that camera's lens and about the board. OpenCV's calibration gives the start, one joint adjustment
(``adjustment``) the values and the covariance that the bundle in water needs as its prior.

It also owns whether the two pictures of a pair show one board: the cameras' relative pose by each pair, against that by
all others.

Each camera by itself tells where it sees the board in each picture. Two pictures of one moment give the cameras'
relative pose; two of different moments give something else each time. So the true pose is the one that most pairs agree
on, and a sequence in which a picture is missing agrees again where the pictures after it are paired one further on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import Adjusted, BoardTolerance, adjust, adjust_with_field
from appliance.calibrate.air.coverage import check_tilts
from appliance.calibrate.air.linearised import VALUES, BoardView, bend_of, each_changed, slopes
from appliance.calibrate.determined import UndeterminedError
from appliance.measure import (
    RIG_PARAMETERS,
    SIDES,
    AirField,
    HousedCamera,
    Lens,
    Port,
    StereoRig,
    matrix3,
    rotation_matrix,
)

Array = NDArray[np.float64]
Place = tuple[Array, Array]
"""Rotation (3, 3) and translation (3,) in mm, board to camera."""

ELSEWHERE = 1 / 40
"""Distance in image widths between where a pair's cameras see the board from which on it is another moment's; poses of
one camera by itself agree to a tenth of that."""
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
    """Number of pictures by which the right ones come later (positive) or earlier than their left ones from the first
    of ``elsewhere_px`` on; 0: it is not that."""


def pair_up(
    views: Sequence[BoardView], left: Mapping[str, Place], right: Mapping[str, Place], f_px: float, width_px: int
) -> Pairing:
    """Compare the relative poses of ``views``, in the order of their pictures: places by name, the right principal
    distance.

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
    # Pictures from the first wrong pair on that no pair of their own explains, and a later or earlier one of the other
    # camera does.
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
    """A left and a right picture: four corners as each camera by itself places them, and the relative pose that
    follows."""

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


MIN_VIEWS = 6
WORST_VIEW = 3.0
"""A view whose residual is this many times the median view's is left out."""
FAR_CORNER, LEAST_FAR_PX = 6.0, 0.1
"""A corner that is off by so many times the usual view's residual, and so many pixels, is left out alone."""
HALF_HIDDEN = 0.55
"""A view in which a camera sees less than this part of the corners of the fullest view is remarked upon."""
VAGUE = 0.05
"""Standard deviation of a principal distance, as a share of it, from which on it counts as not determined."""
NO_PORT = Port((0.0, 0.0, 1.0), 0.0, 0.0, 1.0)
MIN_PAIRS = 3
"""Fewest views that both cameras have: the pose between them is the pairs' alone."""
NOISE_ROUNDS = 3
"""Adjustments between which the noise of each view and camera is estimated anew; the third changes weights by a
percent."""
BELIEVED = 12.0
"""The usual noise counts as so many coordinates in each estimate, lest few corners that happen to fit get a large
weight."""
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


class AirCalibrationError(Exception):
    """The views do not suffice for a calibration in air; the text says why and what to do."""


@contextmanager
def determined_by(views: Sequence[BoardView], width_px: int, height_px: int) -> Iterator[None]:
    """Raise AirCalibrationError that names what ``views`` lack: at once where tilts are missing, else where the
    adjustment inside leaves something free."""
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
        f"{RIG_PARAMETERS.names[RIG_PARAMETERS.air][k]} better than ± {np.sqrt(covariance[k, k]):.3g} of {of:.4g}"
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
    """(n, 2)."""
    left_residual_px: Array
    """(n, 2): seen less computed."""
    right_residual_px: Array
    """(n, 2)."""
    remarks: tuple[str, ...] = ()
    """Oddities of the calibration, in words."""
    noise_px: tuple[float | None, float | None] = (None, None)
    """Each camera's noise of a corner as estimated, per coordinate; ``None`` where it has no view."""

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
    """(22, 22), in the units and order of ``RIG_PARAMETERS.air``: noise of the corners, tolerance of the board.

    What a lens does beyond the model is not in it.
    """
    residual_px: float
    """RMS per coordinate."""
    shapes_mm: Array
    """(``SHAPES``,): the board's shapes as adjusted (``linearised.Bend``).

    The first is its bow: how far its middle stands back.
    """
    left_out: tuple[str, ...]
    """Views that were not used, each with the reason in words."""
    views: tuple[FittedView, ...]
    """Views that were used. A camera that has no view of the board has no corners in it."""
    used: tuple[BoardView, ...]
    """The same as the adjustment had them: without corners that were left out."""
    field: AirField | None = None
    """Field of each lens beyond ``rig``, adjusted together with all else; ``None`` if it was not asked for."""

    @property
    def pairs(self) -> tuple[str, ...]:
        """Names of the views used that both cameras have."""
        return tuple(view.name for view in self.used if not _alone(view))

    @property
    def exchanged(self) -> bool:
        """True where the camera called right stands to the left of the other."""
        t = np.array(self.rig.right.translation_mm)
        # Across and to the left: cameras above each other are neither exchanged nor not.
        return bool(t[0] < -0.5 * np.linalg.norm(t))


def calibrate_air(
    views: Sequence[BoardView],
    width_px: int,
    height_px: int,
    tolerance: BoardTolerance | None = None,
    with_field: bool = True,
) -> AirCalibration:
    """Calibrate the pair in air from boards (twenty or so, tilted by up to 35°, filling the images).

    ``views`` are in the order of their pictures. Square pixels are assumed. ``tolerance`` ``None``: that of a good
    board. ``with_field``: adjust the lenses' fields, too, which takes a second. Raises AirCalibrationError when too few
    views remain, when a picture is missing among them, or when they do not determine the cameras.
    """
    left_out, usable = [], []
    for view in views:
        told = view.without(np.zeros(len(view.corners_mm), np.bool_))
        if len(told.corners_mm):
            usable.append(told)
        else:
            left_out.append(f"{view.name}: few corners of the board, or a single row of them; show more of it")
    with determined_by(usable, width_px, height_px):
        return _calibrated(usable, left_out, (width_px, height_px), tolerance or BoardTolerance(), with_field)


def check_pairs(views: Sequence[BoardView], width_px: int, height_px: int) -> None:
    """Raise AirCalibrationError where the first ``views`` already show that a picture is missing, before the others are
    looked at."""
    try:
        pairing = _start(views, width_px, height_px).pairing
    except (ValueError, cv2.error):
        return  # They tell too little yet.
    if pairing.further_on:
        _wrong_pairs(pairing)


def _calibrated(
    usable: list[BoardView],
    left_out: list[str],
    size_px: tuple[int, int],
    allowed: BoardTolerance,
    with_field: bool,
) -> AirCalibration:
    fullest = max((len(view.corners_mm) for view in usable), default=0)
    remarks = {view.name: (*_alone(view), *_thin(view, fullest)) for view in usable}
    # Outliers are taken out one view at a time, the worst first, and everything is adjusted anew: one bad view bends
    # all others, and most of what looks bad beside it is good without it.
    while True:
        _check_enough(usable, left_out)
        start = _start(usable, *size_px)
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
                usable[k] = usable[k].without(bad)
        usable = [view for view in usable if len(view.corners_mm)]
    return _result(adjusted, usable, noise, allowed, left_out, remarks, with_field)


def _alone(view: BoardView) -> tuple[str, ...]:
    sides = [side for side in SIDES if view.has(side).any()]
    return () if len(sides) == 2 else (f"only the {sides[0]} camera has it",)


def _thin(view: BoardView, most: int) -> tuple[str, ...]:
    """Return a remark on a view in which a camera sees much less of the board than is seen in others."""
    counts = [count for side in SIDES if (count := int(np.count_nonzero(view.has(side))))]
    if min(counts) >= HALF_HIDDEN * most:
        return ()
    return (f"a camera sees {min(counts)} corners, other views have up to {most}: the board is half hidden",)


def _check_enough(views: Sequence[BoardView], left_out: Sequence[str]) -> None:
    seen = {side: sum(bool(view.has(side).any()) for view in views) for side in SIDES}
    pairs = sum(not _alone(view) for view in views)
    if min(seen.values()) >= MIN_VIEWS and pairs >= MIN_PAIRS:
        return
    raise AirCalibrationError(
        f"the left camera has {seen['left']} usable views of the board, the right one {seen['right']}, and {pairs} are "
        "of both; "
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
    """Return OpenCV's separate calibrations, each from all that its camera saw, and the relative pose of the pairs that
    agree."""
    left, at_left = _lens(views, "left", width_px, height_px)
    right, at_right = _lens(views, "right", width_px, height_px)
    pairing = pair_up(views, at_left, at_right, right.lens.f_px[0], width_px)
    R, t = pairing.rotation, pairing.shift_mm
    rig = StereoRig(left, replace(right, rotation=matrix3(R), translation_mm=(float(t[0]), float(t[1]), float(t[2]))))
    boards = [
        at_left[v.name] if v.name in at_left else (R @ at_right[v.name][0], R @ at_right[v.name][1] + t) for v in views
    ]
    return _Start(rig, boards, pairing)


def _wrong_pairs(pairing: Pairing) -> dict[str, str]:
    """Return why pairs are not used, by name.

    Raises AirCalibrationError where a picture is missing, or hardly any pairs agree.
    """
    places = "the left and the right picture show the board at different places"
    elsewhere = pairing.elsewhere_px
    if elsewhere and (pairing.further_on or pairing.agreeing < MIN_PAIRS):
        name, far_px = next(iter(elsewhere.items()))
        later, side = ("later", "left") if pairing.further_on > 0 else ("earlier", "right")
        why = (
            f"from there on left pictures belong to right ones {abs(pairing.further_on)} {later}, so a {side} picture "
            "is missing there or before; "
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
    views: Sequence[BoardView], side: str, width_px: int, height_px: int
) -> tuple[HousedCamera, dict[str, Place]]:
    """Return one camera by itself, and where it sees each board, by the view's name."""
    names = [view.name for view in views if view.has(side).any()]
    sightings = [view.sighting(side) for view in views if view.has(side).any()]
    corners = [corners_mm.astype(np.float32) for corners_mm, _ in sightings]
    pixels = [px.astype(np.float32).reshape(-1, 1, 2) for _, px in sightings]
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
        name: (rotation_matrix(np.ravel(r)), np.asarray(np.ravel(t), np.float64))
        for name, r, t in zip(names, turns, shifts, strict=True)
    }
    return HousedCamera(width_px, height_px, lens, NO_PORT), places


# ------------------------------------------------------------------------------------------ weights


def _adjusted(start: _Start, views: Sequence[BoardView], allowed: BoardTolerance) -> tuple[Adjusted, list[Array]]:
    """Return the adjustment with each view weighted, and the noise (2,) of each, left and right; NaN where it has no
    view."""
    noise = [np.where([v.has(side).any() for side in SIDES], 1.0, np.nan) for v in views]
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
        rows = view.has(side)
        parts.append(np.repeat(np.where(rows, usual_px / sd if np.isfinite(sd) else 0.0, 0.0), 2))
    return np.concatenate(parts)


def _noise(residuals: Sequence[Array]) -> list[Array]:
    """Estimate the noise of a coordinate (2,) in each view, left and right, from residuals (n, 4); NaN where it has no
    view.

    A variance component for each, s² = (ν s₀² + Σ e²) / (ν + 2 n − 3): three of a pair's six values of place per
    camera.
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


# ------------------------------------------------------------------------------------------ result


def _result(
    adjusted: Adjusted,
    views: Sequence[BoardView],
    noise: Sequence[Array],
    allowed: BoardTolerance,
    left_out: Sequence[str],
    remarks: Mapping[str, tuple[str, ...]],
    with_field: bool,
) -> AirCalibration:
    usual = float(np.nanmedian(noise))
    weighted = [
        e.T.ravel() * np.repeat(usual / np.repeat(sd, 2), len(e))
        for e, sd in zip(adjusted.residuals, noise, strict=True)
    ]
    every, plain = np.concatenate(weighted), np.concatenate([e.ravel() for e in adjusted.residuals])
    count = np.count_nonzero(np.isfinite(every))
    # That of unit weight: coordinates less 22 parameters of the rig and six of each view.
    variance = float(np.nansum(every**2)) / (count - VALUES - 6 * len(views))
    covariance = np.asarray(np.linalg.inv(adjusted.information)[:VALUES, :VALUES] * variance, np.float64)
    check_certain(adjusted.rig, covariance)
    # Scale of the print: no image tells it, and every parameter that is a length follows it.
    covariance += allowed.scale**2 * np.outer(adjusted.by_scale, adjusted.by_scale)
    fitted = []
    for view, e, sd in zip(views, adjusted.residuals, noise, strict=True):
        left, right = view.has("left"), view.has("right")
        pixels = view.left_px[left], view.right_px[right], e[left, :2], e[right, 2:]
        known = tuple(None if np.isnan(one) else float(one) for one in sd)
        fitted.append(FittedView(view.name, *pixels, remarks[view.name], (known[0], known[1])))
    field = None
    if with_field:
        weights = [_weights(view, sd, usual) for view, sd in zip(views, noise, strict=True)]
        field = adjust_with_field(
            adjusted.rig,
            adjusted.boards,
            views,
            adjusted.shapes_mm,
            allowed.bow_mm,
            allowed.scale,
            float(np.sqrt(variance)),
            weights,
        )
    residual_px = float(np.sqrt(np.nanmean(plain**2)))
    return AirCalibration(
        adjusted.rig, covariance, residual_px, adjusted.shapes_mm, tuple(left_out), tuple(fitted), tuple(views), field
    )
