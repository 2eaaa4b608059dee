"""Scans that are kept are found again, and only for what they show; shares come with exact limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.verdict.binomial import counted, limits
from bench.verdict.kept_scans import KeptScans, Take, scene_of
from bench.verdict.motion_cases import KINDS, draw_case


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


@pytest.mark.parametrize("kind", KINDS)
def test_a_case_moves_as_its_kind_says(kind: str) -> None:
    case = draw_case(10_000_000_007, kind)
    rest, moving = scene_of(case, Take.REST), scene_of(case, Take.MOVING)
    assert rest.motion.still
    assert rest.drift.fish == 0
    assert (moving.drift.fish > 0) == (kind == "fish") == moving.motion.still


def test_exact_limits_of_a_share() -> None:
    """None of 500: the rule of three, exactly. The tails of the binomial distribution: 0.025 each."""
    low, high = limits(0, 500)
    assert low == 0.0
    assert (1.0 - high) ** 500 == pytest.approx(0.025)
    assert limits(10, 10)[1] == 1.0
    assert counted(0, 0) == "none to count"
    with pytest.raises(ValueError, match="3 of 2"):
        limits(3, 2)
