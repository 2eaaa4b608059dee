"""Sums over the pixels of each cell of the pattern, from which the drift of the fringes is computed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction, PatternSequence

CELL_PX = 64
"""Side of a cell in pattern px: 16 mm; one fringe of the longest period."""
SAMPLES = 30_000
"""Approximate number of pixels of a camera that are used. Four times as many change no verdict of 400 scans."""
TERMS = 8
"""Number of terms in the fit of C (``drift``)."""
LEAST_B2_DN2 = 4.0
"""Least square of the modulation of a pixel that is used."""
STEEP = 0.1
"""Least slope of the coordinate, pattern px per px, by which a gradient of the light is divided."""
MEANS = np.dtype([(name, np.float64) for name in (
    "count", "u", "v", "inverse", "light", "slope", "sloped", "texture", "steep", "apart_noise", "apart_scale",
)])  # fmt: skip
"""Sums of a cell besides Σ x xᵀ. Over its pixels: number, positions in the image, 1/B², mean light. Over those whose
neighbours have coordinates: slope of the coordinate, number, square of the light's gradient per pattern px, and B² of
these. Over those with a pixel below: noise of the difference of both C, and 4 B²."""

Images = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class CellSums:
    """Sums of one camera's cells, (rows, columns, …) float64 of the pattern's cells."""

    products: NDArray[np.float64]
    """(…, ``TERMS`` + 1, ``TERMS`` + 1): Σ x xᵀ, where the last element of x is C."""
    apart: NDArray[np.float64]
    """The same of the differences between a pixel and the one below it."""
    means: NDArray[np.void]
    """(…): sums ``MEANS``."""


def cell_sums(
    frames: NDArray[np.uint8],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
) -> CellSums:
    """Sum up one camera's sine images of X in ``frames`` (n, h, w) uint8, cell by cell.

    ``p_px`` and ``q_px``: (h, w) float32. ``variance_dn2``: of the camera's noise as (dark, per grey value).
    """
    first, second, third, fourth = sequence.axis(Direction.X).sine
    shape = -(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX)
    products, apart = np.zeros((2, *shape, TERMS + 1, TERMS + 1))
    means = np.zeros(shape, MEANS)
    stride = max(1, round(math.sqrt(p_px.size / SAMPLES)))
    images = frames[first], frames[second], frames[third], frames[fourth]
    _add_pixels(images, p_px, q_px, stride, variance_dn2, products, apart, means)
    products, apart = (lower + np.tril(lower, -1).swapaxes(-1, -2) for lower in (products, apart))
    return CellSums(products, apart, means)


# Symbols of the kernels. At a pixel (u, v) with pattern coordinates (p, q): a, b, c, d are the four sine images I₀..I₃,
# (cosine, sine) = B (cos φ, sin φ), and C = a − b + c − d. x holds the terms of the fit of C: B, B cos φ, B sin φ,
# B cos 2φ, B sin 2φ, the mean light, B cos 6φ and B sin 6φ; and then C.


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _terms(images: Images, v: int, u: int, x: NDArray[np.float64]) -> None:
    """Write the terms and C of a pixel to ``x`` (TERMS + 1,)."""
    a, b = np.float64(images[0][v, u]), np.float64(images[1][v, u])
    c, d = np.float64(images[2][v, u]), np.float64(images[3][v, u])
    # Four steps of 90°: I₀ − I₂ = 2 B cos φ, I₃ − I₁ = 2 B sin φ. With z = e^{2iφ}, z³ is the sixth harmonic.
    cosine, sine = 0.5 * (a - c), 0.5 * (d - b)
    modulation = np.sqrt(max(cosine * cosine + sine * sine, 1.0))
    inverse = 1.0 / (modulation * modulation)
    z_cosine, z_sine = (cosine * cosine - sine * sine) * inverse, 2.0 * cosine * sine * inverse
    x[0], x[1], x[2] = modulation, cosine, sine
    x[3], x[4] = modulation * z_cosine, modulation * z_sine
    x[5] = 0.25 * (a + b + c + d)
    x[6] = modulation * z_cosine * (z_cosine * z_cosine - 3.0 * z_sine * z_sine)
    x[7] = modulation * z_sine * (3.0 * z_cosine * z_cosine - z_sine * z_sine)
    x[8] = a - b + c - d


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_square(x: NDArray[np.float64], sums: NDArray[np.float64]) -> None:
    """Add the lower triangle of x xᵀ to ``sums``."""
    for row in range(x.size):
        for column in range(row + 1):
            sums[row, column] += x[row] * x[column]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_pixels(
    images: Images,
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    stride: int,
    variance_dn2: tuple[float, float],
    products: NDArray[np.float64],
    apart: NDArray[np.float64],
    means: NDArray[np.void],
) -> None:
    """Add every ``stride``-th row and column of the four ``images`` to the sums of ``CellSums``."""
    i0, i1, i2, i3 = images
    height, width = p_px.shape
    rows, columns = means.shape
    dark_dn2, per_dn = variance_dn2
    x, below = np.empty(TERMS + 1), np.empty(TERMS + 1)
    for v in range(stride // 2, height, stride):
        for u in range(stride // 2 + 1, width - 1, stride):
            p, q = p_px[v, u], q_px[v, u]
            if not (0.0 <= p < columns * CELL_PX and 0.0 <= q < rows * CELL_PX):
                continue
            row, column = int(q) // CELL_PX, int(p) // CELL_PX
            cell = means[row, column]
            _terms(images, v, u, x)
            squared = x[1] * x[1] + x[2] * x[2]
            # The pixel below: noise of both with four images each, 4 σ² at either's light; over 4 B², a squared phase.
            if v + 1 < height and p_px[v + 1, u] >= 0.0:
                _terms(images, v + 1, u, below)
                cell.apart_noise += 4.0 * (2.0 * dark_dn2 + per_dn * (x[5] + below[5]))
                cell.apart_scale += 4.0 * squared
                for k in range(TERMS + 1):
                    below[k] -= x[k]
                _add_square(below, apart[row, column])
            if squared < LEAST_B2_DN2:
                continue
            _add_square(x, products[row, column])
            # The position of the cell, 1/B² and light for the noise of its phase.
            cell.count += 1.0
            cell.u += u
            cell.v += v
            cell.inverse += 1.0 / squared
            cell.light += x[5]
            # The slope of the coordinate, if both neighbours have one, and with it the gradient of the light.
            slope = 0.5 * (p_px[v, u + 1] - p_px[v, u - 1])
            if np.isnan(slope):
                continue
            cell.slope += slope
            cell.sloped += 1.0
            if abs(slope) > STEEP:
                after = np.float64(i0[v, u + 1]) + i1[v, u + 1] + i2[v, u + 1] + i3[v, u + 1]
                before = np.float64(i0[v, u - 1]) + i1[v, u - 1] + i2[v, u - 1] + i3[v, u - 1]
                gradient = 0.125 * (after - before) / slope
                # Subtract the gradient by noise, that of eight grey values. Not the mean of ratios: in dark places they
                # are large and say little.
                cell.texture += gradient * gradient - 0.125 * (dark_dn2 + per_dn * x[5]) / (slope * slope)
                cell.steep += squared
