"""Owns correspondence: for a left pixel's pattern coordinates (p, q), the right image point that has the same.

No epipolar line is assumed: refraction bends it. A coarse inverse map of the right camera (pattern node → pixel)
gives the start, Newton steps on the right coordinate maps give the subpixel point.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

NO_PIXEL = -1
MAX_STEPS = 8
MAX_DERIVATIVE_SUM_PX = 40.0
"""Sum of the absolute derivatives of (p, q): beyond, the neighbours lie on another surface."""
MAX_FINAL_STEP_PX = 0.75


def node_size_px(width_px: int) -> int:
    """Pattern px between nodes of the inverse map: 2 for 1600 px, coarser for smaller images: all get filled."""
    return max(2, -(-3200 // width_px))


@numba.njit(nogil=True, cache=True)
def fill_inverse_map(
    p: NDArray[np.float32],
    q: NDArray[np.float32],
    mask: NDArray[np.uint8],
    stride: int,
    node_px: int,
    inverse: NDArray[np.int32],
) -> None:
    """Write the flat index of some right pixel near each pattern node into ``inverse`` (rows, columns) int32."""
    node_rows, node_columns = inverse.shape
    for j in range(node_rows):
        for i in range(node_columns):
            inverse[j, i] = NO_PIXEL
    rows, columns = p.shape
    scale = np.float32(1.0) / np.float32(node_px)
    for y in range(0, rows, stride):
        for x in range(0, columns, stride):
            if mask[y, x] == 0:
                i = int(p[y, x] * scale + np.float32(0.5))
                j = int(q[y, x] * scale + np.float32(0.5))
                if 0 <= i < node_columns and 0 <= j < node_rows:
                    inverse[j, i] = y * columns + x


@numba.njit(nogil=True, cache=True, inline="always")
def _derivative(m0: float, c: float, m1: float, valid0: bool, valid1: bool) -> float:
    if valid0 and valid1:
        return 0.5 * (m1 - m0)
    if valid1:
        return m1 - c
    return c - m0


@numba.njit(nogil=True, cache=True)
def match_rows(
    left_p: NDArray[np.float32],
    left_q: NDArray[np.float32],
    left_mask: NDArray[np.uint8],
    right_p: NDArray[np.float32],
    right_q: NDArray[np.float32],
    right_mask: NDArray[np.uint8],
    inverse: NDArray[np.int32],
    node_px: int,
    row_start: int,
    row_stop: int,
    stride: int,
    right_u: NDArray[np.float32],
    right_v: NDArray[np.float32],
    right_slope: NDArray[np.float32],
) -> None:
    """Match left rows [row_start, row_stop) by ``stride``; NaN where there is no match.

    Outputs (h, w) float32: matched right column and row in px, and the gradient of p across right columns (px/px).
    """
    _rows, columns = left_p.shape
    right_rows, right_columns = right_p.shape
    node_rows, node_columns = inverse.shape
    scale = np.float32(1.0) / np.float32(node_px)
    for y in range(row_start, row_stop, stride):
        for x in range(0, columns, stride):
            right_u[y, x] = np.nan
            right_v[y, x] = np.nan
            right_slope[y, x] = np.nan
            if left_mask[y, x] != 0:
                continue
            p, q = left_p[y, x], left_q[y, x]
            ni = int(p * scale + np.float32(0.5))
            nj = int(q * scale + np.float32(0.5))
            start = -1
            for ring in range(9):
                i = ni + (0, 1, -1, 0, 0, 1, -1, 1, -1)[ring]
                j = nj + (0, 0, 0, 1, -1, 1, -1, -1, 1)[ring]
                if 0 <= i < node_columns and 0 <= j < node_rows and inverse[j, i] >= 0:
                    start = inverse[j, i]
                    break
            if start < 0:
                continue
            v = start // right_columns
            u = start - v * right_columns
            for step in range(MAX_STEPS):
                c, d = right_p[v, u], right_q[v, u]
                left_ok = u > 0 and right_mask[v, u - 1] == 0
                right_ok = u + 1 < right_columns and right_mask[v, u + 1] == 0
                up_ok = v > 0 and right_mask[v - 1, u] == 0
                down_ok = v + 1 < right_rows and right_mask[v + 1, u] == 0
                if not ((left_ok or right_ok) and (up_ok or down_ok)):
                    break
                u0, u1 = max(u - 1, 0), min(u + 1, right_columns - 1)
                v0, v1 = max(v - 1, 0), min(v + 1, right_rows - 1)
                pu = _derivative(right_p[v, u0], c, right_p[v, u1], left_ok, right_ok)
                qu = _derivative(right_q[v, u0], d, right_q[v, u1], left_ok, right_ok)
                pv = _derivative(right_p[v0, u], c, right_p[v1, u], up_ok, down_ok)
                qv = _derivative(right_q[v0, u], d, right_q[v1, u], up_ok, down_ok)
                if abs(pu) + abs(pv) + abs(qu) + abs(qv) > MAX_DERIVATIVE_SUM_PX:
                    break
                det = pu * qv - pv * qu
                if abs(det) < 1e-4:
                    break
                rp, rq = p - c, q - d
                du = (qv * rp - pv * rq) / det
                dv = (pu * rq - qu * rp) / det
                inside = abs(du) <= 0.5 and abs(dv) <= 0.5
                last = step == MAX_STEPS - 1
                if inside or (last and abs(du) <= MAX_FINAL_STEP_PX and abs(dv) <= MAX_FINAL_STEP_PX):
                    right_u[y, x] = u + du
                    right_v[y, x] = v + dv
                    right_slope[y, x] = pu
                    break
                # Not home yet: go to the pixel the step points at, at most 3 px at a time.
                nu = u + int(np.rint(min(max(du, -3.0), 3.0)))
                nv = v + int(np.rint(min(max(dv, -3.0), 3.0)))
                if nu < 0 or nv < 0 or nu >= right_columns or nv >= right_rows or right_mask[nv, nu] != 0:
                    if abs(du) <= MAX_FINAL_STEP_PX and abs(dv) <= MAX_FINAL_STEP_PX:
                        right_u[y, x] = u + du
                        right_v[y, x] = v + dv
                        right_slope[y, x] = pu
                    break
                u, v = nu, nv
