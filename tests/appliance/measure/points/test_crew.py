"""Work shared by the caller and its helpers: nothing waits for a free thread, and nothing is at work once it was left."""

from __future__ import annotations

import linecache
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest

from appliance.measure.points import crew as crew_module
from appliance.measure.points.crew import Crew

TIMEOUT_S = 20.0


@pytest.fixture
def pair() -> Iterator[Crew]:
    """The caller and one helper."""
    made = Crew()
    yield made
    made.close()


class Gate:
    """Work that says when it has begun and ended, and ends when it is let."""

    def __init__(self) -> None:
        self.begun, self.let, self.ended = threading.Event(), threading.Event(), threading.Event()
        self.thread = 0

    def __call__(self) -> str:
        self.thread = threading.get_ident()
        self.begun.set()
        assert self.let.wait(TIMEOUT_S)
        self.ended.set()
        return "let"

    def let_later(self) -> threading.Timer:
        timer = threading.Timer(0.1, self.let.set)
        timer.start()
        return timer


@pytest.mark.parametrize("helpers", [0, 1, 3])
def test_what_is_done_for_each_comes_in_the_order_of_the_items_also_without_a_thread_to_spare(helpers: int) -> None:
    crew = Crew(helpers)

    def rows(first: int) -> int:
        return sum(crew.each(lambda k: first + sum(crew.each(lambda j: j, range(k))), range(5)))

    assert crew.each(rows, range(40)) == [5 * first + 10 for first in range(40)]
    crew.close()


def test_of_several_errors_the_first_in_order_is_raised_when_all_have_ended(pair: Crew) -> None:
    slow, ran = Gate(), []

    def work(k: int) -> None:
        ran.append(k)
        if k == 0:
            slow()
        raise ValueError(f"item {k}")

    timer = slow.let_later()
    with pytest.raises(ValueError, match="item 0"):
        pair.each(work, range(2))
    assert slow.ended.is_set()
    timer.join(TIMEOUT_S)


def test_while_the_helper_is_busy_the_caller_does_what_it_waits_for(pair: Crew) -> None:
    busy, caller = Gate(), threading.get_ident()
    with pair.tasks() as tasks:
        first = tasks.add(busy)
        assert busy.begun.wait(TIMEOUT_S)
        assert busy.thread != caller
        assert pair.each(lambda k: (k, threading.get_ident()), range(2)) == [(k, caller) for k in range(2)]
        busy.let.set()
        assert first.answer() == "let"


def test_what_nobody_has_begun_is_dropped_and_the_rest_awaited(pair: Crew) -> None:
    running, dropped = Gate(), Gate()
    with pair.tasks() as tasks:
        tasks.add(running)
        never = tasks.add(dropped)
        assert running.begun.wait(TIMEOUT_S)
        timer = running.let_later()
    assert running.ended.is_set(), "nothing is at work any more"
    assert not dropped.begun.is_set()
    with pytest.raises(RuntimeError, match="was cancelled"):
        never.answer()
    assert pair.each(lambda k: k, range(3)) == [0, 1, 2], "who was dropped leaves nothing in the way of others"
    timer.join(TIMEOUT_S)


def interrupted_at(line: int, helpers: int) -> bool:
    """Work through some tasks, one of which asks for others, with Ctrl-C in the ``line``-th line of crew.py that this thread comes to.

    Returns whether it came so far.
    """
    left = line

    def trace(frame: FrameType, event: str, arg: object) -> Any:
        nonlocal left
        if frame.f_code.co_filename != crew_module.__file__:
            return None
        # A lock is entered and left in one step each, between which nothing interrupts; tracing stops there twice all the same.
        if event == "line" and "with self._lock" not in linecache.getline(crew_module.__file__, frame.f_lineno):
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
        return trace

    crew = Crew(helpers)
    begun_s = time.monotonic()
    before = sys.gettrace()
    try:
        with crew.tasks() as tasks:
            sys.settrace(trace)
            try:
                first = tasks.add(lambda: sum(crew.each(abs, (-1, -2))))
                second = tasks.add(lambda: 3)
                assert (first.answer(helping=True), second.answer()) == (3, 3)
            finally:
                sys.settrace(before)
    except KeyboardInterrupt:
        pass
    assert time.monotonic() - begun_s < TIMEOUT_S
    crew.close()
    return left <= 0


@pytest.mark.parametrize("helpers", [0, 1])
def test_ctrl_c_in_any_line_ends_the_work_at_once(helpers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between taking a task off the list and doing it, it was waited for a quarter of an hour."""
    monkeypatch.setattr(crew_module, "MOST_S", 2.0)
    lines = next(line for line in range(1, 400) if not interrupted_at(line, helpers))
    assert lines > 60
