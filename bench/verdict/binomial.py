"""Confidence limits of a counted share, and the text of a rate in a measurement."""

from __future__ import annotations

import math

from scipy.stats import beta

from bench.result import Measurement


def limits(count: int, trials: int, outside: float = 0.05) -> tuple[float, float]:
    """Return exact confidence limits of a share, 0..1 (Clopper, Pearson, Biometrika 26 (1934) 404).

    Not more than ``outside`` of such intervals exclude the true share. Raises ValueError unless 0 ≤ count ≤ trials,
    trials > 0.
    """
    if not 0 <= count <= trials or trials == 0:
        raise ValueError(f"{count} of {trials}: allowed are 0 to as many as there were trials, and at least one trial")
    low = 0.0 if count == 0 else float(beta.ppf(outside / 2.0, count, trials - count + 1))
    high = 1.0 if count == trials else float(beta.ppf(1.0 - outside / 2.0, count + 1, trials - count))
    return low, high


def count_text(count: int, trials: int) -> str:
    """Return a share as text, in percent: ``3 of 500 = 0.6 % (0.1 to 1.7)``."""
    if trials == 0:
        return "none to count"
    return f"{count} of {trials} = {percent(count / trials)} % ({_between(count, trials)})"


def out_of(trials: int, count: int) -> str:
    """Return the unit of a count, with the limits of its share in percent: ``of 500 (0.1 to 1.7 %)``."""
    if trials == 0:
        return "of 0"
    return f"of {trials} ({_between(count, trials)} %)"


def percent(share: float) -> str:
    """Return a percentage with one decimal, or with as many as distinguish it from 0 and 100: 0.9996 is 99.96, 1 is
    100.0."""
    value = 100.0 * share
    for digits in range(1, 10):
        text = f"{value:.{digits}f}"
        if float(text) not in (0.0, 100.0) or value in (0.0, 100.0):
            return text
    return f"{value!r}"


def tally(
    name: str,
    count: int,
    trials: int,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
    key: str | None = None,
) -> Measurement:
    """Return a count with the limits of its share in its unit.

    Its bounds are of the count, and hold only if there were trials.
    """
    bounds = (at_most, at_least) if trials else (None, None)
    return Measurement(name, float(count), out_of(trials, count), *bounds, key, share=(count, trials))


def rate(
    name: str,
    count: int,
    trials: int,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
    key: str | None = None,
) -> Measurement:
    """Return a share in percent with its count and limits in its unit: 60 ``% (3 of 5; 14.7 to 94.7)``.

    Bounds are in percent. Without trials there is neither a value nor a bound.
    """
    if trials == 0:
        return Measurement(name, math.nan, "", key=key, why="none to count", share=(0, 0))
    unit = f"% ({count} of {trials}; {_between(count, trials)})"
    return Measurement(name, 100.0 * count / trials, unit, at_most, at_least, key, share=(count, trials))


def _between(count: int, trials: int) -> str:
    low, high = limits(count, trials)
    return f"{percent(low)} to {percent(high)}"
