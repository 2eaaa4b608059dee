"""Sums over the pixels of each cell of the pattern, from which the drift of the fringes is solved."""

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
"""Pixels of a camera that are looked at, about. Four times as many change no verdict of 400 scans."""
TERMS = 8
"""Terms that C is fitted by (``drift``)."""
LEAST_B2_DN2 = 4.0
"""Least square of the fringes' amplitude for a pixel to count."""
STEEP = 0.1
"""Least slope of the coordinate, pattern px per px, by which a gradient of the light is divided."""
MEANS = np.dtype([(name, np.float64) for name in (
    "count", "u", "v", "inverse", "light", "slope", "sloped", "texture", "steep", "apart_noise", "apart_scale",
)])  # fmt: skip
"""Sums of a cell beside Σ x xᵀ. Over its pixels: how many, their places in the image, 1/B², mean light; over those with
neighbours that have coordinates: slope of the coordinate, how many, square of the light's gradient per pattern px, and
B² of these; over those with a pixel below: noise of the difference of both C, and 4 B²."""

Images = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class CellSums:
    """Sums of one camera's cells, (rows, columns, …) float64 of the pattern's cells."""

    here: NDArray[np.float64]
    """(…, ``TERMS`` + 1, ``TERMS`` + 1): Σ x xᵀ, of x with C behind it."""
    apart: NDArray[np.float64]
    """The same of the differences between a pixel and the one below it."""
    means: NDArray[np.void]
    """(…): of ``MEANS``."""


def cell_sums(
    frames: NDArray[np.uint8],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
) -> CellSums:
    """Sum up one camera's sine images of X, of ``frames`` (n, h, w) uint8, cell by cell; ``p_px`` and ``q_px`` (h, w)
    float32. ``variance_dn2``: of the camera's noise as (dark, per grey value)."""
    first, second, third, fourth = sequence.axis(Direction.X).sine
    shape = -(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX)
    here, apart = np.zeros((2, *shape, TERMS + 1, TERMS + 1))
    means = np.zeros(shape, MEANS)
    stride = max(1, round(math.sqrt(p_px.size / SAMPLES)))
    images = frames[first], frames[second], frames[third], frames[fourth]
    _add_pixels(images, p_px, q_px, stride, variance_dn2, here, apart, means)
    here, apart = (lower + np.tril(lower, -1).swapaxes(-1, -2) for lower in (here, apart))
    return CellSums(here, apart, means)


# Symbols of the kernels. At a pixel (u, v) with pattern coordinates (p, q): a, b, c, d are the four sine images I₀..I₃,
# (cosine, sine) = B (cos φ, sin φ), and C = a − b + c − d. x holds the terms that C is fitted by: B, B cos φ, B sin φ,
# B cos 2φ, B sin 2φ, the mean light, B cos 6φ and B sin 6φ; and behind them C.


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
    here: NDArray[np.float64],
    apart: NDArray[np.float64],
    means: NDArray[np.void],
) -> None:
    """Add every ``stride``-th row and column of the four ``images`` to the sums of the cells, which ``CellSums``
    names."""
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
            # The pixel below: noise of both with four images each, 4 σ² at either's light; 4 B² makes it a phase, squared.
            if v + 1 < height and p_px[v + 1, u] >= 0.0:
                _terms(images, v + 1, u, below)
                cell.apart_noise += 4.0 * (2.0 * dark_dn2 + per_dn * (x[5] + below[5]))
                cell.apart_scale += 4.0 * squared
                for k in range(TERMS + 1):
                    below[k] -= x[k]
                _add_square(below, apart[row, column])
            if squared < LEAST_B2_DN2:
                continue
            _add_square(x, here[row, column])
            # Where the cell lies, 1/B² and light for the noise of its phase.
            cell.count += 1.0
            cell.u += u
            cell.v += v
            cell.inverse += 1.0 / squared
            cell.light += x[5]
            # The coordinate's slope, where both neighbours have one, and with it the gradient of the light.
            slope = 0.5 * (p_px[v, u + 1] - p_px[v, u - 1])
            if np.isnan(slope):
                continue
            cell.slope += slope
            cell.sloped += 1.0
            if abs(slope) > STEEP:
                after = np.float64(i0[v, u + 1]) + i1[v, u + 1] + i2[v, u + 1] + i3[v, u + 1]
                before = np.float64(i0[v, u - 1]) + i1[v, u - 1] + i2[v, u - 1] + i3[v, u - 1]
                gradient = 0.125 * (after - before) / slope
                # Noise has a gradient, too: of eight grey values. Not the mean of ratios: where next to nothing is
                # illuminated, they are large and mean little.
                cell.texture += gradient * gradient - 0.125 * (dark_dn2 + per_dn * x[5]) / (slope * slope)
                cell.steep += squared
