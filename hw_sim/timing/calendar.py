"""Owns the world's date: what somebody with a watch would say, or whatever the clock chip of the computer makes of it.

It has nothing to do with world time, except that both go on: it is set, jumps, and is kept by a time server or by nobody.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace

KEPT, LOST = "kept", "lost"
FIRST, LAST = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC), datetime.datetime(2106, 1, 1, tzinfo=datetime.UTC)
"""First and last date that can be set; a computer's clock begins with the first."""


@dataclass(frozen=True, slots=True)
class Date:
    """A date in UTC; ``kept``: a time server vouches for it."""

    utc: datetime.datetime
    kept: bool


class Calendar:
    """Begins with the date of the computer it runs on, kept by a time server. Replaced as a whole: any thread may ask."""

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
        # Set against world time, so that the date goes on with it and not with the real clock.
        self._set, self._set_ns = changed(self.today(), word), self._now_ns()


def check(word: str) -> None:
    """Check a word. Raises ValueError for what ``changed`` never takes."""
    if word not in (KEPT, LOST):
        _jump(word) if word[:1] in ("+", "-") else _date(word)


def changed(date: Date, word: str) -> Date:
    """Return the date after ``word``.

    ``+S`` or ``-S``: it jumps by so many seconds, whoever keeps it. A date: it is that, and nobody keeps it. ``kept``: a time
    server sets it right and keeps it. ``lost``: nobody keeps it any more. Raises ValueError for anything else.
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
        said = datetime.datetime.fromisoformat(word)
    except ValueError as error:
        raise ValueError(f"'{word}' is no date; allowed are 1970-01-01T00:00:07, +S, -S, {KEPT} and {LOST}") from error
    return _within(said.replace(tzinfo=datetime.UTC) if said.tzinfo is None else said, word)


def _jump(word: str) -> datetime.timedelta:
    seconds = float(word)
    if not abs(seconds) <= (LAST - FIRST).total_seconds():
        raise ValueError(f"'{word}' is farther than a date can jump: {(LAST - FIRST).total_seconds():.0f} s")
    return datetime.timedelta(seconds=seconds)


def _within(date: datetime.datetime, word: str) -> datetime.datetime:
    if not FIRST <= date <= LAST:
        raise ValueError(f"'{word}' leads to {date:%Y-%m-%d}; allowed are {FIRST:%Y-%m-%d} to {LAST:%Y-%m-%d}")
    return date
