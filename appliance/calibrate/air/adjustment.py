"""Owns the calibration in air: the pinhole stereo pair with distortion from board corners, and how sure it is.

OpenCV's calibration gives the start and names bad views; one joint adjustment of both cameras, their relative pose
and all boards gives the values and the covariance of the twenty-two parameters that the bundle in water needs as its
prior. Boards are eliminated one by one (Schur complement), so that the number of views costs little.

It also owns how a board in air looks to both cameras, and how that changes with rig, board and place.

It also owns the fields of both lenses in air: what the boards show beyond the five coefficients, adjusted with all
else.

The field of a lens stays when its housing is closed. Three thousand corners per camera tell it to a hundredth of a
pixel, for each camera by itself, which matches between two cameras in water never do.

It also owns the joint adjustment in air: both lenses, their relative pose, the board's shapes and every board's place
at once.

Boards are eliminated one by one (Schur complement), so that the number of views costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
from appliance.calibrate.determined import solved
from appliance.calibrate.field import FIELD_CELLS, FieldPrior
from appliance.measure import RIG_PARAMETERS, AirField, SplineGrid, StereoRig

Array = NDArray[np.float64]

UNKNOWNS = (
    *RIG_PARAMETERS.names[RIG_PARAMETERS.air],
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
    """(22 + ``SHAPES``)² for unit noise: the 22 parameters of ``RIG_PARAMETERS.air``, then the shapes."""
    by_scale: Array
    """(22,): what the parameters change by with the scale of the board, which no picture of it can tell."""
    residuals: list[Array]
    """(n, 4) per view: left u, v, right u, v; NaN where a camera did not see a corner."""


def adjust(
    rig: StereoRig,
    boards: list[tuple[Array, Array]],
    views: Sequence[BoardView],
    tolerance: BoardTolerance,
    weights: Sequence[Array],
) -> Adjusted:
    """Adjust by Gauss–Newton over the rig, the board's shapes, and the boards' places.

    ``weights`` (4 n,) of each view are one over the noise of each coordinate, in units of the usual noise, and zero
    where the camera did not see the corner (its pixel is then NaN). Raises UndeterminedError for views that leave
    something free.
    """
    bend, shapes = bend_of(views), np.zeros(SHAPES)
    m = VALUES + SHAPES
    for _ in range(STEPS_AT_MOST):
        # Gauss-Newton with the poses eliminated (Schur complement): with A the derivatives by rig and shapes and B
        # those by one board's pose, the reduced normal matrix is Σ AᵀA − (BᵀA)ᵀ (BᵀB)⁻¹ BᵀA. 27 unknowns remain instead
        # of 27 + 6 n.
        information, gradient, by_scale = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        changed = each_changed(rig)
        blocks, residuals, spread_px = [], [], []
        for view, board, weight in zip(views, boards, weights, strict=True):
            found = slopes(rig, changed, board, view, bend, shapes)
            residuals.append(np.concatenate([part.reshape(-1, 2) for part in np.split(found.residual, 2)], 1))
            found = _weighted(found, weight)
            A, B, residual = found.by_rig, found.by_place, found.residual
            spread_px.append(float(np.sqrt(residual @ residual / np.count_nonzero(weight))))
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
        # The shapes' prior in units of the noise. Without it a board of three rows of corners leaves one shape free: an
        # S down such a board is a lean of it.
        prior = np.eye(SHAPES) * (max(noise_px, LEAST_NOISE_PX) / tolerance.bow_mm) ** 2
        information[VALUES:, VALUES:] += prior
        gradient[VALUES:] -= prior @ shapes
        step = solved(information, gradient, UNKNOWNS)
        rig = RIG_PARAMETERS.changed(rig, step[:VALUES], RIG_PARAMETERS.air)
        shapes = shapes + step[VALUES:]
        boards = [moved(board, place[:, m] - place[:, :m] @ step) for board, place in zip(boards, blocks, strict=True)]
        # Converged in standard deviations, not in units: a step that is small against what is known changes nothing.
        sd = np.sqrt(np.diag(solved(information, np.eye(m), UNKNOWNS))) * noise_px
        if float(np.max(np.abs(step) / sd)) < SMALL:
            break
    return Adjusted(rig, boards, shapes, information, solved(information, by_scale, UNKNOWNS)[:VALUES], residuals)


def _weighted(found: ViewSlopes, weights: Array) -> ViewSlopes:
    """Return each row times its weight, zero for one that was not seen: the others then all have the usual noise."""
    return ViewSlopes(
        np.where(weights > 0.0, found.residual, 0.0) * weights,
        found.by_rig * weights[:, None],
        found.by_place * weights[:, None],
        found.by_scale * weights,
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
    weights: Sequence[Array],
) -> AirField:
    """Return the field of ``views``, about the plain ``rig`` and ``boards`` that fit them best.

    Gauss–Newton over the 22 values, the board's shapes and both cameras' nodes; boards' places are eliminated.
    ``noise_px`` is where the estimate of the corners' usual noise begins; ``weights`` are those of ``adjust``.
    """
    grid = SplineGrid((rig.left.width_px, rig.left.height_px), FIELD_CELLS)
    nodes = grid.count
    first = VALUES + SHAPES
    m = first + AirField.EYES * nodes
    sd = np.concatenate([FREE, np.full(SHAPES, shape_sd_mm), np.zeros(AirField.EYES * nodes)])
    prior = FieldPrior(np.diag(sd**2), np.zeros(m), grid)
    bases = [
        (
            _basis(v.left_px, weight[: len(weight) // 2 : 2], grid),
            _basis(v.right_px, weight[len(weight) // 2 :: 2], grid),
        )
        for v, weight in zip(views, weights, strict=True)
    ]
    bend = bend_of(views)
    places = list(boards)
    nodes_alone = _squares(bases)
    x = np.zeros(m)
    x[VALUES:first] = shapes_mm
    hessian, by_scale = np.zeros((m, m)), np.zeros(m)
    for _ in range(STEPS):
        now = RIG_PARAMETERS.changed(rig, x[:VALUES], RIG_PARAMETERS.air)
        changed = each_changed(rig, x[:VALUES])
        hessian, gradient, by_scale = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        hessian[first:, first:] = nodes_alone
        blocks, squares = [], 0.0
        for view, place, basis, weight in zip(views, places, bases, weights, strict=True):
            s = _weighted(slopes(now, changed, place, view, bend, x[VALUES:first]), weight)
            r = s.residual - _times(basis, x[first:])
            BB, Br = s.by_place.T @ s.by_place, s.by_place.T @ r
            # J = [slopes by rig and shapes, basis]: its square's largest part, that of the nodes, is the same in each
            # step.
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
        count = sum(np.count_nonzero(weight) for weight in weights) - 6 * len(views) - taken
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


def _basis(seen_px: Array, weights: Array, grid: SplineGrid) -> Array:
    """Return the basis at corners (n, 2), each row times its weight (n,), zero where the corner was not seen."""
    return grid.matrix(np.nan_to_num(seen_px)) * weights[:, None]


def _rows(n: int, block: int) -> slice:
    """Return where a view of ``n`` corners keeps the component of an eye: left u, left v, right u, right v."""
    eye, component = divmod(block, 2)
    return slice(2 * n * eye + component, 2 * n * (eye + 1), 2)


def _times(basis: tuple[Array, Array], nodes: Array) -> Array:
    """Return the fields (4 n,) at the corners of a view. A pixel looks where its field says, so that its residual is
    linear in the nodes."""
    n = len(basis[0])
    found = np.empty(4 * n)
    for block, part in enumerate(np.split(nodes, AirField.EYES)):
        found[_rows(n, block)] = basis[block // 2] @ part
    return found


def _across(rows: Array, by_rig: Array, basis: tuple[Array, Array]) -> Array:
    """Return rowsᵀ J (k, m) of rows (4 n, k), with J the slopes by rig, shapes and all nodes."""
    n = len(basis[0])
    return np.concatenate([rows.T @ by_rig, *(rows[_rows(n, k)].T @ basis[k // 2] for k in range(AirField.EYES))], 1)


def _squares(bases: Sequence[tuple[Array, Array]]) -> Array:
    """Return the nodes' own part of JᵀJ over all views, (4·nodes)²."""
    parts = []
    for eye in (0, 1):
        every = np.concatenate([basis[eye] for basis in bases])
        parts += [every.T @ every] * 2
    nodes = len(parts[0])
    found = np.zeros((AirField.EYES * nodes,) * 2)
    for k, part in enumerate(parts):
        found[k * nodes : (k + 1) * nodes, k * nodes : (k + 1) * nodes] = part
    return found
