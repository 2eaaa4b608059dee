"""Counting and pacing where the hardware does less than it should."""

from __future__ import annotations

from itertools import pairwise

import pytest

from drivers.output.pacing import BlankCounter, Pacer
from tests.drivers.output.kernel import Time

PERIOD_NS = 16_666_667


@pytest.mark.parametrize(
    ("raw", "extended"),
    [
        ([0, 0, 0], [None, None, None]),
        ([2**32 - 2, 2**32 - 1, 0, 1], [2**32 - 2, 2**32 - 1, 2**32, 2**32 + 1]),
        ([0, 5, 4, 6, 0], [None, 5, 4, 6, 0]),
        ([1, 2**31, 2**31 + 1], [1, 2**31, 2**31 + 1]),
        ([1, 1 + 2**31], [1, 1 - 2**31]),
    ],
    ids=["zero is missing", "wraps at 32 bits", "older stays older, zero a number after another", "half", "back"],
)
def test_a_counter_of_blanks_runs_on(raw: list[int], extended: list[int | None]) -> None:
    counter = BlankCounter()
    assert [counter.extend(one) for one in raw] == extended


@pytest.mark.parametrize(("between_ns", "step_ns"), [(PERIOD_NS, PERIOD_NS), (100_000, PERIOD_NS)])
def test_flips_come_once_per_period_whether_the_hardware_holds_them_back_or_not(between_ns: int, step_ns: int) -> None:
    time = Time()
    pacer = Pacer(time, 60.0)
    shown = []
    for _ in range(20):
        pacer.wait()
        time.ns += between_ns
        pacer.shown(time.ns)
        shown.append(time.ns)
    assert pacer.unthrottled is (between_ns < PERIOD_NS)
    slack_ns = 200_000 if pacer.unthrottled else 0
    assert all(abs(b - a - step_ns) <= slack_ns for a, b in pairwise(shown[2:]))


def shown_at(*late_ns: int) -> list[float]:
    """Show a picture each so much later than it might be, and return when each was, in periods."""
    time = Time()
    pacer, begin_ns, shown = Pacer(time, 60.0), time.ns, []
    for late in late_ns:
        pacer.wait()
        time.ns += late
        pacer.shown(time.ns)
        shown.append((time.ns - begin_ns) / PERIOD_NS)
    return shown


def test_neither_a_late_picture_nor_a_pause_shifts_those_behind_it_and_a_clock_that_jumps_is_not_waited_for() -> None:
    shown = shown_at(0, 0, 0, 0, 5_000_000, 0, 0)
    assert [round((at - shown[2]) % 1, 2) for at in shown[2:]] == [0.0, 0.0, 0.3, 0.0, 0.0]
    shown = shown_at(0, 0, 0, 10 * PERIOD_NS, 0, 0)
    assert shown[-1] - shown[-2] > 0.5, "nothing is made up for"
    time = Time()
    pacer = Pacer(time, 60.0)
    for _ in range(3):
        pacer.shown(time.ns)
    time.ns -= 60 * 10**9
    before_ns = time.ns
    pacer.wait()
    assert time.ns == before_ns


@pytest.mark.parametrize(
    ("part", "unthrottled"), [(0.0, True), (0.74, True), (0.76, False), (1.0, False), (-0.5, False)]
)
def test_two_flips_closer_than_three_quarters_of_a_period_were_held_back_by_nothing(
    part: float, unthrottled: bool
) -> None:
    pacer = Pacer(Time(), 60.0)
    pacer.shown(10**9)
    pacer.shown(10**9 + round(part * PERIOD_NS))
    assert pacer.unthrottled == unthrottled
