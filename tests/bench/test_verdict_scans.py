"""Scans that are kept are found again, and only for what they show; shares come with exact limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.verdict.binomial import counted, limits, rate, tally
from bench.verdict.kept_scans import KeptScans, Take
from bench.verdict.motion_cases import draw_case


def test_a_kept_scan_is_not_drawn_again_and_no_other_is_taken_for_it(tmp_path: Path) -> None:
    case = draw_case(10_000_000_004, "axial", "slight", 64)
    first = KeptScans(tmp_path, 80).frames(case, Take.REST)
    kept = sorted(tmp_path.iterdir())
    assert len(kept) == 1
    # What lies there is what comes back.
    np.save(kept[0], np.zeros((2, *first["left"].shape), np.uint8))
    assert not KeptScans(tmp_path, 80).frames(case, Take.REST)["left"].any()
    other = KeptScans(tmp_path, 80).frames(replace(case, exposure_s=0.5 * case.exposure_s), Take.REST)
    assert other["left"].any()
    assert len(list(tmp_path.iterdir())) == 2


def test_exact_limits_of_a_share() -> None:
    """None of 500: the rule of three, exactly. The tails of the binomial distribution: 0.025 each."""
    low, high = limits(0, 500)
    assert low == 0.0
    assert (1.0 - high) ** 500 == pytest.approx(0.025)
    assert limits(10, 10)[1] == 1.0
    assert counted(0, 0) == "none to count"
    with pytest.raises(ValueError, match="3 of 2"):
        limits(3, 2)


def test_a_rate_says_its_count_and_its_limits_and_nothing_counted_misses_nothing() -> None:
    found = rate("found", 3, 5, at_least=97.0)
    # Clopper and Pearson of 3 of 5.
    assert (found.value, found.unit, found.kept) == (60.0, "% (3 of 5; 14.7 to 94.7)", False)
    assert tally("alarms", 0, 500, at_most=0.0).unit == "of 500 (0.0 to 0.7 %)"
    none = rate("found", 0, 0, at_least=97.0)
    assert none.why == "none to count"
    assert none.kept
    assert tally("knocks found", 0, 0, at_least=1.0).kept
