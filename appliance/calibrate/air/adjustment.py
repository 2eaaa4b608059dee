"""Owns the calibration in air: the pinhole stereo pair with distortion from board corners, and how sure it is.

OpenCV's calibration gives the start and names bad views; one joint adjustment of both cameras, their relative pose
and all boards gives the values and the covariance of the twenty-two parameters that the bundle in water needs as its
prior. Boards are eliminated one by one (Schur complement), so that the number of views costs little.

It also owns how a board in air looks to both cameras, and how that changes with rig, board and place.

It also owns the fields of both lenses in air: what the boards show beyond the five coefficients, adjusted with all else.

The field of a lens stays when its housing is closed. Three thousand corners per camera tell it to a hundredth of a pixel, for
each camera by itself, which matches between two cameras in water never do.

It also owns the joint adjustment in air: both lenses, their relative pose, the board's shapes and every board's place at once.

Boards are eliminated one by one (Schur complement), so that the number of views costs little.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.coverage import check_tilts
from appliance.calibrate.air.linearised import (
    PLACE,
    SHAPES,
    VALUES,
    BoardView,
    ViewSlopes,
    bend_of,
    each_changed,
    moved,
    slopes,
)
from appliance.measure import (
    AIR,
    EYES,
    FIELD_CELLS,
    PARAMETER_COUNT,
    PARAMETER_NAMES,
    AirField,
    FieldPrior,
    HousedCamera,
    Lens,
    Port,
    StereoRig,
    UndeterminedError,
    basis_matrix,
    matrix3,
    node_count,
    rig_with,
    rotation_matrix,
    solved,
)

Array = NDArray[np.float64]

UNKNOWNS = (
    *PARAMETER_NAMES[AIR],
    *(f"the board's {shape}" for shape in ("bow", "saddle", "twist", "S across", "S down")),
)
STEPS_AT_MOST = 30
LEAST_NOISE_PX = 1e-3
"""Least noise that the shapes' prior is weighed by: a prior of no weight determines nothing."""
SMALL = 1e-4
"""The adjustment has converged when no parameter moves by more than this share of its standard deviation."""


@dataclass(frozen=True, slots=True)
class BoardTolerance:
    """Standard deviations of a board's departures from its drawing."""

    scale: float = 1e-5
    """Standard deviation of the print's scale, relative; every length measured later has this error."""
    bow_mm: float = 0.1
    """Standard deviation of each shape that the board may have (``linearised.Bend``). The bow is how far the middle stands
    back: z = bow (1 − 2 r²/a²), a half the board's width. Shapes are adjusted: twenty views tell them to micrometres, and
    0.01 mm of bow left unnoticed would cost half a pixel of principal distance."""


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Result of the joint adjustment."""

    rig: StereoRig
    boards: list[tuple[Array, Array]]
    """Rotation and translation, board to rig, of each view."""
    shapes_mm: Array
    """(``SHAPES``,): amounts of the board's shapes."""
    information: Array
    """(22 + ``SHAPES``)² for unit noise: the 22 parameters of ``NAMES[AIR]``, then the shapes."""
    by_scale: Array
    """(22,): what the parameters change by with the scale of the board, which no picture of it can tell."""
    residuals: list[Array]
    """(n, 4) per view: left u, v, right u, v; NaN where a camera did not see a corner."""


def adjust(
    rig: StereoRig,
    boards: list[tuple[Array, Array]],
    views: Sequence[BoardView],
    tolerance: BoardTolerance,
    weights: Sequence[Array] | None = None,
) -> Adjusted:
    """Adjust by Gauss–Newton over the rig, the board's shapes, and the boards' places.

    ``weights`` (4 n,) of each view are one over the noise of each coordinate, in units of the usual noise, and zero where the
    camera did not see the corner (its pixel is then NaN); ``None``: every camera saw every corner, all equally well.
    Raises UndeterminedError for views that leave something free.
    """
    bend, shapes = bend_of(views), np.zeros(SHAPES)
    m = VALUES + SHAPES
    for _ in range(STEPS_AT_MOST):
        # Gauss-Newton with the poses eliminated (Schur complement): with A the derivatives by rig and shapes and B those
        # by one board's pose, the reduced normal matrix is Σ AᵀA − (BᵀA)ᵀ (BᵀB)⁻¹ BᵀA. 27 unknowns remain instead of 27
        # + 6 n.
        information, gradient, by_scale = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        changed = each_changed(rig)
        blocks, residuals, spread_px = [], [], []
        for k, (view, board) in enumerate(zip(views, boards, strict=True)):
            found = slopes(rig, changed, board, view, bend, shapes)
            residuals.append(np.concatenate([part.reshape(-1, 2) for part in np.split(found.residual, 2)], 1))
            spread = residuals[-1]
            if weights is not None:
                found = _weighted(found, weights[k])
                spread = found.residual
            A, B, residual = found.by_rig, found.by_place, found.residual
            spread_px.append(float(np.sqrt(np.mean(spread**2))))
            # How the rig would answer to a larger print, by the same elimination: d rig / d scale = −N⁻¹ (reduced Aᵀ
            # ∂e/∂scale).
            BA = B.T @ A
            right = np.column_stack([BA, B.T @ residual, B.T @ found.by_scale])
            place = solved(B.T @ B, right, [f"{view.name}: {name}" for name in PLACE])
            information += A.T @ A - BA.T @ place[:, :m]
            gradient += A.T @ residual - BA.T @ place[:, m]
            by_scale -= A.T @ found.by_scale - BA.T @ place[:, m + 1]
            # Kept for the back substitution: pose = (BᵀB)⁻¹ (Bᵀr − BᵀA · step).
            blocks.append(place)
        noise_px = float(np.median(spread_px))
        # The shapes' prior in units of the noise. Without it a board of three rows of corners leaves one shape free: an S
        # down such a board is a lean of it.
        prior = np.eye(SHAPES) * (max(noise_px, LEAST_NOISE_PX) / tolerance.bow_mm) ** 2
        information[VALUES:, VALUES:] += prior
        gradient[VALUES:] -= prior @ shapes
        step = solved(information, gradient, UNKNOWNS)
        full = np.zeros(PARAMETER_COUNT)
        full[AIR] = step[:VALUES]
        rig = rig_with(rig, full)
        shapes = shapes + step[VALUES:]
        boards = [moved(board, place[:, m] - place[:, :m] @ step) for board, place in zip(boards, blocks, strict=True)]
        # Converged in standard deviations, not in units: a step that is small against what is known changes nothing.
        sd = np.sqrt(np.diag(solved(information, np.eye(m), UNKNOWNS))) * noise_px
        if float(np.max(np.abs(step) / sd)) < SMALL:
            break
    return Adjusted(rig, boards, shapes, information, solved(information, by_scale, UNKNOWNS)[:VALUES], residuals)


def _weighted(found: ViewSlopes, weights: Array) -> ViewSlopes:
    """Return the rows that were seen, each times its weight: they then all have the usual noise."""
    rows = weights > 0.0
    w = weights[rows]
    return ViewSlopes(
        found.residual[rows] * w,
        found.by_rig[rows] * w[:, None],
        found.by_place[rows] * w[:, None],
        found.by_scale[rows] * w,
    )


STEPS = 3
ROUNDS = 2
"""Rounds of the variances' estimate at each step."""
FREE = np.array([100.0, 100.0, 100.0, 1.0, 1.0, 0.1, 0.1, 1.0] * 2 + [0.1] * 3 + [20.0] * 3)
"""Standard deviations of the values before any board: nothing is known that matters."""


def adjust_with_field(
    rig: StereoRig,
    boards: Sequence[tuple[Array, Array]],
    views: Sequence[BoardView],
    shapes_mm: Array,
    shape_sd_mm: float,
    scale_sd: float,
    noise_px: float,
) -> AirField:
    """Return the field of ``views``, about the plain ``rig`` and ``boards`` that fit them best.

    Gauss–Newton over the 22 values, the board's shapes and both cameras' nodes; boards' places are eliminated. ``noise_px``
    is where the estimate of the corners' noise begins.
    """
    size_px = rig.left.width_px, rig.left.height_px
    nodes = node_count(FIELD_CELLS)
    first = VALUES + SHAPES
    m = first + EYES * nodes
    sd = np.concatenate([FREE, np.full(SHAPES, shape_sd_mm), np.zeros(EYES * nodes)])
    prior = FieldPrior(np.diag(sd**2), np.zeros(m), size_px, FIELD_CELLS)
    bases = [
        (basis_matrix(v.left_px, size_px, FIELD_CELLS), basis_matrix(v.right_px, size_px, FIELD_CELLS)) for v in views
    ]
    bend = bend_of(views)
    places = list(boards)
    nodes_alone = _squares(bases)
    x = np.zeros(m)
    x[VALUES:first] = shapes_mm
    hessian, by_scale = np.zeros((m, m)), np.zeros(m)
    for _ in range(STEPS):
        now = _with(rig, x[:VALUES])
        changed = each_changed(rig, x[:VALUES])
        hessian, gradient, by_scale = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        hessian[first:, first:] = nodes_alone
        blocks, squares = [], 0.0
        for view, place, basis in zip(views, places, bases, strict=True):
            s = slopes(now, changed, place, view, bend, x[VALUES:first])
            r = s.residual - _times(basis, x[first:])
            BB, Br = s.by_place.T @ s.by_place, s.by_place.T @ r
            # J = [slopes by rig and shapes, basis]: its square's largest part, that of the nodes, is the same in each step.
            BJ, cross = _across(s.by_place, s.by_rig, basis), _across(s.by_rig, s.by_rig, basis)
            hessian[:first] += cross
            hessian[first:, :first] += cross[:, first:].T
            scaled = s.by_scale
            right = np.column_stack([BJ, Br, s.by_place.T @ scaled])
            of_place = solved(BB, right, [f"{view.name}: {name}" for name in PLACE])
            hessian -= BJ.T @ of_place[:, :m]
            gradient -= _across(r[:, None], s.by_rig, basis)[0] - BJ.T @ of_place[:, m]
            by_scale += _across(scaled[:, None], s.by_rig, basis)[0] - BJ.T @ of_place[:, m + 1]
            blocks.append(of_place)
            squares += float(r @ r - Br @ of_place[:, m])
        prior.refit(hessian / noise_px**2, gradient / noise_px**2, x, ROUNDS)
        whole = hessian / noise_px**2 + prior.information
        covariance = np.linalg.inv(whole)
        step = -covariance @ (gradient / noise_px**2 + prior.information @ x)
        # What is left after the step, over the numbers that are left: observations less what the boards' places and the
        # fitted values, as far as the data determined them, have taken.
        left = squares + 2.0 * float(gradient @ step) + float(step @ hessian @ step)
        taken = float(np.sum(covariance * hessian)) / noise_px**2
        count = sum(len(s) for basis in bases for s in basis) * 2 - 6 * len(views) - taken
        noise_px = float(np.sqrt(left / count))
        x = x + step
        places = [
            moved(place, of_place[:, m] - of_place[:, :m] @ step)
            for place, of_place in zip(places, blocks, strict=True)
        ]
    covariance = np.linalg.inv(hessian / noise_px**2 + prior.information)
    # No picture tells the scale of the print: one fully correlated error of all values, as in the plain adjustment.
    along = covariance @ (by_scale / noise_px**2)
    covariance += scale_sd**2 * np.outer(along, along)
    kept = np.concatenate([np.arange(VALUES), np.arange(first, m)])
    return AirField.of(FIELD_CELLS, x[kept], covariance[np.ix_(kept, kept)])


def _with(rig: StereoRig, values: Array) -> StereoRig:
    x = np.zeros(PARAMETER_COUNT)
    x[AIR] = values
    return rig_with(rig, x)


def _rows(n: int, block: int) -> slice:
    """Return where a view of ``n`` corners keeps the component of an eye: left u, left v, right u, right v."""
    eye, component = divmod(block, 2)
    return slice(2 * n * eye + component, 2 * n * (eye + 1), 2)


def _times(basis: tuple[Array, Array], nodes: Array) -> Array:
    """Return the fields (4 n,) at the corners of a view. A pixel looks where its field says, so that its residual is
    linear in the nodes."""
    n = len(basis[0])
    found = np.empty(4 * n)
    for block, part in enumerate(np.split(nodes, EYES)):
        found[_rows(n, block)] = basis[block // 2] @ part
    return found


def _across(rows: Array, by_rig: Array, basis: tuple[Array, Array]) -> Array:
    """Return rowsᵀ J (k, m) of rows (4 n, k), with J the slopes by rig, shapes and all nodes."""
    n = len(basis[0])
    return np.concatenate([rows.T @ by_rig, *(rows[_rows(n, k)].T @ basis[k // 2] for k in range(EYES))], 1)


def _squares(bases: Sequence[tuple[Array, Array]]) -> Array:
    """Return the nodes' own part of JᵀJ over all views, (4·nodes)²."""
    parts = []
    for eye in (0, 1):
        every = np.concatenate([basis[eye] for basis in bases])
        parts += [every.T @ every] * 2
    nodes = len(parts[0])
    found = np.zeros((EYES * nodes,) * 2)
    for k, part in enumerate(parts):
        found[k * nodes : (k + 1) * nodes, k * nodes : (k + 1) * nodes] = part
    return found


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
