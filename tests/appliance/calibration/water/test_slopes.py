"""Slopes that are kept sparse make the normal equations of the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.water.slopes import NodeBasis, NodeSlopes, Slopes
from appliance.optics.correction import basis_matrix, node_count

SIZE_PX = (400, 300)


def test_nodes_times_their_basis_are_the_surface() -> None:
    rng = np.random.default_rng(1)
    uv = rng.uniform(0.0, [399.0, 299.0], (25, 2))
    nodes = rng.normal(size=node_count((4, 3)))
    basis = NodeBasis.at(uv, SIZE_PX, (4, 3))
    assert basis.count == 42
    assert basis.nodes.shape == basis.weights.shape == (25, 16)
    assert basis.times(nodes) == pytest.approx(basis_matrix(uv, SIZE_PX, (4, 3)) @ nodes)


def test_normal_equations_are_those_of_the_whole_matrix() -> None:
    """Residuals (u, v) of thirty points by three unknowns that touch all, and by two surfaces with nodes of their own."""
    rng = np.random.default_rng(2)
    n, size = 30, 170
    uv = rng.uniform(0.0, [399.0, 299.0], (n, 2))
    dense, columns = rng.normal(size=(n, 2, 3)), np.array([168, 1, 77])
    each, same = rng.normal(size=(2, n, 2)), rng.normal(size=(2, 2))
    fine, coarse = NodeBasis.at(uv, SIZE_PX, (3, 2)), NodeBasis.at(uv, SIZE_PX, (2, 1))
    surfaces = [NodeSlopes(slice(5, 65), fine, list(each)), NodeSlopes(slice(80, 120), coarse, list(same))]
    residual, weight = rng.normal(size=(n, 2)), rng.uniform(0.5, 2.0, 2 * n)
    J = np.zeros((n, 2, size))
    J[:, :, columns] = dense
    for first, intervals, by in ((5, (3, 2), each), (80, (2, 1), np.repeat(same[:, None], n, axis=1))):
        basis = basis_matrix(uv, SIZE_PX, intervals)
        count = basis.shape[1]
        for component in (0, 1):
            at = first + component * count
            J[:, :, at : at + count] = by[component][:, :, None] * basis[:, None, :]
    rows = J.transpose(1, 0, 2).reshape(2 * n, size)
    r = residual.T.ravel()
    for some in (surfaces, []):
        hessian, gradient = np.full((size, size), 0.5), np.full(size, 0.25)
        Slopes(residual, dense, columns, some).add(hessian, gradient, weight)
        whole = rows if some else np.where(np.isin(np.arange(size), columns), rows, 0.0)
        assert hessian == pytest.approx(0.5 + whole.T @ (weight[:, None] * whole), abs=1e-12)
        assert gradient == pytest.approx(0.25 + whole.T @ (weight * r), abs=1e-12)
