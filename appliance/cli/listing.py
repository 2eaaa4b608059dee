"""Values printed for people: rounded to what they mean, one per line. ``--json`` prints them as they are."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from appliance.cli.output import say

DIGITS = 4
"""Significant digits of a measured value: a noise of 0.02489 mm is known to two, a distance of 500.13 mm to four."""
_MORE = {"index": 6, "baseline": 6, "principal": 6, "latitude": 6}
"""Significant digits, by a word of the name, of values whose fifth and sixth digit mean something."""
_WHOLE_FROM = 1000.0
HASH_DIGITS = 12
_HASH = re.compile(r"[0-9a-f]{64}")


def shown(key: str, value: object) -> str:
    """Return a value as people read it: ``-`` for what is not known, ``none`` for an empty list, 12 digits of a
    checksum."""
    match value:
        case None | "":
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return number(key, value)
        case str():
            return value[:HASH_DIGITS] if _HASH.fullmatch(value) else value
        case Mapping():
            return ", ".join(f"{name} {shown(str(name), one)}" for name, one in value.items()) or "none"
        case Sequence():
            return "; ".join(shown(key, one) for one in value) or "none"
        case _:
            return str(value)


def number(key: str, value: float) -> str:
    """Return a float without digits that mean nothing: whole from 1000 on, else ``DIGITS`` significant ones, percent
    with two decimals."""
    if key.endswith("_percent") and abs(value) >= 1.0:
        return f"{value:.2f}"
    digits = next((more for word, more in _MORE.items() if word in key), DIGITS)
    # `g` would write 12345 as 1.234e+04, which nobody reads as a number of µm.
    if abs(value) >= 10.0 ** (digits - 1) and abs(value) >= _WHOLE_FROM:
        return f"{value:.{max(0, digits - len(str(int(abs(value)))))}f}"
    return f"{value:.{digits}g}"


def say_report(report: Mapping[str, object]) -> None:
    """Print one line per value, the names in a column."""
    width = max(24, *(len(key) for key in report))
    for key, value in report.items():
        say(f"{key:<{width}} {shown(key, value)}")
