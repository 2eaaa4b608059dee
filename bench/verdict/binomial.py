"""Owns how certain a share is that was counted in so many trials."""

from __future__ import annotations

from scipy.stats import beta


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
    low, high = limits(count, of)
    return f"{count} of {of} = {100.0 * count / of:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"


def out_of(of: int, count: int) -> str:
    """As the unit of a count, with the limits of its share in percent: ``of 500 (0.1 to 1.7 %)``."""
    if of == 0:
        return "of 0"
    low, high = limits(count, of)
    return f"of {of} ({100.0 * low:.1f} to {100.0 * high:.1f} %)"
