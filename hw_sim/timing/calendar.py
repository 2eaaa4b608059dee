"""The world's date: the true one, or the wrong one of the computer's clock chip.

It is independent of world time, except that both go on: it is set, jumps, and may be kept by a time server.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace

KEPT, LOST = "kept", "lost"
FIRST, LAST = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC), datetime.datetime(2106, 1, 1, tzinfo=datetime.UTC)
"""First and last date that can be set; the clock of a computer without battery begins with the first."""


@dataclass(frozen=True, slots=True)
class Date:
    """A date in UTC; ``kept``: a time server keeps it."""

    utc: datetime.datetime
    kept: bool


class Calendar:
    """The date, at first that of the real computer, kept by a time server; for any thread."""

    def __init__(self, now_ns: Callable[[], int], date: str | None = None) -> None:
        """``now_ns``: world time. ``date``: another one to begin with. Raises ValueError."""
        self._now_ns = now_ns
        self._set = Date(datetime.datetime.now(datetime.UTC), kept=True)
        self._set_ns = now_ns()
        if date is not None:
            self.change(date)

    def today(self) -> Date:
        """Return the date now."""
        passed = datetime.timedelta(microseconds=(self._now_ns() - self._set_ns) // 1000)
        return replace(self._set, utc=self._set.utc + passed)

    def change(self, word: str) -> None:
        """Change the date as ``changed`` says. Raises ValueError."""
        # Relative to world time, so that the date goes on with it and not with the real clock.
        self._set, self._set_ns = changed(self.today(), word), self._now_ns()


def check(word: str) -> None:
    """Check a word. Raises ValueError for an invalid one."""
    if word not in (KEPT, LOST):
        _jump(word) if word[:1] in ("+", "-") else _date(word)


def changed(date: Date, word: str) -> Date:
    """Return the date after ``word``.

    ``+S`` or ``-S``: it jumps by so many seconds, kept or not. A date: it is that, and not kept. ``kept``: a time
    server corrects and keeps it. ``lost``: it is no longer kept. Raises ValueError for another word.
    """
    if word == KEPT:
        return Date(datetime.datetime.now(datetime.UTC), kept=True)
    if word == LOST:
        return replace(date, kept=False)
    if word[:1] not in ("+", "-"):
        return Date(_date(word), kept=False)
    return replace(date, utc=_within(date.utc + _jump(word), word))


def _date(word: str) -> datetime.datetime:
    try:
        parsed = datetime.datetime.fromisoformat(word)
    except ValueError as error:
        raise ValueError(f"'{word}' is no date; allowed are 1970-01-01T00:00:07, +S, -S, {KEPT} and {LOST}") from error
    return _within(parsed.replace(tzinfo=datetime.UTC) if parsed.tzinfo is None else parsed, word)


def _jump(word: str) -> datetime.timedelta:
    seconds = float(word)
    if not abs(seconds) <= (LAST - FIRST).total_seconds():
        raise ValueError(f"'{word}' is too large a shift; allowed are up to {(LAST - FIRST).total_seconds():.0f} s")
    return datetime.timedelta(seconds=seconds)


def _within(date: datetime.datetime, word: str) -> datetime.datetime:
    if not FIRST <= date <= LAST:
        raise ValueError(f"'{word}' leads to {date:%Y-%m-%d}; allowed are {FIRST:%Y-%m-%d} to {LAST:%Y-%m-%d}")
    return date
