"""The path of one light ray: pixel → lens → glass → water, and back by Newton's method on the exact path.

An eye (camera or projector) is packed into one float64 array for compiled loops; the constants below are its layout.
Rig frame, mm; pixel centres at integers. The path follows Snell's law as vectors (no angles, no small-angle terms)
through an inner face with normal n at distance d along n, and an outer face with another normal m (the wedge) through
the point n (d + th).
"""

# Symbols:
#   eye       a packed camera or projector; the constants below name its places
#   u, v      pixel; x, y normalised image coordinates (z = 1); xd, yd the same after lens distortion
#   n, m      unit normals of the window's inner and outer face, pointing into the water
#   a, g, w   unit directions in air, glass and water; p the point reached on the way
#   s         length along a ray, mm; r the first place of the rotation R (row by row) in the packed eye

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.aberrations import ORDERS

Array = NDArray[np.float64]

# Layout of a packed eye.
FOCAL, CENTRE, BROWN, ROTATION, POSITION, INNER, OUTER = 0, 2, 4, 9, 18, 21, 24
DISTANCE, THICKNESS, GLASS, WATER, WIDTH, HEIGHT, HAS_FIELD, FOCUS, FIELD = (
    27, 28, 29, 30, 31, 32, 33, 34, 35
)  # fmt: skip
FIELD_ORDER = 4
PACKED = FIELD + 2 * FIELD_ORDER * FIELD_ORDER
# The following elements are only in an eye with flaws (``optics.aberrations``), in the order of ``Aberrations``.
FLAWS, DENT = PACKED, PACKED + 2 * ORDERS * ORDERS
STRIA, PUPIL, BEND = DENT + 4, DENT + 9, DENT + 10
PACKED_WITH_FLAWS = BEND + 1

UNDISTORT_STEPS = 10
PROJECT_STEPS = 12
DIFFERENCE_PX = 0.01
"""Step of the difference quotients in Newton's method; they only steer, they do not limit the accuracy."""


@numba.njit(nogil=True, cache=True)
def refract(x: float, y: float, z: float, nx: float, ny: float, nz: float, ratio: float) -> tuple[float, float, float]:
    """Return a unit direction after refraction at a face whose unit normal points onwards (Snell's law).

    ``ratio`` = n before / after.
    """
    # t = η i + (√(1 − η²(1 − c²)) − η c) n, with η = ratio and c = i · n: the vector form of Snell's law.
    cosine = x * nx + y * ny + z * nz
    onward = math.sqrt(1.0 - ratio * ratio * (1.0 - cosine * cosine))
    k = onward - ratio * cosine
    return ratio * x + k * nx, ratio * y + k * ny, ratio * z + k * nz


@numba.njit(nogil=True, cache=True)
def lens_field(eye: Array, u: float, v: float) -> tuple[float, float]:
    """Return the part of the lens beyond radial models: low cosines over the image, in px at the pixel.

    A ray that an ideal five-parameter lens would put at (u, v) − field(u, v) arrives at (u, v).
    """
    du, dv = 0.0, 0.0
    if eye[HAS_FIELD] == 0.0:
        return du, dv
    # cos 2x and cos 3x from cos x: cos 2x = 2c² − 1, cos 3x = c(2 cos 2x − 1).
    x, y = math.pi * (u + 0.5) / eye[WIDTH], math.pi * (v + 0.5) / eye[HEIGHT]
    x1, y1 = math.cos(x), math.cos(y)
    x2, y2 = 2.0 * x1 * x1 - 1.0, 2.0 * y1 * y1 - 1.0
    x3, y3 = x1 * (2.0 * x2 - 1.0), y1 * (2.0 * y2 - 1.0)
    k = FIELD
    for j in range(FIELD_ORDER):
        cy = (1.0, y1, y2, y3)[j]
        n = k + FIELD_ORDER * FIELD_ORDER
        du += cy * (eye[k] + eye[k + 1] * x1 + eye[k + 2] * x2 + eye[k + 3] * x3)
        dv += cy * (eye[n] + eye[n + 1] * x1 + eye[n + 2] * x2 + eye[n + 3] * x3)
        k += FIELD_ORDER
    return du, dv


@numba.njit(nogil=True, cache=True)
def cosines(table: Array, first: int, x: float, y: float) -> float:
    """Return Σ c[j, i] cos(i x) cos(j y) of the ORDERS² coefficients that begin at ``first`` of ``table``."""
    # Clenshaw's recurrence for cosines, b[k] = a[k] + 2 cos x b[k+1] − b[k+2]: within each row, then over the rows.
    cx, cy = math.cos(x), math.cos(y)
    down1, down2, row = 0.0, 0.0, 0.0
    for j in range(ORDERS - 1, -1, -1):
        across1, across2 = 0.0, 0.0
        for i in range(ORDERS - 1, 0, -1):
            across1, across2 = table[first + ORDERS * j + i] + 2.0 * cx * across1 - across2, across1
        row = table[first + ORDERS * j] + cx * across1 - across2
        if j > 0:
            down1, down2 = row + 2.0 * cy * down1 - down2, down1
    return row + cy * down1 - down2


@numba.njit(nogil=True, cache=True)
def flaw_field(eye: Array, u: float, v: float) -> tuple[float, float]:
    """Return the displacement, px, by the flaws of an eye that has them: cosines to order 11, a dent, a stria."""
    x, y = math.pi * (u + 0.5) / eye[WIDTH], math.pi * (v + 0.5) / eye[HEIGHT]
    du, dv = cosines(eye, FLAWS, x, y), cosines(eye, FLAWS + ORDERS * ORDERS, x, y)
    # A dent bends light by the slope of a Gaussian bump: away from its middle, most at one width from it.
    a, b, width = u - eye[DENT], v - eye[DENT + 1], eye[DENT + 2]
    k = eye[DENT + 3] / width * math.exp(0.5 - 0.5 * (a * a + b * b) / (width * width))
    du, dv = du + k * a, dv + k * b
    # A stria is a line of another index: the same across it, no effect along it.
    nu, nv, width = math.cos(eye[STRIA + 2]), math.sin(eye[STRIA + 2]), eye[STRIA + 3]
    off = (u - eye[STRIA]) * nu + (v - eye[STRIA + 1]) * nv
    k = eye[STRIA + 4] / width * off * math.exp(0.5 - 0.5 * off * off / (width * width))
    return du + k * nu, dv + k * nv


@numba.njit(nogil=True, cache=True)
def bent_normal(
    bend: float, px: float, py: float, pz: float, ax: float, ay: float, az: float, nx: float, ny: float, nz: float
) -> tuple[float, float, float]:
    """Return the unit normal of a face at p that is bent by ``bend`` (1/mm) about its centre.

    The centre is the foot of the perpendicular n; a is the flat normal. The sag, of micrometres, is neglected: it moves
    a ray by less than a hundredth of that.
    """
    # Off the foot by r = p − (p · n) n the face of a bowl that is hollow on the water's side leans by bend · r towards the axis.
    along = px * nx + py * ny + pz * nz
    x, y, z = ax - bend * (px - along * nx), ay - bend * (py - along * ny), az - bend * (pz - along * nz)
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm


@numba.njit(nogil=True, cache=True)
def undistort(eye: Array, xd: float, yd: float) -> tuple[float, float]:
    """Return normalised coordinates whose distorted ones are (xd, yd), by Newton's method.

    The model is OpenCV's with five parameters.
    """
    k1, k2, p1, p2, k3 = eye[BROWN], eye[BROWN + 1], eye[BROWN + 2], eye[BROWN + 3], eye[BROWN + 4]
    x, y = xd, yd
    for _ in range(UNDISTORT_STEPS):
        r2 = x * x + y * y
        # xd = x(1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 xy + p2(r² + 2x²); e is the error of the present guess.
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        ex = xd - (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x))
        ey = yd - (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
        # The Jacobian d(xd, yd)/d(x, y) is symmetric; solve it for the step by Cramer's rule.
        xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
        xy = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
        det = xx * yy - xy * xy
        sx, sy = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
        x += sx
        y += sy
        if abs(sx) + abs(sy) < 1e-15:
            break
    return x, y


@numba.njit(nogil=True, cache=True)
def pixel_ray(eye: Array, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    """Return the ray in water of pixel (u, v): point on the outer glass face and unit direction, rig frame."""
    du, dv = lens_field(eye, u, v)
    flawed = eye.size > PACKED
    if flawed:
        fu, fv = flaw_field(eye, u, v)
        du, dv = du + fu, dv + fv
    x, y = undistort(
        eye, (u - du - eye[CENTRE]) / eye[FOCAL], (v - dv - eye[CENTRE + 1]) / eye[FOCAL + 1]
    )  # fmt: skip
    # In air, from the projection centre to the inner face: n · p = d.
    norm = math.sqrt(x * x + y * y + 1.0)
    ax, ay, az = x / norm, y / norm, 1.0 / norm
    nx, ny, nz = eye[INNER], eye[INNER + 1], eye[INNER + 2]
    mx, my, mz = eye[OUTER], eye[OUTER + 1], eye[OUTER + 2]
    # The entrance pupil, from which the ray starts, moves along the axis with the squared tangent of the field angle.
    pupil = eye[PUPIL] * (x * x + y * y) if flawed else 0.0
    s = (eye[DISTANCE] - pupil * nz) / (ax * nx + ay * ny + az * nz)
    px, py, pz = ax * s, ay * s, az * s + pupil
    ix, iy, iz = nx, ny, nz
    if flawed and eye[BEND] != 0.0:
        ix, iy, iz = bent_normal(eye[BEND], px, py, pz, nx, ny, nz, nx, ny, nz)
    gx, gy, gz = refract(ax, ay, az, ix, iy, iz, 1.0 / eye[GLASS])
    # In glass, to the outer face: m · (p + s g) = m · n (d + th), for the faces are wedged (m ≠ n).
    depth = eye[DISTANCE] + eye[THICKNESS]
    s = ((nx * depth - px) * mx + (ny * depth - py) * my + (nz * depth - pz) * mz) / (gx * mx + gy * my + gz * mz)
    px, py, pz = px + gx * s, py + gy * s, pz + gz * s
    if flawed and eye[BEND] != 0.0:
        mx, my, mz = bent_normal(eye[BEND], px, py, pz, mx, my, mz, nx, ny, nz)
    # Into the water, then from the eye's frame into the rig's: R p + t.
    wx, wy, wz = refract(gx, gy, gz, mx, my, mz, eye[GLASS] / eye[WATER])
    r = ROTATION
    return (
        eye[r] * px + eye[r + 1] * py + eye[r + 2] * pz + eye[POSITION],
        eye[r + 3] * px + eye[r + 4] * py + eye[r + 5] * pz + eye[POSITION + 1],
        eye[r + 6] * px + eye[r + 7] * py + eye[r + 8] * pz + eye[POSITION + 2],
        eye[r] * wx + eye[r + 1] * wy + eye[r + 2] * wz,
        eye[r + 3] * wx + eye[r + 4] * wy + eye[r + 5] * wz,
        eye[r + 6] * wx + eye[r + 7] * wy + eye[r + 8] * wz,
    )


@numba.njit(nogil=True, cache=True)
def _miss(eye: Array, u: float, v: float, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the miss of the ray of (u, v) at the point's depth, mm along the eye's x and y."""
    ox, oy, oz, dx, dy, dz = pixel_ray(eye, u, v)
    r = ROTATION
    zx, zy, zz = eye[r + 2], eye[r + 5], eye[r + 8]
    s = ((x - ox) * zx + (y - oy) * zy + (z - oz) * zz) / (dx * zx + dy * zy + dz * zz)
    mx, my, mz = ox + s * dx - x, oy + s * dy - y, oz + s * dz - z
    return mx * eye[r] + my * eye[r + 3] + mz * eye[r + 6], mx * eye[r + 1] + my * eye[r + 4] + mz * eye[r + 7]


@numba.njit(nogil=True, cache=True)
def project_point(eye: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the pixel whose ray passes through a water point, by Newton on the exact ray; NaN if none."""
    r = ROTATION
    # Into the eye's frame: l = Rᵀ(p − t).
    dx, dy, dz = x - eye[POSITION], y - eye[POSITION + 1], z - eye[POSITION + 2]
    lx = dx * eye[r] + dy * eye[r + 3] + dz * eye[r + 6]
    ly = dx * eye[r + 1] + dy * eye[r + 4] + dz * eye[r + 7]
    lz = dx * eye[r + 2] + dy * eye[r + 5] + dz * eye[r + 8]
    in_water = lz - eye[DISTANCE] - eye[THICKNESS]
    if not in_water > 0.0:
        return math.nan, math.nan
    # Small angles give the start: slopes divide by the index, so each layer counts as thickness / index.
    reach = eye[DISTANCE] + eye[THICKNESS] / eye[GLASS] + in_water / eye[WATER]
    u, v = eye[CENTRE] + eye[FOCAL] * lx / reach, eye[CENTRE + 1] + eye[FOCAL + 1] * ly / reach
    h = DIFFERENCE_PX
    for _ in range(PROJECT_STEPS):
        # Newton: J from forward differences, (u, v) −= J⁻¹ m. The root alone decides the accuracy.
        mx, my = _miss(eye, u, v, x, y, z)
        ax, ay = _miss(eye, u + h, v, x, y, z)
        bx, by = _miss(eye, u, v + h, x, y, z)
        a, b, c, d = (ax - mx) / h, (bx - mx) / h, (ay - my) / h, (by - my) / h
        det = a * d - b * c
        if not abs(det) > 1e-12:
            return math.nan, math.nan
        du, dv = (d * mx - b * my) / det, (a * my - c * mx) / det
        u -= du
        v -= dv
        if not (abs(u) < 1e5 and abs(v) < 1e5):
            return math.nan, math.nan
        if abs(du) + abs(dv) < 1e-10:
            return u, v
    return math.nan, math.nan


@numba.njit(nogil=True, cache=True)
def rays_of(eye: Array, uv: Array, out: Array) -> None:
    """Fill ``out`` with the rays (n, 6) of pixels ``uv`` (n, 2): see ``pixel_ray``."""
    for i in range(uv.shape[0]):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = pixel_ray(eye, uv[i, 0], uv[i, 1])


@numba.njit(nogil=True, cache=True)
def rays_of_image(eye: Array, out: Array) -> None:
    """Fill ``out`` with the rays (h, w, 6) of all pixels: see ``pixel_ray``."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            o = out[y, x]
            o[0], o[1], o[2], o[3], o[4], o[5] = pixel_ray(eye, float(x), float(y))


@numba.njit(nogil=True, cache=True)
def pixels_of(eye: Array, points: Array, out: Array) -> None:
    """Fill ``out`` with the pixels (n, 2) at which water points (n, 3) of the rig frame, mm, are seen."""
    for i in range(points.shape[0]):
        out[i, 0], out[i, 1] = project_point(eye, points[i, 0], points[i, 1], points[i, 2])
