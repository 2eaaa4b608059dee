"""Owns the expected error of a correspondence: what noise, footprints, ripple and missing neighbours do to it.

It is that of the right image point across the baseline, in px; ``triangulate.py`` makes millimetres along the ray of
it. The parts add as variances (``docs/uncertainty.md``):

- *noise*: the four-step phase noise P·σ/(2π·√2·B) of both cameras at their own light, or what the maps say of it where they
  carry variances; the right one's in the share that reading off between pixels leaves;
- *footprint*: a blur of variance β moves a coordinate by β (½ ∇²p + ∇p · ∇ln B): by its bend, and by its slope where the
  light is steeper on one side. The bend of both cameras counts. The light of both is the same paint and shade, seen at
  other slopes: only the difference counts, and the right one's is the left one's in proportion to p_u²;
- *ripple*: of what the projector's response does to both coordinates alike, that which is lost between right pixels;
- *border*: a neighbour has no coordinate, so that nobody knows how the surface bends.

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
"""Variance of what one pixel sees, in px²: its own area and the lens."""
SPLINE_BLUR_PX2 = 1.0 / 3.0
"""Variance in px² of the cubic B-spline's spot: what reading between pixels adds to ``BLUR_PX2``."""
BORDER_PX = 0.07
"""Expected error, in px, where a neighbour has no coordinate."""
SHARED = np.float32(1.17)
"""Variance of a coordinate read between pixels where neighbours have half of their noise in common, as the B-spline
leaves it, over that of independent ones; mean over all places."""
SURE = np.float32(20.0)
"""Multiple of a coordinate's variance beyond which a bend counts: noise alone makes 5 in the mean."""
RIPPLE_KNEE = np.float32(KNEE)
MIN_SLOPE2 = np.float32(0.0025)
_ZERO, _ONE, _HALF, _QUARTER = np.float32(0.0), np.float32(1.0), np.float32(0.5), np.float32(0.25)


class SigmaFactors(NamedTuple):
    """Factors that make a point's expected error of what is measured at it."""

    scale2_px2: np.float32
    """Coordinate noise squared for camera noise equal to the modulation: P²/8π²."""
    dark_left: np.float32
    """Variance at grey value 0, as a line through the variances at all others has it."""
    shot_left: np.float32
    """Variance per grey value."""
    dark_right: np.float32
    shot_right: np.float32
    ripple_px2: np.float32
    """Squared amplitude of what the projector's response does to a coordinate, four times a period; 0 where that does
    not count."""
    ripple_rad: np.float32
    """Phase of the ripple per px of the pattern."""
    blur2_px4: np.float32
    """Square of the variance of what one place of the maps sees: of ``BLUR_PX2``, and of the spline's where they were
    read by it."""
    border_px2: np.float32
    """``BORDER_PX`` squared."""
    right_correlation: np.float32 = np.float32(1.0)
    """``SHARED`` where right pixels share noise with their neighbours, else 1.

    It multiplies a variance that the right maps carry.
    """


def sigma_factors(period_px: int, noise: StereoNoise, ripple: Ripple = STILL) -> SigmaFactors:
    """Return the factors for fringes of ``period_px``, cameras of that noise, and a coordinate that ripples like that."""

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
    """Return the factors for maps with variances whose grey values were read between pixels by the cubic B-spline.

    What is read is blurred by the spline's spot as well, neighbours share noise, and of fringes ``fringe_px`` long the
    third harmonic, which makes the ripple, is lost more than the first.
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
    """Return the variance of a coordinate by four steps of 90°, in px² of the pattern: (P/(2π √2 B))² σ²(offset).

    Modulations B and the fringes' offsets are float32 of one shape; ``noise`` is the camera's.
    """
    scale_px = period_px / (2.0 * math.pi * math.sqrt(2.0))
    return np.asarray(scale_px**2 * noise.variance_dn2(offset_dn) / modulation_dn**2, np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _expect(factors: SigmaFactors, s: NDArray[np.float32], w: NDArray[np.float32], n: int) -> None:
    """Write POINT_VARIANCE of noise, footprint and border, the noise being that of modulation, offset and camera."""
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
        # Footprint: ∇p · ∇ln B of the left camera less that of the right one, and the bends beyond what noise makes.
        uneven = (s[MODULATION + x + 1] - s[MODULATION + x - 1]) * left_slope * (left2 - slope2) * per_left2
        bend1, bend2 = _HALF * (before + after) - s[P + x], w[BEND_RIGHT + x]
        bend = bend1 * bend1 + bend2 * bend2 - SURE * noise
        known = bend == bend
        bend = bend if bend > _ZERO else _ZERO
        footprint = blur2 * (bend + _QUARTER * uneven * uneven * m22 * per_m12)
        # Px of the pattern become px of the right image.
        up, uq = s[UP + x], s[UQ + x]
        w[POINT_VARIANCE + x] = (up * up + uq * uq) * (noise + (footprint if known else border2 * slope2))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _expect_given(factors: SigmaFactors, s: NDArray[np.float32], w: NDArray[np.float32], n: int) -> None:
    """Write POINT_VARIANCE as ``_expect`` does, with the noise that the maps carry instead of that of modulation and
    light."""
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
        known = bend == bend
        bend = bend if bend > _ZERO else _ZERO
        footprint = blur2 * (bend + _QUARTER * uneven * uneven)
        # From px of the pattern to px of the right image.
        up, uq = s[UP + x], s[UQ + x]
        w[POINT_VARIANCE + x] = (up * up + uq * uq) * (noise + (footprint if known else border2 * slope2))


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _add_ripple(
    ripple_px2: np.float32, rad: np.float32, s: NDArray[np.float32], w: NDArray[np.float32], n: int
) -> None:
    """Add the ripple: of its squared amplitude, t³/(t³ + KNEE) is lost, t the square of its phase per right px.

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
    """Write POINT_VARIANCE in px² of ``n`` matched left pixels. Where there is no match it means nothing.

    ``next_to``: places of ``s`` are neighbours in the image, whose footprints can be told. ``variances_given``: the
    noise of the coordinates is in PHASE_VARIANCE and PHASE_VARIANCE_RIGHT; else it follows from MODULATION,
    MODULATION_RIGHT and OFFSET, the right camera's offset being the left one's in proportion to their modulations. Also
    reads P, UP, UQ, SLOPE, MODULATION, RIGHT_SHARE, BEND_RIGHT.
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
