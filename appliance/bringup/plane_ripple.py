"""Owns how much a decoded coordinate of a plane ripples with its fringes, at one, two and four cycles a period.

A plane's coordinate is a smooth function of the pixel; fringes are not smooth. So what is left of a polynomial and goes with
the fringe's phase θ = 2π (p + ½)/P is the fringes' own error:

    k = 1   light that is added to some of the four images: ambient light that flickers, images of a lamp that dims
    k = 2   images of unequal brightness or phase: a picture that is seen in the next one's exposure, unequal exposures
    k = 4   a light that is no sine, by its third and fifth harmonic: a curved response, clipping, cut bit planes

(Zuo et al., Opt. Lasers Eng. 109, 2018, section 3: errors of four steps.) Symbols: r are the residuals, c_k, s_k the regressors cos kθ and sin kθ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CYCLES = (1, 2, 4)
DEGREE = 5
"""Degree of the polynomial in column and row: a plane through a lens and a window is smooth to some thousandths of a px with it."""
MOST_PIXELS = 40_000
FEWEST_PIXELS = 400
ROUNDS, BELONGS = 4, 5.0
"""Rounds in which pixels are left out that lie beyond so many robust standard deviations: edges, dust, what is no plane."""
FURTHEST = 1.0 / 16.0
"""Largest residual that a ripple makes, in periods: beyond is another surface, or a pixel with a wrong period."""


@dataclass(frozen=True, slots=True)
class CoordinateRipple:
    """Ripple of one coordinate of one camera."""

    amplitude_px: tuple[float, float, float]
    """Amplitudes at one, two and four cycles a period, in pattern px."""
    noise_px: float
    """Standard deviation of a coordinate without them."""
    uncertainty_px: float
    """Standard deviation of an amplitude."""
    pixels: int
    """Pixels that were asked."""


@dataclass(frozen=True, slots=True, eq=False)
class SmoothPlane:
    """The smooth coordinate of a plane, at the pixels that lie on it."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    smooth_px: NDArray[np.float64]
    """(n,) coordinate that the polynomial has there."""
    residual_px: NDArray[np.float64]
    """(n,) measured minus smooth."""


def smooth_plane(coordinate_px: NDArray[np.float32], period_px: int) -> SmoothPlane | None:
    """Fit a coordinate (h, w), NaN where there is none, by a polynomial; ``None`` where too few pixels lie on anything smooth."""
    rows, columns = np.nonzero(np.isfinite(coordinate_px))
    # Every so many: normal equations of some ten thousand pixels leave nothing to be wished for.
    step = max(1, len(rows) // MOST_PIXELS)
    rows, columns = rows[::step], columns[::step]
    if len(rows) < FEWEST_PIXELS:
        return None
    # From -1 to 1: powers of hundreds of pixels would leave the fit no digits.
    height, width = coordinate_px.shape
    x, y = 2.0 * columns / width - 1.0, 2.0 * rows / height - 1.0
    terms = np.column_stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
    wanted = coordinate_px[rows, columns].astype(np.float64)
    keep = np.ones(len(rows), np.bool_)
    residual = np.zeros(len(rows))
    smooth = wanted
    for _ in range(ROUNDS):
        if keep.sum() < FEWEST_PIXELS:
            return None
        solved, *_ = np.linalg.lstsq(terms[keep], wanted[keep], rcond=None)
        smooth = terms @ solved
        residual = wanted - smooth
        # Robust: a pixel that was decoded in the wrong period is a whole one away.
        spread = 1.4826 * float(np.median(np.abs(residual[keep])))
        keep = np.abs(residual) <= min(max(BELONGS * spread, 1e-3), FURTHEST * period_px)
    if keep.sum() < FEWEST_PIXELS:
        return None
    return SmoothPlane(rows[keep], columns[keep], smooth[keep], residual[keep])


def ripple_of(plane: SmoothPlane, period_px: int) -> CoordinateRipple:
    """Return the amplitudes of what in a plane's residuals goes with its fringes: r = Σ_k (a_k c_k + b_k s_k), by least squares."""
    theta = 2.0 * np.pi * (plane.smooth_px + 0.5) / period_px
    regressors = np.column_stack([f(k * theta) for k in CYCLES for f in (np.cos, np.sin)])
    solved, *_ = np.linalg.lstsq(regressors, plane.residual_px, rcond=None)
    rest = plane.residual_px - regressors @ solved
    noise_px = float(np.sqrt((rest**2).sum() / max(1, len(rest) - regressors.shape[1])))
    # Of a cosine and a sine the length: where in the fringe a ripple begins is of no interest.
    one, two, four = (float(np.hypot(*solved[2 * k : 2 * k + 2])) for k in range(len(CYCLES)))
    # Both of a pair have the variance 2 σ²/n.
    return CoordinateRipple((one, two, four), noise_px, noise_px * (2.0 / len(rest)) ** 0.5, len(rest))
