"""Owns how much the projector's response ripples a coordinate, as a scan itself shows it.

A third harmonic in the recorded fringes bends a four-step phase four times a period. Surfaces know nothing of fringes: what
of the second differences of p along rows goes with the fringe's phase is ripple, and nothing else. Measured where it acts:
behind lens and water, in pictures as large as they are; patterns drawn for the response leave next to none.

A ripple a cos θ + b sin θ, θ = 8π (p + ½)/P, has the second difference (2 cos ω − 2)(a cos θ + b sin θ), ω its phase per
pixel: two regressors c and s, and least squares.

Symbols: y is the second difference of p at a pixel, cycle_rad = 8π/P, share = 2 cos ω − 2; cc, ss, cs, cy, sy, yy are the sums of
products of c, s and y, lost that of ω⁶/(ω⁶ + KNEE), the share that is lost between pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

SAMPLES = 2_500
"""Number of pixels that are asked: the amplitude comes out within some thousandths of a px wherever it matters."""


@dataclass(frozen=True, slots=True)
class Ripple:
    """Ripple of a pattern coordinate, at four cycles a period."""

    amplitude_px: float
    """Amplitude in pattern px; what noise alone makes of it is taken off, and 0 is left where that is all."""
    lost_px: float = 0.0
    """RMS error of a coordinate by what of the ripple is lost between pixels of the image."""
    noise_px: float = 0.0
    """RMS error of a coordinate without the ripple."""

    @property
    def counts(self) -> bool:
        """True if it makes the expected error larger by more than some percent."""
        return self.lost_px > 0.2 * self.noise_px


STILL = Ripple(0.0)
KNEE = 2500.0
"""Constant of the share t³/(t³ + KNEE) of the squared amplitude that is lost between pixels, t the square of its phase per px."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sums(
    p_px: NDArray[np.float32], illuminated: NDArray[np.int32], cycle_rad: float, stride: int, most_px: float
) -> tuple[int, float, float, float, float, float, float, float]:
    """Return the count, and sums of products of the second difference y and its regressors c and s: cc, ss, cs, cy, sy, yy;
    and of the lost share."""
    count = 0
    cc, ss, cs, cy, sy, yy, lost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    columns = p_px.shape[1]
    for row in range(stride // 2, p_px.shape[0], stride):
        p = p_px[row]
        for x in range(max(int(illuminated[row, 0]), 1), min(int(illuminated[row, 1]), columns - 1), stride):
            before, here, after = p[x - 1], p[x], p[x + 1]
            y = float(before) + float(after) - 2.0 * float(here)
            if not abs(y) < most_px:
                continue
            # Phase of the ripple per pixel, and here.
            omega, theta = 0.5 * cycle_rad * (float(after) - float(before)), cycle_rad * (float(here) + 0.5)
            share = 2.0 * math.cos(omega) - 2.0
            c, s = share * math.cos(theta), share * math.sin(theta)
            count += 1
            cc += c * c
            ss += s * s
            cs += c * s
            cy += c * y
            sy += s * y
            yy += y * y
            lost += omega**6 / (omega**6 + KNEE)
    return count, cc, ss, cs, cy, sy, yy, lost


def measure_ripple(p_px: NDArray[np.float32], illuminated_columns: NDArray[np.int32], period_px: int) -> Ripple:
    """Measure the ripple of the decoded columns ``p_px`` (h, w), NaN where there is none, whose illuminated parts are
    ``illuminated_columns`` (h, 2)."""
    stride = max(1, int((p_px.size / SAMPLES) ** 0.5))
    # Bends of noise are within this; those of edges need not be asked.
    most_px = period_px / 16.0
    count, cc, ss, cs, cy, sy, yy, lost = _sums(p_px, illuminated_columns, 8.0 * math.pi / period_px, stride, most_px)
    # Two normal equations; the amplitude less what the residuals' noise makes of it.
    det = cc * ss - cs * cs
    if count < 4 or det <= 1e-6 * cc * ss:
        return STILL
    c, s = (ss * cy - cs * sy) / det, (cc * sy - cs * cy) / det
    rest = max(yy - c * cy - s * sy, 0.0) / (count - 2)
    amplitude2 = max(c * c + s * s - rest * (cc + ss) / det, 0.0)
    return Ripple(math.sqrt(amplitude2), math.sqrt(amplitude2 * lost / count), math.sqrt(rest / 6.0))
