"""A device that is not there is tried again and again with growing pauses; one that comes is announced once."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from appliance.instrument.machine.events import DeviceDown, DeviceUp, Event
from appliance.instrument.machine.states import Device
from appliance.instrument.service.devices import PAUSES_S, DeviceRejected, DeviceSupervisor
from appliance.measure.fault import FaultCode
from drivers.api import CardGone, DeviceError, DeviceGone
from tests.drivers.clock import SteppedClock


class Plug:
    def __init__(self) -> None:
        self.present = False
        self.tries = 0
        self.closed = 0
        self.why: DeviceError = DeviceGone("board", "not found", "Plug it in")

    @contextmanager
    def open(self) -> Iterator[str]:
        self.tries += 1
        if not self.present:
            raise self.why
        try:
            yield "the device"
        finally:
            self.closed += 1


def test_pauses_grow_and_the_loss_is_told_once() -> None:
    clock, plug = SteppedClock(), Plug()
    supervisor = DeviceSupervisor(Device.BOARD, plug.open, clock, None)
    told = []
    for _ in range(4000):
        event = supervisor.poll()
        if event is not None:
            told.append(event)
        clock.sleep_s(0.01)
    assert told == [DeviceDown(Device.BOARD, "not found")]
    assert PAUSES_S == (0.2, 0.5, 1.0, 2.0, 5.0)
    assert plug.tries == 1 + next(n for n in range(100) if sum((*PAUSES_S, *[PAUSES_S[-1]] * n)[: n + 1]) > 40.0)
    assert supervisor.tried


def test_the_reason_is_told_again_when_it_is_another_one_and_pauses_begin_anew_once_it_was_there() -> None:
    clock, plug = SteppedClock(), Plug()
    supervisor = DeviceSupervisor(Device.BOARD, plug.open, clock, None)
    assert not supervisor.tried
    assert supervisor.poll() == DeviceDown(Device.BOARD, "not found")
    plug.why = DeviceRejected("board", "too slow", "Check the cable", FaultCode.CAMERA_SLOW_LINK)
    clock.sleep_s(0.19)
    assert supervisor.poll() is None
    assert plug.tries == 1, "not before the pause"
    clock.sleep_s(0.01)
    assert supervisor.poll() == DeviceDown(Device.BOARD, "too slow", FaultCode.CAMERA_SLOW_LINK)
    plug.present = True
    clock.sleep_s(0.5)
    assert supervisor.poll() == DeviceUp(Device.BOARD)
    plug.present = False
    supervisor.lose("unplugged")
    clock.sleep_s(0.2)
    plug.why = DeviceGone("board", "unplugged", "Plug it in")
    assert supervisor.poll() is None, "that is known"
    assert plug.tries == 4


def test_a_device_that_fails_at_work_is_lost_and_told_but_a_card_that_is_gone_ends_the_process() -> None:
    clock, plug, inbox = SteppedClock(), Plug(), list[Event]()
    plug.present = True
    supervisor = DeviceSupervisor(Device.BOARD, plug.open, clock, None)
    supervisor.poll()
    with supervisor.watched(inbox):
        pass
    assert inbox == []
    with pytest.raises(CardGone), supervisor.watched(inbox):
        _fail(CardGone("projector", "gone", "Restart"))
    assert supervisor.value == "the device"
    with supervisor.watched(inbox):
        _fail(DeviceGone("board", "silent", "Plug it in"))
    assert inbox == [DeviceDown(Device.BOARD, "silent")]
    assert plug.closed == 1


def _fail(error: DeviceError) -> None:
    raise error


def test_an_executor_opens_and_closes_and_nobody_waits() -> None:
    clock, plug = SteppedClock(), Plug()
    plug.present = True
    with ThreadPoolExecutor(1) as executor:
        gate = threading.Event()
        executor.submit(gate.wait, 10.0)
        supervisor = DeviceSupervisor(Device.BOARD, plug.open, clock, executor)
        assert [supervisor.poll()] == [None]
        assert [supervisor.tried] == [False]
        gate.set()
        executor.submit(int).result(10.0)
        assert supervisor.poll() == DeviceUp(Device.BOARD)
        assert (plug.tries, supervisor.tried) == (1, True)
        assert supervisor.lose("unplugged") == [DeviceDown(Device.BOARD, "unplugged")]
        executor.submit(int).result(10.0)
        assert plug.closed == 1
        clock.sleep_s(0.2)
        supervisor.poll()
        supervisor.close()
        assert plug.closed == 2, "an opening that was under way is closed, too"
