"""Triangulation with refracted rays: the point half way between two rays, and their gap.

Symbols: a ray in water is (x, y) = (x0, y0) + (sx, sy)·(z − plane_z_mm), the left one with suffix 1, the right one with
suffix 2. h and t are the depths, above the plane, of the nearest points of the left and of the right ray. SHIFT is
∂x0/∂u of the right ray and SHIFT_SLOPE ∂sx/∂u: its displacement per px of the right image.
s and w are scratch rows (``decode/scratch.py``): s has the quantities of the whole row, w those of the current pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import (
    GAP,
    POINT_VARIANCE,
    SHIFT,
    SHIFT_SLOPE,
    SIGMA,
    SX1,
    SX2,
    SY1,
    SY2,
    X1,
    X2,
    Y1,
    Y2,
    U,
    V,
    X,
    Y,
    Z,
)
from appliance.measure.light.rays import RayLattice
from appliance.measure.points.prefetch import prefetch

RAY_BLOCK = 16
"""Number of left pixels of a row that use one node of the right lattice."""
MAX_DU_PX, MAX_DV_PX = np.float32(16.0), np.float32(8.0)
"""Largest distance of a pixel from its node, for nodes 4 px apart: within it, the series is right to 0.1 µm."""
_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_U, _V, _X2, _Y2, _SX2, _SY2, _SHIFT, _SHIFT_SLOPE = (
    np.uint64(place) for place in (U, V, X2, Y2, SX2, SY2, SHIFT, SHIFT_SLOPE)
)


class Rays(NamedTuple):
    """The water rays of both cameras as the kernels read them."""

    left: NDArray[np.float32]
    """(4, rows, w): x0, y0 in mm, sx, sy for every column of every ``step_px``-th row."""
    right: NDArray[np.float32]
    """(rows, columns, 24): the same four at nodes every ``step_px`` px, their derivatives by column and by row, and their
    second derivatives (column-column, column-row, row-row), as coefficients of the series."""
    step_px: int
    plane_z_mm: np.float32


def rays_of(left: RayLattice, right: RayLattice, left_width_px: int) -> Rays:
    """Return the rays of two lattices of equal step and plane. Raises ValueError if these differ.

    The left camera is evaluated at whole pixels, row by row: its rows of nodes are interpolated to all columns. The
    right one is evaluated anywhere, by the second-order series about the nearest node.
    """
    if left.step_px != right.step_px or left.plane_z_mm != right.plane_z_mm:
        raise ValueError("left and right ray lattices differ in step or plane; make both with the same arguments")
    step = left.step_px
    # Left: linear between the columns of nodes, for every column.
    x = np.arange(left_width_px) / step
    i = x.astype(int)
    share = (x - i)[:, None].astype(np.float32)
    spread = left.nodes[:, i] * (1 - share) + left.nodes[:, i + 1] * share
    # Right: value, first and second derivatives at each node.
    value = right.nodes.astype(np.float64)
    by_row, by_column = np.gradient(value, float(step), axis=(0, 1), edge_order=2)
    by_both, twice_by_column = np.gradient(by_column, float(step), axis=(0, 1), edge_order=2)
    twice_by_row = np.gradient(by_row, float(step), axis=0, edge_order=2)
    series = [value, by_column, by_row, 0.5 * twice_by_column, by_both, 0.5 * twice_by_row]
    return Rays(
        np.ascontiguousarray(np.moveaxis(spread, -1, 0), np.float32),
        np.ascontiguousarray(np.concatenate(series, -1), np.float32),
        step,
        np.float32(left.plane_z_mm),
    )


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _rays_one_by_one(
    nodes: NDArray[np.float32], step_px: int, n: int, s: NDArray[np.float32], w: NDArray[np.float32]
) -> None:
    """Compute the right ray of each pixel from the node nearest to it, to first order.

    Without a match, it is some node.
    """
    rows, columns = nodes.shape[0], nodes.shape[1]
    flat = nodes.reshape(-1)
    step = np.float32(step_px)
    per_px = _ONE / step
    last_i, last_j = np.float32(columns - 1), np.float32(rows - 1)
    for x in range(n):
        u, v = s[U + x], s[V + x]
        # The nearest node, within the lattice.
        i, j = u * per_px + _HALF, v * per_px + _HALF
        i = i if i > _ZERO else _ZERO
        i = i if i < last_i else last_i
        j = j if j > _ZERO else _ZERO
        j = j if j < last_j else last_j
        ni, nj = np.uint32(i), np.uint32(j)
        k = np.uint32((nj * np.uint32(columns) + ni) * np.uint32(24))
        du, dv = u - np.float32(ni) * step, v - np.float32(nj) * step
        w[X2 + x] = flat[k] + du * flat[np.uint32(k + 4)] + dv * flat[np.uint32(k + 8)]
        w[Y2 + x] = flat[np.uint32(k + 1)] + du * flat[np.uint32(k + 5)] + dv * flat[np.uint32(k + 9)]
        w[SX2 + x] = flat[np.uint32(k + 2)] + du * flat[np.uint32(k + 6)] + dv * flat[np.uint32(k + 10)]
        w[SY2 + x] = flat[np.uint32(k + 3)] + du * flat[np.uint32(k + 7)] + dv * flat[np.uint32(k + 11)]
        w[SHIFT + x] = flat[np.uint32(k + 4)]
        w[SHIFT_SLOPE + x] = flat[np.uint32(k + 6)]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _series(flat: NDArray[np.float32], k: np.uint32) -> tuple[np.float32, ...]:
    """Return the six coefficients of one quantity."""
    return (
        flat[k],
        flat[np.uint32(k + 4)],
        flat[np.uint32(k + 8)],
        flat[np.uint32(k + 12)],
        flat[np.uint32(k + 16)],
        flat[np.uint32(k + 20)],
    )


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _expand(c: tuple[np.float32, ...], du: np.float32, dv: np.float32) -> np.float32:
    """Return c0 + c1 du + c2 dv + c3 du² + c4 du dv + c5 dv²."""
    return np.float32(c[0] + du * (c[1] + du * c[3] + dv * c[4]) + dv * (c[2] + dv * c[5]))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _rays_by_blocks(
    nodes: NDArray[np.float32], step_px: int, n: int, s: NDArray[np.float32], w: NDArray[np.float32]
) -> None:
    """Compute the right rays block by block, each from one node, since neighbours see neighbouring points.

    If the node is too far from a pixel of the block, each uses its own. The last block may end beyond ``n``, up to the
    size of the slot, which is filled with the row's last pixel. A slice for each block would count references; unsigned
    indices need no check for negative ones.
    """
    rows, columns = np.int32(nodes.shape[0]), np.int32(nodes.shape[1])
    flat = nodes.reshape(-1)
    step = np.float32(step_px)
    per_px = _ONE / step
    last_i, last_j = np.float32(columns - 1), np.float32(rows - 1)
    # Overwrite the values of an earlier row behind the end: they would influence the node of the last block.
    for behind in range(n, (n + RAY_BLOCK - 1) // RAY_BLOCK * RAY_BLOCK):
        s[_U + np.uint64(behind)], s[_V + np.uint64(behind)] = s[_U + np.uint64(n - 1)], s[_V + np.uint64(n - 1)]
    for begin in range(0, n, RAY_BLOCK):
        first = np.uint64(begin)
        middle = first + np.uint64(RAY_BLOCK // 2)
        i, j = s[_U + middle] * per_px + _HALF, s[_V + middle] * per_px + _HALF
        # The node nearest to the middle of the block; in this form NaN becomes 0.
        i = i if i > _ZERO else _ZERO
        i = i if i < last_i else last_i
        j = j if j > _ZERO else _ZERO
        j = j if j < last_j else last_j
        ni, nj = np.int32(i), np.int32(j)
        u, v = np.float32(ni) * step, np.float32(nj) * step
        k = np.uint32((nj * columns + ni) * np.int32(24))
        # The following rows will use the node below.
        below = int((nj + np.int32(1)) * columns + ni) * 24
        prefetch(flat, below)
        prefetch(flat, below + 16)
        # A node's 24 numbers: coefficient after coefficient, each of x0, y0, sx, sy.
        x, y = _series(flat, k), _series(flat, np.uint32(k + 1))
        sx, sy = _series(flat, np.uint32(k + 2)), _series(flat, np.uint32(k + 3))
        # The rays of the block by the series c0 + c1 du + c2 dv + …; their shift per px is its derivative c1.
        # Pixels too far from the node are detected without a branch, so that the loop is vectorised.
        far = np.int32(0)
        for place in range(RAY_BLOCK):
            index = first + np.uint64(place)
            du, dv = s[_U + index] - u, s[_V + index] - v
            outside = (abs(du) > MAX_DU_PX) | (abs(dv) > MAX_DV_PX)
            far = np.int32(far | (np.int32(1) if outside else np.int32(0)))
            w[_X2 + index] = _expand(x, du, dv)
            w[_Y2 + index] = _expand(y, du, dv)
            w[_SX2 + index] = _expand(sx, du, dv)
            w[_SY2 + index] = _expand(sy, du, dv)
            w[_SHIFT + index] = x[1]
            w[_SHIFT_SLOPE + index] = sx[1]
        # Some pixel of the block sees another surface: each uses its own node.
        if far != np.int32(0):
            _rays_one_by_one(nodes, step_px, min(RAY_BLOCK, n - begin), s[begin:], w[begin:])


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _intersect(s: NDArray[np.float32], w: NDArray[np.float32], n: int, plane_z_mm: np.float32) -> None:
    """Triangulate the rays: write X, Y, Z, GAP, SIGMA.

    Sigma is the standard deviation along the left ray: that of the right image point across the baseline, times the
    shift of the right ray per px, times √(a / det), the derivative of h below by a shift of x.
    """
    for x in range(n):
        sx1, sy1, sx2, sy2 = w[SX1 + x], w[SY1 + x], w[SX2 + x], w[SY2 + x]
        # Shortest connection: [a −b; b −c] (h, t) = (−d, −e), with the products of directions and of their offset w.
        wx, wy = w[X1 + x] - w[X2 + x], w[Y1 + x] - w[Y2 + x]
        a = sx1 * sx1 + sy1 * sy1 + _ONE
        b = sx1 * sx2 + sy1 * sy2 + _ONE
        c = sx2 * sx2 + sy2 * sy2 + _ONE
        d = sx1 * wx + sy1 * wy
        e = sx2 * wx + sy2 * wy
        inverse = _ONE / (a * c - b * b)
        h, t = (b * e - c * d) * inverse, (a * e - b * d) * inverse
        # The gap vector; the point is half of it away from the left ray.
        gx, gy, gz = wx + h * sx1 - t * sx2, wy + h * sy1 - t * sy2, h - t
        s[X + x] = w[X1 + x] + h * sx1 - _HALF * gx
        s[Y + x] = w[Y1 + x] + h * sy1 - _HALF * gy
        s[Z + x] = plane_z_mm + _HALF * (h + t)
        s[GAP + x] = np.sqrt(gx * gx + gy * gy + gz * gz)
        # The shift per px at the depth of the point.
        shift = abs(w[SHIFT + x] + t * w[SHIFT_SLOPE + x])
        s[SIGMA + x] = shift * np.sqrt(w[POINT_VARIANCE + x] * a * inverse)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _left_rays(
    rows: NDArray[np.float32], j: int, share: np.float32, first: int, stride: int, n: int, w: NDArray[np.float32]
) -> None:
    """Compute the left rays between two rows of the table, linear in the row."""
    for axis in range(4):
        target = w[(X1, Y1, SX1, SY1)[axis] :]
        upper, lower = rows[axis, j, first:], rows[axis, j + 1, first:]
        if stride == 1:
            for x in range(n):
                target[x] = upper[x] + share * (lower[x] - upper[x])
        else:
            for x in range(n):
                target[x] = upper[x * stride] + share * (lower[x * stride] - upper[x * stride])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def triangulate_row(
    rays: Rays, y: int, first: int, stride: int, s: NDArray[np.float32], w: NDArray[np.float32], n: int
) -> None:
    """Triangulate ``n`` matched left pixels of row ``y``; where U is NaN, so are the results.

    Reads U, V, POINT_VARIANCE; writes X, Y, Z, GAP, SIGMA in mm. Place k is left column
    first + k·stride.
    """
    j = y // rays.step_px
    share = np.float32((y - j * rays.step_px) / rays.step_px)
    _left_rays(rays.left, j, share, first, stride, n, w)
    if stride == 1:
        _rays_by_blocks(rays.right, rays.step_px, n, s, w)
    else:
        _rays_one_by_one(rays.right, rays.step_px, n, s, w)
    _intersect(s, w, n, rays.plane_z_mm)
