"""The shapes: for each object an implicit function, negative inside, whose zero set is the surface.

Object frame, mm: the side towards the instrument faces −z. The function never exceeds the distance to the surface, so
that rays can march along it without stepping through. ``docs/protocols/world.md`` lists the dimensions.
"""

# Symbols:
#   kind, sizes  the object, and its true dimensions (see SIZES)
#   x, y, z      point of the object's frame, mm; o, d origin and unit direction of a ray there
#   f, g         values of the implicit function at the present and the next place of a ray, mm
#   t            length along the ray; fall = −df/dt, mm per mm, as the last step had it

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLANE, BALLBAR, FRUSTUM, PIPE, SHELL, STONES, BOARD, MAIN = range(8)
NAMES = {
    "plane": PLANE,
    "ballbar": BALLBAR,
    "frustum": FRUSTUM,
    "pipe": PIPE,
    "shell": SHELL,
    "stones": STONES,
    "board": BOARD,
    "main": MAIN,
}

BALL_RADIUS_MM = 15.0
BALL_DISTANCE_MM = 150.0
"""Nominal distance of the centres; the true one is in the truth's artefacts."""
BAR_RADIUS_MM = 5.0
PLANE_HALF_X_MM, PLANE_HALF_Y_MM, PLANE_THICKNESS_MM = 125.0, 100.0, 10.0
FRUSTUM_BASE_MM, FRUSTUM_TOP_MM, FRUSTUM_HEIGHT_MM = 150.0, 80.0, 45.0
FRUSTUM_PLATE_X_MM, FRUSTUM_PLATE_Y_MM = 200.0, 170.0
PIPE_RADIUS_MM, PIPE_HALF_LENGTH_MM = 45.0, 130.0
FLANGE_RADIUS_MM, FLANGE_HALF_LENGTH_MM, FLANGE_X_MM = 60.0, 9.0, 55.0
WELD_RADIUS_MM, WELD_X_MM = 4.0, -45.0
BOARD_HALF_X_MM, BOARD_HALF_Y_MM, BOARD_THICKNESS_MM = 145.0, 118.0, 8.0
"""The plate of the ChArUco board; its print is in ``objects.print``."""

MAIN_RADIUS_MM, MAIN_HALF_LENGTH_MM = 60.0, 500.0
MAIN_FLANGE_RADIUS_MM, MAIN_FLANGE_HALF_LENGTH_MM, MAIN_FLANGE_X_MM = 82.0, 11.0, 140.0
MAIN_BOLTS, MAIN_BOLT_CIRCLE_MM, MAIN_BOLT_RADIUS_MM, MAIN_BOLT_HALF_LENGTH_MM = 8, 72.0, 6.0, 19.0
MAIN_WELDS_X_MM = (-330.0, -60.0, 395.0)
"""A metre of a water main, longer than a view: a bolted flange, three weld seams, and smooth in between."""

DEFAULT_POSE: dict[str, tuple[float, float, float, float, float, float]] = {
    "plane": (0.0, 0.0, 522.5, 8.0, 12.0, 0.0),
    "ballbar": (0.0, 0.0, 522.5, 0.0, 10.0, 15.0),
    "frustum": (0.0, 0.0, 545.0, 5.0, -8.0, 12.0),
    "pipe": (0.0, 0.0, 560.0, 0.0, 6.0, 20.0),
    "shell": (0.0, 0.0, 545.0, 6.0, 0.0, 10.0),
    "stones": (0.0, 0.0, 535.0, 0.0, 0.0, 0.0),
    "board": (0.0, 0.0, 560.0, 10.0, -12.0, 5.0),
    "main": (0.0, 0.0, 580.0, 0.0, 6.0, 20.0),
}

HALF_BALL_DISTANCE, PLANE_BOW, BOARD_BOW, BOARD_SCALE, SIZES = 0, 1, 2, 3, 4
"""Layout of ``sizes``: dimensions that differ between copies of an artefact."""
PLANE_FORM, BOARD_FORM, SOFT, SIZES_OUTSIDE = 4, 7, 10, 13
"""Further elements of ``sizes``, in the world ``outside`` only: saddle, twist and S of each plate, mm (``rise``), and
the wave in a soft object (``_wave``): amplitude in mm, wave number in rad/mm, phase in rad."""
VARIED = len(NAMES)
"""Offset of the kind of an object with all these sizes, so that ordinary objects take no longer."""
S_PEAK = 1.5 * math.sqrt(3.0)
"""The cubic p (1 − p²) times this has the extremes ±1."""

_BOX = np.array(
    [
        [-125.0, -100.0, -0.1, 125.0, 100.0, 10.1],
        [-91.0, -15.0, -15.0, 91.0, 15.0, 15.0],
        [-100.0, -85.0, -45.0, 100.0, 85.0, 8.0],
        [-130.0, -60.0, -60.0, 130.0, 60.0, 60.0],
        [-105.0, -80.0, -40.5, 105.0, 80.0, 12.0],
        [-108.0, -76.0, -46.0, 106.0, 78.0, 54.0],
        [-145.0, -118.0, -0.3, 145.0, 118.0, 8.3],
        [-500.0, -82.0, -82.0, 500.0, 82.0, 82.0],
    ]
)
BOX = np.concatenate([_BOX, _BOX])
"""A box (x0 y0 z0 x1 y1 z1) around each object; twice, for kinds with ``VARIED``."""
STONES_AT = np.array(
    [
        [-62.0, -20.0, 8.0, 38.0],
        [18.0, -38.0, 0.0, 32.0],
        [70.0, 8.0, 12.0, 28.0],
        [-20.0, 36.0, -4.0, 34.0],
        [45.0, 50.0, 14.0, 22.0],
    ]
)
"""Middle x y z and mean radius of each stone."""
RADIUS = np.tile([161.0, 92.5, 132.0, 144.0, 138.0, 120.0, 188.0, 507.0], 2)
"""Radius of a ball around the origin that contains each object."""

HIT_MM = 1e-7
"""Largest value of the function at the end of a ray; the last secant removes the remainder."""
NEAR_MM, REACH_MM, LAST_MM = 0.1, 1.0, 1e-4
"""Largest value of the function for secants, their largest length, and the value for the last one."""
STRETCH = 1.9
"""Share of the longest stretched step that is tried (2: the balls of its ends just touch if the guess is right)."""
MARCH_STEPS = 300


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _box(x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Return the signed distance to a box with half sides a, b, c around the origin."""
    # Outside: to the nearest face, edge or corner; inside: to the nearest face, negative.
    dx, dy, dz = abs(x) - a, abs(y) - b, abs(z) - c
    ox, oy, oz = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
    return math.sqrt(ox * ox + oy * oy + oz * oz) + min(max(dx, max(dy, dz)), 0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _disc_or_tube(x: float, r: float, radius: float, half_length: float) -> float:
    """Return the signed distance to a cylinder along x; r is the point's distance from its axis."""
    dr, dx = r - radius, abs(x) - half_length
    outer_r, outer_x = max(dr, 0.0), max(dx, 0.0)
    return math.sqrt(outer_r * outer_r + outer_x * outer_x) + min(max(dr, dx), 0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _pipe(x: float, y: float, z: float) -> float:
    r = math.sqrt(y * y + z * z)
    pipe = _disc_or_tube(x, r, PIPE_RADIUS_MM, PIPE_HALF_LENGTH_MM)
    flange = _disc_or_tube(x - FLANGE_X_MM, r, FLANGE_RADIUS_MM, FLANGE_HALF_LENGTH_MM)
    # The weld seam is a torus half sunk into the pipe.
    along, ring = x - WELD_X_MM, r - PIPE_RADIUS_MM
    weld = math.sqrt(along * along + ring * ring) - WELD_RADIUS_MM
    return min(pipe, min(flange, weld))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _main(x: float, y: float, z: float) -> float:
    r = math.sqrt(y * y + z * z)
    best = _disc_or_tube(x, r, MAIN_RADIUS_MM, MAIN_HALF_LENGTH_MM)
    beside = x - MAIN_FLANGE_X_MM
    best = min(best, _disc_or_tube(beside, r, MAIN_FLANGE_RADIUS_MM, MAIN_FLANGE_HALF_LENGTH_MM))
    for seam in MAIN_WELDS_X_MM:
        along, ring = x - seam, r - MAIN_RADIUS_MM
        best = min(best, math.sqrt(along * along + ring * ring) - WELD_RADIUS_MM)
    # The nearest bolt alone: the others are farther away.
    step = 2.0 * math.pi / MAIN_BOLTS
    angle = math.atan2(z, y)
    angle -= step * math.floor(angle / step + 0.5)
    across, down = r * math.cos(angle) - MAIN_BOLT_CIRCLE_MM, r * math.sin(angle)
    bolt = _disc_or_tube(
        beside, math.sqrt(across * across + down * down), MAIN_BOLT_RADIUS_MM, MAIN_BOLT_HALF_LENGTH_MM
    )
    return min(best, bolt)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _frustum(x: float, y: float, z: float) -> float:
    # Top at z = -45 (towards the instrument), base at z = 0, on a plate.
    slope = 0.5 * (FRUSTUM_BASE_MM - FRUSTUM_TOP_MM) / FRUSTUM_HEIGHT_MM
    k = 1.0 / math.sqrt(1.0 + slope * slope)
    half = 0.5 * FRUSTUM_BASE_MM + slope * z
    sides = max(abs(x) - half, abs(y) - half) * k
    body = max(sides, max(z, -FRUSTUM_HEIGHT_MM - z))
    plate = _box(x, y, z - 4.0, 0.5 * FRUSTUM_PLATE_X_MM, 0.5 * FRUSTUM_PLATE_Y_MM, 4.0)
    return min(body, plate)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _shell(x: float, y: float, z: float) -> float:
    # A fossil scallop on a slab: a dome with ribs that fan out from the hinge, and rings of growth around it.
    ry = (y - 2.5) / 62.5
    rx = x / 88.0
    # Within the ellipse: 24 ribs by the angle from the hinge at y = −85, rings by the distance from it.
    inside = 1.0 - rx * rx - ry * ry
    height = 0.0
    if inside > 0.0:
        fan = y + 85.0
        slope = x / fan
        rib = math.cos(24.0 * slope / (1.0 + 0.3 * slope * slope))
        growth = math.sin(0.16 * math.sqrt(x * x + fan * fan))
        smooth = inside * inside * (3.0 - 2.0 * inside)
        height = smooth * (36.0 + 2.6 * rib * (1.6 - 0.9 * inside) + 0.5 * growth)
    # Solid behind the height field, in front of the slab's back; the factor makes it a bound of the distance.
    return max(max((-height - z) * 0.43, z - 12.0), max(abs(x) - 105.0, abs(y) - 80.0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _stones(x: float, y: float, z: float) -> float:
    best = 1e9
    for i in range(5):
        dx, dy, dz = x - STONES_AT[i, 0], y - STONES_AT[i, 1], z - STONES_AT[i, 2]
        radius = STONES_AT[i, 3]
        # No stone exceeds 1.172 of its radius: outside, that ball is a bound, and a stone further off cannot be nearer.
        r2, reach = dx * dx + dy * dy + dz * dz, 1.172 * radius + best
        if best > 0.0 and r2 > reach * reach:
            continue
        r = math.sqrt(r2) + 1e-9
        ball = r - 1.172 * radius
        if ball > 4.0:
            best = min(best, ball)
            continue
        ux, uy, uz = dx / r, dy / r, dz / r
        # The radius varies with the direction alone, so the factor below bounds the distance.
        bump = (
            0.07 * math.sin(3.0 * ux + 1.7 * i)
            + 0.05 * math.sin(4.0 * uy - 2.0 * i + 1.0)
            + 0.04 * math.sin(5.0 * uz + 3.0 * ux + i)
            + 0.012 * math.sin(11.0 * ux + 9.0 * uy + 2.0 * i)
        )
        best = min(best, (r - radius * (1.0 + bump)) * 0.75)
    return best


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _plate(x: float, y: float, z: float, half_x: float, half_y: float, thickness: float, bow: float) -> float:
    """Return a bound of the distance to a plate whose front is bent: z = bow (1 − 2 r²/half_x²)."""
    bent = bow * (1.0 - (x * x + y * y) * (2.0 / (half_x * half_x)))
    # A front that leans by a slope m is √(1 + m²) nearer than measured along z: 0.999 covers m = 0.045, far above any bow.
    return 0.999 * _box(x, y, z - 0.5 * thickness - bent, half_x, half_y, 0.5 * thickness)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def rise(sizes: Array, bow: int, form: int, half_x: float, x: float, y: float) -> float:
    """Return the height z, mm, of a plate's front with its forms; ``bow``, ``form``: indices in ``sizes``."""
    # Bow, z = bow (1 − 2 r²/a²); saddle p² − q², twist 2 p q (a saddle turned by 45°), and an S along x; p = x/a, q = y/a.
    p, q = x / half_x, y / half_x
    bent = sizes[bow] * (1.0 - 2.0 * (p * p + q * q)) + sizes[form] * (p * p - q * q)
    bent += sizes[form + 1] * 2.0 * p * q + sizes[form + 2] * S_PEAK * p * (1.0 - p * p)
    return float(bent)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _wave(sizes: Array, x: float, y: float) -> float:
    """Return the displacement, mm along z, by the wave in a soft object at (x, y)."""
    # It runs obliquely, so that neither rows nor columns of a pattern see only one phase of it.
    return float(sizes[SOFT] * math.sin(sizes[SOFT + 1] * (0.8 * x + 0.6 * y) + sizes[SOFT + 2]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _outside(kind: int, sizes: Array, x: float, y: float, z: float) -> float:
    """Return ``implicit`` of an object whose kind has ``VARIED``: plates with forms, and soft objects."""
    steep = 1.0
    if sizes[SOFT] != 0.0 and kind != VARIED + BOARD:
        # A shear z → z − wave(x, y) whose slope is m makes gradients at most 1 + m as long.
        z -= _wave(sizes, x, y)
        steep += abs(float(sizes[SOFT] * sizes[SOFT + 1]))
    if kind == VARIED + PLANE:
        bent = rise(sizes, PLANE_BOW, PLANE_FORM, PLANE_HALF_X_MM, x, y)
        thickness = PLANE_THICKNESS_MM
        value = 0.999 * _box(x, y, z - 0.5 * thickness - bent, PLANE_HALF_X_MM, PLANE_HALF_Y_MM, 0.5 * thickness)
    elif kind == VARIED + BOARD:
        bent = rise(sizes, BOARD_BOW, BOARD_FORM, BOARD_HALF_X_MM, x, y)
        thickness = BOARD_THICKNESS_MM
        value = 0.999 * _box(x, y, z - 0.5 * thickness - bent, BOARD_HALF_X_MM, BOARD_HALF_Y_MM, 0.5 * thickness)
    elif kind == VARIED + BALLBAR:
        half, off = sizes[HALF_BALL_DISTANCE], y * y + z * z
        along = abs(x) - half
        ball = math.sqrt(along * along + off) - BALL_RADIUS_MM
        value = min(ball, _disc_or_tube(x, math.sqrt(off), BAR_RADIUS_MM, half))
    elif kind == VARIED + FRUSTUM:
        value = _frustum(x, y, z)
    elif kind == VARIED + PIPE:
        value = _pipe(x, y, z)
    elif kind == VARIED + SHELL:
        value = _shell(x, y, z)
    elif kind == VARIED + MAIN:
        value = _main(x, y, z)
    else:
        value = _stones(x, y, z)
    return float(value / steep)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def implicit(kind: int, sizes: Array, x: float, y: float, z: float) -> float:
    """Return the implicit function at a point of the object frame, mm: at most the surface's distance."""
    if kind == 0:
        return _plate(x, y, z, PLANE_HALF_X_MM, PLANE_HALF_Y_MM, PLANE_THICKNESS_MM, sizes[PLANE_BOW])
    if kind == 1:
        half = sizes[HALF_BALL_DISTANCE]
        along = abs(x) - half
        off = y * y + z * z
        return min(
            math.sqrt(along * along + off) - BALL_RADIUS_MM, _disc_or_tube(x, math.sqrt(off), BAR_RADIUS_MM, half)
        )
    if kind == 2:
        return _frustum(x, y, z)
    if kind == 3:
        return _pipe(x, y, z)
    if kind == 4:
        return _shell(x, y, z)
    if kind == 7:
        return _main(x, y, z)
    if kind == 6:
        return _plate(x, y, z, BOARD_HALF_X_MM, BOARD_HALF_Y_MM, BOARD_THICKNESS_MM, sizes[BOARD_BOW])
    if kind >= VARIED:
        return _outside(kind, sizes, x, y, z)
    return _stones(x, y, z)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def gradient(kind: int, sizes: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the gradient of ``implicit``, by differences over a small tetrahedron; not normalised."""
    h = 1e-4
    a = implicit(kind, sizes, x + h, y - h, z - h)
    b = implicit(kind, sizes, x - h, y - h, z + h)
    c = implicit(kind, sizes, x - h, y + h, z - h)
    d = implicit(kind, sizes, x + h, y + h, z + h)
    k = 0.25 / h
    return (a - b - c + d) * k, (c - a - b + d) * k, (b - a - c + d) * k


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _slab(low: float, high: float, slope: float) -> tuple[float, float]:
    per = 1.0 / (slope if abs(slope) > 1e-12 else 1e-12)
    a, b = (low - 0.5) * per, (high + 0.5) * per
    return min(a, b), max(a, b)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def box_span(kind: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> tuple[float, float]:
    """Return where a ray enters and leaves the object's box, mm, with a margin; enter > leave: it misses."""
    x0, x1 = _slab(BOX[kind, 0] - ox, BOX[kind, 3] - ox, dx)
    y0, y1 = _slab(BOX[kind, 1] - oy, BOX[kind, 4] - oy, dy)
    z0, z1 = _slab(BOX[kind, 2] - oz, BOX[kind, 5] - oz, dz)
    return max(x0, max(y0, z0)), min(x1, min(y1, z1))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def march(
    kind: int, sizes: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, start: float, stop: float
) -> float:
    """Return the length of a ray to the first surface after ``start``; NaN: none before ``stop``.

    Object frame, unit direction; accurate to 1e-8 mm unless the ray grazes. The function is a radius within which there
    is no surface (sphere tracing: Hart 1996). A step may be longer than that, as long as the free balls of its two ends
    touch; its length is guessed from the decrease of the function in the last step (relaxed sphere tracing: Keinert et
    al. 2014; Bálint and Valasek 2018). Near the surface secants take over.
    """
    enter, leave = box_span(kind, ox, oy, oz, dx, dy, dz)
    if kind >= VARIED:
        # A wave may lift the surface out of its box by its amplitude, which is longer along an oblique ray.
        enter, leave = enter - 4.0 * abs(sizes[SOFT]), leave + 4.0 * abs(sizes[SOFT])
    t, end = max(start, enter), min(stop, leave)
    if not t < end:
        return math.nan
    f = implicit(kind, sizes, ox + t * dx, oy + t * dy, oz + t * dz)
    fall = 1.0  # mm per mm
    for _ in range(MARCH_STEPS):
        if f < HIT_MM:
            break
        # Near the surface: Newton's step f / fall, as far as the secant has been going downhill.
        if f < NEAR_MM and f < fall * REACH_MM:
            step = f / fall
            g = implicit(kind, sizes, ox + (t + step) * dx, oy + (t + step) * dy, oz + (t + step) * dz)
            if g < -HIT_MM:
                return _crossing(kind, sizes, ox, oy, oz, dx, dy, dz, t, f, t + step, g)
            if g < 0.5 * f:
                fall = (f - g) / step
                t, f = t + step, g
                continue
        # The free balls of the two ends touch where step = f + g; with g = f − fall · step: step = 2f / (1 + fall).
        step = max(f, f * STRETCH / max(1.0 + fall, 0.5))
        g = implicit(kind, sizes, ox + (t + step) * dx, oy + (t + step) * dy, oz + (t + step) * dz)
        # They do not touch: a surface might lie between. Back to the safe step.
        if step > f + g:
            step = f
            g = implicit(kind, sizes, ox + (t + step) * dx, oy + (t + step) * dy, oz + (t + step) * dz)
        fall = (f - g) / step
        t, f = t + step, g
        if t > end:
            return math.nan
    if not f < HIT_MM:
        return math.nan
    return t + f / fall if abs(f) < fall * LAST_MM else t


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _crossing(
    kind: int, sizes: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float,
    outside: float, f: float, inside: float, g: float,
) -> float:  # fmt: skip
    """Return the length of a ray at which the function is zero, between ``outside`` and ``inside``.

    Their values are f > 0 and g < 0. False position, Illinois variant (Dowell and Jarratt 1971).
    """
    length, last = outside, 0.0
    for _ in range(60):
        length = (outside * g - inside * f) / (g - f)
        value = implicit(kind, sizes, ox + length * dx, oy + length * dy, oz + length * dz)
        if abs(value) < 1e-3 * HIT_MM or inside - outside < 1e-10:
            break
        if value < 0.0:
            inside, g = length, value
            # The same end moved twice: halve the value of the other one, or false position would creep.
            if last < 0.0:
                f *= 0.5
        else:
            outside, f = length, value
            if last > 0.0:
                g *= 0.5
        last = value
    return length


@numba.njit(nogil=True, cache=True)
def march_all(kind: int, sizes: Array, rays: Array, out: Array) -> None:
    """Fill ``out`` (n,) with ``march`` of rays (n, 6) of the object frame, mm."""
    for i in range(rays.shape[0]):
        r = rays[i]
        out[i] = march(kind, sizes, r[0], r[1], r[2], r[3], r[4], r[5], 0.0, 1e4)


@numba.njit(nogil=True, cache=True)
def values(kind: int, sizes: Array, points: Array, out: Array) -> None:
    """Fill ``out`` (n,) with ``implicit`` at points (n, 3) of the object frame, mm."""
    for i in range(points.shape[0]):
        out[i] = implicit(kind, sizes, points[i, 0], points[i, 1], points[i, 2])


@numba.njit(nogil=True, cache=True)
def distances(kind: int, sizes: Array, points: Array, out: Array) -> None:
    """Fill ``out`` (n,) with the signed distances, mm, of points (n, 3) from the surface, outside > 0.

    Object frame. The foot point is dropped onto the surface along the gradient, then slid along the surface until the
    point stands perpendicularly above it. Exact near the surface, for any slope of the function; beside an edge the
    foot is on one of the faces that meet there.
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        fx, fy, fz = x, y, z
        best = 1e30
        for _ in range(12):
            gx, gy, gz = 0.0, 0.0, 1.0
            for _ in range(6):
                # Newton along the gradient: foot −= f ∇f / |∇f|².
                f = implicit(kind, sizes, fx, fy, fz)
                gx, gy, gz = gradient(kind, sizes, fx, fy, fz)
                g2 = gx * gx + gy * gy + gz * gz
                if g2 < 1e-12:
                    break
                fx -= f * gx / g2
                fy -= f * gy / g2
                fz -= f * gz / g2
                if f * f < 1e-16 * g2:
                    break
            rx, ry, rz = x - fx, y - fy, z - fz
            away = math.sqrt(rx * rx + ry * ry + rz * rz)
            if not away < best - 1e-9:
                break
            best = away
            # The component along the surface of the vector back to the point.
            g2 = gx * gx + gy * gy + gz * gz + 1e-30
            normal = (rx * gx + ry * gy + rz * gz) / g2
            fx += rx - normal * gx
            fy += ry - normal * gy
            fz += rz - normal * gz
        out[i] = best if implicit(kind, sizes, x, y, z) >= 0.0 else -best
