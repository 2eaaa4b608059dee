"""How bright scans are: the steps a diver may choose from, and what light each of them gives."""

from __future__ import annotations

from itertools import pairwise

import pytest

from appliance.scan.exposure import NOMINAL, Exposure, Span, ladder


def test_longer_exposures_come_before_more_gain_and_each_step_is_brighter() -> None:
    steps = ladder(60.0, 500, 0.0, Span())
    assert [step.time_us for step in steps[:-6]] == [
        *(2000, 2500, 3200, 4000, 5000, 6300, 8000, 10000, 12000, 14000, 16000)
    ]
    assert [(step.time_us, step.gain_db) for step in steps[-6:]] == [(16000, 2.0 * k) for k in range(1, 7)]
    lights = [step.light for step in steps]
    assert lights == sorted(lights)
    assert all(1.1 < b / a < 1.3 for a, b in pairwise(lights))


def test_no_exposure_ends_after_the_next_vertical_sync() -> None:
    """16.667 ms less the delay and 0.1 ms of margin."""
    assert ladder(60.0, 566, 0.0, Span())[-7].time_us == 16000
    assert ladder(60.0, 568, 0.0, Span())[-7].time_us == 14000
    assert [one.time_us for one in ladder(60.0, 500, 0.0, Span(3.0, 5.0, 0.0))] == [3200, 4000, 5000]


def test_the_rigs_own_gain_is_the_lowest_and_the_spans_the_highest() -> None:
    gains = [step.gain_db for step in ladder(60.0, 500, 3.0, Span(most_gain_db=8.0)) if step.time_us == 16000]
    assert gains == [3.0, 5.0, 7.0]
    assert {step.gain_db for step in ladder(60.0, 500, 12.0, Span())} == {12.0}


def test_a_span_that_has_room_for_half_a_step_of_gain_stops_below_it() -> None:
    gains = [step.gain_db for step in ladder(60.0, 500, 0.0, Span(most_gain_db=5.0)) if step.gain_db > 0.0]
    assert gains == [2.0, 4.0]
    assert len(ladder(60.0, 500, 0.0, Span(most_gain_db=1.9))) == 11, "no gain at all: the eleven times"


def test_of_few_exposures_the_gaps_are_bridged_by_gain_and_nothing_else_is_offered() -> None:
    steps = ladder(60.0, 500, 0.0, Span(times_ms=(16.0, 5.0, 12.0), most_gain_db=12.0))
    assert [(one.time_us, one.gain_db) for one in steps] == [
        *((5000, 0.0), (5000, 2.0), (5000, 4.0), (5000, 6.0)),
        (12000, 0.0),
        *((16000, 2.0 * k) for k in range(7)),
    ]
    lights = [step.light for step in steps]
    assert lights == sorted(lights)
    assert all(b / a < 1.4 for a, b in pairwise(lights)), "no gap that a proposal could fall into"
    own = ladder(60.0, 500, 6.0, Span(times_ms=(5.0, 16.0), most_gain_db=12.0))
    assert own[0] == Exposure(5000, 6.0)
    assert {one.time_us for one in own} == {5000, 16000}
    assert max(one.gain_db for one in own) == 12.0


def test_where_no_step_fits_the_reason_and_the_steps_are_told() -> None:
    with pytest.raises(
        ValueError, match=r"no exposure step lies within 2\.\.1\.57 ms \(60 Hz less trigger delay 15000 us"
    ):
        ladder(60.0, 15_000, 0.0, Span())


def test_an_exposure_is_as_bright_as_its_time_and_gain_and_says_so() -> None:
    assert Exposure(8000).light == 8000.0
    assert Exposure(8000, 20.0).light == pytest.approx(80_000.0)
    assert NOMINAL.label == "12 ms", "of an instrument whose rig file nobody has read"
    assert [one.label for one in (Exposure(8000), Exposure(6300), Exposure(16000, 4.0))] == [
        "8 ms",
        "6.3 ms",
        "16 ms +4 dB",
    ]
