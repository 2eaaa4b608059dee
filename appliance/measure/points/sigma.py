"""The standard deviation of a correspondence by noise, footprints, ripple and missing neighbours.

It is that of the right image point across the baseline, in px; ``triangulate.py`` converts it to millimetres along the
ray. The parts add as variances (``docs/uncertainty.md``):

- *noise*: the four-step phase noise P·σ/(2π·√2·B) of both cameras at their own light, or the maps' variances if they
  have them; that of the right camera times the factor of the interpolation between pixels;
- *footprint*: a blur of variance β moves a coordinate by β (½ ∇²p + ∇p · ∇ln B): by its bend, and by its slope where the
  light has a gradient. The bend of both cameras counts. Both see the light of the same texture and shading at other
  slopes: only the difference counts, and the right one's is the left one's in proportion to p_u²;
- *ripple*: the phase error by the response is the same in both coordinates, except for the part that is lost between
  right pixels;
- *border*: a neighbour has no coordinate, so that the bend of the surface is unknown.

Symbols, at a left pixel and its match: m1, m2 are the modulations B of the left and the right camera, light is the left
fringes' offset, left_slope and slope are p_u of the left and of the right map, left2 and slope2 their squares, up and
uq the inverse derivatives ∂u/∂p and ∂u/∂q (up to the sign) of the right map. scale2 = P²/8π²; dark + shot · light = σ²
in DN².
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import (
    BEND_RIGHT,
    MODULATION,
    MODULATION_RIGHT,
    OFFSET,
    PHASE_VARIANCE,
    PHASE_VARIANCE_RIGHT,
    POINT_VARIANCE,
    RIGHT_SHARE,
    SLOPE,
    UP,
    UQ,
    P,
)
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.points.quality import KNEE, STILL, Ripple

BLUR_PX2 = 0.2
"""Variance of a pixel's footprint by its area and the lens, in px²."""
SPLINE_BLUR_PX2 = 1.0 / 3.0
"""Variance of the cubic B-spline, in px², which interpolation between pixels adds to ``BLUR_PX2``."""
BORDER_PX = 0.07
"""Standard deviation by the unknown bend where a neighbour has no coordinate, px."""
SHARED = np.float32(1.17)
"""Variance of a coordinate interpolated from neighbours that share half of their noise, as the B-spline leaves it, over
that from independent ones; mean over all places."""
SURE = np.float32(20.0)
"""Least bend that counts, as a multiple of a coordinate's variance: noise alone makes 5 in the mean."""
RIPPLE_KNEE = np.float32(KNEE)
MIN_SLOPE2 = np.float32(0.0025)
_ZERO, _ONE, _HALF, _QUARTER = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(0.25)


class SigmaFactors(NamedTuple):
    """Factors from measured quantities to a point's standard deviation."""

    scale2_px2: np.float32
    """Variance of a coordinate for camera noise equal to the modulation: P²/8π²."""
    dark_left: np.float32
    """Variance at grey value 0, on the line through the variances at all grey values."""
    shot_left: np.float32
    """Variance per grey value."""
    dark_right: np.float32
    shot_right: np.float32
    ripple_px2: np.float32
    """Squared amplitude of the ripple; 0 if it is negligible."""
    ripple_rad: np.float32
    """Phase of the ripple per px of the pattern."""
    blur2_px4: np.float32
    """Square of the variance of the footprint: ``BLUR_PX2``, and the spline's if the maps were interpolated."""
    border_px2: np.float32
    """``BORDER_PX`` squared."""
    right_correlation: np.float32 = np.float32(1.0)
    """``SHARED`` if right pixels share noise with their neighbours, else 1; a factor of the right maps' variance."""


def sigma_factors(period_px: int, noise: StereoNoise, ripple: Ripple = STILL) -> SigmaFactors:
    """Return the factors for fringes of ``period_px``, the cameras' noise and a ripple."""

    def of(camera: CameraNoise) -> tuple[np.float32, np.float32]:
        return np.float32(camera.dark_variance_dn2), np.float32(camera.dn_per_e)

    return SigmaFactors(
        np.float32(period_px**2 / (8.0 * math.pi**2)),
        *of(noise.left),
        *of(noise.right),
        np.float32(ripple.amplitude_px**2 if ripple.counts else 0.0),
        np.float32(8.0 * math.pi / period_px),
        np.float32(BLUR_PX2**2),
        np.float32(BORDER_PX**2),
    )


def read_between(factors: SigmaFactors, fringe_px: float) -> SigmaFactors:
    """Return the factors for maps that were interpolated between pixels by the cubic B-spline.

    The spline adds blur, neighbours share noise, and of fringes ``fringe_px`` long the third harmonic, which makes the
    ripple, is attenuated more than the first.
    """
    lost = float((np.sinc(3.0 / fringe_px) / np.sinc(1.0 / fringe_px)) ** 4)
    return factors._replace(
        ripple_px2=factors.ripple_px2 * np.float32(lost**2),
        blur2_px4=np.float32((BLUR_PX2 + SPLINE_BLUR_PX2) ** 2),
        right_correlation=SHARED,
    )


def four_step_variance_px2(
    modulation_dn: NDArray[np.float32], offset_dn: NDArray[np.float32], noise: CameraNoise, period_px: int
) -> NDArray[np.float32]:
    """Return the variance of a four-step coordinate, in px² of the pattern: (P/(2π √2 B))² σ²(offset).

    Modulations B and the fringes' offsets are float32 of one shape; ``noise`` is the camera's.
    """
    scale_px = period_px / (2.0 * math.pi * math.sqrt(2.0))
    return np.asarray(scale_px**2 * noise.variance_dn2(offset_dn) / modulation_dn**2, np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _expect(factors: SigmaFactors, s: NDArray[np.float32], w: NDArray[np.float32], n: int) -> None:
    """Write POINT_VARIANCE of noise, footprint and border; the noise follows from modulation and offset."""
    scale2, dark1, shot1, dark2, shot2, _ripple, _rad, blur2, border2, _correlation = factors
    for x in range(n):
        m1, m2, light, slope = s[MODULATION + x], w[MODULATION_RIGHT + x], s[OFFSET + x], w[SLOPE + x]
        before, after = s[P + x - 1], s[P + x + 1]
        left_slope, slope2 = _HALF * (after - before), slope * slope
        left2 = left_slope * left_slope
        left2 = left2 if left2 > MIN_SLOPE2 else MIN_SLOPE2
        # One division for two: 1/(m1 m2)² and 1/left2.
        m12 = m1 * m2
        m12 = m12 * m12
        inverse = _ONE / (m12 * left2)
        per_m12, per_left2 = inverse * left2, inverse * m12
        # Noise: scale2 (σ_l²/m1² + share · σ_r²/m2²), the right camera's light being light · m2/m1.
        m22 = m2 * m2
        left, right = (dark1 + shot1 * light) * m22, (dark2 * m1 + shot2 * light * m2) * m1
        noise = scale2 * (left + w[RIGHT_SHARE + x] * right) * per_m12
        # Footprint: ∇p · ∇ln B of the left camera less that of the right one, and the bends beyond their noise.
        uneven = (s[MODULATION + x + 1] - s[MODULATION + x - 1]) * left_slope * (left2 - slope2) * per_left2
        bend1, bend2 = _HALF * (before + after) - s[P + x], w[BEND_RIGHT + x]
        bend = bend1 * bend1 + bend2 * bend2 - SURE * noise
        has_bend = bend == bend
        bend = bend if bend > _ZERO else _ZERO
        footprint = blur2 * (bend + _QUARTER * uneven * uneven * m22 * per_m12)
        # From px of the pattern to px of the right image.
        up, uq = s[UP + x], s[UQ + x]
        w[POINT_VARIANCE + x] = (up * up + uq * uq) * (noise + (footprint if has_bend else border2 * slope2))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _expect_given(factors: SigmaFactors, s: NDArray[np.float32], w: NDArray[np.float32], n: int) -> None:
    """Write POINT_VARIANCE as ``_expect`` does, with the variances of the maps as noise."""
    blur2, border2, correlation = factors.blur2_px4, factors.border_px2, factors.right_correlation
    for x in range(n):
        modulation, slope = s[MODULATION + x], w[SLOPE + x]
        before, after = s[P + x - 1], s[P + x + 1]
        left_slope, slope2 = _HALF * (after - before), slope * slope
        left2 = left_slope * left_slope
        left2 = left2 if left2 > MIN_SLOPE2 else MIN_SLOPE2
        # Noise: V_left + share · V_right.
        noise = s[PHASE_VARIANCE + x] + w[RIGHT_SHARE + x] * (correlation * w[PHASE_VARIANCE_RIGHT + x])
        # Footprint: β (½ ∇²p + ∇p · ∇ln B), the second part as the difference of both cameras.
        gradient = s[MODULATION + x + 1] - s[MODULATION + x - 1]
        uneven = gradient * left_slope * (left2 - slope2) / (left2 * modulation)
        bend1, bend2 = _HALF * (before + after) - s[P + x], w[BEND_RIGHT + x]
        bend = bend1 * bend1 + bend2 * bend2 - SURE * noise
        has_bend = bend == bend
        bend = bend if bend > _ZERO else _ZERO
        footprint = blur2 * (bend + _QUARTER * uneven * uneven)
        # From px of the pattern to px of the right image.
        up, uq = s[UP + x], s[UQ + x]
        w[POINT_VARIANCE + x] = (up * up + uq * uq) * (noise + (footprint if has_bend else border2 * slope2))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _add_ripple(
    ripple_px2: np.float32, rad: np.float32, s: NDArray[np.float32], w: NDArray[np.float32], n: int
) -> None:
    """Add the ripple: t³/(t³ + KNEE) of its squared amplitude, t the square of its phase per right px.

    That is within a fifth of the mean over all places between pixels, wherever it is more than a tenth.
    """
    for x in range(n):
        t = rad * w[SLOPE + x]
        t = t * t
        t = t * t * t
        up, uq = s[UP + x], s[UQ + x]
        w[POINT_VARIANCE + x] += (up * up + uq * uq) * ripple_px2 * t / (t + RIPPLE_KNEE)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def expect_row(
    factors: SigmaFactors, next_to: bool, variances_given: bool, s: NDArray[np.float32], w: NDArray[np.float32], n: int
) -> None:
    """Write POINT_VARIANCE in px² of ``n`` matched left pixels; it has no meaning without a match.

    ``next_to``: elements of ``s`` are neighbours in the image, so that their footprints are known. ``variances_given``:
    the variances of the coordinates are in PHASE_VARIANCE and PHASE_VARIANCE_RIGHT; otherwise they follow from
    MODULATION, MODULATION_RIGHT and OFFSET, the right camera's offset being the left one's in proportion to their
    modulations. Also reads P, UP, UQ, SLOPE, MODULATION, RIGHT_SHARE, BEND_RIGHT.
    """
    used = factors if next_to else without_neighbours(factors)
    if variances_given:
        _expect_given(used, s, w, n)
    else:
        _expect(used, s, w, n)
    if factors.ripple_px2 > _ZERO:
        _add_ripple(factors.ripple_px2, factors.ripple_rad, s, w, n)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def without_neighbours(f: SigmaFactors) -> SigmaFactors:
    """Return the factors of noise and ripple alone."""
    return SigmaFactors(
        f.scale2_px2, f.dark_left, f.shot_left, f.dark_right, f.shot_right, f.ripple_px2, f.ripple_rad, _ZERO, _ZERO,
        f.right_correlation,
    )  # fmt: skip
