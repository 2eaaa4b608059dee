"""Owns what is supposed of the field of a lens or a window before it was measured, and how the data say how strong it
is.

A field is what a pixel is off beyond every formula: coefficients of a bicubic B-spline over the image. It is supposed
to be a sum of Gaussian processes of three lengths (Matérn 3/2), each with a variance that the data choose: variance
components by restricted maximum likelihood, as in geostatistics. So few data give a smooth field, and many resolve a
fine one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from appliance.measure import AirField, SplineGrid

Array = NDArray[np.float64]

FIELD_CELLS = (16, 12)
"""Intervals across and down the image: square on 4:3.

A twelfth of the width is followed to within a tenth of its height.
"""
REACHES = (0.5, 0.2, 0.07)
"""Lengths of the processes, as shares of the image's width: from what bends the whole image to what a flaw of a window
does."""
FIRST_PX = 0.03
"""Standard deviation of each process before any data."""
LEAST_PX = 0.002
"""A process is never believed to be weaker: it would be held at nothing by data that only seem to be perfect."""
MOST_PER_ROUND = 10.0
"""Factor by which a variance may change in one round."""
JITTER_PX2 = 1e-9
"""Added to each node's variance: keeps the smooth covariance invertible, a thousand times below anything measured."""


def kernels(grid: SplineGrid) -> tuple[Array, ...]:
    """Return the correlation (nodes, nodes) of one component's nodes, for each of ``REACHES``."""
    columns, rows = grid.intervals
    x = (np.arange(columns + 3) - 1.0) * grid.size_px[0] / columns
    y = (np.arange(rows + 3) - 1.0) * grid.size_px[1] / rows
    at = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    apart = np.hypot(*(at[:, None] - at).transpose(2, 0, 1))
    found = []
    for reach in REACHES:
        r = math.sqrt(3.0) * apart / (reach * grid.size_px[0])
        found.append(np.asarray((1.0 + r) * np.exp(-r)))
    return tuple(found)


class FieldPrior:
    """Mean and covariance of unknowns of which the last ``AirField.EYES`` blocks are nodes of fields.

    The covariance is what was known, ``known`` (m, m), plus the processes, with a variance each that ``refit``
    estimates.
    """

    def __init__(self, known: Array, mean: Array, grid: SplineGrid) -> None:
        self._known = known
        self.mean = mean
        self._kernels = kernels(grid)
        count = grid.count
        first = len(mean) - AirField.EYES * count
        self._first = first
        self._apart = not known[first:].any()
        """Nothing is known of the nodes but what is supposed: blocks are inverted and weighed one by one."""
        self._blocks = [slice(first + k * count, first + (k + 1) * count) for k in range(AirField.EYES)]
        self.variances_px2 = np.full(len(REACHES), FIRST_PX**2)
        self.information = self._information()

    def refit(self, hessian: Array, gradient: Array, x: Array, rounds: int) -> None:
        """Estimate the variances from the data's quadratic cost about ``x``: ``hessian`` (n, n), ``gradient`` (n,), n ≥
        m, without the prior."""
        m = len(self.mean)
        for _ in range(rounds):
            P = self.information
            whole = hessian.copy()
            whole[:m, :m] += P
            S = _inverse(whole)
            slope = gradient.copy()
            slope[:m] += P @ (x[:m] - self.mean)
            best = x - S @ slope
            # With V the covariance of the data's noise and prior together, the likelihood has its top where, for each
            # process with the correlation K, αᵀ K α = tr(K Q): α the pull of the data on the nodes, Q = P − P S P what
            # the data are expected to pull. Their ratio, as a factor, is the usual fixed-point step.
            pull = P @ (best[:m] - self.mean)
            reach = [b if self._apart else slice(0, m) for b in self._blocks]
            Q = [P[b, b] - P[b, r] @ S[r, r] @ P[r, b] for b, r in zip(self._blocks, reach, strict=True)]
            for k, K in enumerate(self._kernels):
                found = sum(float(pull[b] @ K @ pull[b]) for b in self._blocks)
                expected = sum(float(np.sum(K * q)) for q in Q)
                factor = min(max(found / max(expected, 1e-300), 1.0 / MOST_PER_ROUND), MOST_PER_ROUND)
                self.variances_px2[k] = max(self.variances_px2[k] * factor, LEAST_PX**2)
            self.information = self._information()

    def _information(self) -> Array:
        one = sum(v * K for v, K in zip(self.variances_px2, self._kernels, strict=True))
        if self._apart:
            information = np.zeros_like(self._known)
            if self._first:
                information[: self._first, : self._first] = _inverse(self._known[: self._first, : self._first])
            of_block = _inverse(one + JITTER_PX2 * np.eye(len(one)))
            for block in self._blocks:
                information[block, block] = of_block
            return information
        covariance = self._known.copy()
        for block in self._blocks:
            covariance[block, block] += one
        nodes = np.arange(self._blocks[0].start, self._blocks[-1].stop)
        covariance[nodes, nodes] += JITTER_PX2
        # Units differ by many powers of ten: inverted as a correlation.
        scale = np.sqrt(np.diag(covariance))
        return np.asarray(_inverse(covariance / np.outer(scale, scale)) / np.outer(scale, scale))


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric, positive definite matrix, in half the time of a general one."""
    import scipy.linalg.lapack  # half a second that a start of the service does not need

    factor, failed = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError(f"not positive definite at {failed} of {len(matrix)}")
    half, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
    return np.asarray(half + np.tril(half, -1).T)
