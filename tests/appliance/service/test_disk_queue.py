"""What is asked of the disk is done in its order, answered once, and finished before the program ends."""

from __future__ import annotations

import os
import threading
import time

import pytest

from appliance.machine import events as on
from appliance.scan.fault import FaultCode
from appliance.service.disk import DiskQueue

SAVED = on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED)


def wait_until_answered(queue: DiskQueue) -> list[list[on.Event]]:
    deadline_s = time.monotonic() + 10.0
    while not (found := queue.answered()):
        assert time.monotonic() < deadline_s
        threading.Event().wait(0.002)
    return found


def test_a_task_that_is_answered_by_events_keeps_the_queue_busy_until_they_are_fetched_once() -> None:
    gate = threading.Event()
    with DiskQueue() as queue:
        queue.ask(lambda: [SAVED])
        assert wait_until_answered(queue) == [[SAVED]]
        assert (queue.busy, queue.answered()) == (False, [])
        queue.ask(lambda: [] if gate.wait(10.0) else [SAVED])
        queue.ask(lambda: [SAVED, SAVED])
        assert queue.answered() == [], "nothing of it has ended"
        assert queue.busy
        gate.set()
        found = wait_until_answered(queue)
        while len(found) < 2:
            found += wait_until_answered(queue)
        assert found == [[], [SAVED, SAVED]]


def test_what_is_being_written_is_finished_before_the_program_ends() -> None:
    written = []

    def write(what: str, lasts_s: float) -> list[on.Event]:
        threading.Event().wait(lasts_s)
        written.append(what)
        return []

    with DiskQueue() as queue:
        queue.ask(lambda: write("frames", 0.1))
        queue.ask(lambda: write("cloud", 0.0))
    assert written == ["frames", "cloud"]


def test_what_a_task_raises_is_raised_where_its_answer_is_fetched() -> None:
    def fails() -> list[on.Event]:
        raise OSError("the disk is gone")

    with DiskQueue() as queue:
        queue.ask(fails)
        with pytest.raises(OSError, match="the disk is gone"):
            wait_until_answered(queue)
        assert not queue.busy


def test_the_disk_steps_back_behind_whoever_computes_what_the_diver_waits_for() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    with DiskQueue() as queue:
        assert queue.submit(priority).result(10.0) == priority() + 10
