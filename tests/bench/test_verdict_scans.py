"""Scans that are kept are found again, and only for what they show; shares come with exact limits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.result import Measured
from bench.verdict.binomial import counted, limits, percent, rate, tally
from bench.verdict.causes import figures as figures_of_causes
from bench.verdict.identity import _figures as figures_of_identity
from bench.verdict.kept_scans import KeptScans, Take, scene_of
from bench.verdict.motion_cases import KINDS, draw_case
from bench.verdict.motion_figures import figures as figures_of_motion
from bench.verdict.motion_page import table


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


def test_a_share_that_is_not_all_is_never_said_to_be() -> None:
    assert [percent(share) for share in (0.0, 1.0, 0.5, 0.9996, 0.99996, 0.0004)] == [
        "0.0", "100.0", "50.0", "99.96", "99.996", "0.04",
    ]  # fmt: skip


def test_a_rate_says_its_count_and_its_limits_and_nothing_counted_misses_nothing() -> None:
    found = rate("found", 3, 5, at_least=97.0)
    # Clopper and Pearson of 3 of 5.
    assert (found.value, found.unit, found.kept) == (60.0, "% (3 of 5; 14.7 to 94.7)", False)
    assert tally("alarms", 0, 500, at_most=0.0).unit == "of 500 (0.0 to 0.7 %)"
    none = rate("found", 0, 0, at_least=97.0)
    assert none.why == "none to count"
    assert none.kept
    assert tally("knocks found", 0, 0, at_least=1.0).kept


def of(measured: Iterable[Measured], name: str) -> Measured:
    (found,) = (one for one in measured if one.name == name)
    return found


def a_take(found: bool, named: bool, seen_percent: float) -> dict[str, Any]:
    """Return one scan with one visible wrong order of its left camera."""
    return {
        "good_passed": True, "cpu_s": 0.01, "classes": ["still"], "seen_percent": [seen_percent, seen_percent],
        "found": [["left", "swap", 0.5, found, False]], "named": [["swap", False, found, named, True, 0.01 * seen_percent]],
    }  # fmt: skip


def test_where_the_object_fills_a_fifth_every_wrong_order_must_be_found_and_97_of_100_rightly_named() -> None:
    name = "identity: found, where the object fills a fifth of the image"
    small_one_missed = [*[a_take(True, True, 50.0)] * 99, a_take(False, False, 5.0)]
    assert of(figures_of_identity(small_one_missed), name).kept
    one_missed = figures_of_identity([*[a_take(True, True, 50.0)] * 99, a_take(False, True, 50.0)])
    assert not of(one_missed, name).kept
    assert of(one_missed, name).unit.startswith("% (99 of 100; 94.6 to")
    named = "identity: rightly named where the object fills a fifth"
    assert of(one_missed, named).kept
    badly = figures_of_identity([*[a_take(True, True, 50.0)] * 96, *[a_take(True, False, 50.0)] * 4])
    assert not of(badly, named).kept
    assert not of(badly, "identity: seen and rightly named").kept


def test_the_first_reason_has_an_interval_on_both_sides() -> None:
    row = {"grade": "bad", "reasons": ["MOVED"], "blamed": "hands", "mends": ["hands"]}
    found = figures_of_causes([{**row, "right": k >= 5} for k in range(37)])
    assert of(found, "first reason is a true one").unit == "% (32 of 37; 71.2 to 95.5)"
    assert not of(found, "first reason is a true one").kept


def a_moving_row(added_percent: float, refused: bool, over_rest: float | None = None) -> dict[str, Any]:
    said = {"passed": not refused, "added_percent": added_percent, "score": 1.0}
    return {
        "kind": "lateral", "texture": "slight", "classes": [], "added_percent": added_percent, "lost_percent": 0.0,
        "at_rest": {"passed": True, "added_percent": 0.0, "score": 0.0}, "moving": said, "speed_mm_s": 5.0, "object": "plane",
        "compensated": over_rest is not None, "compensated_over_rest": over_rest,
    }  # fmt: skip


def test_scans_that_are_shown_compensated_are_counted_apart_of_those_refused() -> None:
    rows = [
        a_moving_row(30.0, True),
        a_moving_row(30.0, True, 0.9),
        a_moving_row(1.0, True, 1.3),
        a_moving_row(1.0, False),
    ]
    found = figures_of_motion(rows, 30.0)
    assert of(found, "motion: refused, of those adding over 10 %").unit.startswith("% (2 of 2;")
    assert of(found, "motion: shown compensated, of those refused adding over 10 %").share == (1, 2)
    assert of(found, "motion: shown compensated, of those refused adding under 5 %").share == (1, 1)
    beyond = of(found, "motion: shown compensated and erring over 1.2 times as at rest")
    assert beyond.share == (1, 2)
    assert not beyond.kept
    lines = table(rows, 30.0)
    assert lines[2].split("|")[3].strip() == "of these shown compensated"
    (line,) = (line for line in lines if line.startswith("| refused, of those whose hands add over 10 %"))
    assert line.split("|")[3].strip().startswith("1 of 2 = 50.0 %")
    assert len({line.count("|") for line in lines[2:9]}) == 1
