"""Prior of image corrections (fields) of lenses and ports, with variances estimated from the data.

A field is the displacement of each pixel beyond the camera model: coefficients of a bicubic B-spline over the image.
Its prior is a sum of Gaussian processes of three lengths (Matérn 3/2). The data choose the variance of each process:
variance components by restricted maximum likelihood, as in geostatistics. So few data give a smooth field, and many
resolve a fine one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from appliance.measure import AirField, SplineGrid

Array = NDArray[np.float64]

FIELD_CELLS = (16, 12)
"""Intervals across and down the image, square on 4:3.

A bump as wide as a twelfth of the image is reproduced to a tenth of its height.
"""
REACHES = (0.5, 0.2, 0.07)
"""Correlation lengths of the processes, as shares of the image's width: from errors of the whole image to local
flaws of a port."""
FIRST_PX = 0.03
"""Standard deviation of each process before any data."""
LEAST_PX = 0.002
"""Smallest standard deviation of a process: data that only seem perfect would hold it at zero."""
MOST_PER_ROUND = 10.0
"""Factor by which a variance may change in one round."""
JITTER_PX2 = 1e-9
"""Added to each node's variance to keep the smooth covariance invertible; a thousand times below measured variances."""


def correlations(grid: SplineGrid) -> tuple[Array, ...]:
    """Return the correlation (nodes, nodes) of the nodes of one component, for each of ``REACHES``."""
    columns, rows = grid.intervals
    x = (np.arange(columns + 3) - 1.0) * grid.size_px[0] / columns
    y = (np.arange(rows + 3) - 1.0) * grid.size_px[1] / rows
    nodes_px = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    distance_px = np.hypot(*(nodes_px[:, None] - nodes_px).transpose(2, 0, 1))
    matrices = []
    for reach in REACHES:
        r = math.sqrt(3.0) * distance_px / (reach * grid.size_px[0])
        matrices.append(np.asarray((1.0 + r) * np.exp(-r)))
    return tuple(matrices)


class FieldPrior:
    """Mean and covariance of parameters whose last ``AirField.EYES`` blocks are the nodes of fields.

    The covariance is ``known`` (m, m) plus the processes, each with a variance that ``refit`` estimates.
    """

    def __init__(self, covariance: Array, mean: Array, grid: SplineGrid) -> None:
        self._known = covariance
        self.mean = mean
        self._kernels = correlations(grid)
        count = grid.count
        first = len(mean) - AirField.EYES * count
        self._first = first
        self._apart = not covariance[first:].any()
        """The processes are the only covariance of the nodes: blocks are inverted and weighted one by one."""
        self._blocks = [slice(first + k * count, first + (k + 1) * count) for k in range(AirField.EYES)]
        self.variances_px2 = np.full(len(REACHES), FIRST_PX**2)
        self.information = self._information()

    def refit(self, hessian: Array, gradient: Array, x: Array, rounds: int) -> None:
        """Estimate the variances from the quadratic cost of the data about ``x``.

        ``hessian`` (n, n) and ``gradient`` (n,), n ≥ m, are without the prior.
        """
        m = len(self.mean)
        for _ in range(rounds):
            P = self.information
            normal = hessian.copy()
            normal[:m, :m] += P
            S = _inverse(normal)
            slope = gradient.copy()
            slope[:m] += P @ (x[:m] - self.mean)
            best = x - S @ slope
            # The restricted likelihood is largest where, for each process with the correlation K, αᵀ K α = tr(K Q).
            # α = P (x − mean) is the pull of the data on the nodes, and Q = P − P S P its expected covariance. The
            # usual fixed-point step multiplies the variance by the ratio of both sides.
            pull = P @ (best[:m] - self.mean)
            reach = [b if self._apart else slice(0, m) for b in self._blocks]
            Q = [P[b, b] - P[b, r] @ S[r, r] @ P[r, b] for b, r in zip(self._blocks, reach, strict=True)]
            for k, K in enumerate(self._kernels):
                observed = sum(float(pull[b] @ K @ pull[b]) for b in self._blocks)
                expected = sum(float(np.sum(K * q)) for q in Q)
                factor = min(max(observed / max(expected, 1e-300), 1.0 / MOST_PER_ROUND), MOST_PER_ROUND)
                self.variances_px2[k] = max(self.variances_px2[k] * factor, LEAST_PX**2)
            self.information = self._information()

    def _information(self) -> Array:
        block_covariance = sum(v * K for v, K in zip(self.variances_px2, self._kernels, strict=True))
        if self._apart:
            information = np.zeros_like(self._known)
            if self._first:
                information[: self._first, : self._first] = _inverse(self._known[: self._first, : self._first])
            block_information = _inverse(block_covariance + JITTER_PX2 * np.eye(len(block_covariance)))
            for block in self._blocks:
                information[block, block] = block_information
            return information
        covariance = self._known.copy()
        for block in self._blocks:
            covariance[block, block] += block_covariance
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
