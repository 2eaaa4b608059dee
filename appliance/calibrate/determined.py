"""Owns whether normal equations determine their unknowns: their solution, or the names of the unknowns that are left
free."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FREE = 1e-12
"""Least pivot of the matrix with a diagonal of ones: below it, rounding alone decides the solution."""
SHARE = 0.3
"""Unknowns are named whose part of the free combination is at least this share of the largest part."""


class UndeterminedError(ArithmeticError):
    """Observations leave a combination of unknowns free; ``names`` has those that take part in it."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(dict.fromkeys(names))
        super().__init__(f"{', '.join(self.names)}: not determined")


def solved(matrix: Array, right: Array, names: Sequence[str]) -> Array:
    """Return x (n, …) with ``matrix`` (n, n), symmetric, times x = ``right`` (n, …).

    Raises UndeterminedError with those of ``names`` (n) that the matrix leaves free, or that are not finite.
    """
    both = np.column_stack([matrix, right])
    bad = ~np.asarray(np.isfinite(both).all(axis=1))
    if bad.any():
        raise UndeterminedError([name for name, free in zip(names, bad, strict=True) if free])
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if not np.all(scale > 0.0):
        raise UndeterminedError([name for name, one in zip(names, scale, strict=True) if not one > 0.0])
    # Each unknown in units of its own certainty: units of px, mm and radians are comparable only so.
    scaled = matrix / np.outer(scale, scale)
    try:
        # A pivot is an unknown's certainty beside those before it, and never below the least eigenvalue.
        sound = float(np.diag(np.linalg.cholesky(scaled)).min()) ** 2 >= FREE
    except np.linalg.LinAlgError:
        sound = False
    if not sound:
        part = np.abs(np.linalg.eigh(scaled)[1][:, 0])
        raise UndeterminedError([name for name, one in zip(names, part, strict=True) if one >= SHARE * part.max()])
    across = scale if right.ndim == 1 else scale[:, None]
    return np.asarray(np.linalg.solve(scaled, right / across) / across, np.float64)
