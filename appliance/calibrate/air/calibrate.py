"""Air calibration: lenses and extrinsics with their covariance from views of a board.

Views may differ: boards near and far, sharp and blurred, and some that only one camera sees. The number and positions
of corners enter the equations of the adjustment, and their noise is estimated for each view and camera from the
residuals. A view of one camera determines that camera's lens and the board's shape. OpenCV's calibration gives the
start; one joint adjustment (``adjustment``) gives the parameters and the covariance that the adjustment in water takes
as its prior.

``pair_up`` checks whether the two pictures of a pair show one board, before that. Each camera by itself gives the
board's pose in each picture. Two pictures of one moment give the cameras' extrinsics; two of different moments give
different poses each time. So the true extrinsics are those on which most pairs agree. In a sequence with a missing
picture, pairs agree again if the pictures after it are paired with the following ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import AirAdjustment, BoardTolerance, adjust, adjust_with_field
from appliance.calibrate.air.coverage import check_tilts
from appliance.calibrate.air.linearised import VALUES, BoardView, bend_of, linearise_view, rig_steps
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
BoardPose = tuple[Array, Array]
"""Rotation (3, 3) and translation (3,) in mm, board to camera."""

ELSEWHERE = 1 / 40
"""Distance in image widths between the positions of the board by a pair's two cameras above which the pictures are of
different moments; poses by one camera agree to a tenth of that."""
MOST_SHIFT = 2
"""Largest number of pictures by which one camera's may be offset from the other's."""
LEAST_SHIFTED = 2
"""Number of pairs that must agree with an offset before a picture is called missing."""
HALF = 0.5
"""Share of the pairs that must agree as they are named; with fewer, pairs with an offset determine the extrinsics."""
EXCHANGED = 0.3
"""Largest distance from the inverse of the usual translation, in baselines, of a pair whose pictures are exchanged."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """The cameras' extrinsics by pairs that agree, and the pairs that do not."""

    rotation: Array
    """(3, 3), of the right camera in the left camera frame."""
    shift_mm: Array
    """(3,)."""
    agreeing: int
    """Number of pairs that agree."""
    exchanged: frozenset[str]
    """Names of the pairs whose pictures are exchanged."""
    disagreeing_px: Mapping[str, float]
    """Distance between the board's positions by both cameras, by the name of each other pair that disagrees, in order.
    """
    picture_offset: int
    """Number of pictures by which the right ones come later (positive) or earlier than their left ones, from the first
    of ``disagreeing_px`` on; 0 without an offset."""


def pair_up(
    views: Sequence[BoardView],
    left: Mapping[str, BoardPose],
    right: Mapping[str, BoardPose],
    f_px: float,
    width_px: int,
) -> Pairing:
    """Compare the extrinsics by each pair of ``views``, which are in the order of their pictures.

    ``left`` and ``right`` are board poses by view name; ``f_px`` is the right principal distance. Raises ValueError
    where no view has both poses.
    """
    left_numbers = [k for k, view in enumerate(views) if view.name in left]
    pairs = [
        _PicturePair.of(views, left, right, i, j)
        for i in left_numbers
        for j in _near(i, len(views))
        if views[j].name in right
    ]
    as_named = np.array([pair.left == pair.right for pair in pairs], np.bool_)
    if not as_named.any():
        raise ValueError("no view has the board in both images")
    corners = np.stack([pair.corners_mm for pair in pairs])
    right_px = _pinhole(np.stack([pair.right_mm for pair in pairs]), f_px)
    # Error of each pair, (n, n), with the extrinsics by each other pair.
    error_px = np.stack(
        [_rms_px(_pinhole((corners - pair.shift_mm) @ pair.rotation, f_px) - right_px) for pair in pairs]
    )
    agrees = error_px < ELSEWHERE * width_px
    support = np.where(as_named, np.count_nonzero(agrees[:, as_named], axis=1), 0)
    if support.max() < HALF * np.count_nonzero(as_named):
        support = np.count_nonzero(agrees, axis=1)
    best = int(np.argmax(support))
    agreeing_pairs = [pair for pair, agreed in zip(pairs, agrees[best], strict=True) if agreed]
    R = rotation_matrix(np.median([np.ravel(cv2.Rodrigues(pair.rotation)[0]) for pair in agreeing_pairs], axis=0))
    t = np.asarray(np.median([pair.shift_mm for pair in agreeing_pairs], axis=0), np.float64)
    exchanged, disagreeing = [], {}
    for pair, agreed, far_px in zip(pairs, agrees[best], error_px[best], strict=True):
        name = views[pair.left].name
        if pair.left != pair.right or agreed:
            continue
        if np.linalg.norm(pair.shift_mm + R.T @ t) < EXCHANGED * np.linalg.norm(t):
            exchanged.append(name)
        else:
            disagreeing[name] = float(far_px)
    # Offsets of the pictures from the first disagreeing pair on which agree only with a later or earlier picture of the
    # other camera.
    explained = {pair.left for pair in agreeing_pairs if pair.left == pair.right}
    first = min((k for k, view in enumerate(views) if view.name in disagreeing), default=len(views))
    steps = [
        pair.right - pair.left
        for pair in agreeing_pairs
        if pair.left != pair.right and pair.left >= first and pair.left not in explained
    ]
    offset = max(set(steps), key=steps.count, default=0)
    is_certain = steps.count(offset) >= max(LEAST_SHIFTED, HALF * (len(disagreeing) - MOST_SHIFT))
    agreeing = int(np.count_nonzero(agrees[best] & as_named))
    return Pairing(R, t, agreeing, frozenset(exchanged), disagreeing, offset if is_certain else 0)


def _near(i: int, count: int) -> range:
    return range(max(0, i - MOST_SHIFT), min(count, i + MOST_SHIFT + 1))


@dataclass(frozen=True, slots=True, eq=False)
class _PicturePair:
    """Four corners of a left and a right picture, and the extrinsics that follow from them."""

    left: int
    right: int
    rotation: Array
    shift_mm: Array
    corners_mm: Array
    """(4, 3), left camera's frame."""
    right_mm: Array
    """(4, 3), right camera's frame."""

    @classmethod
    def of(
        cls, views: Sequence[BoardView], left: Mapping[str, BoardPose], right: Mapping[str, BoardPose], i: int, j: int
    ) -> _PicturePair:
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
    """Return pixels (…, 2) relative to the principal point; infinity behind the camera."""
    z = points_mm[..., 2:]
    ahead = np.where(z > 0.0, z, 1.0)
    return np.where(z > 0.0, f_px * points_mm[..., :2] / ahead, np.inf)


def _rms_px(errors_px: Array) -> Array:
    """Return the root mean square distance (n,) of corners (n, 4, 2); infinity for those behind a camera."""
    with np.errstate(invalid="ignore"):
        rms = np.sqrt(np.mean(np.sum(errors_px**2, axis=-1), axis=-1))
    return np.where(np.isfinite(rms), rms, np.inf)


MIN_VIEWS = 6
WORST_VIEW = 3.0
"""A view is left out if its residual is this many times that of the median view."""
FAR_CORNER, LEAST_FAR_PX = 6.0, 0.1
"""A corner is left out if its residual exceeds both this many times that of the view, and this many pixels."""
HALF_HIDDEN = 0.55
"""Share of the corners of the fullest view below which a view gets a remark."""
VAGUE = 0.05
"""Relative standard deviation of a principal distance or the baseline above which it counts as not determined."""
NO_PORT = Port((0.0, 0.0, 1.0), 0.0, 0.0, 1.0)
MIN_PAIRS = 3
"""Least number of views that both cameras have; only they determine the extrinsics."""
NOISE_ROUNDS = 3
"""Number of adjustments, each with the noise of each view and camera estimated anew; the third changes weights by 1 %.
"""
BELIEVED = 12.0
"""Number of coordinates for which the usual noise counts in each estimate, so that a few corners that happen to fit do
not get a large weight."""
LEAST_NOISE = 0.25
"""Least noise of a view, in units of the usual noise; smaller estimates are chance."""
GUESSES = (1.5, 0.7, 3.5)
"""Principal distances in image widths from which the calibration of a lens starts: usual, wide, and long."""
GOOD_START_PX = 2.0
"""Residual below which no other guess is tried."""
MOVED = 0.5
"""Share of the residual below which each camera by itself must come for a board that moved between the exposures."""
MAD_TO_SD = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute value."""


class AirCalibrationError(Exception):
    """Error of views that do not suffice for an air calibration; the text says why and the remedy."""


@contextmanager
def require_observable(views: Sequence[BoardView], width_px: int, height_px: int) -> Iterator[None]:
    """Raise AirCalibrationError that names the tilts or parameters which ``views`` leave open.

    It is raised at once where tilts are missing, else where the adjustment inside the block leaves a parameter free.
    """
    tilts, is_enough = check_tilts(views, width_px, height_px)
    # With too few views, their number is reported first.
    if not is_enough and len(views) >= MIN_VIEWS:
        raise AirCalibrationError(f"tilt missing: {tilts}")
    try:
        yield
    except UndeterminedError as error:
        raise AirCalibrationError(
            f"the views do not determine {', '.join(error.names)}: {tilts}; hold it near and far, and in every corner"
        ) from error
    except cv2.error as error:
        raise AirCalibrationError(
            f"OpenCV finds no intrinsics that fit the views ({' '.join(str(error).split())[:120]}): {tilts}"
        ) from error


def check_certain(rig: StereoRig, covariance: Array) -> None:
    """Raise UndeterminedError where ``covariance`` (22, 22) leaves a principal distance or the baseline open."""
    base_mm = float(np.linalg.norm(rig.right.translation_mm))
    lengths = {0: rig.left.lens.f_px[0], 8: rig.right.lens.f_px[0], **dict.fromkeys((19, 20, 21), base_mm)}
    vague = [
        f"{RIG_PARAMETERS.names[RIG_PARAMETERS.air][k]} better than ± {np.sqrt(covariance[k, k]):.3g} of {length:.4g}"
        for k, length in lengths.items()
        if not np.sqrt(covariance[k, k]) < VAGUE * abs(length)
    ]
    if vague:
        raise UndeterminedError(vague)


@dataclass(frozen=True, slots=True, eq=False)
class FittedView:
    """A view that was used, with its residuals after the adjustment."""

    name: str
    left_px: Array
    """(n, 2): observed corners."""
    right_px: Array
    """(n, 2)."""
    left_residual_px: Array
    """(n, 2): observed minus computed."""
    right_residual_px: Array
    """(n, 2)."""
    remarks: tuple[str, ...] = ()
    """Remarks on the view, in words."""
    noise_px: tuple[float | None, float | None] = (None, None)
    """Estimated noise of a corner in each camera, per coordinate; ``None`` where it has no view."""

    @property
    def residual_px(self) -> float:
        """RMS per coordinate."""
        return float(np.sqrt(np.mean(np.concatenate([self.left_residual_px, self.right_residual_px]) ** 2)))


@dataclass(frozen=True, slots=True, eq=False)
class AirCalibration:
    """Calibration of a stereo pair in air: both lenses and the extrinsics, with covariance."""

    rig: StereoRig
    """Rig whose ports have no thickness and no distance: air."""
    covariance: Array
    """(22, 22), in the units and order of ``RIG_PARAMETERS.air``: noise of the corners, tolerance of the board.

    Errors of a lens beyond the model are not in it.
    """
    residual_px: float
    """RMS per coordinate."""
    shapes_mm: Array
    """(``SHAPES``,): the board's shapes as adjusted (``linearised.Bend``); the first is the bow."""
    left_out: tuple[str, ...]
    """Views that were not used, each with the reason in words."""
    views: tuple[FittedView, ...]
    """Used views; without corners of a camera that does not see the board."""
    used: tuple[BoardView, ...]
    """Used views as the adjustment took them, without corners that were left out."""
    field: AirField | None = None
    """Field of each lens beyond ``rig``, adjusted together with it; ``None`` without ``with_field``."""

    @property
    def pairs(self) -> tuple[str, ...]:
        """Names of the used views that both cameras have."""
        return tuple(view.name for view in self.used if not _single_camera(view))

    @property
    def exchanged(self) -> bool:
        """True where the right camera stands to the left of the other."""
        t = np.array(self.rig.right.translation_mm)
        # Mainly to the left: for cameras above each other the question has no meaning.
        return bool(t[0] < -0.5 * np.linalg.norm(t))


def calibrate_air(
    views: Sequence[BoardView],
    width_px: int,
    height_px: int,
    tolerance: BoardTolerance | None = None,
    with_field: bool = True,
) -> AirCalibration:
    """Calibrate a stereo pair in air from twenty or so views of a board, tilted by up to 35°.

    The boards should fill the images. ``views`` are in the order of their pictures. Square pixels are assumed.
    ``tolerance`` ``None`` is that of a good board. ``with_field`` adjusts the lenses' fields, too, which takes a
    second. Raises AirCalibrationError when too few views remain, when a picture is missing among them, or when they do
    not determine the cameras.
    """
    left_out, usable = [], []
    for view in views:
        determined_view = view.without(np.zeros(len(view.corners_mm), np.bool_))
        if len(determined_view.corners_mm):
            usable.append(determined_view)
        else:
            left_out.append(f"{view.name}: few corners of the board, or a single row; bring more of it into view")
    with require_observable(usable, width_px, height_px):
        return _calibrate(usable, left_out, (width_px, height_px), tolerance or BoardTolerance(), with_field)


def check_pairs(views: Sequence[BoardView], width_px: int, height_px: int) -> None:
    """Raise AirCalibrationError where the first ``views`` show that a picture is missing, before all are searched."""
    try:
        pairing = _start(views, width_px, height_px).pairing
    except (ValueError, cv2.error):
        return  # too few views yet
    if pairing.picture_offset:
        _wrong_pairs(pairing)


def _calibrate(
    usable: list[BoardView],
    left_out: list[str],
    size_px: tuple[int, int],
    allowed: BoardTolerance,
    with_field: bool,
) -> AirCalibration:
    fullest = max((len(view.corners_mm) for view in usable), default=0)
    remarks = {view.name: (*_single_camera(view), *_half_hidden(view, fullest)) for view in usable}
    # Outliers are left out one view at a time, the worst first, and all is adjusted anew: one bad view spoils the
    # residuals of others, most of which are good without it.
    while True:
        _check_enough(usable, left_out)
        start = _start(usable, *size_px)
        wrong_pairs = _wrong_pairs(start.pairing)
        if wrong_pairs:
            left_out += wrong_pairs.values()
            usable = [view for view in usable if view.name not in wrong_pairs]
            continue
        adjusted, noise = _adjust_weighted(start, usable, allowed)
        rms_px = np.array([_rms(e) for e in adjusted.residuals])
        usual_px, worst = float(np.median(rms_px)), int(np.argmax(rms_px))
        if rms_px[worst] > WORST_VIEW * usual_px:
            has_moved = _rms_alone(adjusted, worst, usable) < MOVED * rms_px[worst]
            # A blurred or far view is only less accurate and gets a smaller weight; a board that moved is an error.
            if has_moved or rms_px[worst] > WORST_VIEW**2 * usual_px:
                cause = "the board moved between the cameras' exposures" if has_moved else "corners are misdetected"
                left_out.append(
                    f"{usable[worst].name}: residual {rms_px[worst]:.2f} px, the median view has "
                    f"{usual_px:.2f} px; {cause}"
                )
                del usable[worst]
                continue
        is_outlier = [_outlying_corners(e) for e in adjusted.residuals]
        if not any(bad.any() for bad in is_outlier):
            break
        for k, bad in enumerate(is_outlier):
            if bad.any():
                largest_px = float(np.nanmax(np.abs(adjusted.residuals[k][bad])))
                remarks[usable[k].name] += (f"{np.count_nonzero(bad)} corners left out, up to {largest_px:.2f} px off",)
                usable[k] = usable[k].without(bad)
        usable = [view for view in usable if len(view.corners_mm)]
    return _result(adjusted, usable, noise, allowed, left_out, remarks, with_field)


def _single_camera(view: BoardView) -> tuple[str, ...]:
    sides = [side for side in SIDES if view.has(side).any()]
    return () if len(sides) == 2 else (f"only the {sides[0]} camera has this view",)


def _half_hidden(view: BoardView, fullest: int) -> tuple[str, ...]:
    """Return a remark on a view in which a camera sees much less of the board than in others."""
    counts = [count for side in SIDES if (count := int(np.count_nonzero(view.has(side))))]
    if min(counts) >= HALF_HIDDEN * fullest:
        return ()
    return (f"a camera sees {min(counts)} corners, other views up to {fullest}: the board is partly hidden",)


def _check_enough(views: Sequence[BoardView], left_out: Sequence[str]) -> None:
    counts = {side: sum(bool(view.has(side).any()) for view in views) for side in SIDES}
    pairs = sum(not _single_camera(view) for view in views)
    if min(counts.values()) >= MIN_VIEWS and pairs >= MIN_PAIRS:
        return
    raise AirCalibrationError(
        f"the left camera has {counts['left']} usable views of the board, the right one {counts['right']}, "
        f"both together {pairs}; "
        f"{MIN_VIEWS} of each camera and {MIN_PAIRS} of both are needed; give more"
        + (f" ({'; '.join(left_out)})" if left_out else "")
    )


# ------------------------------------------------------------------------------------------ start


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    rig: StereoRig
    boards: list[BoardPose]
    pairing: Pairing


def _start(views: Sequence[BoardView], width_px: int, height_px: int) -> _Start:
    """Return OpenCV's calibration of each camera from all its views, and the extrinsics of the pairs that agree."""
    left, left_poses = _calibrate_camera(views, "left", width_px, height_px)
    right, right_poses = _calibrate_camera(views, "right", width_px, height_px)
    pairing = pair_up(views, left_poses, right_poses, right.lens.f_px[0], width_px)
    R, t = pairing.rotation, pairing.shift_mm
    rig = StereoRig(left, replace(right, rotation=matrix3(R), translation_mm=(float(t[0]), float(t[1]), float(t[2]))))
    boards = [
        left_poses[v.name] if v.name in left_poses else (R @ right_poses[v.name][0], R @ right_poses[v.name][1] + t)
        for v in views
    ]
    return _Start(rig, boards, pairing)


def _wrong_pairs(pairing: Pairing) -> dict[str, str]:
    """Return why pairs are not used, by name.

    Raises AirCalibrationError where a picture is missing, or hardly any pairs agree.
    """
    symptom = "the left and the right image show the board in different poses"
    disagreeing = pairing.disagreeing_px
    if disagreeing and (pairing.picture_offset or pairing.agreeing < MIN_PAIRS):
        name, far_px = next(iter(disagreeing.items()))
        later, side = ("later", "left") if pairing.picture_offset > 0 else ("earlier", "right")
        cause = (
            f"from there on, left images belong to right ones {abs(pairing.picture_offset)} {later}, so a {side} "
            "image is missing there or before; add it, or remove the other one of its stereo pair, and "
            "renumber the images after it"
            if pairing.picture_offset
            else f"only {pairing.agreeing} stereo pairs agree on the extrinsics, {MIN_PAIRS} must; give images "
            "taken at the same moment"
        )
        raise AirCalibrationError(
            f"pair {name}: {symptom}, {far_px:.0f} px apart; so do {len(disagreeing) - 1} other stereo pairs: {cause}"
        )
    return {
        **{
            name: f"{name}: its left and right images are exchanged; exchange their names" for name in pairing.exchanged
        },
        **{
            name: f"{name}: {symptom}, {far_px:.0f} px apart; give images taken at the same moment"
            for name, far_px in disagreeing.items()
        },
    }


def _calibrate_camera(
    views: Sequence[BoardView], side: str, width_px: int, height_px: int
) -> tuple[HousedCamera, dict[str, BoardPose]]:
    """Return the calibration of one camera by itself, and the board's pose in each view, by the view's name."""
    names = [view.name for view in views if view.has(side).any()]
    sightings = [view.sighting(side) for view in views if view.has(side).any()]
    corners = [corners_mm.astype(np.float32) for corners_mm, _ in sightings]
    pixels = [px.astype(np.float32).reshape(-1, 1, 2) for _, px in sightings]
    # Square pixels: f_y = f_x. Otherwise a board that is never tilted about one axis leaves the ratio undetermined.
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO
    best = None
    for guess in GUESSES:
        f_px = guess * width_px
        matrix = np.array([[f_px, 0, (width_px - 1) / 2], [0, f_px, (height_px - 1) / 2], [0, 0, 1]])
        candidate = cv2.calibrateCamera(corners, pixels, (width_px, height_px), matrix, np.zeros(5), flags=flags)
        if best is None or candidate[0] < best[0]:
            best = candidate
        if best[0] < GOOD_START_PX:
            break
    assert best is not None
    _, matrix, brown, rotations, shifts = best
    k1, k2, p1, p2, k3 = (float(k) for k in np.ravel(brown)[:5])
    lens = Lens((float(matrix[0, 0]),) * 2, (float(matrix[0, 2]), float(matrix[1, 2])), (k1, k2, p1, p2, k3))
    poses = {
        name: (rotation_matrix(np.ravel(r)), np.asarray(np.ravel(t), np.float64))
        for name, r, t in zip(names, rotations, shifts, strict=True)
    }
    return HousedCamera(width_px, height_px, lens, NO_PORT), poses


# ------------------------------------------------------------------------------------------ weights


def _adjust_weighted(
    start: _Start, views: Sequence[BoardView], allowed: BoardTolerance
) -> tuple[AirAdjustment, list[Array]]:
    """Return the adjustment with weighted views, and the noise (2,) of each, left and right; NaN without a view."""
    noise = [np.where([v.has(side).any() for side in SIDES], 1.0, np.nan) for v in views]
    rig, boards = start.rig, start.boards
    adjusted: AirAdjustment | None = None
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
    """Estimate the noise of a coordinate (2,) in each view, left and right, from residuals (n, 4).

    NaN without a view. A variance component for each, s² = (ν s₀² + Σ e²) / (ν + 2 n − 3), where three of a pair's six
    parameters of pose count for each camera.
    """
    noise = []
    usual = float(
        np.sqrt(np.nanmedian([np.nanmean(part**2) for e in residuals for part in _sides(e) if np.isfinite(part).any()]))
    )
    for e in residuals:
        sd = []
        for part in _sides(e):
            count = np.count_nonzero(np.isfinite(part))
            variance = (BELIEVED * usual**2 + float(np.nansum(part**2))) / (BELIEVED + count - 3)
            sd.append(max(float(np.sqrt(variance)), LEAST_NOISE * usual) if count else np.nan)
        noise.append(np.array(sd))
    return noise


def _sides(residual: Array) -> tuple[Array, Array]:
    return residual[:, :2], residual[:, 2:]


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _rms_alone(adjusted: AirAdjustment, k: int, views: Sequence[BoardView]) -> float:
    """Return the RMS residual per coordinate of view ``k`` if each camera had its own pose of the board."""
    view, rig = views[k], adjusted.rig
    jacobian = linearise_view(rig, rig_steps(rig), adjusted.boards[k], view, bend_of(views), adjusted.shapes_mm)
    residuals = []
    for rows in np.split(np.arange(len(jacobian.residual)), 2):
        visible = rows[np.isfinite(jacobian.residual[rows])]
        if len(visible):
            B, r = jacobian.by_pose[visible], jacobian.residual[visible]
            residuals.append(r - B @ np.linalg.lstsq(B, r)[0])
    return _rms(np.concatenate(residuals))


def _outlying_corners(residual: Array) -> NDArray[np.bool_]:
    """Return which corners (n,) have residuals (n, 4) that are too large to be noise of their view and camera."""
    is_outlier = np.zeros(len(residual), np.bool_)
    for part in _sides(residual):
        magnitude = np.abs(part)
        if np.isfinite(magnitude).any():
            # By the median, which outliers hardly change.
            limit = max(FAR_CORNER * MAD_TO_SD * float(np.nanmedian(magnitude)), LEAST_FAR_PX)
            with np.errstate(invalid="ignore"):
                is_outlier |= np.any(magnitude > limit, axis=1)
    return is_outlier


# ------------------------------------------------------------------------------------------ result


def _result(
    adjusted: AirAdjustment,
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
    # Variance of unit weight: coordinates less 22 parameters of the rig and six of each view.
    variance = float(np.nansum(every**2)) / (count - VALUES - 6 * len(views))
    covariance = np.asarray(np.linalg.inv(adjusted.information)[:VALUES, :VALUES] * variance, np.float64)
    check_certain(adjusted.rig, covariance)
    # No image determines the scale of the print, and every parameter that is a length follows it.
    covariance += allowed.scale**2 * np.outer(adjusted.by_scale, adjusted.by_scale)
    fitted = []
    for view, e, sd in zip(views, adjusted.residuals, noise, strict=True):
        left, right = view.has("left"), view.has("right")
        pixels = view.left_px[left], view.right_px[right], e[left, :2], e[right, 2:]
        noise_px = tuple(None if np.isnan(value) else float(value) for value in sd)
        fitted.append(FittedView(view.name, *pixels, remarks[view.name], (noise_px[0], noise_px[1])))
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
