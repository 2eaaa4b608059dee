"""The devices of a rig: how each is opened and kept open. The composition root.

Devices             all devices; a context manager
DeviceSupervisor    one device: opened in the background, closed when lost, opened again with growing pauses
KeyReader           the thread ``kf-keys``, which waits for the diver's keys
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from appliance.instrument.capture.grabber import Grabber, Timeouts
from appliance.instrument.machine.events import DeviceDown, DeviceUp, Event
from appliance.instrument.machine.states import Device
from appliance.measure import Exposure, FaultCode, of_side
from appliance.store import CameraRig, OutputRig, Rig
from drivers import rig as drivers_rig
from drivers.api import (
    Board,
    Camera,
    CameraSettings,
    CardGone,
    Clock,
    DeviceError,
    DeviceRefused,
    Display,
    KeyEvent,
    Keys,
    KeysLost,
    Projector,
    Wires,
)

T = TypeVar("T")

PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Pauses before the first, second … attempt to open a lost device again; the last one repeats for ever."""


class DeviceRejected(DeviceError):
    """The device is present but not fit for use; ``code``: its precise fault."""

    def __init__(self, device: str, message: str, remedy: str, code: FaultCode) -> None:
        super().__init__(device, message, remedy)
        self.code = code


class DeviceSupervisor(Generic[T]):
    """Keeps one device open. Methods are for the service's thread, which never waits for the device.

    Opening and closing run in ``executor``; ``None`` opens in the calling thread, for devices that belong to it.
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
        """True if the first attempt has ended, with or without success."""

    @property
    def value(self) -> T | None:
        """The open device, or ``None`` while it is lost."""
        return self._value

    def poll(self) -> DeviceUp | DeviceDown | None:
        """Go on opening; return the change since the last call. Never blocks with an executor."""
        if self._value is not None:
            return None
        if self._pending is None:
            if self._clock.now_ns() < self._next_try_ns:
                return None
            if self._executor is not None:
                self._pending = self._executor.submit(self._enter)
                return None
            # A future as well, so that both ways of opening end in the lines below.
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
        """Close a device that no longer works and plan to open it; return its loss, if it is new."""
        context, self._context, self._value = self._context, None, None
        if context is None:
            return []
        if self._executor is not None:
            # Closing may take long (a thread to join, a transfer to end); the service's cycle must not wait for it.
            self._executor.submit(_leave, context)
        else:
            _leave(context)
        self._plan()
        self._reported = reason
        return [DeviceDown(self.device, reason)]

    @contextmanager
    def watched(self, inbox: list[Event]) -> Iterator[None]:
        """Work with the device inside; if it fails, it is lost, and ``inbox`` gets the event.

        Raises CardGone: GL is lost with the graphics card, and needs another process.
        """
        try:
            yield
        except CardGone:
            raise
        except DeviceError as error:
            inbox += self.lose(error.message)

    def close(self) -> None:
        """Close for good. Waits for a pending opening."""
        if self._pending is not None:
            try:
                # A pending opening cannot be cancelled; its device is closed after it has ended.
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
        # An absent device fails every few seconds: reported once, and again for another reason.
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


READ_TIMEOUT_S = 0.25
QUEUE_SIZE = 64
JOIN_TIMEOUT_S = 2.0


class KeyReader:
    """Reads the keypad in its own thread. With 64 unread events, newer ones are dropped."""

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
        """Return the events since the last call, in order."""
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
            # Only this thread puts, so that putting never waits.
            if not self._queue.full():
                self._queue.put_nowait(event)
            if isinstance(event, KeysLost):
                return


class Devices:
    """All devices, each kept open by its supervisor. A context manager."""

    def __init__(self, rig: Rig, wires: Wires, load_projector: Callable[[Projector], None]) -> None:
        """Prepare; ``load_projector`` is called with each newly opened projector, to load its patterns."""
        self._rig = rig
        self._wires = wires
        self._timeouts = Timeouts(rig.projector.refresh_hz)
        self._load_projector = load_projector
        self._executor = ThreadPoolExecutor(4, "kf-open")
        projector = replace(output_spec(rig.projector), all_channels=rig.projector.channels == "all")
        self._outputs = drivers_rig.open_outputs(projector, output_spec(rig.display), wires)
        clock = wires.clock
        self.cameras: dict[str, DeviceSupervisor[Grabber]] = {
            "left": DeviceSupervisor(Device.CAMERA_LEFT, lambda: self._camera("left"), clock, self._executor),
            "right": DeviceSupervisor(Device.CAMERA_RIGHT, lambda: self._camera("right"), clock, self._executor),
        }
        self.board: DeviceSupervisor[Board] = DeviceSupervisor(Device.BOARD, self._board, clock, self._executor)
        self.keys: DeviceSupervisor[KeyReader] = DeviceSupervisor(Device.KEYS, self._keys, clock, self._executor)
        # No executor: outputs draw by GL, whose context belongs to the service's main thread.
        self.display: DeviceSupervisor[Display] = DeviceSupervisor(Device.DISPLAY, self._display, clock, None)
        self.projector: DeviceSupervisor[Projector] = DeviceSupervisor(Device.PROJECTOR, self._projector, clock, None)

    def __enter__(self) -> Self:
        self._outputs.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for supervisor in self._supervisors():
            supervisor.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._outputs.__exit__(kind, error, trace)

    @property
    def all_tried(self) -> bool:
        """True if every device was tried once."""
        return all(supervisor.tried for supervisor in self._supervisors())

    def openers(self) -> dict[str, Callable[[], AbstractContextManager[Any]]]:
        """Return for each device, by its name in the rig file, a function that opens it for a health check."""
        wires, rig = self._wires, self._rig
        keys = drivers_rig.KeysSpec(rig.keys.vendor_id, rig.keys.product_id)
        return {
            "camera.left": lambda: self._set_up("left"),
            "camera.right": lambda: self._set_up("right"),
            "board": lambda: drivers_rig.open_board(drivers_rig.BoardSpec(rig.board.url), wires),
            "keys": lambda: drivers_rig.open_keys(keys, wires),
            "projector": self._projector,
            "display": self._display,
        }

    def _supervisors(self) -> list[DeviceSupervisor[Any]]:
        """Return all of them, in the order of closing."""
        return [*self.cameras.values(), self.keys, self.board, self.projector, self.display]

    def poll(self) -> list[DeviceUp | DeviceDown]:
        """Return the devices that came and went since the last call."""
        changes: list[DeviceUp | DeviceDown | None] = []
        for camera in self.cameras.values():
            # A grabber reports the loss of its camera: its thread cannot close it while the cycle may use it.
            reason = camera.value.lost if camera.value is not None else None
            changes += camera.lose(reason) if reason is not None else [camera.poll()]
        changes += [self.display.poll(), self.board.poll(), self.keys.poll(), self.projector.poll()]
        return [change for change in changes if change is not None]

    @contextmanager
    def _camera(self, side: str) -> Iterator[Grabber]:
        with ExitStack() as stack:
            try:
                camera, settings = self._configured(side, stack)
            except DeviceRefused as error:  # it is present: the plug is not the cause
                message = f"{error.message}; {error.remedy}"
                raise DeviceRejected(error.device, message, error.remedy, FaultCode.CAMERA_REFUSED) from error
            yield stack.enter_context(Grabber(side, camera, self._wires.clock, settings, self._timeouts))

    def _configured(self, side: str, stack: ExitStack) -> tuple[Camera, CameraSettings]:
        """Return a camera that is open until ``stack`` closes, and its settings. Raises DeviceError."""
        camera = stack.enter_context(self.open_camera(side))
        slow = camera.slow_link
        if slow is not None:
            # At 480 Mbit/s a frame of 1.92 MB takes 32 ms at the very least; the projector's period is 16.7 ms.
            raise DeviceRejected(f"camera.{side}", slow, "Check connector and cable", FaultCode.CAMERA_SLOW_LINK)
        settings = self._settings(side)
        camera.configure(settings)
        return camera, settings

    @contextmanager
    def _set_up(self, side: str) -> Iterator[Camera]:
        """Open a camera and configure it, unless its link is slow, which its health check reports."""
        with self.open_camera(side) as camera:
            # Configuring is part of the check, so that refusals are known before the first scan.
            if camera.slow_link is None:
                camera.configure(self._settings(side))
            yield camera

    def _settings(self, side: str) -> CameraSettings:
        spec = self._camera_rig(side)
        return CameraSettings(spec.width_px, spec.height_px, 1000.0 * spec.exposure_ms, spec.gain_db)

    def open_camera(self, side: str) -> AbstractContextManager[Camera]:
        """Open one camera once, without configuring it."""
        camera = self._camera_rig(side)
        spec = drivers_rig.CameraSpec(
            f"camera.{side}",
            camera.serial,
            camera.trigger_source,
            camera.pixel_format,
            camera.offset_x_px,
            camera.offset_y_px,
            tuple(camera.features.items()),
        )
        return drivers_rig.open_camera(spec, self._wires, self._rig.camera.kind)

    def _camera_rig(self, side: str) -> CameraRig:
        return of_side(self._rig.camera, side)

    def expose(self, exposure: Exposure) -> None:
        """Set the exposure of both cameras from their next image on; a camera that comes later gets it then.

        If the rig file sets the right camera differently from the left one, the difference is kept.
        """
        left, right = self._rig.camera.left, self._rig.camera.right
        for side, spec in (("left", left), ("right", right)):
            grabber = self.cameras[side].value
            if grabber is not None:
                time_us = exposure.time_us * spec.exposure_ms / left.exposure_ms
                grabber.expose(time_us, exposure.gain_db + spec.gain_db - left.gain_db)

    @contextmanager
    def _board(self) -> Iterator[Board]:
        with drivers_rig.open_board(drivers_rig.BoardSpec(self._rig.board.url), self._wires) as board:
            board.stop()
            # An earlier process may have left them on.
            board.set_lasers(False, False)
            yield board

    @contextmanager
    def _keys(self) -> Iterator[KeyReader]:
        spec = drivers_rig.KeysSpec(self._rig.keys.vendor_id, self._rig.keys.product_id)
        with drivers_rig.open_keys(spec, self._wires) as pad, KeyReader(pad) as reader:
            yield reader

    @contextmanager
    def _display(self) -> Iterator[Display]:
        yield self._outputs.open_display()

    @contextmanager
    def _projector(self) -> Iterator[Projector]:
        projector = self._outputs.open_projector()
        self._load_projector(projector)
        yield projector


def output_spec(spec: OutputRig) -> drivers_rig.OutputSpec:
    """Return the driver's specification of an output in the rig file."""
    return drivers_rig.OutputSpec(
        drivers_rig.OutputKind(spec.kind), spec.card, spec.connector, spec.width_px, spec.height_px, spec.refresh_hz
    )
