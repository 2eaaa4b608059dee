"""Counting and pacing where the hardware does less than it should."""

from __future__ import annotations

from itertools import pairwise

import pytest

from drivers.output.pacing import BlankCounter, Pacer
from tests.drivers.output.kernel import Time

PERIOD_NS = 16_666_667


def test_a_counter_that_stays_zero_is_missing_not_zero() -> None:
    counter = BlankCounter()
    assert [counter.extend(0) for _ in range(3)] == [None, None, None]


def test_a_counter_runs_on_where_32_bits_wrap() -> None:
    counter = BlankCounter()
    assert [counter.extend(raw) for raw in (2**32 - 2, 2**32 - 1, 0, 1)] == [2**32 - 2, 2**32 - 1, 2**32, 2**32 + 1]


def test_throttled_flips_are_not_held_back() -> None:
    time = Time()
    pacer = Pacer(time, 60.0)
    for _ in range(10):
        pacer.wait()
        time.ns += PERIOD_NS
        pacer.shown(time.ns)
    assert time.ns == Time().ns + 10 * PERIOD_NS
    assert not pacer.unthrottled


def test_unthrottled_flips_come_once_per_period() -> None:
    time = Time()
    pacer = Pacer(time, 60.0)
    shown = []
    for _ in range(20):
        pacer.wait()
        time.ns += 100_000
        pacer.shown(time.ns)
        shown.append(time.ns)
    steps = [b - a for a, b in pairwise(shown[2:])]
    assert pacer.unthrottled
    assert all(abs(step - PERIOD_NS) < 200_000 for step in steps)


def test_after_a_long_pause_nothing_is_made_up_for() -> None:
    time = Time()
    pacer = Pacer(time, 60.0)
    for pause_ns in (0, 0, 0, 10 * PERIOD_NS, 0, 0):
        time.ns += pause_ns
        pacer.wait()
        time.ns += 100_000
        before = time.ns
        pacer.shown(time.ns)
    pacer.wait()
    assert time.ns - before > PERIOD_NS // 2


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


def test_one_picture_that_comes_late_does_not_shift_those_behind_it() -> None:
    time = Time()
    pacer = Pacer(time, 60.0)
    begin_ns = time.ns
    shown = []
    for late_ns in (0, 0, 0, 0, 5_000_000, 0, 0):
        pacer.wait()
        time.ns += late_ns
        pacer.shown(time.ns)
        shown.append((time.ns - begin_ns) / PERIOD_NS)
    grid = [round((at - shown[2]) % 1, 2) for at in shown[2:]]
    assert grid == [0.0, 0.0, 0.3, 0.0, 0.0]


def test_a_clock_that_jumps_is_not_waited_for() -> None:
    time = Time()
    pacer = Pacer(time, 60.0)
    for _ in range(3):
        pacer.shown(time.ns)
    time.ns -= 60 * 10**9
    before_ns = time.ns
    pacer.wait()
    assert time.ns == before_ns


def test_a_report_that_is_older_than_the_latest_stays_older_and_zero_is_a_number_once_there_was_another() -> None:
    counter = BlankCounter()
    assert [counter.extend(raw) for raw in (0, 5, 4, 6, 0)] == [None, 5, 4, 6, 0]
    half = BlankCounter()
    assert [half.extend(raw) for raw in (1, 2**31, 2**31 + 1)] == [1, 2**31, 2**31 + 1]
    back = BlankCounter()
    assert [back.extend(raw) for raw in (1, 1 + 2**31)] == [1, 1 - 2**31]
