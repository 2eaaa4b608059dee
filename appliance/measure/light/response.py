"""The projector's response: light as a function of the code, and the codes for a sine of light.

Over the codes of sine fringes, 8 … 247, the response is a sum of Chebyshev polynomials T_k of
x = (code − 127.5)/119.5. With codes drawn as 127.5 + 119.5 cos φ, T_k(x) = cos kφ: the coefficients *are* the harmonics
of the fringe's light. Even harmonics cancel in four steps of 90°; odd ones make a phase error (``phase_error_rad``).
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from appliance.measure.light.sine import AMPLITUDE_CODE, MEAN_CODE, fringe

HIGHEST_ORDER = 24
_FINE = 4096


@dataclass(frozen=True, slots=True)
class Response:
    """One projector's response. Raises ValueError if light does not grow with the code."""

    harmonics: tuple[float, ...]
    """Coefficients of T_0, T_1, … in any unit of light."""

    def __post_init__(self) -> None:
        if not 2 <= len(self.harmonics) <= HIGHEST_ORDER + 1 or not np.isfinite(self.harmonics).all():
            raise ValueError(
                f"a response of {len(self.harmonics)} harmonics, {self.harmonics}; allowed are 2 to "
                f"{HIGHEST_ORDER + 1} finite numbers; measure it again"
            )
        if np.diff(self.light(np.linspace(*CODES, _FINE))).min() <= 0.0:
            raise ValueError("the response's light does not grow with the code; measure it again")

    def light(self, codes: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the light of codes 8 … 247, any shape, in the unit of the harmonics."""
        return np.asarray(chebyshev.chebval((codes - MEAN_CODE) / AMPLITUDE_CODE, self.harmonics))

    def sine_codes(self, size_px: int, period_px: int, step: int) -> NDArray[np.uint8]:
        """Return the codes of step ``step`` whose light is a sine: shape (size_px,) uint8.

        ``patterns.sine.sine_codes`` makes a sine of the codes instead; the ends are the same.
        """
        # Invert the response by interpolation.
        fine = np.linspace(*CODES, _FINE)
        light = self.light(fine)
        target = 0.5 * (light[0] + light[-1]) + 0.5 * (light[-1] - light[0]) * fringe(size_px, period_px, step)
        return np.asarray(np.rint(np.interp(target, light, fine)), np.uint8)

    def drawn(self, size_px: int, period_px: int, step: int) -> NDArray[np.float64]:
        """Return x of the codes of ``sine_codes``: shape (size_px,), −1 … 1."""
        return np.asarray((self.sine_codes(size_px, period_px, step) - MEAN_CODE) / AMPLITUDE_CODE)

    @property
    def hash(self) -> str:
        """SHA-256 of the content, hexadecimal."""
        return hashlib.sha256(json.dumps(self.harmonics, separators=(",", ":")).encode()).hexdigest()


CODES = (MEAN_CODE - AMPLITUDE_CODE, MEAN_CODE + AMPLITUDE_CODE)
"""First and last code of sine fringes."""


def phase_error_rad(harmonics: NDArray[np.floating] | tuple[float, ...]) -> float:
    """Return the largest error of a four-step phase on fringes with these harmonics, in radians.

    The phasor (I0 − I2) + i(I3 − I1) is 2 e^{iφ} (b₁ + b₃ e^{−4iφ} + b₅ e^{4iφ} + b₇ e^{−8iφ} + …): the phase error is
    its argument less φ, which repeats four times a period.
    """
    b = np.asarray(harmonics, np.float64)
    phi = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    orders = np.arange(1, len(b), 2)
    # Order n = 4m + 1 rotates with φ as n, order 4m + 3 against it.
    turns = np.where(orders % 4 == 1, orders, -orders)
    phasor = np.exp(1j * np.outer(phi, turns - 1)) @ b[orders]
    # A negative fundamental is a fringe shifted by half a period, which is no phase error.
    return float(np.abs(np.angle(phasor * np.sign(b[1]))).max())
