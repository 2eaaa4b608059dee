"""Owns the thread that waits for the diver's keys, ``kf-keys``."""

from __future__ import annotations

import queue
import threading
from types import TracebackType
from typing import Self

from drivers.api import DeviceError, KeyEvent, Keys, KeysLost

READ_TIMEOUT_S = 0.25
QUEUE_SIZE = 64
JOIN_TIMEOUT_S = 2.0


class KeyReader:
    """Reads a key pad in its own thread. When 64 events wait unread, newer ones are dropped: nobody is listening."""

    def __init__(self, keys: Keys) -> None:
        self._keys = keys
        self._queue: queue.Queue[KeyEvent] = queue.Queue(QUEUE_SIZE)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="kf-keys", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join(JOIN_TIMEOUT_S)

    def take(self) -> list[KeyEvent]:
        """Return what happened since the last call, in order."""
        events: list[KeyEvent] = []
        while len(events) < QUEUE_SIZE:
            try:
                events.append(self._queue.get_nowait())
            except queue.Empty:
                break
        return events

    def _run(self) -> None:
        while not self._end.is_set():
            try:
                event = self._keys.next_event(READ_TIMEOUT_S)
            except DeviceError as error:
                event = KeysLost(error.message)
            if event is None:
                continue
            # One thread puts: where there is room, putting does not wait.
            if not self._queue.full():
                self._queue.put_nowait(event)
            if isinstance(event, KeysLost):
                return
