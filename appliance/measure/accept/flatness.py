"""The flatness error of a plane, its systematic part, and the noise, from residuals.

E_F = (|d_max| + |d_min|)/d_r is a range (the paper's Eq. 7) and is therefore at least about six sigma/d_r; E_F,sys is
the range of the smooth part alone, a bivariate cubic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.accept.plane import PlaneFit
from appliance.measure.accept.points import Array

REFERENCE_MM = 250.0
"""d_r: a constant of the instrument, fixed by its measuring field; the paper wants at least half the volume's diagonal.
"""
NOISE_CELL_MM = 6.0
NOISE_LEAST_POINTS = 12
_POWERS = [(i, j) for i in range(4) for j in range(4 - i)]


@dataclass(frozen=True, slots=True)
class Flatness:
    """Flatness of a measured plane, as fractions of d_r (1 is 100 %)."""

    e_f: float
    e_f_sys: float
    range_mm: float
    sys_range_mm: float
    noise_mm: float | None
    """Pooled sigma to small local planes; ``None``: too few points for any."""


def flatness(fit: PlaneFit, reference_mm: float = REFERENCE_MM) -> Flatness:
    """Return E_F, E_F,sys and noise of a plane whose outliers (0.3 %) have been removed."""
    residual, xy = fit.used.residual_mm, fit.coordinates_mm
    # E_F,sys: the range of the smooth part, in which the noise of single points is averaged.
    smooth = np.ptp(cubic_of(xy, residual))
    return Flatness(
        e_f=fit.used.range_mm / reference_mm,
        e_f_sys=float(smooth) / reference_mm,
        range_mm=fit.used.range_mm,
        sys_range_mm=float(smooth),
        noise_mm=local_noise_mm(xy, residual),
    )


def cubic_of(xy: Array, residual: Array) -> Array:
    """Return the values (n,) of the best-fit bivariate cubic of residuals (n,) at xy (n, 2).

    It has ten coefficients.
    """
    middle, half = xy.mean(axis=0), np.ptp(xy, axis=0) / 2.0 + 1e-9
    x, y = ((xy - middle) / half).T
    columns = np.column_stack([x**i * y**j for i, j in _POWERS])
    # Coordinates are of order one, so that the normal equations are exact enough, and thirty times faster.
    solved, *_ = np.linalg.lstsq(columns.T @ columns, columns.T @ residual, rcond=None)
    return np.asarray(columns @ solved)


def local_noise_mm(xy: Array, residual: Array, cell_mm: float = NOISE_CELL_MM) -> float | None:
    """Return the pooled sigma of residuals (n,) to a local plane in each square of ``cell_mm``.

    ``xy``: their coordinates (n, 2).
    """
    cell = np.floor((xy - xy.min(axis=0)) / cell_mm).astype(np.int64)
    _, which, counts = np.unique(
        cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1], return_inverse=True, return_counts=True
    )
    # Coordinates about each cell's middle make offset and slopes of its plane nearly independent.
    local = xy - np.column_stack([np.bincount(which, c) / counts for c in xy.T])[which]
    A = np.column_stack([np.ones(len(xy)), local / cell_mm])
    products = np.array([[np.bincount(which, A[:, i] * A[:, j]) for j in range(3)] for i in range(3)]).transpose(
        2, 0, 1
    )
    right = np.array([np.bincount(which, A[:, i] * residual) for i in range(3)]).T
    good = (counts >= NOISE_LEAST_POINTS) & (np.linalg.eigvalsh(products)[:, 0] > 1e-3 * counts)
    if not good.any():
        return None
    solved = np.zeros((len(counts), 3))
    solved[good] = np.linalg.solve(products[good], right[good][..., None])[..., 0]
    left_over = residual - np.einsum("ij,ij->i", A, solved[which])
    chosen = good[which]
    # Pooled variance: squares over all cells, over the sum of their degrees of freedom (three per plane).
    return float(np.sqrt(np.sum(left_over[chosen] ** 2) / (counts[good] - 3).sum()))
