"""Refraction at a plane port: air → glass → water, and the projection through it.

Formulas: vector form of Snell's law; all refracted rays meet the axis through the projection centre along the
port's normal (axial camera), so projecting a water point is a one-dimensional monotone equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEWTON_STEPS = 12
TOLERANCE = 1e-15


@dataclass(frozen=True, slots=True)
class Port:
    """A plane-parallel port in front of a camera."""

    normal: tuple[float, float, float]
    """Unit normal in the camera frame, towards the water."""
    distance_mm: float
    """Interface distance d: projection centre to the inner glass face, along the normal."""
    thickness_mm: float
    glass_index: float
    """Refractive index of the glass relative to air."""


def refract(incident: Array, normal: Array, ratio: float) -> Array:
    """Return the refracted unit directions (..., 3) by Snell's law in vector form.

    ``ratio`` is n_before / n_after; ``normal`` points onwards.
    """
    cosine = np.sum(incident * normal, axis=-1, keepdims=True)
    inside = 1.0 - ratio**2 * (1.0 - cosine**2)
    return np.asarray(ratio * incident + (np.sqrt(inside) - ratio * cosine) * normal)


def water_rays(port: Port, water_index: float, air_directions: Array) -> tuple[Array, Array]:
    """Return the water rays of air directions (..., 3): points on the outer face, mm, and unit directions.

    Both are in the camera frame.
    """
    n = np.asarray(port.normal, np.float64)
    a = np.asarray(air_directions, np.float64)
    # Both refracted from air, since plane-parallel glass does not change the direction in water.
    g = refract(a, n, 1.0 / port.glass_index)
    w = refract(a, n, 1.0 / water_index)
    # Through the air to the inner face, then through the glass to the outer one.
    point = a * (port.distance_mm / np.sum(a * n, -1, keepdims=True)) + g * (
        port.thickness_mm / np.sum(g * n, -1, keepdims=True)
    )
    return point, w


def air_directions(port: Port, water_index: float, points_mm: Array) -> Array:
    """Return the directions in air (..., 3), not normalised, of water points (..., 3) in the camera frame.

    Points not beyond the outer face give NaN. Converges from any point in 3–4 Newton steps to 1e-12 px, because
    the left side of the equation is increasing and concave.
    """
    n = np.asarray(port.normal, np.float64)
    points = np.asarray(points_mm, np.float64)
    z = np.sum(points * n, -1)
    radial = points - z[..., None] * n
    h = np.linalg.norm(radial, axis=-1)
    d, th, ng2, nw2 = port.distance_mm, port.thickness_mm, port.glass_index**2, water_index**2
    # t: tangent of the angle in air. Glass and water add th·t/√g2 and zw·t/√w2 to the radius h: solve for t by Newton.
    zw = np.where(z > d + th, z - d - th, np.nan)
    t = h / (d + th / port.glass_index + zw / water_index)
    for _ in range(NEWTON_STEPS):
        g2 = ng2 + (ng2 - 1.0) * t * t
        w2 = nw2 + (nw2 - 1.0) * t * t
        value = d * t + th * t / np.sqrt(g2) + zw * t / np.sqrt(w2) - h
        slope = d + th * ng2 / (g2 * np.sqrt(g2)) + zw * nw2 / (w2 * np.sqrt(w2))
        step = value / slope
        t = t - step
        if not np.any(np.abs(step) > TOLERANCE * (1.0 + np.abs(t))):
            break
    with np.errstate(invalid="ignore", divide="ignore"):
        outward = np.where(h[..., None] > 0.0, radial / np.where(h > 0.0, h, 1.0)[..., None], 0.0)
    return np.asarray(n + t[..., None] * outward)
