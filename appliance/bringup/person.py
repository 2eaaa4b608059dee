"""Owns what the guide asks of the person at the instrument: something to be done, with or without an answer."""

from __future__ import annotations

from typing import Protocol


class GivenUp(Exception):
    """The person gave up, or nobody is there: the guide ends, and what was done stays done."""


class Person(Protocol):
    """Whoever stands at the instrument. Implemented by the command line."""

    def tell(self, what: str) -> None:
        """Say what is to be done now. No answer is waited for: the software sees for itself when it was done."""

    def ask(self, what: str) -> None:
        """Say what is to be done now and wait until the person says that it was. Raises GivenUp."""


MOST_ASKED = 3
"""Times that one thing is asked for; then it is judged as it is."""


def numbered(what: str, turn: int) -> str:
    """Return a wish for the ``turn``-th time, from 0: the last ones say that it did not help."""
    if turn == 0:
        return what
    return f"{what} (asked again, {turn + 1} of {MOST_ASKED}: it was not seen)"
