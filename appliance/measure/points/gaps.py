"""Owns the sample of signed ray gaps of a scan: matched like all points, but before any limit could hide a knock.

The gap is w · n / |n|, w the offset of the two rays on the lattice's plane and n the cross product of their directions; its
sign is that of the side on which the right ray passes.

Symbols: the left ray goes along (ax, ay, 1), the right one along (bx, by, 1), and n = (cx, cy, cz); (u, v) and (u', v') are the
left pixel and its match in px.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import GapModes
from appliance.measure.calibration.patches import average
from appliance.measure.cloud import PatchGaps
from appliance.measure.decode.scratch import SIZE, SX1, SX2, SY1, SY2, X1, X2, Y1, Y2, P, Q, U, V, Z
from appliance.measure.points.match import RightMaps, match_row
from appliance.measure.points.triangulate import Rays, triangulate_row

SAMPLES = 5_000
"""Number of left pixels that are asked: a hundred in each patch of a lit image, so that noise is a tenth of that of a point."""
MAX_GAP_MM = np.float32(20.0)
"""Largest gap in mm; beyond, it is a false match: no camera that still sees the fringes is knocked so far."""
_DEPTHS_MM = (300.0, 900.0)
"""Depths of the standard housing between which gaps are taken."""
_NAN = np.float32(np.nan)
_COLUMNS = 5


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sample(
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    right: RightMaps,
    rays: Rays,
    stride: int,
    depths_mm: tuple[np.float32, np.float32],
    found: NDArray[np.float32],
) -> int:
    """Write u, v, u', v' in px and the signed gap in mm of every ``stride``-th pixel that has a match; return how many."""
    rows, columns = p_px.shape
    n = (columns + stride - 1) // stride
    s = np.full(SIZE, _NAN, np.float32)
    at = np.zeros(columns, np.int32)
    count = 0
    for y in range(stride // 2, rows, stride):
        for x in range(n):
            s[P + x], s[Q + x] = p_px[y, x * stride], q_px[y, x * stride]
        match_row(right, s, s, s, n, False, at)
        triangulate_row(rays, y, 0, stride, s, s, n)
        # Limits are wider than those of points: a knock shows in what they would leave out.
        for x in range(n):
            if not (depths_mm[0] < s[Z + x] < depths_mm[1]):
                continue
            # n = (ax, ay, 1) × (bx, by, 1).
            ax, ay, bx, by = s[SX1 + x], s[SY1 + x], s[SX2 + x], s[SY2 + x]
            cx, cy, cz = ay - by, bx - ax, ax * by - ay * bx
            gap = ((s[X1 + x] - s[X2 + x]) * cx + (s[Y1 + x] - s[Y2 + x]) * cy) / np.sqrt(cx * cx + cy * cy + cz * cz)
            if abs(gap) < MAX_GAP_MM:
                found[count, 0], found[count, 1] = np.float32(x * stride), np.float32(y)
                found[count, 2], found[count, 3] = s[U + x], s[V + x]
                found[count, 4] = gap if cy > np.float32(0.0) else -gap
                count += 1
    return count


class GapSampler:
    """A sampler of the gaps of one instrument's scans. Buffers are allocated once."""

    def __init__(self, modes: GapModes) -> None:
        self._modes = modes
        width_px, height_px = modes.size_px
        self._stride = max(1, round((width_px * height_px / SAMPLES) ** 0.5))
        most = -(-width_px // self._stride) * -(-height_px // self._stride)
        self._found = np.empty((most, _COLUMNS), np.float32)
        low, high = _DEPTHS_MM
        self._depths_mm = np.float32(modes.volume.scaled(low)), np.float32(modes.volume.scaled(high))

    def matches(
        self,
        p_px: NDArray[np.float32],
        q_px: NDArray[np.float32],
        right: RightMaps,
        rays: Rays,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return matched pixels (n, 2) of both cameras, the sample that ``measure`` averages."""
        found = self._sampled(p_px, q_px, right, rays)
        return found[:, 0:2], found[:, 2:4]

    def _sampled(
        self,
        p_px: NDArray[np.float32],
        q_px: NDArray[np.float32],
        right: RightMaps,
        rays: Rays,
    ) -> NDArray[np.float64]:
        count = int(_sample(p_px, q_px, right, rays, self._stride, self._depths_mm, self._found))
        return self._found[:count].astype(np.float64)

    def measure(
        self,
        p_px: NDArray[np.float32],
        q_px: NDArray[np.float32],
        right: RightMaps,
        rays: Rays,
    ) -> PatchGaps:
        """Return the gaps of a decoded scan; ``right`` with its inverse map filled."""
        found = self._sampled(p_px, q_px, right, rays)
        return average(self._modes, found[:, 0:2], found[:, 2:4], 1000.0 * found[:, 4])
