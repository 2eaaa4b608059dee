"""Owns the intersection of refracted rays: point half way between the two rays, their gap, and the expected error."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

READ_NOISE_DN = 1.0
"""Camera noise that does not depend on light, in grey values."""
SHOT_NOISE_DN = 0.014
"""Variance per grey value: 255 DN correspond to about 18,000 electrons … 1.9 DN² at mid-scale."""


@numba.njit(nogil=True, cache=True, inline="always")
def _ray(nodes: NDArray[np.float32], inverse_step: float, u: float, v: float) -> tuple[float, float, float, float]:
    x, y = u * inverse_step, v * inverse_step
    i = min(max(int(x), 0), nodes.shape[1] - 2)
    j = min(max(int(y), 0), nodes.shape[0] - 2)
    fx, fy = x - i, y - j
    w00, w01, w10, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        w00 * nodes[j, i, 0] + w01 * nodes[j, i + 1, 0] + w10 * nodes[j + 1, i, 0] + w11 * nodes[j + 1, i + 1, 0],
        w00 * nodes[j, i, 1] + w01 * nodes[j, i + 1, 1] + w10 * nodes[j + 1, i, 1] + w11 * nodes[j + 1, i + 1, 1],
        w00 * nodes[j, i, 2] + w01 * nodes[j, i + 1, 2] + w10 * nodes[j + 1, i, 2] + w11 * nodes[j + 1, i + 1, 2],
        w00 * nodes[j, i, 3] + w01 * nodes[j, i + 1, 3] + w10 * nodes[j + 1, i, 3] + w11 * nodes[j + 1, i + 1, 3],
    )


@numba.njit(nogil=True, cache=True)
def triangulate_rows(
    left_nodes: NDArray[np.float32],
    right_nodes: NDArray[np.float32],
    step_px: int,
    plane_z_mm: float,
    right_u: NDArray[np.float32],
    right_v: NDArray[np.float32],
    right_slope: NDArray[np.float32],
    right_modulation: NDArray[np.float32],
    left_modulation: NDArray[np.float32],
    left_bright: NDArray[np.uint8],
    period_px: float,
    row_start: int,
    row_stop: int,
    stride: int,
    points: NDArray[np.float32],
    gap: NDArray[np.float32],
    sigma: NDArray[np.float32],
) -> None:
    """Triangulate matched left pixels of rows [row_start, row_stop).

    ``points`` (h, w, 3), ``gap`` and ``sigma`` (h, w) float32 in mm, NaN where there is no match. Sigma is the standard
    deviation along the left ray: four-step phase noise P·σ/(2π·√2·B) of both cameras, divided by the pattern's
    gradient across the right image, times the shift of the right ray per px, over the sine of the angle between them.
    """
    columns = right_u.shape[1]
    right_rows, right_columns = right_modulation.shape
    inverse_step = 1.0 / step_px
    phase_scale = period_px / (2.0 * math.pi * math.sqrt(2.0))
    for y in range(row_start, row_stop, stride):
        for x in range(0, columns, stride):
            u, v = right_u[y, x], right_v[y, x]
            if u != u:  # NaN: no match
                points[y, x, 0] = np.nan
                points[y, x, 1] = np.nan
                points[y, x, 2] = np.nan
                gap[y, x] = np.nan
                sigma[y, x] = np.nan
                continue
            x1, y1, sx1, sy1 = _ray(left_nodes, inverse_step, float(x), float(y))
            x2, y2, sx2, sy2 = _ray(right_nodes, inverse_step, float(u), float(v))
            wx, wy = x1 - x2, y1 - y2
            a = sx1 * sx1 + sy1 * sy1 + 1.0
            b = sx1 * sx2 + sy1 * sy2 + 1.0
            c = sx2 * sx2 + sy2 * sy2 + 1.0
            d = sx1 * wx + sy1 * wy
            e = sx2 * wx + sy2 * wy
            det = a * c - b * b
            s = (b * e - c * d) / det
            t = (a * e - b * d) / det
            ax, ay = x1 + s * sx1, y1 + s * sy1
            bx, by = x2 + t * sx2, y2 + t * sy2
            points[y, x, 0] = 0.5 * (ax + bx)
            points[y, x, 1] = 0.5 * (ay + by)
            points[y, x, 2] = plane_z_mm + 0.5 * (s + t)
            gap[y, x] = math.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (s - t) ** 2)
            # Expected error.
            x3, y3, sx3, sy3 = _ray(right_nodes, inverse_step, float(u) + 1.0, float(v))
            shift = math.hypot(x3 - x2 + (sx3 - sx2) * t, y3 - y2 + (sy3 - sy2) * t)
            iu = min(max(int(u + 0.5), 0), right_columns - 1)
            iv = min(max(int(v + 0.5), 0), right_rows - 1)
            noise = math.sqrt(READ_NOISE_DN**2 + SHOT_NOISE_DN * 0.5 * float(left_bright[y, x]))
            # The nearest right pixel may be a masked neighbour of the matched ones.
            b_left = max(float(left_modulation[y, x]), 1.0)
            b_right = max(float(right_modulation[iv, iu]), 1.0)
            phase_px = phase_scale * noise * math.sqrt(1.0 / (b_left * b_left) + 1.0 / (b_right * b_right))
            slope = max(abs(float(right_slope[y, x])), 0.05)
            sigma[y, x] = phase_px / slope * shift / math.sqrt(det / (a * c)) * math.sqrt(c / a)
