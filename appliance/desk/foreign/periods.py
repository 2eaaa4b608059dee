"""Owns which periods several sets of fringes have, by their phases alone: how fast each runs, and on which whole numbers all agree.

From a pixel to the next, phase k runs r_k times as fast as that of the finest fringes: r_k is the ratio of their numbers. Of all whole
numbers in such ratios those are right with which the phases agree on one fringe; that they do so by chance is the less likely
the fewer fringes there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.decode import by_periods, chance_misfit
from appliance.desk.foreign.description import AxisConvention
from appliance.desk.foreign.phase import fit_sine

MOST_FRINGES = 200
RATIO_SLACK = 0.03
"""Allowed relative error of a ratio of speeds."""
LEAST_RUN_TURNS = 0.004
"""Slowest phase of the finest fringes, from a pixel to the next, that a ratio is taken of."""
LAGS_PX = (1, 4, 16)
"""Distances over which phases are compared; the longest over which the finest fringes run less than half a turn counts."""
PIXELS = 1000
STRONG = 0.5


def periods_by_phases(
    images: Sequence[NDArray[Any]], steps_deg: Sequence[tuple[float, ...]], name: str, size_px: float
) -> tuple[float, ...]:
    """Return the periods in px of the direction ``name``, along which the pattern is ``size_px`` long.

    ``images`` (n, h, w) are those of each period in the order of its steps.
    """
    if len(images) < 2:
        return (size_px,) * len(images)
    fits = [fit_sine(list(one), steps, np.inf) for one, steps in zip(images, steps_deg, strict=True)]
    strong = np.logical_and.reduce([fit.modulation > STRONG * np.quantile(fit.modulation, 0.9) for fit in fits])
    finest = int(np.argmax([_speed(fit.turns, strong, name) for fit in fits]))
    # A lag of several pixels tells slow phases better, and wraps fast ones.
    ratios = np.array([_ratio(fit.turns, fits[finest].turns, strong, name) for fit in fits])
    ratios[finest] = 1.0
    places = np.flatnonzero(strong)
    places = places[:: max(1, len(places) // PIXELS)]
    few = [fit.turns.ravel()[places] for fit in fits]
    best, best_share = tuple(float(size_px * (k + 1) / len(fits)) for k in range(len(fits)))[::-1], np.inf
    for count in range(len(fits), MOST_FRINGES + 1):
        wanted = count * ratios
        fringes = np.rint(wanted)
        if fringes.min() < 1.0 or len(set(fringes)) < len(fits) or np.abs(fringes / wanted - 1.0).max() >= RATIO_SLACK:
            continue  # no whole numbers, all different, are near
        axis = AxisConvention(name, size_px, tuple(float(size_px / one) for one in fringes), tuple(steps_deg))
        share = float(np.median(by_periods(few, axis)[1])) / chance_misfit(axis)
        if share < 0.9 * best_share:
            best, best_share = axis.periods_px, share
    return best


def _differences(turns: NDArray[Any], strong: NDArray[np.bool_], name: str, lag: int) -> NDArray[np.float64]:
    """Return by how much phases differ over ``lag`` px along the direction, wrapped, NaN where they are weak."""
    values, known = (turns, strong) if name == "x" else (turns.T, strong.T)
    step = (values[:, lag:] - values[:, :-lag]).astype(np.float64)
    step -= np.rint(step)
    return np.where(known[:, lag:] & known[:, :-lag], step, np.nan)


def _speed(turns: NDArray[Any], strong: NDArray[np.bool_], name: str) -> float:
    step = np.abs(_differences(turns, strong, name, LAGS_PX[0]))
    known = step[np.isfinite(step)]
    return float(np.median(known)) if known.size else 0.0


def _ratio(slow: NDArray[Any], fast: NDArray[Any], strong: NDArray[np.bool_], name: str) -> float:
    """Return how fast one phase runs over how fast another does: the longest lag whose whole turns the shorter one tells."""
    ratio, near = 1.0, None
    for lag in LAGS_PX:
        of_slow, of_fast = (_differences(one, strong, name, lag) for one in (slow, fast))
        if near is not None:
            # What a quarter of the lag told says how many whole turns were wrapped away.
            length = LAGS_PX[1] // LAGS_PX[0]
            for step, before in ((of_slow, near[0]), (of_fast, near[1])):
                expected = length * before[:, : step.shape[1]]
                step += np.rint(expected - step)
        near = of_slow, of_fast
        usable = np.isfinite(of_slow) & np.isfinite(of_fast) & (np.abs(of_fast) > LEAST_RUN_TURNS * lag)
        if np.count_nonzero(usable) > 100:
            ratio = float(np.median(of_slow[usable] / of_fast[usable]))
    return max(ratio, 1e-4)
