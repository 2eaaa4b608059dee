"""Owns the slopes of one recording's residuals, and how they enter the normal equations: few unknowns touch every point,
and of the many nodes of a surface sixteen touch one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.measure import basis_entries, node_count

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NodeBasis:
    """The nodes that touch each of n points, and how much."""

    nodes: NDArray[np.intp]
    """(n, 16)."""
    weights: Array
    """(n, 16)."""
    count: int
    """All nodes of one component of the surface."""

    @classmethod
    def at(cls, uv_px: Array, size_px: tuple[int, int], intervals: tuple[int, int]) -> NodeBasis:
        """Return that of pixels (n, 2)."""
        return cls(*basis_entries(uv_px, size_px, intervals), node_count(intervals))

    def times(self, nodes: Array) -> Array:
        """Return the values (n,) of one component with these nodes (count,)."""
        return np.asarray(np.sum(self.weights * nodes[self.nodes], axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class NodeSlopes:
    """Slopes by the nodes of one surface: those of the residuals by the surface's components, times its basis."""

    columns: slice
    """Places among all unknowns: the nodes of the first component, then those of the second."""
    basis: NodeBasis
    by_component: Sequence[Array]
    """Two of (n, 2) or (2,): the residuals' slopes by the surface's first and second component."""

    def matrix(self) -> Any:
        """Return the slopes (2 n, 2·nodes), a sparse matrix: all first coordinates of the residuals, then all second."""
        import scipy.sparse  # half a second that a start of the service does not need

        n = len(self.basis.nodes)
        two = [np.broadcast_to(d, (n, 2)) for d in self.by_component]
        data = np.concatenate([np.concatenate([self.basis.weights * d[:, [k]] for d in two], axis=1) for k in (0, 1)])
        indices = np.concatenate([self.basis.nodes, self.basis.nodes + self.basis.count], axis=1)
        indices = np.concatenate([indices, indices])
        starts = np.arange(2 * n + 1) * indices.shape[1]
        return scipy.sparse.csr_matrix((data.ravel(), indices.ravel(), starts), (2 * n, 2 * self.basis.count))


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Residuals of n points, and their slopes by all unknowns."""

    residual: Array
    """(n, 2), px."""
    dense: Array
    """(n, 2, k): by the unknowns that touch every point."""
    columns: NDArray[np.intp]
    """(k,): which of all unknowns these are."""
    nodes: Sequence[NodeSlopes]

    def add(self, hessian: Array, gradient: Array, weight: Array) -> None:
        """Add Jᵀ W J to ``hessian`` and Jᵀ W r to ``gradient``, in place; ``weight`` (2 n,) is of all first coordinates,
        then of all second."""
        D = np.concatenate([self.dense[:, 0], self.dense[:, 1]])
        r = weight * np.concatenate([self.residual[:, 0], self.residual[:, 1]])
        WD = weight[:, None] * D
        hessian[np.ix_(self.columns, self.columns)] += D.T @ WD
        gradient[self.columns] += D.T @ r
        if not self.nodes:
            return
        import scipy.sparse  # as above

        N = scipy.sparse.hstack([one.matrix() for one in self.nodes], format="csr")
        columns = np.concatenate([np.arange(one.columns.start, one.columns.stop) for one in self.nodes])
        cross = N.T @ WD
        hessian[np.ix_(columns, self.columns)] += cross
        hessian[np.ix_(self.columns, columns)] += cross.T
        hessian[np.ix_(columns, columns)] += (N.T @ N.multiply(weight[:, None])).toarray()
        gradient[columns] += N.T @ r
