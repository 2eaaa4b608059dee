"""Owns the boards that must keep the protocol: the simulator's, and the firmware under CPython and under MicroPython."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol

from hw_sim.devices.board import Board
from tests.drivers.board.firmware.desk import Desk
from tests.hw_sim.devices.bench import Bench, bench
from tests.support.micropython import ROOT, desk_inside

FILES = [
    *(ROOT / "drivers" / "board" / "firmware" / name for name in ("hardware.py", "line.py", "core.py")),
    ROOT / "tests" / "drivers" / "board" / "firmware" / "desk.py",
]


class Target(Protocol):
    """A board as a host has it."""

    def exchange(self, data: bytes, time_us: int) -> bytes:
        """Send ``data``, let ``time_us`` of the board's time pass, return what it said."""

    def sync(self, there: bool) -> None:
        """Connect or disconnect the projector's video signal."""


class _Simulated:
    """The simulator's board on a bench, in time that stands still in between."""

    def __init__(self, made: Bench, board: Board) -> None:
        self._bench, self._board = made, board
        self._there = True
        made.on_blank = self._blank

    def _blank(self, time_ns: int) -> None:
        if self._there:
            self._board.vsync(time_ns)
        else:
            self._board.no_vsync(time_ns)

    def exchange(self, data: bytes, time_us: int) -> bytes:
        self._board.receive(data)
        self._bench.run_s(time_us * 1e-6)
        return self._board.take(self._board.waiting)

    def sync(self, there: bool) -> None:
        self._there = there


@contextmanager
def simulated() -> Iterator[Target]:
    with bench() as made:
        sensors = {"TBOARD": "-", "LEAK": "0"}
        board = Board(made.time, made.faults, lambda *_: None, lambda name: sensors.get(name, "21.5"), 1)
        made.changed.append(board.refresh)
        board.open = True
        # The port is open now: the reset is heard.
        made.faults.add("board wrong how=reset")
        yield _Simulated(made, board)


def cpython() -> AbstractContextManager[Target]:
    return nullcontext(Desk())


def micropython() -> AbstractContextManager[Target]:
    return desk_inside(FILES, "tests.drivers.board.firmware.desk", "Desk")


TARGETS: dict[str, Callable[[], AbstractContextManager[Target]]] = {
    "simulator": simulated,
    "firmware in CPython": cpython,
    "firmware in MicroPython": micropython,
}
