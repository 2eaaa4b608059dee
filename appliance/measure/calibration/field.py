"""Owns what is supposed of the field of a lens or a window before it was measured, and how the data say how strong it
is.

A field is what a pixel is off beyond every formula: coefficients of a bicubic B-spline over the image. It is supposed
to be a sum of Gaussian processes of three lengths (Matérn 3/2), each with a variance that the data choose: variance
components by restricted maximum likelihood, as in geostatistics. So few data give a smooth field, and many resolve a
fine one.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.correction import node_count

Array = NDArray[np.float64]

FIELD_CELLS = (16, 12)
"""Intervals across and down the image: square on 4:3.

A twelfth of the width is followed to within a tenth of its height.
"""
REACHES = (0.5, 0.2, 0.07)
"""Lengths of the processes, as shares of the image's width: from what bends the whole image to what a flaw of a window
does."""
EYES = 4
"""Blocks of nodes of a rig: left across, left down, right across, right down."""
AIR_VALUES = 22
FIRST_PX = 0.03
"""Standard deviation of each process before any data."""
LEAST_PX = 0.002
"""A process is never believed to be weaker: it would be held at nothing by data that only seem to be perfect."""
MOST_PER_ROUND = 10.0
"""Factor by which a variance may change in one round."""
JITTER_PX2 = 1e-9
"""Added to each node's variance: keeps the smooth covariance invertible, a thousand times below anything measured."""
ROUNDED = 1e-6
"""Share of each variance that is added where rounding has left a covariance without a factor: a thousandth of a
standard deviation."""


def kernels(size_px: tuple[int, int], intervals: tuple[int, int]) -> tuple[Array, ...]:
    """Return the correlation (nodes, nodes) of one component's nodes, for each of ``REACHES``."""
    columns, rows = intervals
    x = (np.arange(columns + 3) - 1.0) * size_px[0] / columns
    y = (np.arange(rows + 3) - 1.0) * size_px[1] / rows
    at = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    apart = np.hypot(*(at[:, None] - at).transpose(2, 0, 1))
    found = []
    for reach in REACHES:
        r = math.sqrt(3.0) * apart / (reach * size_px[0])
        found.append(np.asarray((1.0 + r) * np.exp(-r)))
    return tuple(found)


class FieldPrior:
    """Mean and covariance of unknowns of which the last ``EYES`` blocks are nodes of fields.

    The covariance is what was known, ``known`` (m, m), plus the processes, with a variance each that ``refit``
    estimates.
    """

    def __init__(self, known: Array, mean: Array, size_px: tuple[int, int], intervals: tuple[int, int]) -> None:
        self._known = known
        self.mean = mean
        self._kernels = kernels(size_px, intervals)
        count = node_count(intervals)
        first = len(mean) - EYES * count
        self._first = first
        self._apart = not known[first:].any()
        """Nothing is known of the nodes but what is supposed: blocks are inverted and weighed one by one."""
        self._blocks = [slice(first + k * count, first + (k + 1) * count) for k in range(EYES)]
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


def _rounded_root(covariance: Array) -> Array:
    """Return the Cholesky factor (m, m) of a covariance that rounding has left with variances of nothing or less than
    nothing.

    Raises LinAlgError for what is none by more than rounding.
    """
    # In standard deviations, so that pixels and radians are rounded alike.
    scale = np.sqrt(np.diag(covariance))
    return np.asarray(
        scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale) + ROUNDED * np.eye(len(scale)))
    )


@dataclass(frozen=True, slots=True)
class AirField:
    """The lenses' fields as boards in air tell of them, together with all else: mean and covariance of (22 + 4·nodes)
    values. The first 22 are changes of the values of the file (``parameters.NAMES[AIR]``), then the nodes of the left
    image across, down, and of the right one."""

    intervals: tuple[int, int]
    mean: tuple[float, ...]
    root: bytes
    """Lower Cholesky factor of the covariance, row by row up to the diagonal, float32 with the low byte first."""

    def __post_init__(self) -> None:
        size = AIR_VALUES + EYES * node_count(self.intervals)
        if len(self.mean) != size or len(self.root) != 2 * size * (size + 1):
            raise ValueError(
                f"field from air with {len(self.mean)} values and {len(self.root)} bytes; {self.intervals[0]} × "
                f"{self.intervals[1]} intervals need {size} and {2 * size * (size + 1)}; calibrate in air again"
            )

    @classmethod
    def of(cls, intervals: tuple[int, int], mean: Array, covariance: Array) -> AirField:
        """Return the field with that mean (m,) and covariance (m, m)."""
        try:
            root = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            root = _rounded_root(covariance)
        packed = root[np.tril_indices(len(root))].astype("<f4")
        return cls(intervals, tuple(float(v) for v in mean), packed.tobytes())

    @property
    def covariance(self) -> Array:
        """(m, m)."""
        root = np.zeros((len(self.mean),) * 2)
        root[np.tril_indices(len(root))] = np.frombuffer(self.root, "<f4")
        return root @ root.T

    @property
    def text(self) -> str:
        """``root`` as a file keeps it."""
        return base64.b64encode(self.root).decode("ascii")

    @classmethod
    def from_text(cls, intervals: tuple[int, int], mean: Sequence[float], text: str) -> AirField:
        """Return the field as a file keeps it. Raises ValueError for a text of another length, or that is none."""
        try:
            root = base64.b64decode(text, validate=True)
        except binascii.Error as error:
            raise ValueError(f"not base64 ({error})") from error
        found = cls(intervals, tuple(mean), root)
        if not np.isfinite(np.frombuffer(root, "<f4")).all():
            raise ValueError("a value is not finite")
        return found
