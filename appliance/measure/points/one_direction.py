"""Epipolar matching: points from fringes of one direction.

The correspondence of a left pixel lies where the right image, along the pixel's refracted epipolar curve, has the same
coordinate. Nothing checks such points. With two directions the rays of a wrong calibration pass each other, and the gap
shows it; with one they always meet. Such a cloud is marked (``UNCHECKED``) and never used to calibrate, to evaluate or
to watch the calibration.

Method: curves are cut into pieces of ``reach.PIECE_PX``. For each piece, each cell of the left image has the least and
the greatest coordinate that the right image has near it. Only pieces that may have the pixel's coordinate are searched,
pixel by pixel. There Newton steps along the curve, on the quadratic surface fitted to a pixel and its neighbours, find
the crossing. All such pieces are searched: if there are two crossings, the pixel is ambiguous and gets no point.

Symbols: s runs along the curve from −1 at the nearest to 1 at the farthest depth (``measure/light/epipolar.py``), (u,
v) is the place in the right image, (us, vs) its derivative by s. p is the left pixel's coordinate; c, l, r, t, b are
the right map's at a pixel and at its neighbours to the left, right, top and bottom; pu, puu, pv, pvv their first and
second differences; (du, dv) the offset of (u, v) from the pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import borrowed
from appliance.measure.light.epipolar import RAY_TERMS, CurveError, EpipolarCurves, epipolar_curves, inverse_depths
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.points.reach import TOGETHER, places, reach_along

UNCHECKED = "unchecked: fringes of one direction only, no ray gap tells whether the calibration fits"
"""The note that every file of such a cloud carries."""
MAX_STEPS, LAST_STEPS = 11, 3
"""Largest number of Newton steps; the last ones stay at their pixel up to ``MAX_HOME_PX`` away, since noise can make
two neighbours point at each other for ever."""
MAX_STEP_PX = 3.0
"""Longest step along the curve in px: far from the crossing, derivatives are those of another place."""
HOME_PX, MAX_HOME_PX = 0.5, 0.75
"""Largest distance of a crossing from the pixel from which it is interpolated; the second one is for the last steps."""
CONVERGED_PX = 1e-5
SAME_PX = 3.0
"""Crossings closer than this along the curve are one, which noise has multiplied."""
MIN_ANGLE_DEG = 10.0
"""Least angle between the curve and the lines of equal coordinate.

Below it, an error of the coordinate is six times as large in depth, and an error of the calibration moves the crossing
far.
"""
ANGLE_SAMPLES = 2_000
"""Number of left pixels at which the angle between curve and fringes is measured."""
STEPS_OF_SURFACE, STEPS_OF_BEND = 6.0, 1.5
"""Multiples of the coordinate's usual difference between neighbours from which a difference is a jump, and a second
difference an edge."""
NOISE_OF_STEP = 8.0
"""Multiple of the noise that is added to these limits."""
SPREAD_OF_POINTS = 9.4
"""Allowed distance in depth of two neighbours of one surface, over the distance of their rays: 1.5 mm on the default
rig."""
_NO_NOISE = np.zeros((0, 0), np.float32)


class OneDirectionError(CurveError):
    """These maps cannot be matched with one direction; the text says why, and the remedy."""


class NoPoint(IntEnum):
    """Reason why a left pixel has no point; the first that applies."""

    FOUND = 0
    NO_PHASE = 1
    """The left pixel has no coordinate."""
    OUT_OF_VIEW = 2
    """The curve passes no right pixel that has a coordinate."""
    NO_CROSSING = 3
    """No right pixel along the curve has the coordinate: the point is occluded, or outside of the depths."""
    STEP = 4
    """The right map has the coordinate only between two pixels of two surfaces, where there is no surface."""
    SEVERAL = 5
    """The curve crosses the coordinate more than once: ambiguous."""
    GRAZING = 6
    """The fringes run along the curve there (less than ``MIN_ANGLE_DEG``)."""
    LONELY = 7
    """Too few neighbours are on the same surface, or the standard deviation is too large."""


@dataclass(frozen=True, slots=True)
class OneDirectionLimits:
    """Limits of a search; those that are ``None`` follow from the maps."""

    jump_px: float | None = None
    """Least difference of neighbouring coordinates of two surfaces, in px of the pattern."""
    bend_px: float | None = None
    """Least second difference at an edge."""
    max_sigma_mm: float = math.inf
    """Largest standard deviation of a point, if the noise is known."""
    max_step_mm: float | None = None
    """Largest distance in depth to a neighbour of the same surface."""
    min_neighbours: int = 5
    """Least number of such neighbours, of eight."""
    min_angle_deg: float = MIN_ANGLE_DEG


@dataclass(frozen=True, slots=True, eq=False)
class UncheckedPoints:
    """Points of one direction on the left image's pixels, left camera frame.

    Nothing has checked them (``UNCHECKED``).
    """

    points_mm: NDArray[np.float32]
    """(h, w, 3) float32; NaN where there is no point."""
    sigma_mm: NDArray[np.float32]
    """(h, w) float32: standard deviation along the ray; NaN without a point or if the noise is unknown."""
    reason: NDArray[np.uint8]
    """(h, w) uint8, values of ``NoPoint``."""
    right_px: NDArray[np.float32]
    """(h, w, 2) float32: (u, v) of the correspondence in the right image; NaN without a point."""
    angle_deg: float
    """Median angle between the curves and the fringes; 90 is best."""

    @property
    def unchecked(self) -> bool:
        """True: such points are never used for calibrating, evaluating or the calibration's health."""
        return True

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(h, w) bool: the pixel has a point."""
        return np.asarray(self.reason == NoPoint.FOUND)

    def count(self, reason: NoPoint) -> int:
        """Return the number of pixels with that reason."""
        return int(np.count_nonzero(self.reason == reason))


class _Curves(NamedTuple):
    """``EpipolarCurves`` as the kernel reads them."""

    nodes: NDArray[np.float64]
    degree: int
    across_px: float
    """Distance of two nodes across, and down."""
    down_px: float
    middle: float
    """1/z = middle + half · s, per mm."""
    half: float
    first_cell: int
    """Number of the first row of cells (between four nodes each) of ``reach_px``."""
    reach_px: NDArray[np.float32]
    """(cells down, across, 2, pieces): least and greatest coordinate of the right image near a piece of a curve of the
    cell; NaN where it has none. Pieces have equal lengths in s."""
    together_px: NDArray[np.float32]
    """The same of ``TOGETHER`` pieces each."""


class _Right(NamedTuple):
    """The right image's maps as the kernel reads them."""

    p_px: NDArray[np.float32]
    """(h, w)."""
    sigma_px: NDArray[np.float32]
    """(h, w), or (0, 0)."""
    jump_px: float
    bend_px: float
    min_sine: float
    """Sine of the least angle between curve and fringes."""


class _Crossing(NamedTuple):
    """The result of one search."""

    s: float
    u: float
    v: float
    slope: float
    """Derivative of the coordinate by s; 0: no crossing there."""
    variance: float
    """Variance of the coordinate interpolated there."""
    grazing: bool


_NONE = _Crossing(0.0, 0.0, 0.0, 0.0, 0.0, False)


def match_along_curves(
    left_px: NDArray[np.float32],
    right_px: NDArray[np.float32],
    rig: StereoRig,
    water_index: float,
    z_mm: tuple[float, float],
    noise_px: tuple[float | NDArray[np.float32], float | NDArray[np.float32]] | None = None,
    limits: OneDirectionLimits | None = None,
    *,
    partners: bool = True,
) -> UncheckedPoints:
    """Find the point of each left pixel whose coordinate the right image has along the epipolar curve.

    ``left_px`` and ``right_px`` (h, w) float32 are coordinates of one direction, X or Y, absolute in px of the pattern;
    NaN where there is none. ``z_mm`` are nearest and farthest depth in the left camera frame. ``noise_px`` are the
    standard deviations of left and right coordinates, each a number or a map (h, w). The cameras may differ in size; in
    air they are the same with ``lens_in_water``. Without ``partners``, ``right_px`` of the result is empty, which saves
    memory. Raises OneDirectionError for maps that are not of the rig's cameras, for maps without coordinates, and where
    the fringes run along the curves; CurveError for depths without curves.
    """
    wish = limits or OneDirectionLimits()
    left, right = _checked(left_px, rig.left, "left"), _checked(right_px, rig.right, "right")
    curves = epipolar_curves(rig, water_index, z_mm)
    sigmas = (_NO_NOISE, _NO_NOISE)
    typical_px = 0.0
    if noise_px is not None:
        sigmas = (_noise(noise_px[0], left.shape), _noise(noise_px[1], right.shape))
        # Pixels without a coordinate have hardly any light; their noise is not typical of the others.
        typical_px = float(np.nanmedian(sigmas[1][np.isfinite(right)]))
    step_px = _usual_step(right)
    angle_deg = _angle(curves, left, right)
    if angle_deg < wish.min_angle_deg:
        raise OneDirectionError(
            f"the fringes run along the epipolar curves: the angle between them is {angle_deg:.1f}°, at least "
            f"{wish.min_angle_deg:g}° are needed; use the fringes of the other direction"
        )
    jump_px = wish.jump_px if wish.jump_px is not None else STEPS_OF_SURFACE * step_px + NOISE_OF_STEP * typical_px
    bend_px = wish.bend_px if wish.bend_px is not None else STEPS_OF_BEND * step_px + NOISE_OF_STEP * typical_px
    middle, half = inverse_depths(curves.z_mm)
    points_mm = np.full((*left.shape, 3), np.nan, np.float32)
    sigma_mm = np.full(left.shape, np.nan, np.float32)
    partner_px = np.full((*left.shape, 2) if partners else (0, 0, 2), np.nan, np.float32)
    reason = np.zeros(left.shape, np.uint8)
    right_maps = _Right(right, sigmas[1], jump_px, bend_px, math.sin(math.radians(wish.min_angle_deg)))
    # The last row of pixels belongs to the last row of cells.
    cell = np.minimum(np.arange(len(left)) / curves.spacing_px[1], len(curves.nodes) - 2).astype(int)
    for first, reach_px, together_px in reach_along(curves, right, step_px):
        start, stop = np.searchsorted(cell, (first, first + len(reach_px)))
        cut = _Curves(curves.nodes, curves.degree, *curves.spacing_px, middle, half, first, reach_px, together_px)
        _match_rows(left, sigmas[0], right_maps, cut, int(start), int(stop), points_mm, sigma_mm, partner_px, reason)
    if wish.min_neighbours or wish.max_sigma_mm < math.inf:
        lonely = _lonely(points_mm[..., 2], sigma_mm, wish, curves)
        reason[lonely] = NoPoint.LONELY
        for values in (points_mm, sigma_mm, *([partner_px] if partners else [])):
            values[lonely] = np.nan
    return UncheckedPoints(points_mm, sigma_mm, reason, partner_px, angle_deg)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _cubic(position: float, count: int) -> tuple[int, float, float, float, float]:
    """Return the first of the four of ``count`` nodes around ``position``, and their cubic weights."""
    first = min(max(int(position) - 1, 0), count - 4)
    a = position - first
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    return first, -b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _place(terms: NDArray[np.float64], degree: int, s: float) -> tuple[float, float, float, float]:
    """Return u, v, us, vs at s: both polynomials and their derivatives, by Horner's rule."""
    first_u, first_v = RAY_TERMS, RAY_TERMS + degree + 1
    u, v, us, vs = terms[first_u + degree], terms[first_v + degree], 0.0, 0.0
    for k in range(degree - 1, -1, -1):
        us, vs = us * s + u, vs * s + v
        u, v = u * s + terms[first_u + k], v * s + terms[first_v + k]
    return u, v, us, vs


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _differences(before: float, centre: float, after: float, jump_px: float) -> tuple[float, float, int]:
    """Return the first and second difference, and from which sides they are.

    2: both; −1 or 1: one, since the other neighbour has no coordinate or that of another surface; 0: none.
    """
    a, b = centre - before, after - centre
    has_before, has_after = abs(a) <= jump_px, abs(b) <= jump_px
    if has_before and has_after:
        return 0.5 * (a + b), b - a, 2
    if has_before:
        return a, 0.0, -1
    return (b, 0.0, 1) if has_after else (0.0, 0.0, 0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _share(d: float, sides: int) -> tuple[float, float]:
    """Return the change of a pixel's weight by reading ``d`` px beside it, and its neighbours' squares."""
    # The parabola's weights are 1 − d², (d² − d)/2, (d² + d)/2; the straight line's 1 ± d and ∓d.
    if sides == 2:
        return -d * d, 0.5 * (d**4 + d * d)
    return (d, d * d) if sides < 0 else (-d, d * d)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _fitted(
    p_px: NDArray[np.float32], x: int, y: int, jump_px: float
) -> tuple[float, float, float, float, float, float]:
    """Return c, pu, puu, pv, pvv, puv of the least-squares fit to a pixel and its eight neighbours.

    c is NaN where a corner has no coordinate, or that of another surface.
    """
    c = float(p_px[y, x])
    left, right, above, below = (
        float(p_px[y, x - 1]) - c,
        float(p_px[y, x + 1]) - c,
        float(p_px[y - 1, x]) - c,
        float(p_px[y + 1, x]) - c,
    )
    # Corners, clockwise from the upper left; each lies two steps away.
    k, l, m, n = (
        float(p_px[y - 1, x - 1]) - c,
        float(p_px[y - 1, x + 1]) - c,
        float(p_px[y + 1, x + 1]) - c,
        float(p_px[y + 1, x - 1]) - c,
    )
    if not (
        abs(k) <= 2.0 * jump_px and abs(l) <= 2.0 * jump_px and abs(m) <= 2.0 * jump_px and abs(n) <= 2.0 * jump_px
    ):
        return np.nan, 0.0, 0.0, 0.0, 0.0, 0.0
    # Weights 1/9 · (−1 2 −1; 2 5 2; −1 2 −1) for the value; means over three rows or columns for the differences.
    value = c + (2.0 * (left + right + above + below) - (k + l + m + n)) / 9.0
    pu, pv = (l + right + m - k - left - n) / 6.0, (n + below + m - k - above - l) / 6.0
    puu = (k + left + n + l + right + m - 2.0 * (above + below)) / 3.0
    pvv = (k + above + l + n + below + m - 2.0 * (left + right)) / 3.0
    return value, pu, puu, pv, pvv, 0.25 * (k + m - l - n)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _cross(right: _Right, terms: NDArray[np.float64], degree: int, p: float, s: float) -> _Crossing:
    """Find where the curve crosses the coordinate ``p``, beginning at ``s``."""
    rows, columns = right.p_px.shape
    x, y = -1, -1
    c, pu, puu, pv, pvv, puv, in_u, in_v, complete = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, False
    for iteration in range(MAX_STEPS):
        u, v, us, vs = _place(terms, degree, s)
        # Another pixel is nearer: interpolate from its neighbours.
        limit = HOME_PX if iteration < MAX_STEPS - LAST_STEPS else MAX_HOME_PX
        if x < 0 or abs(u - x) > limit or abs(v - y) > limit:
            x, y = math.floor(u + 0.5), math.floor(v + 0.5)
            if not (1 <= x < columns - 1 and 1 <= y < rows - 1):
                return _NONE
            c = float(right.p_px[y, x])
            pu, puu, in_u = _differences(right.p_px[y, x - 1], c, right.p_px[y, x + 1], right.jump_px)
            pv, pvv, in_v = _differences(right.p_px[y - 1, x], c, right.p_px[y + 1, x], right.jump_px)
            # Isolated, or at an edge: between its neighbours there is no surface. NaN at the pixel ends here, too.
            if in_u == 0 or in_v == 0 or max(abs(puu), abs(pvv)) > right.bend_px:
                return _NONE
            # With all nine pixels, their least-squares quadratic surface, which has two thirds of the noise.
            puv = 0.0
            complete = in_u == 2 and in_v == 2
            if complete:
                fitted = _fitted(right.p_px, x, y, right.jump_px)
                complete = fitted[0] == fitted[0]
                if complete:
                    c, pu, puu, pv, pvv, puv = fitted
        du, dv = u - x, v - y
        # p(u, v) = c + pu du + ½ puu du² + pv dv + ½ pvv dv² + puv du dv, and its derivative along the curve.
        value = c + du * (pu + 0.5 * puu * du + puv * dv) + dv * (pv + 0.5 * pvv * dv)
        gu, gv = pu + puu * du + puv * dv, pv + pvv * dv + puv * du
        slope = gu * us + gv * vs
        if slope == 0.0:
            return _NONE
        step = (p - value) / slope
        speed = max(abs(us), abs(vs))
        if abs(step) * speed <= CONVERGED_PX:
            if complete:
                # Σ φ_k² of the orthonormal polynomials 1/3, i/√6, j/√6, (3 i² − 2)/√18, (3 j² − 2)/√18, i j/2 of the
                # nine.
                even = (3.0 * du * du - 2.0) ** 2 + (3.0 * dv * dv - 2.0) ** 2
                share = 1.0 / 9.0 + (du * du + dv * dv) / 6.0 + even / 18.0 + 0.25 * du * du * dv * dv
            else:
                (own_u, others_u), (own_v, others_v) = _share(du, in_u), _share(dv, in_v)
                share = (1.0 + own_u + own_v) ** 2 + others_u + others_v
            variance = share * right.sigma_px[y, x] ** 2 if right.sigma_px.size else np.nan
            # Sine of the angle between the curve and the line of equal coordinate.
            squarely = slope * slope >= right.min_sine**2 * (gu * gu + gv * gv) * (us * us + vs * vs)
            return _Crossing(s, u, v, slope, variance, not squarely)
        longest = MAX_STEP_PX / speed
        s += min(max(step, -longest), longest)
    return _NONE


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _more(right: _Right, p: float, u: float, v: float) -> float:
    """Return the difference of a pixel's coordinate from ``p``; NaN without a coordinate or neighbours."""
    rows, columns = right.p_px.shape
    x, y = math.floor(u + 0.5), math.floor(v + 0.5)
    return float(right.p_px[y, x]) - p if 1 <= x < columns - 1 and 1 <= y < rows - 1 else np.nan


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _search(
    right: _Right,
    terms: NDArray[np.float64],
    degree: int,
    p: float,
    reach_px: NDArray[np.float32],
    together_px: NDArray[np.float32],
) -> tuple[_Crossing, int]:
    """Search the pieces that may have ``p``; return the only crossing and FOUND, or none and the reason."""
    pieces = reach_px.shape[1]
    accepted, crossings, reason = _NONE, 0, 2
    # End of the last crossing's neighbourhood, in which there is no other one.
    behind = -2.0
    # The last pixel's coordinate minus p.
    before = np.nan
    piece = -1
    while piece + 1 < pieces:
        piece += 1
        # Skip the pieces that cannot have p.
        if piece % TOGETHER == 0 and not together_px[0, piece // TOGETHER] <= p <= together_px[1, piece // TOGETHER]:
            piece += TOGETHER - 1
            before = np.nan
            continue
        if not reach_px[0, piece] <= p <= reach_px[1, piece]:
            before = np.nan
            continue
        low = 2.0 * piece / pieces - 1.0
        # Within a piece the curve is a straight line to a hundredth of a pixel: enough to choose pixels.
        u, v, _, _ = _place(terms, degree, low)
        end_u, end_v, us, vs = _place(terms, degree, low + 2.0 / pieces)
        count = int(max(abs(end_u - u), abs(end_v - v))) + 1
        step_u, step_v, step_s = (end_u - u) / count, (end_v - v) / count, 2.0 / (pieces * count)
        more = _more(right, p, u, v)
        for k in range(count + 1):
            s, u, v = low + k * step_s, u + step_u, v + step_v
            after = _more(right, p, u, v) if k < count else np.nan
            reason = 3 if more == more and reason == 2 else reason
            # Behind a crossing, steps from pixels that are not the nearest ones would lead back to it.
            nearest = crossings == 0 or not (abs(before) <= abs(more) or abs(after) < abs(more))
            if s > behind and nearest and abs(more) <= right.jump_px:
                crossing = _cross(right, terms, degree, p, s)
                if crossing.slope != 0.0 and abs(crossing.s) <= 1.0:
                    reason = 6 if crossing.grazing else reason
                    # The same crossing, reached from the other side, does not count twice.
                    same = SAME_PX / max(abs(us), abs(vs))
                    if not crossing.grazing and (crossings == 0 or abs(crossing.s - accepted.s) > same):
                        accepted = crossing
                        crossings += 1
                    behind = max(s, crossing.s + same)
            # Above p at one pixel and below it at the next without a crossing: p lies between two surfaces.
            if before * more < 0.0 and reason != 6:
                reason = 4
            before, more = more, after
    if crossings == 1:
        return accepted, 0
    return _NONE, 5 if crossings > 1 else reason


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _match_rows(
    left_px: NDArray[np.float32],
    sigma_px: NDArray[np.float32],
    right: _Right,
    curves: _Curves,
    start: int,
    stop: int,
    points_mm: NDArray[np.float32],
    sigma_mm: NDArray[np.float32],
    partner_px: NDArray[np.float32],
    reason: NDArray[np.uint8],
) -> None:
    """Write the points of the left pixels of rows ``start`` to ``stop``; other pixels are not written."""
    # Borrowed, since counting references in each step along a curve is expensive.
    left_px, sigma_px, right, curves = borrowed(left_px), borrowed(sigma_px), borrowed(right), borrowed(curves)
    nodes = curves.nodes
    down, across, count = nodes.shape
    cells_down, cells_across = curves.reach_px.shape[:2]
    row, row_nodes = np.empty((across, count)), np.empty(count)
    terms = borrowed(row_nodes)
    for y in range(start, stop):
        # The nodes of this row: a cubic through those of four rows.
        # Σ w_k node_k with Lagrange's weights, in both directions one after the other.
        place = y / curves.down_px
        cell_y = min(int(place) - curves.first_cell, cells_down - 1)
        j, a, b, c, d = _cubic(place, down)
        for i in range(across):
            for k in range(count):
                row[i, k] = (
                    a * nodes[j, i, k] + b * nodes[j + 1, i, k] + c * nodes[j + 2, i, k] + d * nodes[j + 3, i, k]
                )
        for x in range(left_px.shape[1]):
            p = float(left_px[y, x])
            if p != p:
                reason[y, x] = 1
                continue
            # The ray and the curve of this pixel.
            place = x / curves.across_px
            i, a, b, c, d = _cubic(place, across)
            for k in range(count):
                terms[k] = a * row[i, k] + b * row[i + 1, k] + c * row[i + 2, k] + d * row[i + 3, k]
            # The last row and column of pixels belong to the last cells.
            cell_x = min(int(place), cells_across - 1)
            reach_px, together_px = curves.reach_px[cell_y, cell_x], curves.together_px[cell_y, cell_x]
            crossing, no_point_reason = _search(right, terms, curves.degree, p, reach_px, together_px)
            reason[y, x] = no_point_reason
            if no_point_reason != 0:
                continue
            # 1/z = middle + half s, and so dz = −half z² ds; the coordinate's error of both cameras is slope · ds.
            z = 1.0 / (curves.middle + curves.half * crossing.s)
            sx, sy = terms[2], terms[3]
            points_mm[y, x, 0] = terms[0] + sx * z
            points_mm[y, x, 1] = terms[1] + sy * z
            points_mm[y, x, 2] = z
            if partner_px.size:
                partner_px[y, x, 0], partner_px[y, x, 1] = crossing.u, crossing.v
            if sigma_px.size:
                along = abs(curves.half) * z * z * math.sqrt(1.0 + sx * sx + sy * sy)
                sigma_mm[y, x] = math.sqrt(sigma_px[y, x] ** 2 + crossing.variance) * along / abs(crossing.slope)


def _checked(coordinate_px: NDArray[np.float32], camera: HousedCamera, side: str) -> NDArray[np.float32]:
    """Return one side's map as the kernel needs it. Raises OneDirectionError."""
    camera_shape = (camera.height_px, camera.width_px)
    if coordinate_px.shape != camera_shape:
        raise OneDirectionError(
            f"the {side} coordinates are {'x'.join(str(n) for n in coordinate_px.shape[::-1])} px, the calibration's "
            f"{side} camera has "
            f"{camera.width_px}x{camera.height_px}; take the calibration of these cameras"
        )
    if not np.isfinite(coordinate_px).any():
        raise OneDirectionError(f"the {side} image has no coordinate at any pixel; look at its masks")
    infinite = np.isinf(coordinate_px)
    return np.ascontiguousarray(
        np.where(infinite, np.nan, coordinate_px) if infinite.any() else coordinate_px, np.float32
    )


def _noise(noise_px: float | NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the standard deviation (h, w) of coordinates. Raises OneDirectionError for another size."""
    noise = np.asarray(noise_px, np.float32)
    if noise.shape not in ((), shape):
        raise OneDirectionError(
            f"the noise is a map of {noise.shape}, the coordinates of {shape}; give one of the same size"
        )
    return np.ascontiguousarray(np.broadcast_to(noise, shape))


def _usual_step(coordinate_px: NDArray[np.float32]) -> float:
    """Return the median difference of neighbours, across plus down, in px of the pattern.

    Raises OneDirectionError if there are no neighbours.
    """
    centre = coordinate_px[:-1, :-1]
    # In place, since the differences of a large image need much memory.
    step, down = coordinate_px[:-1, 1:] - centre, coordinate_px[1:, :-1] - centre
    np.add(np.abs(step, out=step), np.abs(down, out=down), out=step)
    finite = step[np.isfinite(step)]
    if not finite.size:
        raise OneDirectionError("no two neighbours of the right image have coordinates; look at its masks")
    return float(np.median(finite, overwrite_input=True))


def _angle(curves: EpipolarCurves, left_px: NDArray[np.float32], right_px: NDArray[np.float32]) -> float:
    """Return the median angle, in degrees, between curves and lines of equal coordinate; or NaN."""
    v, u = np.nonzero(np.isfinite(left_px))
    some = slice(None, None, max(1, v.size // ANGLE_SAMPLES))
    across_px, down_px = curves.spacing_px
    j, i = np.rint(v[some] / down_px).astype(int), np.rint(u[some] / across_px).astype(int)
    # Each curve at nine depths, and a little farther on for its direction.
    s = np.linspace(-1.0, 1.0 - 1e-3, 9)
    starts, ends = (places(curves, node_s)[j, i] for node_s in (s, s + 1e-3))
    height, width = right_px.shape
    x, y = starts[..., 0], starts[..., 1]
    with np.errstate(invalid="ignore"):
        inside = (x > 1.0) & (x < width - 2.0) & (y > 1.0) & (y < height - 2.0)
    i, j = np.rint(x[inside]).astype(int), np.rint(y[inside]).astype(int)
    tu, tv = (ends - starts)[inside].T
    gu, gv = right_px[j, i + 1] - right_px[j, i - 1], right_px[j + 1, i] - right_px[j - 1, i]
    size = np.hypot(gu, gv) * np.hypot(tu, tv)
    finite = np.isfinite(size) & (size > 0.0)
    if not finite.any():
        return math.nan
    sine = np.abs(gu * tu + gv * tv)[finite] / size[finite]
    return float(np.degrees(np.median(np.arcsin(np.clip(sine, 0.0, 1.0)))))


def _lonely(
    z_mm: NDArray[np.float32], sigma_mm: NDArray[np.float32], limits: OneDirectionLimits, curves: EpipolarCurves
) -> NDArray[np.bool_]:
    """Return which points (h, w) have too few neighbours of similar depth or are too uncertain."""
    most_mm = limits.max_step_mm
    if most_mm is None:
        # Distance of two neighbouring rays per mm of depth.
        spread = float(np.median(np.abs(np.diff(curves.nodes[..., 2], axis=1)))) / curves.spacing_px[0]
        most_mm = SPREAD_OF_POINTS * spread * float(np.nanmedian(z_mm)) if np.isfinite(z_mm).any() else 0.0
    around = np.pad(z_mm, 1, constant_values=np.nan)
    near = np.zeros(z_mm.shape, np.uint8)
    h, w = z_mm.shape
    for j in (0, 1, 2):
        for i in (0, 1, 2):
            if (j, i) != (1, 1):
                near += np.abs(around[j : j + h, i : i + w] - z_mm) <= most_mm
    with np.errstate(invalid="ignore"):
        uncertain = sigma_mm > limits.max_sigma_mm
    return np.asarray(np.isfinite(z_mm) & ((near < limits.min_neighbours) | uncertain))
