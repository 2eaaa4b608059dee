"""The world's date is what it was set to, goes on with world time, and jumps as it is told."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from hw_sim.timing.calendar import Calendar, check


def test_a_date_goes_on_and_jumps_and_nobody_vouches_for_one_that_was_set() -> None:
    now_ns = 5_000_000_000
    calendar = Calendar(lambda: now_ns, "1970-01-01T00:00:07")
    now_ns += 2_500_000_000
    assert calendar.today().utc == datetime(1970, 1, 1, 0, 0, 9, 500_000, UTC)
    assert not calendar.today().kept
    calendar.change("+86400")
    assert calendar.today().utc == datetime(1970, 1, 2, 0, 0, 9, 500_000, UTC)
    calendar.change("kept")
    assert abs(calendar.today().utc - datetime.now(UTC)) < timedelta(minutes=1)
    assert calendar.today().kept
    calendar.change("-3600")
    assert calendar.today().kept, "a time server may step it"
    calendar.change("lost")
    assert not calendar.today().kept


@pytest.mark.parametrize("word", ["yesterday", "+1e12", "-nan", "+", "1969-12-31", "2200-01-01", ""])
def test_what_is_no_date_of_a_computer_is_refused(word: str) -> None:
    with pytest.raises(ValueError, match=r"allowed|farther|float"):
        check(word)
