"""Owns how certain a share is that was counted in so many trials, and how every rate of a measurement is said."""

from __future__ import annotations

import math

from scipy.stats import beta

from bench.result import Measured


def limits(count: int, of: int, outside: float = 0.05) -> tuple[float, float]:
    """Exact confidence limits of a share, 0..1 (Clopper, Pearson, Biometrika 26 (1934) 404).

    Not more than ``outside`` of such intervals leave the true share out. Raises ValueError unless 0 ≤ count ≤ of, of > 0.
    """
    if not 0 <= count <= of or of == 0:
        raise ValueError(f"{count} of {of}: allowed are 0 to as many as there were trials, and at least one trial")
    low = 0.0 if count == 0 else float(beta.ppf(outside / 2.0, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(1.0 - outside / 2.0, count + 1, of - count))
    return low, high


def counted(count: int, of: int) -> str:
    """As words, in percent: ``3 of 500 = 0.6 % (0.1 to 1.7)``."""
    if of == 0:
        return "none to count"
    return f"{count} of {of} = {percent(count / of)} % ({_between(count, of)})"


def out_of(of: int, count: int) -> str:
    """As the unit of a count, with the limits of its share in percent: ``of 500 (0.1 to 1.7 %)``."""
    if of == 0:
        return "of 0"
    return f"of {of} ({_between(count, of)} %)"


def percent(share: float) -> str:
    """As a number of percent with one decimal, or with as many as tell it from none and from all: 0.9996 is 99.96, 1 is 100.0."""
    value = 100.0 * share
    for digits in range(1, 10):
        text = f"{value:.{digits}f}"
        if float(text) not in (0.0, 100.0) or value in (0.0, 100.0):
            return text
    return f"{value!r}"


def tally(
    name: str,
    count: int,
    of: int,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
    key: str | None = None,
) -> Measured:
    """Return a count with the limits of its share in its unit; bounds are of the count, and judge only where there was anything to count."""
    bounds = (at_most, at_least) if of else (None, None)
    return Measured(name, float(count), out_of(of, count), *bounds, key, share=(count, of))


def rate(
    name: str,
    count: int,
    of: int,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
    key: str | None = None,
) -> Measured:
    """Return a share in percent with its count and limits in its unit: 60 ``% (3 of 5; 14.7 to 94.7)``.

    Bounds are in percent. Where there was nothing to count there is no value, and no bound: nothing was missed.
    """
    if of == 0:
        return Measured(name, math.nan, "", key=key, why="none to count", share=(0, 0))
    unit = f"% ({count} of {of}; {_between(count, of)})"
    return Measured(name, 100.0 * count / of, unit, at_most, at_least, key, share=(count, of))


def _between(count: int, of: int) -> str:
    low, high = limits(count, of)
    return f"{percent(low)} to {percent(high)}"
