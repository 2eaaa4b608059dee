"""Owns what the sine frames say against a motion: each sample's disagreements, and the normal equations of all of them.

Per sample and camera there are two. The four x-sines, read where the motion takes the point and with the phase steps
that it makes, leave one of four degrees of freedom: what contradicts every offset, modulation and phase. And their offset
and that of the y-sines are the same texture, but for a gain that is smooth over the image.

Parameters: for each of the 8 sine frames 3 mm of shift and 3 mm of turn (at the lever), a gain for each, and six
coefficients of the smooth gain per camera.

Legend of the kernels, per sample i and frame k (block 0: x-sines, 1: y-sines; m = 0 … 3 within a block)::

    d      (3,) mm   displacement of the point: shift + turn × lever
    J, e             jacobian and inverse-depth gradient of the camera: u(X + d) = u(X) + J d / (1 + e·d)
    G, eg            the same of the projector's phase in rad: ψ = G d / (1 + eg·d) + m π/2
    y_m              grey value read there, over the frame's gain
    a, c, s          offset and the modulation's two parts: y_m = a + c cos ψ_m − s sin ψ_m
    weights  (4, 4)  rows: how a, c, s and the contradiction follow from y
    row              derivative of one residual by what its camera's sample depends on
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRAMES = 8
"""The x-sines, then the y-sines."""
MOTIONS = 6 * FRAMES
GAINS = MOTIONS
"""Place of the frames' gains among the parameters, behind the motions."""
SMOOTH_GAIN = MOTIONS + FRAMES
"""Place of the first camera's coefficients of the smooth gain."""
SMOOTH_TERMS = 6
PARAMETERS = SMOOTH_GAIN + 2 * SMOOTH_TERMS
X_STEPS, TEXTURE = 0, 1
"""Kinds of residuals."""
FRAME_UNKNOWNS = 7
"""Each frame has three unknowns of shift, three of turn and one of gain."""
_ROW = FRAME_UNKNOWNS * FRAMES + SMOOTH_TERMS
"""Length of ``row``: the unknowns of all frames, then the smooth gain."""
CAUCHY = 0.16
"""A residual of r times the scale σ counts with the weight 1 / (σ² (1 + ``CAUCHY`` r²)), as if it were Cauchy
distributed."""


class Samples(NamedTuple):
    """n points as one camera and the projector see them; all float64."""

    uv_px: Array
    """(n, 2) px of the pictures that are looked at."""
    jacobian: Array
    """J (n, 2, 3) px/mm."""
    inverse_depth_gradient: Array
    """e (n, 3) 1/mm."""
    phase_per_mm: Array
    """G (n, 2, 3) rad/mm along the two directions of the pattern."""
    projector_inverse_depth_gradient: Array
    """eg (n, 3) 1/mm."""
    lever: Array
    """(n, 3): the point from the middle of the volume, in units of ``LEVER_MM``."""
    gain_basis: Array
    """(n, SMOOTH_TERMS): the polynomials that the smooth gain is made of."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _cubic_weights(t: float) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the weights of cubic convolution (Keys, a = −½) at −1, 0, 1, 2 for ``t`` in 0 … 1, and their derivatives."""
    t2, t3 = t * t, t * t * t
    return (
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        -0.5 * t2 + 0.5 * t3,
        -0.5 + 2.0 * t - 1.5 * t2,
        -5.0 * t + 4.5 * t2,
        0.5 + 4.0 * t - 4.5 * t2,
        -t + 1.5 * t2,
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_cubic(picture: NDArray[np.float32], u: float, v: float) -> tuple[float, float, float]:
    """Return the grey value at (u, v) and its derivatives by u and v; (u, v) lies at least 1 px inside."""
    i, j = int(np.floor(u)), int(np.floor(v))
    a0, a1, a2, a3, da0, da1, da2, da3 = _cubic_weights(u - i)
    b0, b1, b2, b3, db0, db1, db2, db3 = _cubic_weights(v - j)
    value, by_u, by_v = 0.0, 0.0, 0.0
    for m in range(4):
        b = b0 if m == 0 else (b1 if m == 1 else (b2 if m == 2 else b3))
        db = db0 if m == 0 else (db1 if m == 1 else (db2 if m == 2 else db3))
        p0, p1 = picture[j - 1 + m, i - 1], picture[j - 1 + m, i]
        p2, p3 = picture[j - 1 + m, i + 1], picture[j - 1 + m, i + 2]
        row = a0 * p0 + a1 * p1 + a2 * p2 + a3 * p3
        value += b * row
        by_v += db * row
        by_u += b * (da0 * p0 + da1 * p1 + da2 * p2 + da3 * p3)
    return value, by_u, by_v


@numba.njit(nogil=True, cache=True, error_model="numpy")
def invert_steps(cosine: Array, sine: Array, weights: Array) -> None:
    """Solve y_k = a + c cos ψ_k − s sin ψ_k of four steps by least squares, for any y.

    Writes into ``weights`` (4, 4) how a, c and s follow from y, and the unit vector that contradicts them all.
    """
    # The contradiction n is orthogonal to (1, cos, −sin): n_k = ± the minor without row k, which is twice the area of
    # the triangle that the three other steps make on the unit circle.
    size = 0.0
    for k in range(4):
        i, j, l = (1, 2, 3) if k == 0 else ((0, 2, 3) if k == 1 else ((0, 1, 3) if k == 2 else (0, 1, 2)))
        area = (
            sine[j] * cosine[i]
            - cosine[j] * sine[i]
            + sine[l] * cosine[j]
            - cosine[l] * sine[j]
            + sine[i] * cosine[l]
            - cosine[i] * sine[l]
        )
        weights[3, k] = area if k % 2 == 0 else -area
        size += area * area
    scale = 1.0 / np.sqrt(size)
    # N = AᵀA with A = (1, cos, −sin); n00 = 4.
    n01, n02, n11, n12, n22 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        weights[3, k] *= scale
        n01 += cosine[k]
        n02 -= sine[k]
        n11 += cosine[k] * cosine[k]
        n12 -= cosine[k] * sine[k]
        n22 += sine[k] * sine[k]
    # N⁻¹ by its adjugate i, then N⁻¹ Aᵀ.
    i00, i01, i02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    i11, i12, i22 = 4.0 * n22 - n02 * n02, n01 * n02 - 4.0 * n12, 4.0 * n11 - n01 * n01
    scale = 1.0 / (4.0 * i00 + n01 * i01 + n02 * i02)
    for k in range(4):
        weights[0, k] = scale * (i00 + i01 * cosine[k] - i02 * sine[k])
        weights[1, k] = scale * (i01 + i11 * cosine[k] - i12 * sine[k])
        weights[2, k] = scale * (i02 + i12 * cosine[k] - i22 * sine[k])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def apply_steps(weights: Array, y: Array) -> tuple[float, float, float, float]:
    """Return a, c, s and the contradiction of the values ``y`` (4,), by the ``weights`` of ``invert_steps``."""
    a, c, s, contradiction = 0.0, 0.0, 0.0, 0.0
    for k in range(4):
        a += weights[0, k] * y[k]
        c += weights[1, k] * y[k]
        s += weights[2, k] * y[k]
        contradiction += weights[3, k] * y[k]
    return a, c, s, contradiction


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _phase_variance(weights: Array, c: float, s: float) -> float:
    """Return the variance of the phase φ = atan2(s, c) over that by steps of 90°, σ² / (2 (c² + s²))."""
    total = 0.0
    for k in range(4):
        part = s * weights[1, k] - c * weights[2, k]
        total += part * part
    return 2.0 * total / max(s * s + c * c, 1e-9)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def accumulate(
    samples: Samples,
    pictures: NDArray[np.float32],
    values: Array,
    side: int,
    scale_dn: Array,
    kinds: int,
    matrix: Array,
    vector: Array,
    residual_dn: Array,
    modulation_dn: Array,
    variance: Array,
) -> None:
    """Add one camera's samples to the normal equations ``matrix`` (P, P), ``vector`` (P,) at the parameters ``values``
    (P,).

    ``pictures`` (8, h, w) float32; ``side`` is the camera's number; ``kinds``: bit k lets residuals of kind k count.
    ``scale_dn`` (2,) are the kinds' robust scales. Per sample, ``residual_dn`` (n, 2) gets the residuals, NaN where a
    point leaves the picture; ``modulation_dn`` (n,) the modulation of the x-sines, and ``variance`` (n,) that of their phase over that by steps of 90°. Where only x-sines count, the other frames are not read, and what belongs to them stays as it
    was.
    """
    uv, J, e, G, eg, lever, basis = samples
    height, width = pictures.shape[1], pictures.shape[2]
    y, h = np.empty(4), np.empty(4)
    cosine, sine = np.empty(4), np.empty(4)
    D = np.empty((FRAMES, 3))
    grey = np.empty(FRAMES)
    solved = np.empty((2, 3))
    weights = np.empty((2, 4, 4))
    contradiction = np.empty(2)
    row = np.empty(_ROW)
    # Sums in the order of ``row``: what is added up then lies side by side.
    products, sums = np.zeros((_ROW, _ROW)), np.zeros(_ROW)
    blocks = 1 if kinds == 1 << X_STEPS else 2
    for i in range(uv.shape[0]):
        # A point that leaves the picture in one frame says nothing at all: its equations need every sine.
        inside = True
        for block in range(blocks):
            for m in range(4):
                k = 4 * block + m
                # d = shift + turn × lever
                d0 = values[6 * k] + values[6 * k + 4] * lever[i, 2] - values[6 * k + 5] * lever[i, 1]
                d1 = values[6 * k + 1] + values[6 * k + 5] * lever[i, 0] - values[6 * k + 3] * lever[i, 2]
                d2 = values[6 * k + 2] + values[6 * k + 3] * lever[i, 1] - values[6 * k + 4] * lever[i, 0]
                # u(X + d) = u(X) + J d / (1 + e·d)
                near = 1.0 / (1.0 + e[i, 0] * d0 + e[i, 1] * d1 + e[i, 2] * d2)
                u = uv[i, 0] + near * (J[i, 0, 0] * d0 + J[i, 0, 1] * d1 + J[i, 0, 2] * d2)
                v = uv[i, 1] + near * (J[i, 1, 0] * d0 + J[i, 1, 1] * d1 + J[i, 1, 2] * d2)
                if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
                    inside = False
                    break
                value, by_u, by_v = read_cubic(pictures[k], u, v)
                gain = 1.0 / (1.0 + values[GAINS + k])
                y[m] = grey[k] = value * gain
                # ψ_m: what the motion adds to the step of 90°.
                near_p = 1.0 / (1.0 + eg[i, 0] * d0 + eg[i, 1] * d1 + eg[i, 2] * d2)
                psi = near_p * (G[i, block, 0] * d0 + G[i, block, 1] * d1 + G[i, block, 2] * d2) + 0.5 * np.pi * m
                cosine[m], sine[m] = np.cos(psi), np.sin(psi)
                # ∂y/∂d by the picture's gradient.
                for a in range(3):
                    D[k, a] = gain * near * (by_u * J[i, 0, a] + by_v * J[i, 1, a])
            if not inside:
                break
            # a, c, s and the contradiction of y_m = a + c cos ψ_m − s sin ψ_m.
            invert_steps(cosine, sine, weights[block])
            solved[block, 0], solved[block, 1], solved[block, 2], contradiction[block] = apply_steps(weights[block], y)
            # ∂(y − a − c cos ψ + s sin ψ)/∂d: the model moves with the phase, too (h = ∂model/∂ψ).
            for m in range(4):
                h[m] = -solved[block, 1] * sine[m] - solved[block, 2] * cosine[m]
                for a in range(3):
                    D[4 * block + m, a] -= h[m] * G[i, block, a]
        if not inside:
            residual_dn[i, :] = np.nan
            continue
        residual_dn[i, X_STEPS] = contradiction[0]
        modulation_dn[i] = np.sqrt(solved[0, 1] ** 2 + solved[0, 2] ** 2)
        variance[i] = _phase_variance(weights[0], solved[0, 1], solved[0, 2])
        mean, doubt = 0.0, 0.0
        if blocks == 2:
            # Texture: a_y − (1 + smooth gain) a_x, over its noise (1 by steps of 90°). Moving sideways, a point may see
            # nearly equal phases in all steps: its offset is then hardly known.
            for t in range(SMOOTH_TERMS):
                mean += basis[i, t] * values[SMOOTH_GAIN + SMOOTH_TERMS * side + t]
            for m in range(4):
                doubt += 2.0 * (weights[0, 0, m] ** 2 + weights[1, 0, m] ** 2)
            doubt = np.sqrt(doubt)
            residual_dn[i, TEXTURE] = (solved[1, 0] - (1.0 + mean) * solved[0, 0]) / doubt
        # One row of the normal equations for each kind: x-sines touch frames 0 … 3, texture all.
        for kind in range(2):
            if not kinds >> kind & 1:
                continue
            stop = 4 if kind == X_STEPS else 8
            # ``row``: ∂residual/∂y_k times ∂y_k/∂(shift, turn, gain); a turn's derivative is lever × that of a shift.
            for k in range(stop):
                block, m = k // 4, k % 4
                if kind == TEXTURE:
                    part = (weights[block, 0, m] if block == 1 else -(1.0 + mean) * weights[block, 0, m]) / doubt
                else:
                    part = weights[block, 3, m]
                g0, g1, g2 = part * D[k, 0], part * D[k, 1], part * D[k, 2]
                at = FRAME_UNKNOWNS * k
                row[at], row[at + 1], row[at + 2] = g0, g1, g2
                row[at + 3] = lever[i, 1] * g2 - lever[i, 2] * g1
                row[at + 4] = lever[i, 2] * g0 - lever[i, 0] * g2
                row[at + 5] = lever[i, 0] * g1 - lever[i, 1] * g0
                row[at + 6] = -part * grey[k]
            last = FRAME_UNKNOWNS * stop
            # ∂texture/∂(coefficient of the smooth gain) = −basis · a_x / doubt.
            if kind == TEXTURE:
                for t in range(SMOOTH_TERMS):
                    row[last + t] = -basis[i, t] * solved[0, 0] / doubt
                last += SMOOTH_TERMS
            # Normal equations with Cauchy weights; the lower triangle is enough.
            r = residual_dn[i, kind]
            weight = 1.0 / (scale_dn[kind] ** 2 + CAUCHY * r * r)
            for a in range(last):
                wa = weight * row[a]
                sums[a] += wa * r
                for b in range(a + 1):
                    products[a, b] += wa * row[b]
    # From the order of ``row`` to that of the parameters, where the two cameras share the motion but not the smooth
    # gain.
    for a in range(_ROW):
        vector[_parameter(a, side)] += sums[a]
        for b in range(a + 1):
            matrix[_parameter(a, side), _parameter(b, side)] += products[a, b]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _parameter(place: int, side: int) -> int:
    """Return which parameter stands at a place of ``row``."""
    frame, part = place // FRAME_UNKNOWNS, place % FRAME_UNKNOWNS
    if frame >= FRAMES:
        return SMOOTH_GAIN + SMOOTH_TERMS * side + place - FRAME_UNKNOWNS * FRAMES
    return 6 * frame + part if part < 6 else GAINS + frame
