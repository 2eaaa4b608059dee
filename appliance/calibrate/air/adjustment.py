"""Joint adjustments in air: lenses, extrinsics, the board's shapes and every board's pose at once.

    adjust               the 22 parameters from air with their information matrix, and the residuals of each view
    adjust_with_field    the same with the image corrections (fields) of both lenses, beyond the five coefficients

Boards are eliminated one by one (Schur complement), so that many views cost little. The result is the prior of the
adjustment in water. The field of a lens stays when its housing is closed. Three thousand corners determine it to a
hundredth of a pixel for each camera by itself, which correspondences between two cameras in water never do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.linearised import (
    POSE_NAMES,
    SHAPES,
    VALUES,
    BoardView,
    ViewJacobian,
    bend_of,
    linearise_view,
    move_board,
    rig_steps,
)
from appliance.calibrate.determined import solve_symmetric
from appliance.calibrate.field import FIELD_CELLS, FieldPrior
from appliance.measure import RIG_PARAMETERS, AirField, SplineGrid, StereoRig

Array = NDArray[np.float64]

UNKNOWNS = (
    *RIG_PARAMETERS.names[RIG_PARAMETERS.air],
    *(f"the board's {shape}" for shape in ("bow", "saddle", "twist", "S across", "S down")),
)
STEPS_AT_MOST = 30
LEAST_NOISE_PX = 1e-3
"""Least noise for the weight of the shapes' prior, which must not vanish."""
SMALL = 1e-4
"""The adjustment has converged when no parameter changes by more than this share of its standard deviation."""


@dataclass(frozen=True, slots=True)
class BoardTolerance:
    """Standard deviations of a board's deviations from its design."""

    scale: float = 1e-5
    """Relative standard deviation of the print's scale, an error of all lengths that are measured later."""
    bow_mm: float = 0.1
    """Standard deviation of each shape of the board (``linearised.Bend``). The bow is the distance by which the middle
    stands back: z = bow (1 − 2 r²/a²), with a half the board's width. Twenty views determine the shapes to micrometres;
    an undetected bow of 0.01 mm would change the principal distance by half a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class AirAdjustment:
    """Result of the joint adjustment."""

    rig: StereoRig
    boards: list[tuple[Array, Array]]
    """Rotation and translation, board to rig, of each view."""
    shapes_mm: Array
    """(``SHAPES``,): amounts of the board's shapes."""
    information: Array
    """(22 + ``SHAPES``)² for unit noise: the 22 parameters of ``RIG_PARAMETERS.air``, then the shapes."""
    by_scale: Array
    """(22,): derivative of the parameters by the scale of the board, which no picture determines."""
    residuals: list[Array]
    """(n, 4) per view: left u, v, right u, v; NaN where a camera did not see a corner."""


def adjust(
    rig: StereoRig,
    boards: list[tuple[Array, Array]],
    views: Sequence[BoardView],
    tolerance: BoardTolerance,
    weights: Sequence[Array],
) -> AirAdjustment:
    """Adjust rig, board shapes and board poses by Gauss–Newton.

    ``weights`` (4 n,) of each view are one over the noise of each coordinate, in units of the usual noise, and zero
    where the camera did not see the corner (its pixel is then NaN). Raises UndeterminedError where the views leave a
    parameter free.
    """
    bend, shapes = bend_of(views), np.zeros(SHAPES)
    m = VALUES + SHAPES
    for _ in range(STEPS_AT_MOST):
        # Gauss-Newton with the poses eliminated (Schur complement): with A the derivatives by rig and shapes and B
        # those by one board's pose, the reduced normal matrix is Σ AᵀA − (BᵀA)ᵀ (BᵀB)⁻¹ BᵀA. 27 parameters remain
        # instead of 27 + 6 n.
        information, gradient, by_scale = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        changed = rig_steps(rig)
        blocks, residuals, rms_px = [], [], []
        for view, board, weight in zip(views, boards, weights, strict=True):
            jacobian = linearise_view(rig, changed, board, view, bend, shapes)
            residuals.append(np.concatenate([part.reshape(-1, 2) for part in np.split(jacobian.residual, 2)], 1))
            jacobian = _apply_weights(jacobian, weight)
            A, B, residual = jacobian.by_rig, jacobian.by_pose, jacobian.residual
            rms_px.append(float(np.sqrt(residual @ residual / np.count_nonzero(weight))))
            # Derivative of the rig by the scale of the print, by the same elimination: d rig / d scale = −N⁻¹ (reduced
            # Aᵀ ∂e/∂scale).
            BA = B.T @ A
            right = np.column_stack([BA, B.T @ residual, B.T @ jacobian.by_scale])
            place = solve_symmetric(B.T @ B, right, [f"{view.name}: {name}" for name in POSE_NAMES])
            information += A.T @ A - BA.T @ place[:, :m]
            gradient += A.T @ residual - BA.T @ place[:, m]
            by_scale -= A.T @ jacobian.by_scale - BA.T @ place[:, m + 1]
            # Kept for the back substitution: pose = (BᵀB)⁻¹ (Bᵀr − BᵀA · step).
            blocks.append(place)
        noise_px = float(np.median(rms_px))
        # The shapes' prior in units of the noise. Without it a board with three rows of corners leaves one shape free:
        # an S down such a board is a tilt.
        prior = np.eye(SHAPES) * (max(noise_px, LEAST_NOISE_PX) / tolerance.bow_mm) ** 2
        information[VALUES:, VALUES:] += prior
        gradient[VALUES:] -= prior @ shapes
        step = solve_symmetric(information, gradient, UNKNOWNS)
        rig = RIG_PARAMETERS.changed(rig, step[:VALUES], RIG_PARAMETERS.air)
        shapes = shapes + step[VALUES:]
        boards = [
            move_board(board, place[:, m] - place[:, :m] @ step) for board, place in zip(boards, blocks, strict=True)
        ]
        # Convergence is judged in standard deviations, since a step that is small against them does not matter.
        sd = np.sqrt(np.diag(solve_symmetric(information, np.eye(m), UNKNOWNS))) * noise_px
        if float(np.max(np.abs(step) / sd)) < SMALL:
            break
    return AirAdjustment(
        rig, boards, shapes, information, solve_symmetric(information, by_scale, UNKNOWNS)[:VALUES], residuals
    )


def _apply_weights(jacobian: ViewJacobian, weights: Array) -> ViewJacobian:
    """Return each row times its weight, so that all have the usual noise; zero for a corner that was not seen."""
    return ViewJacobian(
        np.where(weights > 0.0, jacobian.residual, 0.0) * weights,
        jacobian.by_rig * weights[:, None],
        jacobian.by_pose * weights[:, None],
        jacobian.by_scale * weights,
    )


STEPS = 3
ROUNDS = 2
"""Rounds of the estimate of the variances at each step."""
FREE = np.array([100.0, 100.0, 100.0, 1.0, 1.0, 0.1, 0.1, 1.0] * 2 + [0.1] * 3 + [20.0] * 3)
"""Standard deviations of the parameters before any board, too large to matter."""


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
    """Return the fields of both cameras from ``views``, about the plain ``rig`` and ``boards`` that fit them best.

    Gauss–Newton over the 22 parameters, the board's shapes and both cameras' nodes; the poses of boards are eliminated.
    ``noise_px`` is the first estimate of the usual noise of a corner; ``weights`` are those of ``adjust``.
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
    poses = list(boards)
    nodes_alone = _node_information(bases)
    x = np.zeros(m)
    x[VALUES:first] = shapes_mm
    hessian, by_scale = np.zeros((m, m)), np.zeros(m)
    for _ in range(STEPS):
        current_rig = RIG_PARAMETERS.changed(rig, x[:VALUES], RIG_PARAMETERS.air)
        changed = rig_steps(rig, x[:VALUES])
        hessian, gradient, by_scale = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        hessian[first:, first:] = nodes_alone
        blocks, squares = [], 0.0
        for view, pose, basis, weight in zip(views, poses, bases, weights, strict=True):
            s = _apply_weights(linearise_view(current_rig, changed, pose, view, bend, x[VALUES:first]), weight)
            r = s.residual - _field_at(basis, x[first:])
            BB, Br = s.by_pose.T @ s.by_pose, s.by_pose.T @ r
            # J = [derivatives by rig and shapes, basis]. The largest part of JᵀJ, that of the nodes, is the same in
            # each step.
            BJ, cross = _times_jacobian(s.by_pose, s.by_rig, basis), _times_jacobian(s.by_rig, s.by_rig, basis)
            hessian[:first] += cross
            hessian[first:, :first] += cross[:, first:].T
            by_scale_rows = s.by_scale
            right = np.column_stack([BJ, Br, s.by_pose.T @ by_scale_rows])
            solved_pose = solve_symmetric(BB, right, [f"{view.name}: {name}" for name in POSE_NAMES])
            hessian -= BJ.T @ solved_pose[:, :m]
            gradient -= _times_jacobian(r[:, None], s.by_rig, basis)[0] - BJ.T @ solved_pose[:, m]
            by_scale += _times_jacobian(by_scale_rows[:, None], s.by_rig, basis)[0] - BJ.T @ solved_pose[:, m + 1]
            blocks.append(solved_pose)
            squares += float(r @ r - Br @ solved_pose[:, m])
        prior.refit(hessian / noise_px**2, gradient / noise_px**2, x, ROUNDS)
        normal = hessian / noise_px**2 + prior.information
        covariance = np.linalg.inv(normal)
        step = -covariance @ (gradient / noise_px**2 + prior.information @ x)
        # Sum of squares after the step over the degrees of freedom: observations less the boards' poses and less the
        # fitted parameters as far as the data determined them.
        residual_squares = squares + 2.0 * float(gradient @ step) + float(step @ hessian @ step)
        fitted_count = float(np.sum(covariance * hessian)) / noise_px**2
        count = sum(np.count_nonzero(weight) for weight in weights) - 6 * len(views) - fitted_count
        noise_px = float(np.sqrt(residual_squares / count))
        x = x + step
        poses = [
            move_board(pose, solved_pose[:, m] - solved_pose[:, :m] @ step)
            for pose, solved_pose in zip(poses, blocks, strict=True)
        ]
    covariance = np.linalg.inv(hessian / noise_px**2 + prior.information)
    # No picture determines the scale of the print: a fully correlated error of all parameters, as in ``adjust``.
    along = covariance @ (by_scale / noise_px**2)
    covariance += scale_sd**2 * np.outer(along, along)
    rows = np.concatenate([np.arange(VALUES), np.arange(first, m)])
    return AirField.of(FIELD_CELLS, x[rows], covariance[np.ix_(rows, rows)])


def _basis(corners_px: Array, weights: Array, grid: SplineGrid) -> Array:
    """Return the basis at corners (n, 2), each row times its weight (n,), zero where the corner was not seen."""
    return grid.matrix(np.nan_to_num(corners_px)) * weights[:, None]


def _rows(n: int, block: int) -> slice:
    """Return the rows of a view of ``n`` corners with a component of a camera: left u, left v, right u, right v."""
    eye, component = divmod(block, 2)
    return slice(2 * n * eye + component, 2 * n * (eye + 1), 2)


def _field_at(basis: tuple[Array, Array], nodes: Array) -> Array:
    """Return the fields (4 n,) at the corners of a view.

    They are evaluated at the observed pixel, so that the residual is linear in the nodes.
    """
    n = len(basis[0])
    displacements = np.empty(4 * n)
    for block, part in enumerate(np.split(nodes, AirField.EYES)):
        displacements[_rows(n, block)] = basis[block // 2] @ part
    return displacements


def _times_jacobian(rows: Array, by_rig: Array, basis: tuple[Array, Array]) -> Array:
    """Return rowsᵀ J (k, m) of rows (4 n, k), with J the derivatives by rig, shapes and all nodes."""
    n = len(basis[0])
    return np.concatenate([rows.T @ by_rig, *(rows[_rows(n, k)].T @ basis[k // 2] for k in range(AirField.EYES))], 1)


def _node_information(bases: Sequence[tuple[Array, Array]]) -> Array:
    """Return the part of JᵀJ that belongs to the nodes alone, over all views, (4·nodes)²."""
    squares = []
    for eye in (0, 1):
        basis_rows = np.concatenate([basis[eye] for basis in bases])
        squares += [basis_rows.T @ basis_rows] * 2
    nodes = len(squares[0])
    information = np.zeros((AirField.EYES * nodes,) * 2)
    for k, part in enumerate(squares):
        information[k * nodes : (k + 1) * nodes, k * nodes : (k + 1) * nodes] = part
    return information
