"""A device that is not there is tried again and again with growing pauses; one that comes is announced once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from appliance.machine.events import DeviceDown, DeviceUp
from appliance.machine.states import Device
from appliance.service.device_supervisor import PAUSES_S, DeviceSupervisor
from drivers.api import DeviceGone


class HandClock:
    """A clock that the test turns."""

    def __init__(self) -> None:
        self.time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_s(self, duration_s: float) -> None:
        self.time_ns += int(duration_s * 1e9)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        return predicate()


class Plug:
    def __init__(self) -> None:
        self.present = False
        self.tries = 0
        self.closed = 0

    @contextmanager
    def open(self) -> Iterator[str]:
        self.tries += 1
        if not self.present:
            raise DeviceGone("board", "not found", "Plug it in")
        try:
            yield "the device"
        finally:
            self.closed += 1


def test_pauses_grow_and_the_loss_is_told_once() -> None:
    clock, plug = HandClock(), Plug()
    supervisor = DeviceSupervisor(Device.BOARD, plug.open, clock, None)
    told = []
    for _ in range(4000):
        event = supervisor.poll()
        if event is not None:
            told.append(event)
        clock.sleep_s(0.01)
    assert told == [DeviceDown(Device.BOARD, "not found")]
    assert plug.tries == 1 + next(n for n in range(100) if sum((*PAUSES_S, *[PAUSES_S[-1]] * n)[: n + 1]) > 40.0)
    assert supervisor.tried


def test_it_comes_goes_and_comes_again() -> None:
    clock, plug = HandClock(), Plug()
    plug.present = True
    supervisor = DeviceSupervisor(Device.BOARD, plug.open, clock, None)
    assert supervisor.poll() == DeviceUp(Device.BOARD)
    assert supervisor.value == "the device"
    assert supervisor.poll() is None
    assert supervisor.lose("unplugged") == [DeviceDown(Device.BOARD, "unplugged")]
    assert supervisor.lose("unplugged") == []
    assert [supervisor.value] == [None]
    assert plug.closed == 1
    assert supervisor.poll() is None, "not before the pause"
    clock.sleep_s(PAUSES_S[0] + 0.01)
    assert supervisor.poll() == DeviceUp(Device.BOARD)
    supervisor.close()
    assert plug.closed == 2
