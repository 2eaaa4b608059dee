"""Phase from any number of steps: least squares over sine frames whose steps are known.

Image k shows I_k = A + B cos(φ + δ_k) = A + C cos δ_k − S sin δ_k with C = B cos φ and S = B sin φ: linear in A, C and
S, so that their best values are fixed weights times the images (the pseudo-inverse of the columns 1, cos δ_k, −sin
δ_k). The kernel stands beside the instrument's own for four steps (``appliance/measure/decode/phase.py``;
``docs/foreign.md``). Source: Greivenkamp, Opt. Eng. 23 (1984) 350.

A non-linear response adds harmonics, of which N equal steps leave an error that repeats N times in a period. Phases
that are spread evenly are then denser at some places than at others: the share of phases below one is its true value
(``correct_response``). Source: Guo, He, Chen, Appl. Opt. 43 (2004) 2906.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.problem import ForeignError
from appliance.measure import fit_steps

Floats = NDArray[np.float32]

WORST_CONDITION = 30.0
"""Largest ratio of the singular values of the three columns: steps too near to each other determine no phase."""
ROWS_AT_ONCE = 64
"""Rows that are processed together, so that they stay in the cache."""
TURN = 2.0 * math.pi
BINS, MAX_SAMPLES = 1024, 1_000_000
CLEARLY = 2.0
"""A response is bent where its harmonic in the histogram of phases is so many times its neighbours, which follow from
the object."""
LEAST_LEFT = 2.0
"""Least ratio of the misfit of the steps to the phase error, in radians, of a bent response."""
REMAINING_SHARE = 0.25
"""Share of the phase error that remains after correction, since it differs between bright and dark places: measured on
rendered sets with 16 and 64 fringes."""


@dataclass(frozen=True, slots=True, eq=False)
class SineFit:
    """The best sine through the images of one period, (h, w) each; grey values are the images' own."""

    turns: Floats
    """Phase φ in turns, −½ … ½."""
    modulation: Floats
    """Half the swing, B."""
    offset: NDArray[Any]
    """Mean A."""
    misfit: NDArray[np.floating[Any]] | None
    """Root mean square residual by the degrees of freedom; ``None`` for three steps, which always fit."""
    saturated: NDArray[np.bool_]
    """True where an image is at full scale."""


def step_columns(steps_deg: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the columns (n, 3) of A, C and S: 1, cos δ_k, −sin δ_k."""
    angles = np.deg2rad(np.asarray(steps_deg, np.float64))
    return np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)


def step_weights(steps_deg: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the weights (3, n) that make A, C and S of n images.

    Raises ForeignError for steps that determine no phase.
    """
    columns = step_columns(steps_deg)
    singular = np.linalg.svd(columns, compute_uv=False)
    if len(steps_deg) < 3 or singular[-1] * WORST_CONDITION < singular[0]:
        steps_text = ", ".join(f"{step:g}" for step in steps_deg)
        raise ForeignError(
            f"steps_deg {steps_text} lie too close together for a phase; correct them, so that three differ clearly"
        )
    return np.asarray(np.linalg.pinv(columns))


def fit_sine(images: Sequence[NDArray[Any]] | NDArray[Any], steps_deg: tuple[float, ...], white: float) -> SineFit:
    """Fit the ``images`` (h, w) of the steps ``steps_deg``, whose saturated grey value is ``white``.

    Raises ForeignError.
    """
    # Rounded to twelve digits, the weights of four steps of 90° are exactly 0 and ½.
    weights = np.round(step_weights(steps_deg), 12).astype(np.float32)
    columns = (step_columns(steps_deg)[:, 1:] * [1.0, -1.0]).T.astype(np.float32, order="C")
    stack = np.ascontiguousarray(images)
    shape = stack.shape[1:]
    turns, modulation, offset, misfit = (np.empty(shape, np.float32) for _ in range(4))
    saturated = np.empty(shape, np.bool_)
    fit_steps(stack, weights, columns, np.float32(white), (turns, modulation, offset, misfit), saturated)
    return SineFit(turns, modulation, offset, misfit if len(stack) > 3 else None, saturated)


def some_pixels(maps: NDArray[Any]) -> NDArray[Any]:
    """Return the values (…, n) of maps (…, h, w) at some pixels, equally far apart."""
    flat = maps.reshape(*maps.shape[:-2], -1)
    return flat[..., :: 1 + flat.shape[-1] // MAX_SAMPLES].copy()


def misfit_samples(fit: SineFit) -> tuple[Floats, Floats] | None:
    """Return misfit and modulation of some pixels; ``None`` if the steps always fit."""
    return None if fit.misfit is None else (some_pixels(fit.misfit), some_pixels(fit.modulation))


def misfit_share(samples: tuple[Floats, Floats] | None, usable: NDArray[np.bool_]) -> float | None:
    """Return the misfit of the steps over the modulation.

    ``None`` if they always fit, or no pixel is usable.
    """
    usable_samples = some_pixels(usable)
    if samples is None or not usable_samples.any():
        return None
    return float(np.median(samples[0][usable_samples] / samples[1][usable_samples]))


def correct_response(turns: Floats, usable: NDArray[np.bool_], steps: int, share: float | None) -> float:
    """Subtract the ripple of a non-linear response from the phases ``turns`` in place, if it is clear.

    Returns the standard deviation of the remaining ripple, in turns; ``share`` is the misfit of the steps.
    """
    samples = turns.ravel()[np.flatnonzero(usable)[:: 1 + usable.size // MAX_SAMPLES]]
    counts = np.bincount(np.clip((samples + 0.5) * BINS, 0, BINS - 1).astype(np.int32), minlength=BINS)
    middles = (np.arange(BINS) + 0.5) / BINS - 0.5
    orders = [steps - 1, steps + 1, steps, 2 * steps, 3 * steps]
    # Mean of exp(i n φ): an error ε sin(n φ) makes it ε n / 2.
    means = np.exp(1j * TURN * np.outer(orders, middles)) @ counts / max(1, counts.sum())
    neighbour_amplitude = float(np.abs(means[:2]).max())
    size = 2.0 * np.sqrt(np.maximum(np.abs(means[2:]) ** 2 - neighbour_amplitude**2, 0.0)) / orders[2:] / TURN
    bend = math.sqrt(0.5 * float(size @ size))
    max_bend = math.inf if share is None else share / LEAST_LEFT / TURN
    if bend > max_bend or abs(means[2]) < CLEARLY * neighbour_amplitude:
        return min(bend, max_bend)
    angles = TURN * np.outer(orders[2:], middles) - np.angle(means[2:])[:, None]
    table = size @ np.sin(angles)
    for begin in range(0, len(turns), ROWS_AT_ONCE):
        turns[begin : begin + ROWS_AT_ONCE] += np.interp(turns[begin : begin + ROWS_AT_ONCE], middles, table).astype(
            np.float32
        )
    return REMAINING_SHARE * bend
