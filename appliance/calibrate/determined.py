"""Solve normal equations, or name the parameters that they leave undetermined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FREE = 1e-12
"""Smallest allowed pivot of the matrix scaled to a diagonal of ones; below it, rounding decides the solution."""
SHARE = 0.3
"""A parameter is named if its part of the free combination is at least this share of the largest part."""


class UndeterminedError(ArithmeticError):
    """Error of normal equations that leave a combination of parameters free.

    ``names`` are those of the parameters that take part in it.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(dict.fromkeys(names))
        super().__init__(f"{', '.join(self.names)}: not determined")


def solve_symmetric(matrix: Array, right: Array, names: Sequence[str]) -> Array:
    """Return x (n, …) that solves ``matrix`` x = ``right`` for a symmetric ``matrix`` (n, n).

    ``names`` (n) are those of the parameters. Raises UndeterminedError with the parameters that the matrix leaves free,
    or whose equations are not finite.
    """
    augmented = np.column_stack([matrix, right])
    is_bad = ~np.asarray(np.isfinite(augmented).all(axis=1))
    if is_bad.any():
        raise UndeterminedError([name for name, free in zip(names, is_bad, strict=True) if free])
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if not np.all(scale > 0.0):
        raise UndeterminedError([name for name, value in zip(names, scale, strict=True) if not value > 0.0])
    # Scaled by its own diagonal element, each parameter has the same unit: px, mm and rad cannot be compared otherwise.
    scaled = matrix / np.outer(scale, scale)
    try:
        # A pivot is the information on one parameter given those before it, and never below the smallest eigenvalue.
        is_definite = float(np.diag(np.linalg.cholesky(scaled)).min()) ** 2 >= FREE
    except np.linalg.LinAlgError:
        is_definite = False
    if not is_definite:
        weights = np.abs(np.linalg.eigh(scaled)[1][:, 0])
        raise UndeterminedError(
            [name for name, value in zip(names, weights, strict=True) if value >= SHARE * weights.max()]
        )
    right_scale = scale if right.ndim == 1 else scale[:, None]
    return np.asarray(np.linalg.solve(scaled, right / right_scale) / right_scale, np.float64)
