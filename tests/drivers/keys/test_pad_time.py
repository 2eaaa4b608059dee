"""When a report was made: by the pad's own clock where the host was late, and never in the future."""

from __future__ import annotations

from drivers.keys.keypad import PadTime

MS = 1_000_000
T0 = 7_000 * MS


def test_a_report_that_was_waited_for_is_dated_to_its_arrival_whatever_the_pads_clock_says() -> None:
    time = PadTime()
    assert time.date(100, T0, waited_for=True) == T0
    assert time.date(5, T0 + 250 * MS, waited_for=True) == T0 + 250 * MS
    assert PadTime().date(100, T0, waited_for=False) == T0, "the first one has none before it"


def test_reports_that_lay_there_keep_their_distance_by_the_pads_clock_also_across_its_wrap() -> None:
    time = PadTime()
    time.date(65_500, T0, waited_for=True)
    late_ns = T0 + 60_000 * MS
    assert time.date(65_535, late_ns, waited_for=False) == T0 + 35 * MS
    assert time.date(14, late_ns, waited_for=False) == T0 + 50 * MS
    assert time.date(40_014, late_ns, waited_for=False) == T0 + 40_050 * MS


def test_no_report_is_later_than_its_arrival_nor_earlier_than_the_one_before() -> None:
    time = PadTime()
    time.date(0, T0, waited_for=True)
    assert time.date(500, T0 + 100 * MS, waited_for=False) == T0 + 100 * MS
    assert time.date(510, T0 + 200 * MS, waited_for=False) == T0 + 110 * MS
    assert time.date(520, T0 + 105 * MS, waited_for=True) == T0 + 110 * MS
