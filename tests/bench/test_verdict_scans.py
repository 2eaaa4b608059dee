"""Shares that are counted come with exact limits."""

from __future__ import annotations

import pytest

from bench.verdict.binomial import count_text, limits, rate, tally


def test_exact_limits_of_a_share() -> None:
    """None of 500: the rule of three, exactly. The tails of the binomial distribution: 0.025 each."""
    low, high = limits(0, 500)
    assert low == 0.0
    assert (1.0 - high) ** 500 == pytest.approx(0.025)
    assert limits(10, 10)[1] == 1.0
    assert count_text(0, 0) == "none to count"
    with pytest.raises(ValueError, match="3 of 2"):
        limits(3, 2)


def test_a_rate_says_its_count_and_its_limits_and_nothing_counted_misses_nothing() -> None:
    found = rate("found", 3, 5, at_least=97.0)
    # Clopper and Pearson of 3 of 5.
    assert (found.value, found.unit, found.is_kept) == (60.0, "% (3 of 5; 14.7 to 94.7)", False)
    assert tally("alarms", 0, 500, at_most=0.0).unit == "of 500 (0.0 to 0.7 %)"
    none = rate("found", 0, 0, at_least=97.0)
    assert none.why == "none to count"
    assert none.is_kept
    assert tally("knocks found", 0, 0, at_least=1.0).is_kept
