"""Owns the smooth depth error that all scans of one calibration share, as seven numbers: what residuals of a merge do not show.

An error of 30 µm, smooth over the view and the same in every scan, fits every pair: each neighbour is only turned a little, always in the
same sense, and twelve scans in a row bend by more than half a millimetre. So the shared error is carried as unknowns with a prior: what
overlaps tell about it (turned or nearer views, loops that close) makes it smaller, and what they do not tell stays in the budget.

The error is along the ray, in mm at 525 mm distance, and grows with the square of the distance, as any error of a disparity does. Symbols:
u, v  direction (x/z, y/z) over its value at the border of the view;  c  coefficients, mm;  φ  their shapes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.registration.patches import Array

NAMES = ("uu", "uv", "vv", "uuu", "uuv", "uvv", "vvv")
"""Shapes: what is constant or linear over the view only moves or shears a scan, and overlaps absorb it."""
DISTANCE_MM = 525.0
BORDER = 0.24
"""x/z at the border of the view."""
PRIOR_MM = (0.030, 0.030, 0.030, 0.020, 0.020, 0.020, 0.020)
"""Standard deviations before any overlap is seen: flatness errors of calibrated instruments (docs/accuracy.md: worst 0.017 % of
the view's diagonal, 46 µm from the highest to the lowest point)."""


@dataclass(frozen=True, slots=True, eq=False)
class BowNews:
    """Equations of one pair for the shared error."""

    response: Array
    """(6, 7): by how much the pair's pose is wrong per mm of each coefficient."""
    information: Array
    """(7, 7), 1/mm²: of the residuals that no pose takes away."""
    gradient: Array
    """(7,), 1/mm: of half the sum of squares, at zero coefficients."""


def shapes(points_mm: Array) -> Array:
    """Return φ (…, 7) at points (…, 3) of a scan's own frame: depth error in mm per mm of each coefficient."""
    z = points_mm[..., 2]
    u, v = points_mm[..., 0] / z / BORDER, points_mm[..., 1] / z / BORDER
    basis = np.stack([u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3], axis=-1)
    return np.asarray(basis * ((z / DISTANCE_MM) ** 2)[..., None])


def along_ray(points_mm: Array) -> Array:
    """Return the vectors (…, 3) by which points move per mm of depth."""
    return np.asarray(points_mm / points_mm[..., 2:])


def spread_mm(sigma_mm: Array) -> float:
    """Return the RMS depth over the view that coefficients of these standard deviations (7,) may have, at 525 mm."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-0.75, 0.75, 7))
    points = DISTANCE_MM * np.stack([BORDER * u, BORDER * v, np.ones_like(u)], axis=-1)
    return float(np.sqrt(((shapes(points) * sigma_mm) ** 2).sum(axis=-1).mean()))


def corrected(points_mm: Array, coefficients_mm: Array) -> Array:
    """Return points (…, 3) of a scan's own frame with the shared error taken out."""
    error = shapes(points_mm) @ coefficients_mm
    return np.asarray(points_mm - along_ray(points_mm) * error[..., None])


def derivatives(normal_a: Array, at_a_mm: Array, at_b_mm: Array, rotation: Array) -> Array:
    """Return ∂r/∂c (n, 7): how the distance of B's patches from A's planes changes with the shared error.

    ``at_a_mm``: the places (n, 3) in A's frame, ``at_b_mm``: the same in B's, ``rotation``: from B's frame into A's.
    """
    of_b = (normal_a * (along_ray(at_b_mm) @ rotation.T)).sum(-1)
    of_a = (normal_a * along_ray(at_a_mm)).sum(-1)
    return np.asarray(of_b[:, None] * shapes(at_b_mm) - of_a[:, None] * shapes(at_a_mm))


def news_of(J: Array, S_inverse: Array, B: Array, w: Array, r: Array, overdispersion: float) -> BowNews:
    """Return a pair's news from its equations.

    ``J`` (n, 6) and ``B`` (n, 7) derivatives of residuals ``r`` (n,) by pose and coefficients, ``w`` weights, all of planes alone or
    with zeros in ``B`` where a residual is paint's. ``overdispersion``: variance of sums of residuals over that of independent ones.
    """
    C = J.T @ (w[:, None] * B)
    response = -S_inverse @ C
    rest = B + J @ response
    # Residuals are those at the pose found, where J' w r = 0: what is left for the coefficients alone.
    return BowNews(response, rest.T @ (w[:, None] * rest) / overdispersion, -rest.T @ (w * r) / overdispersion)
