"""Owns the fields of both lenses in air: what the boards show beyond the five coefficients, adjusted with all else.

The field of a lens stays when its housing is closed. Three thousand corners per camera tell it to a hundredth of a pixel, for
each camera by itself, which matches between two cameras in water never do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.linearised import PLACE, SHAPES, VALUES, BoardView, bend_of, each_changed, moved, slopes
from appliance.measure import (
    AIR,
    EYES,
    FIELD_CELLS,
    PARAMETER_COUNT,
    AirField,
    FieldPrior,
    StereoRig,
    basis_matrix,
    node_count,
    rig_with,
    solved,
)

Array = NDArray[np.float64]

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
