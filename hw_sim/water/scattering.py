"""Scattering by particles of natural water, and its effect on fringes, sharpness and backscatter.

The phase function is the mean of T. J. Petzold's measurements in San Diego harbour (Volume Scattering Functions for
Selected Ocean Waters, SIO Ref. 72-78, 1972) as tabulated by C. D. Mobley, Light and Water (1994), table 3.10; below
0.1° it is continued with its power there. Its effect on a pattern of a given period is the small-angle theory of W. H.
Wells (J. Opt. Soc. Am. 59 (1969) 686): light scattered by θ somewhere on its path of length s arrives displaced by θ u
s, with u evenly distributed in 0..1, so of a fringe with wave number κ the mean of J0(κ θ u s) survives.
"""

# Symbols:
#   b, c      scattering and attenuation coefficients, 1/m (here named scattering_per_m and attenuation_per_m)
#   θ         scattering angle; p(θ) the phase function, 1/sr, of integral 1 over the sphere
#   s, u      length of the path, and the share of it behind the scattering, 0..1
#   κ         wave number of a fringe, 2π / period; S(κ) the share of scattered light that still carries it (survival)

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WAY_MM = 487.5
"""Path from a port to the middle of the volume."""
FRINGE_MM = 4.08
"""Period of 16 projector px there. The fit is exact for it and for half of it."""
BACKSCATTER_MM, BACKSCATTER_DEG, BACKSCATTER_ALBEDO = 576.0, 159.4, 0.6
"""The water before the middle in a camera's view and inside the projector's beam: its length, weighted with its
brightness relative to the middle; the weighted scattering angle; and the albedo to which backscatter is compared."""
_POWER = -1.346
_DEG = (*(0.1, 0.126, 0.158, 0.200, 0.251, 0.316, 0.398, 0.501, 0.631, 0.794, 1.000, 1.259, 1.585, 1.995, 2.512, 3.162,
          3.981, 5.012, 6.310, 7.943), *range(10, 181, 5))  # fmt: skip
_PER_SR = (
    1.767e3, 1.296e3, 9.502e2, 6.991e2, 5.140e2, 3.764e2, 2.763e2, 2.012e2, 1.444e2, 1.022e2, 7.161e1, 4.958e1, 3.395e1,
    2.281e1, 1.516e1, 1.002e1, 6.580, 4.295, 2.807, 1.819, 1.153, 4.893e-1, 2.444e-1, 1.472e-1, 8.609e-2, 5.931e-2,
    4.210e-2, 3.067e-2, 2.275e-2, 1.699e-2, 1.313e-2, 1.046e-2, 8.488e-3, 6.976e-3, 5.842e-3, 4.953e-3, 4.292e-3,
    3.782e-3, 3.404e-3, 3.116e-3, 2.912e-3, 2.797e-3, 2.686e-3, 2.571e-3, 2.476e-3, 2.377e-3, 2.329e-3, 2.313e-3,
    2.365e-3, 2.506e-3, 2.662e-3, 2.835e-3, 3.031e-3, 3.092e-3, 3.154e-3,
)  # fmt: skip


def phase_function(angle_rad: Array) -> Array:
    """Return the share of the scattered light per steradian at scattering angles 0..π (0 excluded)."""
    log_angles = np.log(np.radians(_DEG))
    # Between the table's angles the function is close to a power: interpolate logarithms.
    inside = np.exp(np.interp(np.log(angle_rad), log_angles, np.log(_PER_SR)))
    first = math.radians(_DEG[0])
    return np.where(angle_rad < first, _PER_SR[0] * (angle_rad / first) ** _POWER, inside)


def survival(period_mm: float, way_mm: float = WAY_MM) -> float:
    """Return the share of once scattered light that carries fringes of ``period_mm`` after ``way_mm``."""
    from scipy.special import j0  # half a second that a start of the world does not need

    angles = np.geomspace(1e-7, math.pi, 4000)
    # The ring of directions at θ has the solid angle 2π sin θ dθ.
    weight = 2.0 * math.pi * phase_function(angles) * np.sin(angles)
    places = (np.arange(64) + 0.5) / 64.0
    # Mean over the place u of scattering of J0(κ θ u s), κ = 2π / period.
    carried = j0(2.0 * math.pi / period_mm * way_mm * angles[:, None] * places).mean(axis=1)
    return float(np.trapezoid(weight * carried, angles) / np.trapezoid(weight, angles))


def seen_in_fringes(scattering_per_m: float) -> tuple[float, float]:
    """Return the rate per metre at which scattering returns light to fringes, and its Gaussian sigma in mm.

    Fringes are dimmed less than by beam attenuation by that rate; sigma is that after ``WAY_MM``. Together they dim
    fringes of ``FRINGE_MM`` and of half of it as ``survival`` says.
    """
    coarse, fine = survival(FRINGE_MM), survival(0.5 * FRINGE_MM)
    depth = scattering_per_m * WAY_MM / 1000.0
    wave = 2.0 * math.pi / FRINGE_MM
    # Solve b s S(κ) = g − σ²κ²/2 for both κ and 2κ: σ² = 2 b s (S(κ) − S(2κ)) / (3 κ²), g from the first.
    variance_mm2 = 2.0 * depth * (coarse - fine) / (3.0 * wave**2)
    given_back = depth * coarse + 0.5 * wave**2 * variance_mm2
    return given_back / (WAY_MM / 1000.0), math.sqrt(variance_mm2)


def backscatter(scattering_per_m: float) -> float:
    """Return the single-scattering backscatter of white light before the middle.

    It is a fraction of the reflection of a surface of ``BACKSCATTER_ALBEDO`` there.
    """
    angles = np.geomspace(1e-7, math.pi, 4000)
    integral = float(np.trapezoid(2.0 * math.pi * phase_function(angles) * np.sin(angles), angles))
    per_sr = float(phase_function(np.array([math.radians(BACKSCATTER_DEG)]))[0]) / integral
    # b L p(θ), against a Lambertian surface, which sends albedo / π per steradian.
    return scattering_per_m * BACKSCATTER_MM / 1000.0 * per_sr * math.pi / BACKSCATTER_ALBEDO
