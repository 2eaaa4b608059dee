"""The shipped driver and the firmware at the two ends of a pseudo terminal: ten thousand commands with garbage between."""

from __future__ import annotations

import os
import random
import select
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

from drivers.api import LaserState, Pulse, PulsesDone
from drivers.board import BoardSpec, TriggerBoard
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from drivers.native import MonotonicClock
from tests.drivers.board.firmware.targets import Target, cpython, micropython
from tests.support.micropython import require

pytestmark = pytest.mark.devices

COMMANDS = 10_000


class Terminal:
    """A pseudo terminal with a board at its far end, which lives in real time; ``noisy`` puts garbage on both ways."""

    def __init__(self, target: Target, noisy: bool) -> None:
        self._target, self._noisy = target, noisy
        self._rng = random.Random(6)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.url = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._failure: BaseException | None = None

    def __enter__(self) -> Terminal:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(5.0)
        os.close(self._slave)
        os.close(self._master)
        if self._failure is not None:
            raise self._failure

    def _serve(self) -> None:
        try:
            self._relay()
        except BaseException as error:
            self._failure = error

    def _relay(self) -> None:
        before_ns = time.monotonic_ns()
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], 0.002)
            heard = os.read(self._master, 4096) if ready else b""
            now_ns = time.monotonic_ns()
            passed_us = min((now_ns - before_ns) // 1000, 100_000)
            before_ns += passed_us * 1000
            said = self._target.exchange(self._garbage() + heard if heard else b"", max(passed_us, 250))
            if said:
                os.write(self._master, self._garbage() + said)

    def _garbage(self) -> bytes:
        if not self._noisy or self._rng.random() < 0.5:
            return b""
        kind = self._rng.randrange(4)
        if kind == 0:
            return self._rng.randbytes(self._rng.randrange(1, 40))
        return [b"$", b"$C,77,PI", b"$C,1,LASER,1,1*0000\r\n"][kind - 1]


MACHINES = ["CPython", "MicroPython"]


def machine(name: str) -> AbstractContextManager[Target]:
    if name == "CPython":
        return cpython()
    require()
    return micropython()


@contextmanager
def talking(made: AbstractContextManager[Target], noisy: bool) -> Iterator[TriggerBoard]:
    with (
        made as target,
        Terminal(target, noisy) as terminal,
        TriggerBoard.open(BoardSpec(terminal.url), MonotonicClock()) as board,
    ):
        yield board


@pytest.mark.parametrize("made", MACHINES)
def test_ten_thousand_commands_among_garbage_are_all_answered(made: str) -> None:
    rng = random.Random(7)
    with talking(machine(made), noisy=True) as board:
        assert board.info.firmware == "2.0.0"
        time.sleep(0.1)
        last = board.vsync()
        for _ in range(COMMANDS):
            if rng.random() < 0.5:
                sides = (rng.random() < 0.5, rng.random() < 0.5)
                assert board.set_lasers(*sides) == LaserState(*sides)
            else:
                seen = board.vsync()
                assert seen.count >= last.count
                assert seen.board_now_us >= last.board_now_us
                last = seen
        counters = board.counters
        print(
            f"{made}: {counters.retries} of {COMMANDS} commands asked again, {counters.garbage_bytes} bytes of garbage"
        )
        assert counters.garbage_bytes > 10_000, "there was garbage"
        # None on an idle computer; an answer that a busy one was late to relay is asked for again, as on an instrument.
        assert counters.retries < COMMANDS / 100
        assert counters.lost_reports == 0


@pytest.mark.parametrize("made", MACHINES)
def test_the_driver_arms_and_hears_every_pulse(made: str) -> None:
    with talking(machine(made), noisy=False) as board:
        time.sleep(0.2)
        start = board.vsync().count + 20
        board.arm(24, start, 500, 12_000)
        with pytest.raises(BoardRefused, match="Send STOP first") as caught:
            board.live(1, 0, 50)
        assert caught.value.code == Refusal.BUSY
        pulses, deadline = [], time.monotonic() + 10.0
        while time.monotonic() < deadline:
            event = board.next_event(0.1)
            if isinstance(event, Pulse):
                pulses.append(event)
            if isinstance(event, PulsesDone):
                break
        assert [(p.index, p.vsync) for p in pulses] == [(k, start + k) for k in range(24)]
        assert board.health().ok
