"""What is counted over scans whose movement was undone in the world ``outside``: what is shown must err little, or be refused."""

from __future__ import annotations

from typing import Any

from bench.outside.compensation import figures
from bench.result import Measured


def a_row(after: float, used: bool = True, thing: str = "shell", moved: bool = True) -> dict[str, Any]:
    return {"object": thing, "moved": moved, "used": used, "after": after, "before": 10.0, "in_sigmas": 1.0}


def of(named: list[dict[str, Any]], drawn: list[dict[str, Any]], name: str) -> Measured:
    (found,) = (one for one in figures(named, drawn) if one.name == name)
    return found


def test_what_is_shown_may_err_a_fifth_more_than_at_rest_and_what_is_refused_may_err_at_will() -> None:
    rows = [a_row(0.9), a_row(1.3), a_row(10.0, used=False)]
    beyond = of([], rows, "drawn, shown: err over 1.2 times as at rest")
    assert (beyond.share, beyond.kept) == ((1, 2), False)
    assert of([], rows, "drawn, moving: refused").share == (1, 3)
    assert of([], rows[:1], "drawn, shown: err over 1.2 times as at rest").kept


def test_a_checkered_pipe_is_as_at_rest_or_refused() -> None:
    name = "the checkered pipe, shown: error over that at rest, largest"
    assert not of([a_row(1.25, thing="pipe"), a_row(0.8, thing="pipe")], [], name).kept
    refused = of([a_row(40.0, used=False, thing="pipe")], [], name)
    assert refused.why == "all are refused"
    assert refused.kept


def test_what_was_at_rest_is_not_to_be_touched_and_counts_for_nothing_else() -> None:
    rows = [a_row(1.0, moved=False), a_row(0.9)]
    assert not of([], rows, "drawn, at rest: touched").kept
    assert of([], rows, "drawn, moving: shown compensated").share == (1, 1)
