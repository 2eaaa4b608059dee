"""Correspondence: for a left pixel's pattern coordinates (p, q), the right image point with the same.

There is no epipolar line, since refraction bends it. From one left row to the next the right point moves little: last
row's point and derivatives predict the nearest pixel, and one Newton step on central differences gives the subpixel
point. That works for nearly all pixels and is written as short loops over a row. The others (at edges, depth
discontinuities, in the first row) start from an inverse map (pattern node → pixel) and are matched one by one, which is
slower.

The last step is of second order: a parabola through three pixels in each direction. It follows curved surfaces, and its
weights on noise are smaller than those of a straight line: 0.80 instead of 1.08 of one pixel's variance.

Symbols: (u, v) is a right column and row in px, (du, dv) the step from a pixel to the point. pu, pv, qu, qv are ∂p/∂u …
∂q/∂v, puu … qvv second differences, det = pu qv − pv qu. up, uq, vp, vq are the inverse derivatives up to their signs:
du = up dp − uq dq, dv = vq dq − vp dp. In the scratch row, PC, PL, PR, PT, PB are p at the pixel (centre) and at its
neighbours to the left, right, top and bottom; QC … QB the same of q. s is the row's scratch, w that of its chunk.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import (
    BEND_RIGHT,
    MODULATION_RIGHT,
    PB,
    PC,
    PHASE_VARIANCE_RIGHT,
    PL,
    PR,
    PT,
    QB,
    QC,
    QL,
    QR,
    QT,
    RIGHT_SHARE,
    SLOPE,
    U_START,
    UP,
    UQ,
    V_START,
    VP,
    VQ,
    P,
    Q,
    U,
    V,
)
from appliance.measure.points.prefetch import LINE_BYTES, prefetch

MAX_STEPS = 4
MAX_FINAL_STEP_PX = np.float32(0.75)
"""Longest last step in px.

Noise can make two neighbours point at each other for ever; a little more than half a pixel is as accurate.
"""
MAX_FIRST_STEP_PX = np.float32(4.0)
"""Longest step in px from the pixel of the inverse map."""
MIN_DETERMINANT = np.float32(1e-4)
NODE_MARGIN = np.float32(1.5)
"""Offset of node numbers, so that coordinates from −1 px on round to nodes from 0 on."""
_HOME, _LOST, _OUTSIDE = 1, 0, -1
"""Results of a walk."""
_BLOCK = 64
"""Number of pixels that are skipped at once if all have a match."""
_LINE = LINE_BYTES // 4
"""Coordinates in a cache line."""
_ZERO, _ONE, _TWO, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
_NAN = np.float32(np.nan)
NO_VARIANCE = np.zeros((0, 0), np.float32)
"""Variance map of maps without variances: kernels are compiled for an array."""


class RightMaps(NamedTuple):
    """Maps of the right camera, (h, w) each, in which left pixels are looked up."""

    p_px: NDArray[np.float32]
    """Pattern column; NaN where there is none."""
    q_px: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    inverse: NDArray[np.uint32]
    """(rows, columns) of nodes: row·65536 + column of a pixel near the node; 0 where there is none."""
    nodes_per_px: np.float32
    """1 / distance of nodes in pattern px."""
    max_derivative_sum_px: np.float32
    """Largest sum of the absolute derivatives of p and q; beyond, the neighbours lie on another surface."""
    variance_px2: NDArray[np.float32] = NO_VARIANCE
    """(h, w): variance of either coordinate, in px² of the pattern, if it does not follow from modulation and light."""


def right_maps(
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    modulation_half_dn: NDArray[np.uint8],
    projector_width_px: int,
    projector_height_px: int,
    variance_px2: NDArray[np.float32] = NO_VARIANCE,
) -> RightMaps:
    """Return the right camera's maps (h, w) with an empty inverse map.

    Its nodes are 2 pattern px apart for images 1600 px wide, and farther for smaller ones, so that all are filled.
    """
    width_px = p_px.shape[1]
    node_px = max(2, -(-3200 // width_px))
    shape = (projector_height_px // node_px + 4, projector_width_px // node_px + 4)
    limit_px = 10.0 * max(1.0, 1600.0 / width_px)
    return RightMaps(
        p_px,
        q_px,
        modulation_half_dn,
        np.zeros(shape, np.uint32),
        np.float32(1.0 / node_px),
        np.float32(limit_px),
        variance_px2,
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def fill_inverse_map(right: RightMaps, stride: int) -> None:
    """Enter every ``stride``-th right pixel at its node, then fill each empty node from a neighbour."""
    inverse = right.inverse
    node_rows, node_columns = inverse.shape
    inverse[:, :] = np.uint32(0)
    rows, columns = right.p_px.shape
    scale = right.nodes_per_px
    for y in range(1, rows - 1, stride):
        # Of the pixels that round to a node, the last one remains.
        p, q = right.p_px[y], right.q_px[y]
        for x in range(1, columns - 1, stride):
            if p[x] == p[x]:
                node_i = np.int32(p[x] * scale + NODE_MARGIN)
                node_j = np.int32(q[x] * scale + NODE_MARGIN)
                inverse[node_j, node_i] = np.uint32(y << 16 | x)
    # An empty node takes the pixel of a neighbour, left and above first.
    for j in range(1, node_rows - 1):
        for i in range(1, node_columns - 1):
            if inverse[j, i] == 0:
                near = max(inverse[j, i - 1], inverse[j - 1, i])
                inverse[j, i] = near if near != 0 else max(inverse[j, i + 1], inverse[j + 1, i])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _upper_left(u: np.int32, v: np.int32, width: np.int32) -> np.int32:
    """Return the flat index of a pixel's neighbour to the upper left."""
    return np.int32((v - np.int32(1)) * width + u - np.int32(1))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _nearest(position: np.float32, last: np.float32) -> np.float32:
    """Return the pixel from 1 to ``last`` that is nearest to ``position``."""
    # In this form NaN becomes 1.
    position = position if position > _ONE else _ONE
    position = position if position < last else last
    return np.float32(np.floor(position + _HALF))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _predict(
    above: NDArray[np.float32],
    s: NDArray[np.float32],
    w: NDArray[np.float32],
    n: int,
    width: np.int32,
    height: np.int32,
    corner: NDArray[np.int32],
) -> None:
    """Choose the pixel nearest to the prediction from the point above; some pixel if there is none."""
    last_u, last_v = np.float32(width) - np.float32(2.0), np.float32(height) - np.float32(2.0)
    for x in range(n):
        # (u, v) = (u, v)_above + J⁻¹ (dp, dq), with the derivatives of the row above.
        dp, dq = s[P + x] - above[P + x], s[Q + x] - above[Q + x]
        u = _nearest(above[U + x] + above[UP + x] * dp - above[UQ + x] * dq, last_u)
        v = _nearest(above[V + x] + above[VQ + x] * dq - above[VP + x] * dp, last_v)
        w[U_START + x] = u
        w[V_START + x] = v
        corner[x] = _upper_left(np.int32(u), np.int32(v), width)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _look_up(
    right: RightMaps, s: NDArray[np.float32], w: NDArray[np.float32], n: int, corner: NDArray[np.int32]
) -> None:
    """Choose the pixel of the inverse map; some pixel if its node is empty."""
    inverse = right.inverse.reshape(-1)
    columns, width = np.int32(right.inverse.shape[1]), np.int32(right.p_px.shape[1])
    for x in range(n):
        start = np.uint32(0)
        if s[P + x] == s[P + x]:
            # 65537 is pixel (1, 1): for an empty node, the match from there is judged like every other.
            i = np.int32(s[P + x] * right.nodes_per_px + NODE_MARGIN)
            j = np.int32(s[Q + x] * right.nodes_per_px + NODE_MARGIN)
            start = inverse[np.uint32(j * columns + i)]
        start = start if start != np.uint32(0) else np.uint32(65537)
        v, u = np.int32(start >> np.uint32(16)), np.int32(start & np.uint32(0xFFFF))
        w[U_START + x], w[V_START + x] = np.float32(u), np.float32(v)
        corner[x] = _upper_left(u, v, width)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _move_on(
    s: NDArray[np.float32], w: NDArray[np.float32], n: int, width: np.int32, height: np.int32, corner: NDArray[np.int32]
) -> None:
    """Choose the pixel nearest to the end of the last step."""
    last_u, last_v = np.float32(width) - np.float32(2.0), np.float32(height) - np.float32(2.0)
    for x in range(n):
        u, v = _nearest(s[U + x], last_u), _nearest(s[V + x], last_v)
        w[U_START + x] = u
        w[V_START + x] = v
        corner[x] = _upper_left(np.int32(u), np.int32(v), width)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _take(source: NDArray[np.float32], indices: NDArray[np.int32], n: int, target: NDArray[np.float32]) -> None:
    """Copy ``source`` at ``indices`` to ``target``; unsigned indices need no check for negative ones."""
    for x in range(n):
        target[x] = source[np.uint32(indices[x])]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _gather(
    p: NDArray[np.float32],
    q: NDArray[np.float32],
    width: int,
    corner: NDArray[np.int32],
    n: int,
    w: NDArray[np.float32],
) -> None:
    """Load the chosen pixels and their neighbours; ``corner``: indices of the upper left neighbours.

    All other indices are larger. One quantity is loaded after the other: a loop with ten loads and ten stores takes a
    third longer.
    """
    top, left, centre, right, bottom = 1, width, width + 1, width + 2, 2 * width + 1
    _take(p[centre:], corner, n, w[PC:])
    _take(p[left:], corner, n, w[PL:])
    _take(p[right:], corner, n, w[PR:])
    _take(p[top:], corner, n, w[PT:])
    _take(p[bottom:], corner, n, w[PB:])
    _take(q[centre:], corner, n, w[QC:])
    _take(q[left:], corner, n, w[QL:])
    _take(q[right:], corner, n, w[QR:])
    _take(q[top:], corner, n, w[QT:])
    _take(q[bottom:], corner, n, w[QB:])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _take_modulation(
    half_dn: NDArray[np.uint8], width: int, corner: NDArray[np.int32], n: int, w: NDArray[np.float32]
) -> None:
    """Write MODULATION_RIGHT of the chosen pixels; ``corner`` is overwritten.

    It first gets their half grey values: to collect them one by one and convert many at once takes half as long.
    """
    centre_dn = half_dn[width + 1 :]
    for x in range(n):
        corner[x] = centre_dn[np.uint32(corner[x])]
    for x in range(n):
        w[MODULATION_RIGHT + x] = _HALF * np.float32(corner[x])


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _share(a: np.float32, b: np.float32) -> np.float32:
    """Return the variance of a coordinate interpolated at (du, dv), over that of one pixel.

    a = ½ du², b = ½ dv². The weight of the pixel is 1 − du² − dv², those of its neighbours are ½(du² ± du) and
    ½(dv² ± dv): the sum of their squares is (1 − 2(a + b))² + (a + b) + 2(a² + b²).
    """
    total = a + b
    centre = _ONE - _TWO * total
    return np.float32(centre * centre + total + _TWO * (a * a + b * b))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _newton(
    s: NDArray[np.float32],
    w: NDArray[np.float32],
    n: int,
    max_step: np.float32,
    max_sum: np.float32,
    curvature: np.float32,
) -> None:
    """Make one step on central differences; U is NaN where it is not reliable.

    ``curvature`` 1: along the parabola, in one more substitution; 0: straight, which is safer over several pixels.
    """
    half = _HALF * curvature
    for x in range(n):
        # J by central differences, and its inverse.
        pu, qu = _HALF * (w[PR + x] - w[PL + x]), _HALF * (w[QR + x] - w[QL + x])
        pv, qv = _HALF * (w[PB + x] - w[PT + x]), _HALF * (w[QB + x] - w[QT + x])
        det = pu * qv - pv * qu
        inverse = _ONE / det
        up, uq, vq, vp = qv * inverse, pv * inverse, pu * inverse, qu * inverse
        # Straight step: (du, dv) = J⁻¹ (dp, dq).
        dp, dq = s[P + x] - w[PC + x], s[Q + x] - w[QC + x]
        du, dv = up * dp - uq * dq, vq * dq - vp * dp
        # Subtract the second-order terms: dp − ½ du² puu − ½ dv² pvv; no mixed term, whose pixels are not loaded.
        puu, pvv = w[PR + x] + w[PL + x] - _TWO * w[PC + x], w[PB + x] + w[PT + x] - _TWO * w[PC + x]
        quu, qvv = w[QR + x] + w[QL + x] - _TWO * w[QC + x], w[QB + x] + w[QT + x] - _TWO * w[QC + x]
        du2, dv2 = half * du * du, half * dv * dv
        dp -= du2 * puu + dv2 * pvv
        dq -= du2 * quu + dv2 * qvv
        # The limit is on the straight step: a parabola far from its pixel may lead anywhere.
        home = (abs(du) <= max_step) & (abs(dv) <= max_step)
        du, dv = up * dp - uq * dq, vq * dq - vp * dp
        # No neighbour on another surface, and derivatives that can be inverted.
        smooth = (abs(pu) + abs(pv) + abs(qu) + abs(qv) <= max_sum) & (abs(det) > MIN_DETERMINANT)
        s[U + x] = w[U_START + x] + du if home & smooth else _NAN
        s[V + x] = w[V_START + x] + dv
        s[UP + x] = up
        s[UQ + x] = uq
        s[VQ + x] = vq
        s[VP + x] = vp
        w[SLOPE + x] = pu
        w[BEND_RIGHT + x] = _HALF * (puu + pvv)
        w[RIGHT_SHARE + x] = _share(du2, dv2)


@numba.njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _derivative(m0: np.float32, c: np.float32, m1: np.float32) -> np.float32:
    """Return the central difference, a one-sided one if a neighbour is missing, or NaN if both are."""
    if m0 == m0 and m1 == m1:
        return _HALF * (m1 - m0)
    return m1 - c if m1 == m1 else c - m0


@numba.njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _bend(m0: np.float32, c: np.float32, m1: np.float32) -> np.float32:
    """Return the second difference; 0 if a neighbour is missing."""
    return m0 + m1 - _TWO * c if m0 == m0 and m1 == m1 else _ZERO


@numba.njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _walk(
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    max_sum: np.float32,
    start: np.uint32,
    x: int,
    s: NDArray[np.float32],
    w: NDArray[np.float32],
) -> int:
    """Make Newton steps between right pixels until home, one-sided where a neighbour is missing.

    Returns _HOME, _LOST, or _OUTSIDE when a step leaves the image.
    """
    rows, columns = p_px.shape
    p, q = s[P + x], s[Q + x]
    v, u = np.int64(start >> np.uint32(16)), np.int64(start & np.uint32(0xFFFF))
    far = np.float32(3.0)
    for step in range(MAX_STEPS):
        # J = (pu pv; qu qv) by differences; no step if the surface ends on both sides of the pixel.
        c, d = p_px[v, u], q_px[v, u]
        pu = _derivative(p_px[v, u - 1], c, p_px[v, u + 1])
        qu = _derivative(q_px[v, u - 1], d, q_px[v, u + 1])
        pv = _derivative(p_px[v - 1, u], c, p_px[v + 1, u])
        qv = _derivative(q_px[v - 1, u], d, q_px[v + 1, u])
        det = pu * qv - pv * qu
        if not (abs(pu) + abs(pv) + abs(qu) + abs(qv) <= max_sum and abs(det) > MIN_DETERMINANT):
            return _LOST
        # Straight step (du, dv) = J⁻¹ (p − c, q − d), and the pixel it leads to.
        inverse = _ONE / det
        du = (qv * (p - c) - pv * (q - d)) * inverse
        dv = (pu * (q - d) - qu * (p - c)) * inverse
        # At most three pixels at a time: far from home, derivatives are those of another place.
        nu = u + np.int64(np.rint(min(max(du, -far), far)))
        nv = v + np.int64(np.rint(min(max(dv, -far), far)))
        # Within half a pixel it is home, or farther if the walk must end: no coordinate at the next pixel, or no steps.
        inside = 1 <= nu < columns - 1 and 1 <= nv < rows - 1
        goes_on = inside and step < MAX_STEPS - 1 and p_px[nv, nu] == p_px[nv, nu]
        limit = _HALF if goes_on else MAX_FINAL_STEP_PX
        if abs(du) <= limit and abs(dv) <= limit:
            # Home: the same second-order step as in ``_newton``, with the same results.
            puu, pvv = _bend(p_px[v, u - 1], c, p_px[v, u + 1]), _bend(p_px[v - 1, u], c, p_px[v + 1, u])
            quu, qvv = _bend(q_px[v, u - 1], d, q_px[v, u + 1]), _bend(q_px[v - 1, u], d, q_px[v + 1, u])
            du2, dv2 = _HALF * du * du, _HALF * dv * dv
            dp, dq = p - c - du2 * puu - dv2 * pvv, q - d - du2 * quu - dv2 * qvv
            du, dv = (qv * dp - pv * dq) * inverse, (pu * dq - qu * dp) * inverse
            # Bend ½ ∇²p = ½ Σ of the four neighbours − 2 p; NaN if one is missing, which sigma treats as a border.
            around = p_px[v, u - 1] + p_px[v, u + 1] + p_px[v - 1, u] + p_px[v + 1, u]
            w[BEND_RIGHT + x] = _HALF * around - _TWO * c
            w[RIGHT_SHARE + x] = _share(du2, dv2)
            w[U_START + x], w[V_START + x] = np.float32(u), np.float32(v)
            s[U + x], s[V + x], w[SLOPE + x] = np.float32(u) + du, np.float32(v) + dv, pu
            s[UP + x], s[UQ + x], s[VQ + x], s[VP + x] = qv * inverse, pv * inverse, pu * inverse, qu * inverse
            w[MODULATION_RIGHT + x] = _HALF * np.float32(half_dn[v, u])
            return _HOME
        if not goes_on:
            return _LOST if inside else _OUTSIDE
        u, v = nu, nv
    return _LOST


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _node(coordinate_px: np.float32, nodes_per_px: np.float32) -> int:
    """Return the number of the node of a pattern column or row."""
    return int(coordinate_px * nodes_per_px + NODE_MARGIN)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _start(inverse: NDArray[np.uint32], i: int, j: int) -> np.uint32:
    """Return the pixel of the inverse map at a node; 0 for none, and beyond its edges."""
    if i < 0 or j < 0 or i >= inverse.shape[1] or j >= inverse.shape[0]:
        return np.uint32(0)
    return np.uint32(inverse[j, i])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _any_missing(s: NDArray[np.float32], n: int) -> bool:
    """Return True if any of ``n`` places has coordinates and no match."""
    any_missing = np.int32(0)
    for x in range(n):
        missing = (s[P + x] == s[P + x]) & (s[U + x] != s[U + x])
        any_missing = np.int32(any_missing | (np.int32(1) if missing else np.int32(0)))
    return bool(any_missing != np.int32(0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _list_missing(s: NDArray[np.float32], n: int, missing: NDArray[np.int32]) -> int:
    """Write the places that have coordinates and no match into ``missing`` (n,); return their number."""
    count = 0
    for begin in range(0, n, _BLOCK):
        size = min(_BLOCK, n - begin)
        if not _any_missing(s[begin:], size):
            continue
        # Always written, but counted only if missing: a branch would be mispredicted at every edge.
        for x in range(begin, begin + size):
            missing[count] = x
            count += 1 if (s[P + x] == s[P + x]) & (s[U + x] != s[U + x]) else 0
    return count


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _search(
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    inverse: NDArray[np.uint32],
    nodes_per_px: np.float32,
    max_sum: np.float32,
    s: NDArray[np.float32],
    w: NDArray[np.float32],
    missing: NDArray[np.int32],
    count: int,
) -> None:
    """Match ``count`` places without a match, one by one, from the node's pixel or a neighbour of it.

    The starts are prefetched: each walk is a chain of steps that waits for memory, and none can begin before the last
    one has ended.
    """
    width = p_px.shape[1]
    nodes, p, q = inverse.reshape(-1), p_px.reshape(-1), q_px.reshape(-1)
    # All nodes, then the three rows of either map about the pixel of each.
    for k in range(count):
        x = missing[k]
        prefetch(nodes, _node(s[Q + x], nodes_per_px) * inverse.shape[1] + _node(s[P + x], nodes_per_px))
    for k in range(count):
        x = missing[k]
        start = _start(inverse, _node(s[P + x], nodes_per_px), _node(s[Q + x], nodes_per_px))
        # The inverse map packs row · 65536 + column.
        place = np.int64(start >> np.uint32(16)) * width + np.int64(start & np.uint32(0xFFFF))
        for row in (place - width, place, place + width):
            prefetch(p, row)
            prefetch(q, row)
    # The walks, one by one.
    for k in range(count):
        x = missing[k]
        ni, nj = _node(s[P + x], nodes_per_px), _node(s[Q + x], nodes_per_px)
        # The node itself, then its four neighbours.
        first_start = np.uint32(0)
        for ring in range(5):
            start = _start(inverse, ni + (0, 1, -1, 0, 0)[ring], nj + (0, 0, 0, 1, -1)[ring])
            if start == 0 or start == first_start:
                continue
            # A second walk only if the first one was lost.
            if _walk(p_px, q_px, half_dn, max_sum, start, x, s, w) != _LOST or first_start != 0:
                break
            first_start = start


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _take_variance(variance_px2: NDArray[np.float32], w: NDArray[np.float32], n: int) -> None:
    """Write PHASE_VARIANCE_RIGHT: the variance of the right pixel at which the last Newton step began."""
    for x in range(n):
        w[PHASE_VARIANCE_RIGHT + x] = variance_px2[np.uint32(w[V_START + x]), np.uint32(w[U_START + x])]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _prefetch_below(
    p: NDArray[np.float32],
    q: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    width: int,
    corner: NDArray[np.int32],
    n: int,
) -> None:
    """Prefetch the right pixels of the left row after the next one.

    They lie two rows below those of this row.
    """
    centre, bottom = 3 * width + 1, 4 * width + 1
    for x in range(0, n, _LINE):
        prefetch(p, corner[x] + bottom)
        prefetch(q, corner[x] + bottom)
    for x in range(0, n, 4 * _LINE):
        prefetch(half_dn, corner[x] + centre)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def match_row(
    right: RightMaps,
    above: NDArray[np.float32],
    s: NDArray[np.float32],
    w: NDArray[np.float32],
    n: int,
    coherent: bool,
    corner: NDArray[np.int32],
) -> None:
    """Match ``n`` left pixels of a row whose coordinates are in P and Q (NaN: none).

    Writes U, V: right column and row in px, U = NaN without a match; SLOPE, the gradient of p across right columns in
    px/px, and all of UP … VP; MODULATION_RIGHT; BEND_RIGHT, half the second differences of p in px, NaN if a neighbour
    is missing; RIGHT_SHARE, the variance of p there over that of one pixel; PHASE_VARIANCE_RIGHT if the maps have
    variances. ``coherent``: ``above`` is the matched row above. ``corner`` (n,) int32 is scratch. ``w``, laid out as
    ``s``, takes the quantities that the next row does not need (``scratch``).
    """
    height, width = right.p_px.shape
    p, q, modulation = right.p_px.reshape(-1), right.q_px.reshape(-1), right.modulation_half_dn.reshape(-1)
    # A pixel near the match: from the row above, or from the inverse map and one straight step.
    if coherent:
        _predict(above, s, w, n, np.int32(width), np.int32(height), corner)
    else:
        _look_up(right, s, w, n, corner)
        _gather(p, q, width, corner, n, w)
        _newton(s, w, n, MAX_FIRST_STEP_PX, right.max_derivative_sum_px, _ZERO)
        _move_on(s, w, n, np.int32(width), np.int32(height), corner)
    # The subpixel step, and the slower search for pixels that it does not match.
    _gather(p, q, width, corner, n, w)
    # Prefetch for the rows below while this one is computed.
    if coherent:
        _prefetch_below(p, q, modulation, width, corner, n)
    _take_modulation(modulation, width, corner, n, w)
    # Along the parabola: the subpixel point.
    _newton(s, w, n, MAX_FINAL_STEP_PX, right.max_derivative_sum_px, _ONE)
    # The start is no longer needed, so its buffer is free.
    missing = _list_missing(s, n, corner)
    if missing:
        _search(
            right.p_px, right.q_px, right.modulation_half_dn, right.inverse, right.nodes_per_px, right.max_derivative_sum_px,
            s, w, corner, missing,
        )  # fmt: skip
    if right.variance_px2.size:
        _take_variance(right.variance_px2, w, n)
