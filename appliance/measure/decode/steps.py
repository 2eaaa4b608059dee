"""Owns the phase of any number of steps as a kernel; that of four steps of 90°, our own sequence, has one of its own (``phase``).

Both turn cosine and sine into a phase by the same function, and C = (I0 − I2) / 2, S = (I3 − I1) / 2 of four steps of 90° are exact in
float32: the same four images give the same phase, byte for byte.

Symbols: image k shows I_k = A + B cos(φ + δ_k) = A + C cos δ_k − S sin δ_k; A, C and S are weights times the images.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.phase import turns_of

_ZERO = np.float32(0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def fit_steps(
    images: NDArray[Any],
    weights: NDArray[np.float32],
    columns: NDArray[np.float32],
    white: np.float32,
    found: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    saturated: NDArray[np.bool_],
) -> None:
    """Fit sines to ``images`` (n, h, w), of any type of numbers, by ``weights`` (3, n), which make A, C and S; ``columns`` (2, n) are cos δ_k and sin δ_k.

    Writes phase in turns, modulation B, offset A and the root mean square that is left into ``found``, four (h, w), and whether an
    image reaches ``white`` into ``saturated`` (h, w). What is left of three steps is 0.
    """
    count, height, width = images.shape
    mean, cosine = np.empty(width, np.float32), np.empty(width, np.float32)
    sine, left = np.empty(width, np.float32), np.empty(width, np.float32)
    phase, modulation, offset, misfit = found
    freedom = np.float32(max(count - 3, 1))
    for y in range(height):
        mean[:], cosine[:], sine[:], left[:] = _ZERO, _ZERO, _ZERO, _ZERO
        saturated[y] = False
        # Image by image along the row: sums of weights times images.
        for k in range(count):
            a, c, s = weights[0, k], weights[1, k], weights[2, k]
            for x in range(width):
                value = np.float32(images[k, y, x])
                mean[x] += a * value
                cosine[x] += c * value
                sine[x] += s * value
                saturated[y, x] |= value >= white
        # What is left: I_k − A − C cos δ_k + S sin δ_k.
        for k in range(count):
            along, across = columns[0, k], columns[1, k]
            for x in range(width):
                off = np.float32(images[k, y, x]) - mean[x] - along * cosine[x] + across * sine[x]
                left[x] += off * off
        for x in range(width):
            phase[y, x] = turns_of(cosine[x], sine[x])
            modulation[y, x] = np.sqrt(cosine[x] * cosine[x] + sine[x] * sine[x])
            offset[y, x] = mean[x]
            misfit[y, x] = np.sqrt(left[x] / freedom)
