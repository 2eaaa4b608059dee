"""Owns the map of phase drift: how far the fringes move from one sine image to the next, place by place.

Four steps of 90° leave one combination that holds no phase, C = I₀ − I₁ + I₂ − I₃. On a thing at rest it is noise, but for
what daylight adds between images (in proportion to the modulation) and for the second harmonic of the projector's light
(cos 2φ). A fringe that drifts by ε from image to image makes C = 2 ε B (sin φ − cos φ). Least squares over a cell of the
pattern therefore tell ε, signed. Flickering and drifting daylight adds a part of the mean light and of the modulation to each image, and the
projector's second harmonic a cos 2φ: all three are terms of the fit. So is its sixth, the only other one below the tenth that is
left in C: a light that is made of bit planes and seen for a part of a frame has steps, and these have harmonics. Depth steps, shadows and edges of albedo at rest give the same
C as any other pixel: nothing. Cells are squares of the *pattern*, so that both cameras' cells are the same place on the
thing, whatever its shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode.decoder import CameraDecoder

CELL_PX = 64
"""Side of a cell in pattern px: 16 mm; one fringe of the longest period."""
SAMPLES = 120_000
"""Pixels of a camera that are looked at, about."""
# Symbols of the kernels. At a pixel (u, v) with pattern coordinates (p, q): a, b, c, d are the four sine images I₀..I₃,
# (cosine, sine) = B (cos φ, sin φ), and C = a − b + c − d (left_over). x holds the terms that C is fitted by: B, B cos
# φ, B sin φ, B cos 2φ, B sin 2φ, the mean light, B cos 6φ and B sin 6φ. A row of sums holds the lower triangle of their normal equations,
# then the products with C, C², and the sums named by the constants below.

_TERMS = 8
_PRODUCTS = _TERMS * (_TERMS + 1) // 2
_SIXTH = (_TERMS - 2) * (_TERMS - 1) // 2
_RIGHT = _PRODUCTS
_SQUARE = _RIGHT + _TERMS
_COUNT, _U, _V, _INVERSE, _LIGHT, _SLOPE, _SLOPES, _TEXTURE, _TEXTURES = (_SQUARE + 1 + k for k in range(9))
_COLUMNS = _TEXTURES + 1
LEAST_LEFT = 0.3
"""Least share of the drift's terms that is left in C, whatever the second harmonic takes of them."""
MIN_PIXELS = 40
"""Fewer in a cell tell nothing."""


@dataclass(frozen=True, slots=True)
class DriftMap:
    """One camera's cells; arrays (rows, columns) float64 of the pattern's cells, NaN where there are too few pixels."""

    drift_px: NDArray[np.float64]
    """Drift of the fringes ε, pattern px per frame; positive: a pixel's coordinate grows."""
    early_px: NDArray[np.float64]
    """The same from the first sine image to the third."""
    late_px: NDArray[np.float64]
    """The same from the second to the fourth: of a steady movement, no other."""
    sd_px: NDArray[np.float64]
    """Standard deviation of it from what the fit leaves."""
    u_px: NDArray[np.float64]
    """Mean place in the image."""
    v_px: NDArray[np.float64]
    slope_per_px: NDArray[np.float64]
    """Pattern px per image px to the right."""
    noise_rad2: NDArray[np.float64]
    """Variance of the phase from the cameras' noise."""
    texture_per_px2: NDArray[np.float64]
    """Mean square of how much the light changes per pattern px across the fringes, in modulations."""
    uneven_rad2: NDArray[np.float64]
    """Mean square difference, from one pixel to that below, of the phase error that moving albedo makes."""
    second2: NDArray[np.float64]
    """Square of the second harmonic's share of the first, of the projector's light as it was recorded."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _second(cosine: float, sine: float, modulation: float) -> tuple[float, float]:
    """Return cos 2φ and sin 2φ of a pixel with B cos φ, B sin φ and B."""
    squared = modulation * modulation
    return (cosine * cosine - sine * sine) / squared, 2.0 * cosine * sine / squared


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _accumulate(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    stride: int,
    cell_px: float,
    dark_dn2: float,
    per_dn: float,
    sums: NDArray[np.float64],
) -> None:
    """Add every ``stride``-th row and column of images and maps (h, w) to ``sums`` (rows, columns, _COLUMNS)."""
    height, width = p_px.shape
    for v in range(stride // 2, height, stride):
        for u in range(stride // 2 + 1, width - 1, stride):
            p, q = p_px[v, u], q_px[v, u]
            if not (p >= 0.0 and q >= 0.0):
                continue
            row, column = int(q / cell_px), int(p / cell_px)
            if row >= sums.shape[0] or column >= sums.shape[1]:
                continue
            a, b, c, d = np.float64(i0[v, u]), np.float64(i1[v, u]), np.float64(i2[v, u]), np.float64(i3[v, u])
            # Four steps of 90°: I₀ − I₂ = 2 B cos φ, I₃ − I₁ = 2 B sin φ.
            cosine, sine = 0.5 * (a - c), 0.5 * (d - b)
            modulation = np.sqrt(cosine * cosine + sine * sine)
            if modulation < 2.0:
                continue
            # The combination that holds no phase, and the terms by which it is explained. With z = e^{2iφ}, z³ is the sixth harmonic.
            left_over = a - b + c - d
            second_cosine, second_sine = _second(cosine, sine, modulation)
            x = (
                modulation,
                cosine,
                sine,
                modulation * second_cosine,
                modulation * second_sine,
                0.25 * (a + b + c + d),
            )
            sixth_cosine = (
                modulation * second_cosine * (second_cosine * second_cosine - 3.0 * second_sine * second_sine)
            )
            sixth_sine = modulation * second_sine * (3.0 * second_cosine * second_cosine - second_sine * second_sine)
            # Normal equations of the cell, x xᵀ row by row up to the diagonal: the last two rows by themselves, for
            # loops as short as this are unrolled.
            s = sums[row, column]
            k = 0
            for i in range(_TERMS - 2):
                for j in range(i + 1):
                    s[k] += x[i] * x[j]
                    k += 1
                s[_RIGHT + i] += x[i] * left_over
            for j in range(_TERMS - 2):
                s[_SIXTH + j] += sixth_cosine * x[j]
                s[_SIXTH + _TERMS - 1 + j] += sixth_sine * x[j]
            s[_SIXTH + _TERMS - 2] += sixth_cosine * sixth_cosine
            s[_PRODUCTS - 2] += sixth_sine * sixth_cosine
            s[_PRODUCTS - 1] += sixth_sine * sixth_sine
            s[_RIGHT + _TERMS - 2] += sixth_cosine * left_over
            s[_RIGHT + _TERMS - 1] += sixth_sine * left_over
            s[_SQUARE] += left_over * left_over
            # Means over the cell: where it lies, 1/B² and light for the noise of its phase.
            s[_COUNT] += 1.0
            s[_U] += u
            s[_V] += v
            s[_INVERSE] += 1.0 / (modulation * modulation)
            s[_LIGHT] += 0.25 * (a + b + c + d)
            # The coordinate's slope, where both neighbours have one (NaN differs from itself), and with it the gradient
            # of the light.
            before, after = p_px[v, u - 1], p_px[v, u + 1]
            if before == before and after == after:
                slope = np.float64(0.5) * (after - before)
                s[_SLOPE] += slope
                s[_SLOPES] += 1.0
                light_before = np.float64(i0[v, u - 1]) + i1[v, u - 1] + i2[v, u - 1] + i3[v, u - 1]
                light_after = np.float64(i0[v, u + 1]) + i1[v, u + 1] + i2[v, u + 1] + i3[v, u + 1]
                if abs(slope) > 0.1:
                    gradient = 0.125 * (light_after - light_before) / slope
                    # Noise has a gradient, too: of eight grey values.
                    own = 0.125 * (dark_dn2 + per_dn * 0.25 * (a + b + c + d)) / (slope * slope)
                    # Not the mean of ratios: where next to nothing is illuminated, they are large and mean little.
                    s[_TEXTURE] += gradient * gradient - own
                    s[_TEXTURES] += modulation * modulation


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _left_over_at(a: float, b: float, c: float, d: float, fit: NDArray[np.float64]) -> tuple[float, float]:
    """Return what ``fit`` (_TERMS,) leaves of C at a pixel with these four values, and its modulation squared."""
    cosine, sine = 0.5 * (a - c), 0.5 * (d - b)
    squared = cosine * cosine + sine * sine
    modulation = np.sqrt(max(squared, 1.0))
    second_cosine, second_sine = _second(cosine, sine, modulation)
    expected = (
        fit[0] * modulation
        + fit[1] * cosine
        + fit[2] * sine
        + modulation * (fit[3] * second_cosine + fit[4] * second_sine)
        + fit[5] * 0.25 * (a + b + c + d)
        + fit[6] * modulation * second_cosine * (second_cosine * second_cosine - 3.0 * second_sine * second_sine)
        + fit[7] * modulation * second_sine * (3.0 * second_cosine * second_cosine - second_sine * second_sine)
    )
    return a - b + c - d - expected, squared


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _left_over(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    stride: int,
    cell_px: float,
    dark_dn2: float,
    per_dn: float,
    fit: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    """Write into ``sums`` (rows, columns) how much what C leaves beside ``fit`` (rows, columns, _TERMS) differs from
    one pixel to that below, without the cameras' noise, as mean square over that of twice the modulation.

    Down an x-fringe the phase hardly changes: what the light's own steps leave of the fit, which follows the phase, is none of it.
    """
    height, width = p_px.shape
    count = np.zeros(sums.shape)
    for v in range(stride // 2, height - 1, stride):
        for u in range(stride // 2 + 1, width - 1, stride):
            # The pixel and the one below it must both have a coordinate; the first one's says which cell they count in.
            p, q = p_px[v, u], q_px[v, u]
            if not (p >= 0.0 and q >= 0.0 and p_px[v + 1, u] >= 0.0):
                continue
            row, column = int(q / cell_px), int(p / cell_px)
            if row >= sums.shape[0] or column >= sums.shape[1]:
                continue
            # C − fit here and at the pixel below: what differs is no drift, which neighbours share.
            f = fit[row, column]
            a, b, c, d = np.float64(i0[v, u]), np.float64(i1[v, u]), np.float64(i2[v, u]), np.float64(i3[v, u])
            here, squared = _left_over_at(a, b, c, d, f)
            # Mean light of both pixels' four images, for the noise.
            light = 0.25 * (a + b + c + d)
            a, b, c, d = (
                np.float64(i0[v + 1, u]), np.float64(i1[v + 1, u]), np.float64(i2[v + 1, u]), np.float64(i3[v + 1, u])
            )  # fmt: skip
            beside, _ = _left_over_at(a, b, c, d, f)
            light += 0.25 * (a + b + c + d)
            # Noise of two pixels with four images each, 4 σ² at either's light, is taken off; 4 B² makes it a phase, squared.
            apart = beside - here
            sums[row, column] += apart * apart - 4.0 * (2.0 * dark_dn2 + per_dn * light)
            count[row, column] += 4.0 * squared
    # Σ difference² / Σ 4 B²; a cell without a pair of pixels knows nothing.
    for row in range(sums.shape[0]):
        for column in range(sums.shape[1]):
            sums[row, column] = sums[row, column] / count[row, column] if count[row, column] > 0.0 else np.nan


def drift_map(
    frames: NDArray[np.uint8],
    decoded: CameraDecoder,
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
) -> DriftMap:
    """Measure the drift in one camera's frames (n, h, w) uint8, by the sine images across which depth moves the
    pattern.

    ``variance_dn2``: of the cameras' noise as (dark, per grey value), see ``CameraNoise``.
    """
    i0, i1, i2, i3 = (frames[k] for k in sequence.axis(Direction.X).sine)
    height_px, width_px = decoded.p_px.shape
    stride = max(1, round((height_px * width_px / SAMPLES) ** 0.5))
    shape = (-(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX))
    sums = np.zeros((*shape, _COLUMNS))
    _accumulate(i0, i1, i2, i3, decoded.p_px, decoded.q_px, stride, float(CELL_PX), *variance_dn2, sums)
    fit, solved = _solve(sums, sequence.period_px / (2.0 * np.pi), variance_dn2)
    uneven = np.zeros(shape)
    _left_over(i0, i1, i2, i3, decoded.p_px, decoded.q_px, stride, float(CELL_PX), *variance_dn2, fit, uneven)
    return replace(solved, uneven_rad2=np.where(np.isfinite(solved.drift_px), uneven, np.nan))


def _solve(
    sums: NDArray[np.float64], px_per_rad: float, variance_dn2: tuple[float, float]
) -> tuple[NDArray[np.float64], DriftMap]:
    count = sums[..., _COUNT]
    enough = count >= MIN_PIXELS
    normal = np.empty((*count.shape, _TERMS, _TERMS))
    lower = np.tril_indices(_TERMS)
    # The full symmetric matrix from its lower triangle.
    normal[..., lower[0], lower[1]] = sums[..., :_PRODUCTS]
    normal[..., lower[1], lower[0]] = sums[..., :_PRODUCTS]
    # A little of the trace keeps cells with few fringes solvable; it is far below what any cell can tell.
    trace = np.trace(normal, axis1=-2, axis2=-1)
    normal += (1e-6 * np.maximum(trace, 1.0))[..., None, None] * np.eye(_TERMS)
    inverse = np.linalg.inv(normal)
    right = sums[..., _RIGHT : _RIGHT + _TERMS]
    fit = np.einsum("...ij,...j->...i", inverse, right)
    # Residual variance of the fit: (Σ C² − fit · right) / degrees of freedom.
    rest = np.maximum(sums[..., _SQUARE] - np.sum(fit * right, -1), 0.0) / np.maximum(count - _TERMS, 1.0)
    # C = 2 ε B (sin φ − cos φ): the coefficients of B sin φ and B cos φ are 2 ε and −2 ε; ε is a quarter of their difference.
    tells = np.array([0.0, -0.25, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0])
    # A second harmonic κ puts 4 κ cos 2φ into C, and a drift bends φ itself, by 2 ε κ sin 2φ (cos φ − sin φ): of the
    # drift's own terms, 4 κ² are then missing from C.
    second2 = (fit[..., 3] ** 2 + fit[..., 4] ** 2) / 16.0
    px = px_per_rad / np.maximum(1.0 - 4.0 * second2, LEAST_LEFT)
    variance = rest * np.einsum("i,...ij,j->...", tells, inverse, tells)

    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(enough[..., None], sums / count[..., None], np.nan)
        dark, per_dn = variance_dn2
        noise = dark + per_dn * mean[..., _LIGHT]
        return fit, DriftMap(
            np.where(enough, px * (fit @ tells), np.nan),
            np.where(enough, px * 0.5 * fit[..., 2], np.nan),
            np.where(enough, px * -0.5 * fit[..., 1], np.nan),
            np.where(enough, px * np.sqrt(variance), np.nan),
            mean[..., _U],
            mean[..., _V],
            np.where(enough, sums[..., _SLOPE] / sums[..., _SLOPES], np.nan),
            0.5 * noise * mean[..., _INVERSE],
            np.where(enough, np.maximum(sums[..., _TEXTURE] / sums[..., _TEXTURES], 0.0), np.nan),
            np.full(count.shape, np.nan),
            np.where(enough, second2, np.nan),
        )
