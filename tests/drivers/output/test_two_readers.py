"""Two outputs on one card: one thread reads the kernel's reports for both, and nobody waits longer than for its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

import pytest

from drivers.output.card import Card
from drivers.output.drm import FlipDone
from tests.drivers.output.kernel import Kernel, Plug, VblankEvent, mode

LONG_S = 20.0
"""Time that nobody in here waits out."""
SOON_S = 8.0


class Held(Kernel):
    """Its reports come when the test says so, in true time."""

    def __init__(self) -> None:
        super().__init__([Plug(1, 11, 1, [mode(128, 96)])])
        self.readers, self.most_readers = 0, 0
        self.asked = threading.Condition()
        self.answers: list[bytes | None] = []
        """What the next waits find; ``None``: nothing in their time."""

    def wait_readable(self, timeout_s: float) -> bool:
        with self.asked:
            self.readers += 1
            self.most_readers = max(self.most_readers, self.readers)
            self.asked.notify_all()
            self.asked.wait_for(lambda: bool(self.answers), LONG_S)
            answer = self.answers.pop(0) if self.answers else None
            self.readers -= 1
            if answer is None:
                return False
            self.events = answer
            return True

    def answer(self, *found: bytes | None) -> None:
        with self.asked:
            self.asked.wait_for(lambda: self.readers == 1, SOON_S)
            self.answers += found
            self.asked.notify_all()


class Waiting:
    """A thread that waits for the report of one flip."""

    def __init__(self, card: Card, token: int, timeout_s: float) -> None:
        self.found: FlipDone | None = None
        self.lasted_s = LONG_S
        self._thread = threading.Thread(target=self._wait, args=(card, token, timeout_s), daemon=True)
        self._thread.start()

    def _wait(self, card: Card, token: int, timeout_s: float) -> None:
        begun_s = monotonic()
        self.found = card.wait_flip(token, timeout_s)
        self.lasted_s = monotonic() - begun_s

    def token(self) -> int | None:
        self._thread.join(SOON_S)
        assert not self._thread.is_alive(), "it waits on although its report is there"
        return None if self.found is None else self.found.token


def report(token: int) -> bytes:
    return bytes(VblankEvent(2, 32, token, 1, 2, 3, 40))


@contextmanager
def two_flips() -> Iterator[tuple[Held, Card, int, int]]:
    kernel = Held()
    card = Card(kernel, kernel.time)
    buffer = card.create_buffer(128, 96)
    yield kernel, card, card.submit_flip(40, buffer), card.submit_flip(50, buffer)
    assert kernel.most_readers == 1, "the kernel gives a report to whoever reads first"


def until(happened: Callable[[], bool]) -> None:
    deadline_s = monotonic() + SOON_S
    while not happened():
        assert monotonic() < deadline_s
        threading.Event().wait(0.002)


def sleeps(card: Card) -> bool:
    """Somebody waits for what the reader finds."""
    return bool(card._changed._waiters)  # type: ignore[attr-defined]


FIRST, SECOND = 0, 1


@pytest.mark.parametrize(
    "found",
    [
        pytest.param([(SECOND, FIRST)], id="both at once: who does not read is told as soon as its report was read"),
        pytest.param([(FIRST,), (SECOND,)], id="the reader has its own: the other one reads on"),
        pytest.param([(SECOND,), (FIRST,)], id="the reader found the other's: it reads on for its own"),
    ],
)
def test_each_of_two_that_wait_gets_its_report_whoever_reads_it(found: list[tuple[int, ...]]) -> None:
    with two_flips() as (kernel, card, *tokens):
        reader = Waiting(card, tokens[FIRST], LONG_S)
        until(lambda: kernel.readers == 1)
        waiting = (reader, Waiting(card, tokens[SECOND], LONG_S))
        until(lambda: sleeps(card))
        for reports in found:
            kernel.answer(b"".join(report(tokens[who]) for who in reports))
            for who in reports:
                assert waiting[who].token() == tokens[who]
