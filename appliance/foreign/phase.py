"""Owns the phase of any number of steps: least squares over sine images whose steps are known.

Image k shows I_k = A + B cos(φ + δ_k) = A + C cos δ_k − S sin δ_k with C = B cos φ and S = B sin φ: linear in A, C and S, so that
their best values are fixed weights times the images (the pseudo-inverse of the columns 1, cos δ_k, −sin δ_k). Four steps of 90° give
C = (I0 − I2) / 2 and S = (I3 − I1) / 2, which is what the instrument's own kernels compute of its own sequences
(``appliance/reconstruct/decode/phase.py``; ``docs/adr/0057-foreign-frames-are-decoded-beside-our-own.md``).
Source: Greivenkamp, Opt. Eng. 23 (1984) 350.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.foreign.problem import ForeignError

Floats = NDArray[np.float32]

WORST_CONDITION = 30.0
"""Largest ratio of the singular values of the three columns: steps that lie too near to each other tell no phase."""
ROWS_AT_ONCE = 64
"""Rows that are worked on together, so that they stay in the cache."""


@dataclass(frozen=True, slots=True, eq=False)
class SineFit:
    """The best sine through the images of one period, (h, w) float32 each; grey values are the images' own."""

    turns: Floats
    """Phase φ in turns, −½ … ½."""
    modulation: Floats
    """Half the swing, B."""
    offset: Floats
    """Mean A."""
    misfit: Floats | None
    """Root mean square of what is left, with the degrees of freedom that are left; ``None`` for three steps, which always fit."""
    saturated: NDArray[np.bool_]
    """True where an image is at full scale."""


def step_weights(steps_deg: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the (3, n) weights that make A, C and S of n images. Raises ForeignError for steps that cannot tell a phase."""
    angles = np.deg2rad(np.asarray(steps_deg, np.float64))
    columns = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
    singular = np.linalg.svd(columns, compute_uv=False)
    if len(steps_deg) < 3 or singular[-1] * WORST_CONDITION < singular[0]:
        said = ", ".join(f"{step:g}" for step in steps_deg)
        raise ForeignError(
            f"steps_deg {said} lie too near to each other to tell a phase; correct them, three must differ by far"
        )
    return np.asarray(np.linalg.pinv(columns))


def fit_sine(images: list[NDArray[Any]], steps_deg: tuple[float, ...], white: float) -> SineFit:
    """Fit the ``images`` (h, w) of the steps ``steps_deg``, whose saturated grey value is ``white``. Raises ForeignError."""
    weights = step_weights(steps_deg).astype(np.float32)
    count, shape = len(images), images[0].shape
    angles = np.deg2rad(np.asarray(steps_deg, np.float64))
    cosines, sines = np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
    turns, modulation, offset = (np.empty(shape, np.float32) for _ in range(3))
    misfit = np.empty(shape, np.float32) if count > 3 else None
    saturated = np.empty(shape, np.bool_)
    for begin in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        block = np.stack([image[rows] for image in images]).astype(np.float32)
        mean, cosine, sine = np.tensordot(weights, block, 1)
        turns[rows] = np.arctan2(sine, cosine) * np.float32(0.5 / np.pi)
        modulation[rows] = np.hypot(cosine, sine)
        offset[rows] = mean
        saturated[rows] = (block >= white).any(axis=0)
        if misfit is not None:
            left = block - mean - cosines[:, None, None] * cosine + sines[:, None, None] * sine
            misfit[rows] = np.sqrt(np.square(left).sum(axis=0) / np.float32(count - 3))
    return SineFit(turns, modulation, offset, misfit, saturated)
