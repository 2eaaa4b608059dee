"""Two outputs on one card: one thread reads the kernel's reports for both, and nobody waits longer than for its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from time import monotonic

import pytest

from drivers.output.card import Card
from tests.drivers.output.kernel import Kernel, Plug, VblankEvent, mode

LONG_S = 60.0
"""Time that nobody in here waits out."""


class Held(Kernel):
    """Its reports come when the test says so, in true time."""

    def __init__(self) -> None:
        super().__init__({1: Plug(1, 11, 1, [mode(128, 96)])})
        self.readers, self.most_readers = 0, 0
        self.asked = threading.Condition()
        self.answers: list[bytes] = []

    def wait_readable(self, timeout_s: float) -> bool:
        with self.asked:
            self.readers += 1
            self.most_readers = max(self.most_readers, self.readers)
            self.asked.notify_all()
            self.asked.wait_for(lambda: bool(self.answers), LONG_S)
            self.readers -= 1
            self.events = self.answers.pop(0)
            return True

    def answer(self, *tokens: int) -> None:
        with self.asked:
            self.asked.wait_for(lambda: self.readers == 1, LONG_S)
            self.answers.append(b"".join(bytes(VblankEvent(2, 32, token, 1, 2, 3, 40)) for token in tokens))
            self.asked.notify_all()


def until(happened: Callable[[], bool]) -> None:
    deadline_s = monotonic() + LONG_S
    while not happened():
        assert monotonic() < deadline_s
        threading.Event().wait(0.002)


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
    kernel = Held()
    card = Card(kernel, kernel.time)
    buffer = card.create_buffer(128, 96)
    tokens = [card.submit_flip(crtc, buffer) for crtc in (40, 50)]
    with ThreadPoolExecutor(2) as threads:
        waiting = [threads.submit(card.wait_flip, tokens[FIRST], LONG_S)]
        until(lambda: kernel.readers == 1)
        waiting.append(threads.submit(card.wait_flip, tokens[SECOND], LONG_S))
        until(lambda: bool(card._changed._waiters))  # type: ignore[attr-defined]
        for reports in found:
            kernel.answer(*(tokens[who] for who in reports))
            for who in reports:
                done = waiting[who].result(LONG_S)
                assert done is not None
                assert done.token == tokens[who]
    assert kernel.most_readers == 1, "the kernel gives a report to whoever reads first"
