"""Owns the life of one device: opened in the background, closed when lost, opened again with growing pauses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, contextmanager
from typing import Generic, TypeVar

from appliance.instrument.machine.events import DeviceDown, DeviceUp, Event
from appliance.instrument.machine.states import Device
from appliance.measure import FaultCode
from drivers.api import CardGone, Clock, DeviceError

T = TypeVar("T")

PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Pauses before the first, second … attempt to open a lost device again; the last one repeats for ever."""


class DeviceRejected(DeviceError):
    """The device is there but not fit for use; ``code`` is the precise name of what is wrong with it."""

    def __init__(self, device: str, message: str, remedy: str, code: FaultCode) -> None:
        super().__init__(device, message, remedy)
        self.code = code


class DeviceSupervisor(Generic[T]):
    """Keeps one device open. All methods are for the service's thread; only opening and closing run in ``executor``.

    ``executor`` ``None`` opens in the calling thread, for devices that belong to it.
    """

    def __init__(
        self,
        device: Device,
        open_device: Callable[[], AbstractContextManager[T]],
        clock: Clock,
        executor: Executor | None,
    ) -> None:
        self.device = device
        self._open = open_device
        self._clock = clock
        self._executor = executor
        self._context: AbstractContextManager[T] | None = None
        self._value: T | None = None
        self._pending: Future[tuple[AbstractContextManager[T], T]] | None = None
        self._failures = 0
        self._next_try_ns = clock.now_ns()
        self._reported: str | None = None
        self.tried = False
        """The first attempt has ended, one way or the other."""

    @property
    def value(self) -> T | None:
        """The open device, or ``None`` while it is lost."""
        return self._value

    def poll(self) -> DeviceUp | DeviceDown | None:
        """Go on opening; returns what changed since the last call. Never blocks with an executor."""
        if self._value is not None:
            return None
        if self._pending is None:
            if self._clock.now_ns() < self._next_try_ns:
                return None
            if self._executor is not None:
                self._pending = self._executor.submit(self._enter)
                return None
            # A future all the same, so that both ways of opening end in the lines below.
            pending: Future[tuple[AbstractContextManager[T], T]] = Future()
            try:
                pending.set_result(self._enter())
            except DeviceError as error:
                pending.set_exception(error)
            self._pending = pending
        if not self._pending.done():
            return None
        pending, self._pending = self._pending, None
        self.tried = True
        try:
            self._context, self._value = pending.result()
        except DeviceError as error:
            return self._failed(error)
        self._failures = 0
        self._reported = None
        return DeviceUp(self.device)

    def lose(self, reason: str) -> list[DeviceDown]:
        """Close a device that no longer works and begin anew; return that it went, or nothing when that is known
        already."""
        context, self._context, self._value = self._context, None, None
        if context is None:
            return []
        if self._executor is not None:
            # Closing takes its time (a thread to join, a transfer to end); the heartbeat must not wait with it.
            self._executor.submit(_leave, context)
        else:
            _leave(context)
        self._plan()
        self._reported = reason
        return [DeviceDown(self.device, reason)]

    @contextmanager
    def watched(self, inbox: list[Event]) -> Iterator[None]:
        """Work with the device inside; one that fails is lost, and ``inbox`` hears of it as of any other event.

        Raises CardGone: GL is lost with the graphics card, and comes back in another process only.
        """
        try:
            yield
        except CardGone:
            raise
        except DeviceError as error:
            inbox += self.lose(error.message)

    def close(self) -> None:
        """Close for good. Waits for an opening that is under way."""
        if self._pending is not None:
            try:
                # An opening cannot be cancelled half-way; closed only after it has ended, or its device would stay
                # taken.
                self._context, _ = self._pending.result(timeout=30.0)
            except (DeviceError, TimeoutError):
                self._context = None
            self._pending = None
        context, self._context, self._value = self._context, None, None
        if context is not None:
            _leave(context)

    def _enter(self) -> tuple[AbstractContextManager[T], T]:
        context = self._open()
        return context, context.__enter__()

    def _failed(self, error: DeviceError) -> DeviceDown | None:
        self._plan()
        # A device that is not there fails every few seconds: said once, and again when the reason is another one.
        if self._reported == error.message:
            return None
        self._reported = error.message
        return DeviceDown(self.device, error.message, error.code if isinstance(error, DeviceRejected) else None)

    def _plan(self) -> None:
        pause_s = PAUSES_S[min(self._failures, len(PAUSES_S) - 1)]
        self._failures += 1
        self._next_try_ns = self._clock.now_ns() + int(pause_s * 1e9)


def _leave(context: AbstractContextManager[T]) -> None:
    try:
        context.__exit__(None, None, None)
    except DeviceError:
        return  # it is gone; there is nothing left to close
