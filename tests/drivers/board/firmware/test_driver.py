"""The shipped driver and the firmware at the two ends of a pseudo terminal: ten thousand commands with garbage between."""

from __future__ import annotations

import itertools
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from drivers.api import LaserState, Pulse, PulsesDone
from drivers.board import BoardSpec, TriggerBoard
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from drivers.native import MonotonicClock
from tests.drivers.board.firmware.targets import Target, cpython, micropython
from tests.drivers.board.terminal import Terminal

pytestmark = pytest.mark.devices

GARBAGE = [b"$", b"$C,77,PI", b"$C,1,LASER,1,1*0000\r\n"]


class PatientClock(MonotonicClock):
    """A clock for a busy computer: answers may take twenty times as long."""

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        return super().wait_for(condition, predicate, 20.0 * timeout_s)


class Noisy:
    """A board in real time, with garbage on both ways."""

    def __init__(self, target: Target, share: float) -> None:
        self._target, self._share = target, share
        self._rng = random.Random(6)
        self._before_ns = time.monotonic_ns()

    def exchange(self, heard: bytes) -> bytes:
        passed_us = min((time.monotonic_ns() - self._before_ns) // 1000, 100_000)
        self._before_ns += passed_us * 1000
        said = self._target.exchange(self._garbage() + heard if heard else b"", max(passed_us, 250))
        return self._garbage() + said if said else b""

    def _garbage(self) -> bytes:
        if self._rng.random() >= self._share:
            return b""
        return self._rng.choice([self._rng.randbytes(self._rng.randrange(1, 40)), *GARBAGE])


@contextmanager
def talking(machine: str, noise: float) -> Iterator[TriggerBoard]:
    with cpython() if machine == "CPython" else micropython() as target:
        terminal = Terminal(Noisy(target, noise).exchange)
        try:
            with TriggerBoard.open(BoardSpec(terminal.url), PatientClock()) as board:
                yield board
        finally:
            terminal.unplug()


@pytest.mark.parametrize(("made", "commands"), [("CPython", 10_000), ("MicroPython", 1000)])
def test_thousands_of_commands_among_garbage_are_all_answered(made: str, commands: int) -> None:
    rng = random.Random(7)
    with talking(made, 0.5) as board:
        assert board.info.firmware == "2.0.0"
        time.sleep(0.1)
        last = board.vsync()
        for _ in range(commands):
            if rng.random() < 0.5:
                sides = (rng.random() < 0.5, rng.random() < 0.5)
                assert board.set_lasers(*sides) == LaserState(*sides)
            else:
                seen = board.vsync()
                assert seen.count >= last.count
                assert seen.board_now_us >= last.board_now_us
                last = seen
        counters = board.counters
        assert counters.garbage_bytes > commands, "there was garbage"
        # None, but for a command that came in two pieces with garbage between them.
        assert counters.retries < commands / 100
        assert counters.lost_reports == 0


@pytest.mark.parametrize("made", ["CPython", "MicroPython"])
def test_the_driver_arms_and_hears_every_pulse(made: str) -> None:
    with talking(made, 0.0) as board:
        time.sleep(0.2)
        start = board.vsync().count + 60
        board.arm(24, start, 500, 12_000)
        with pytest.raises(BoardRefused, match="Send STOP first") as caught:
            board.live(1, 0, 50)
        assert caught.value.code == Refusal.BUSY
        events = iter(lambda: board.next_event(0.1), PulsesDone(24))
        pulses = [(one.index, one.vsync) for one in itertools.islice(events, 600) if isinstance(one, Pulse)]
        assert pulses == [(k, start + k) for k in range(24)]
        assert board.health().ok
