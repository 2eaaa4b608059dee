"""Owns the disk's thread, ``kf-storage``: one task after the other, and the events that answer those that were asked for."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self, TypeVar

from appliance.instrument.machine import events as on

Answer = TypeVar("Answer")
NICENESS = 10
"""Steps of priority behind the heartbeat, and so behind the worker, too: where processors are short, the diver has the cloud first, and the frames are durable
at about the same time, since both have to be done."""


class DiskQueue:
    """Does disk work in the order in which it was asked for. A context manager; called by the heartbeat only.

    One thread is what keeps the order: a task may rely on everything that was asked for before it having ended.
    """

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, "kf-storage", initializer=_step_back)
        self._answers: list[Future[list[on.Event]]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True)  # whatever is being written is finished first

    @property
    def busy(self) -> bool:
        """Something that was asked for has not been answered, or its answer was not fetched."""
        return bool(self._answers)

    def submit(self, work: Callable[[], Answer]) -> Future[Answer]:
        """Begin work whose answer somebody else waits for; it does not make the queue ``busy``."""
        return self._executor.submit(work)

    def ask(self, work: Callable[[], list[on.Event]]) -> None:
        """Begin work that is answered by events, which ``answered`` returns."""
        self._answers.append(self._executor.submit(work))

    def answered(self) -> list[list[on.Event]]:
        """Return the events of each task that ended since the last call, and forget it. Raises what a task raised."""
        done = [answer for answer in self._answers if answer.done()]
        self._answers = [answer for answer in self._answers if not answer.done()]
        return [answer.result() for answer in done]


def _step_back() -> None:
    """Let other threads go first; Linux has a priority for each."""
    thread = threading.get_native_id()
    os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + NICENESS)
