"""Counting and pacing where the hardware does less than it should."""

from __future__ import annotations

from itertools import pairwise

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
