"""Owns a fast, proven stand-in for exact projection: Chebyshev polynomials of the exact one over the measuring volume.

Projecting 2 million surface points per frame by Newton on the exact ray is slow; the map from a water point to a
projector pixel is smooth, so a tensor of Chebyshev polynomials in (x/z, y/z, 1/z) reaches 1e-4 px.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.trace import FIELD, HAS_FIELD, POSITION, ROTATION, lens_field, pixels_of

Array = NDArray[np.float64]

ORDER_XY, ORDER_Z = 10, 5
NEAR_MM, FAR_MM = 300.0, 800.0
HALF_X, HALF_Y = 0.30, 0.24


@dataclass(frozen=True, slots=True)
class FastProjection:
    """Coefficients (2, ORDER_XY, ORDER_XY, ORDER_Z) of one eye."""

    eye: Array
    coefficients: Array


def fit_projection(eye: Array) -> FastProjection:
    """Fit to exact projections at Chebyshev nodes."""

    def nodes(n: int) -> Array:
        return np.asarray(np.cos(np.pi * (np.arange(n) + 0.5) / n))

    nx, nz = ORDER_XY + 4, ORDER_Z + 3
    a, b, c = np.meshgrid(nodes(nx), nodes(nx), nodes(nz), indexing="ij")
    inverse_z = 0.5 * (1 / NEAR_MM + 1 / FAR_MM) + 0.5 * (1 / NEAR_MM - 1 / FAR_MM) * c
    z = 1 / inverse_z
    local = np.stack([a * HALF_X * z, b * HALF_Y * z, z], -1).reshape(-1, 3)
    R = eye[ROTATION : ROTATION + 9].reshape(3, 3)
    points = np.ascontiguousarray(local @ R.T + eye[POSITION : POSITION + 3])
    pixels = np.empty((len(points), 2))
    smooth = eye.copy()
    smooth[FIELD:] = 0.0  # the lens field is added exactly, below
    pixels_of(smooth, points, pixels)

    def vandermonde(x: Array, order: int) -> Array:
        return np.asarray(np.polynomial.chebyshev.chebvander(x, order - 1))

    va, vb, vc = vandermonde(nodes(nx), ORDER_XY), vandermonde(nodes(nx), ORDER_XY), vandermonde(nodes(nz), ORDER_Z)
    pa, pb, pc = (np.linalg.pinv(m) for m in (va, vb, vc))
    grid = pixels.reshape(nx, nx, nz, 2)
    coefficients = np.einsum("ia,jb,kc,abcd->dijk", pa, pb, pc, grid)
    return FastProjection(eye, np.ascontiguousarray(coefficients))


@numba.njit(nogil=True, cache=True)
def project_fast(eye: Array, coefficients: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Pixel of a water point in the rig frame; (-1e6, -1e6) outside of the fitted volume."""
    r = ROTATION
    dx, dy, dz = x - eye[POSITION], y - eye[POSITION + 1], z - eye[POSITION + 2]
    lx = dx * eye[r] + dy * eye[r + 3] + dz * eye[r + 6]
    ly = dx * eye[r + 1] + dy * eye[r + 4] + dz * eye[r + 7]
    lz = dx * eye[r + 2] + dy * eye[r + 5] + dz * eye[r + 8]
    if lz < NEAR_MM or lz > FAR_MM:
        return -1e6, -1e6
    a, b = lx / lz / HALF_X, ly / lz / HALF_Y
    if abs(a) > 1.0 or abs(b) > 1.0:
        return -1e6, -1e6
    c = (1.0 / lz - 0.5 * (1.0 / NEAR_MM + 1.0 / FAR_MM)) / (0.5 * (1.0 / NEAR_MM - 1.0 / FAR_MM))
    ta, tb, tc = np.empty(ORDER_XY), np.empty(ORDER_XY), np.empty(ORDER_Z)
    ta[0], ta[1], tb[0], tb[1], tc[0], tc[1] = 1.0, a, 1.0, b, 1.0, c
    for i in range(2, ORDER_XY):
        ta[i] = 2.0 * a * ta[i - 1] - ta[i - 2]
        tb[i] = 2.0 * b * tb[i - 1] - tb[i - 2]
    for i in range(2, ORDER_Z):
        tc[i] = 2.0 * c * tc[i - 1] - tc[i - 2]
    u, v = 0.0, 0.0
    for i in range(ORDER_XY):
        for j in range(min(ORDER_XY, ORDER_XY + 2 - i)):
            su, sv = 0.0, 0.0
            for k in range(ORDER_Z):
                su += coefficients[0, i, j, k] * tc[k]
                sv += coefficients[1, i, j, k] * tc[k]
            w = ta[i] * tb[j]
            u += su * w
            v += sv * w
    field_u, field_v = 0.0, 0.0
    if eye[HAS_FIELD] != 0.0:
        for _ in range(3):
            field_u, field_v = lens_field(eye, u + field_u, v + field_v)
    return u + field_u, v + field_v
