"""Owns the joint adjustment in air: both lenses, their relative pose, the board's shapes and every board's place at once.

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
from appliance.measure import AIR, PARAMETER_COUNT, PARAMETER_NAMES, StereoRig, rig_with, solved

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
