"""Frame grabber: the thread of one camera.

    Grabber          one camera in its own thread, ``kf-camera-left`` or ``kf-camera-right``; a context manager
    SideRecording    one side of a sequence being recorded
    Timeouts         time limits of a capture: in the projector's periods, and never less than a host may be late

Only this thread calls the camera. Other threads give orders (idle, live, record) and read results. A lost camera ends
the thread; the service opens a new one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.api import Camera, CameraSettings, Clock, ClockReading, DeviceError, Frame, FrameStatus


@dataclass(frozen=True, slots=True)
class Timeouts:
    """Time limits of a sequence. At 60 Hz and faster the seconds count, at slower rates the periods."""

    refresh_hz: float

    def _at_least(self, seconds: float, periods: float) -> float:
        return max(seconds, periods / self.refresh_hz)

    @property
    def ready_s(self) -> float:
        """Time for both cameras to leave their live views, and again for both to start."""
        return self._at_least(2.0, 12)

    @property
    def first_frame_s(self) -> float:
        """Time from a ready camera to its first frame: the other camera, the heartbeat, the first blank."""
        return self._at_least(2.0, 24)

    @property
    def next_frame_s(self) -> float:
        """Time after which a frame counts as lost."""
        return self._at_least(0.15, 9)

    @property
    def silence_s(self) -> float:
        """Time of a little over two vertical blanks after the last frame, in which no other may come."""
        return self._at_least(0.035, 2.1)

    @property
    def collect_s(self) -> float:
        """Time from the last pattern until a camera has its last frame, or has given it up."""
        return self._at_least(2.5, 12)

    @property
    def pulse_s(self) -> float:
        """Time from one pulse's report to the next."""
        return self._at_least(0.25, 3)

    @property
    def margin_s(self) -> float:
        """Time beyond the length of the sequence: to find the vertical blank, and to wait for missing frames."""
        return self._at_least(5.0, 40)


LIVE_TIMEOUT_S = 0.15
"""Longest wait for a live image, during which an order to stop is not heard.

With a slow projector, a later image is waited for again.
"""
JOIN_TIMEOUT_S = 5.0


@dataclass(slots=True)
class SideRecording:
    """One side of a sequence being recorded. Filled by the camera's thread, read after ``done``."""

    slots: NDArray[np.uint8]
    """Memory for the frames, (n, h, w) uint8."""
    on_frame: Callable[[int], None]
    """Called in the camera's thread after each complete frame, with its index. Must not block."""
    ready: bool = False
    done: bool = False
    cancelled: bool = False
    frames: list[Frame] = field(default_factory=list)
    """Frames in order of arrival; the first incomplete frame is the last."""
    clock: ClockReading | None = None
    """The camera's clock just before the sequence."""
    lost: str | None = None
    """Reason why the camera was lost, if it was."""

    @property
    def complete(self) -> bool:
        """True if all frames arrived complete. The ledger checks their ids."""
        return self.done and len(self.frames) == len(self.slots) and self.frames[-1].status is FrameStatus.COMPLETE


class Grabber:
    """Runs one camera in its own thread. A context manager: leaving it stops the thread, not the camera."""

    def __init__(self, side: str, camera: Camera, clock: Clock, settings: CameraSettings, timeouts: Timeouts) -> None:
        """Prepare the thread. ``settings``: those that the camera has."""
        self.side = side
        self._camera = camera
        self._clock = clock
        self._changed = threading.Condition()
        self._order: Literal["idle", "live", "record", "end"] = "idle"
        self._state: Literal["idle", "start", "live", "record"] = "idle"
        self._recording: SideRecording | None = None
        self._settings = self._next_settings = settings
        self._timeouts = timeouts
        self._live = np.zeros((2, settings.height_px, settings.width_px), np.uint8)
        self._live_count = 0
        self._lost: str | None = None
        self._temperature_c: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"kf-camera-{side}", daemon=True)

    def __enter__(self) -> Grabber:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._set("end")
        self._thread.join(JOIN_TIMEOUT_S)

    @property
    def lost(self) -> str | None:
        """Reason why the camera was lost; ``None`` while it works."""
        with self._changed:
            return self._lost

    @property
    def temperature_c(self) -> float | None:
        """Temperature of the camera when it was idle last."""
        with self._changed:
            return self._temperature_c

    def expose(self, exposure_us: float, gain_db: float) -> None:
        """Set the exposure for the next start of the camera; ``live`` and ``record`` start it."""
        with self._changed:
            self._next_settings = replace(self._settings, exposure_us=exposure_us, gain_db=gain_db)

    def live(self) -> None:
        """Record live images, at the rate of the board's pulses."""
        self._set("live")

    def leave(self) -> None:
        """Order the camera to stop; returns at once. ``idle`` waits for it."""
        self._set("idle")

    def idle(self, timeout_s: float = 2.0) -> bool:
        """Stop the camera; return True when it has stopped (or is lost)."""
        self._set("idle")
        with self._changed:
            return self._clock.wait_for(
                self._changed, lambda: self._state == "idle" or self._lost is not None, timeout_s
            )

    def latest(self, newer_than: int) -> tuple[int, NDArray[np.uint8]] | None:
        """Return a copy of the newest live image (h, w) uint8 and its number, if above ``newer_than``."""
        with self._changed:
            # Copied under the lock: the driver fills the other half of the double buffer, and then this one.
            if self._live_count <= newer_than or self._live_count == 0:
                return None
            return self._live_count, self._live[self._live_count % 2].copy()

    def record(self, slots: NDArray[np.uint8], on_frame: Callable[[int], None]) -> SideRecording:
        """Start recording ``len(slots)`` frames; returns at once.

        Wait for ``ready`` before arming, then for ``done``.
        """
        recording = SideRecording(slots, on_frame)
        with self._changed:
            # The thread of a lost camera is over, so the recording is ended here.
            if self._lost is not None:
                recording.lost, recording.done = self._lost, True
                return recording
            self._recording = recording
            self._order = "record"
            self._changed.notify_all()
        return recording

    def wait(self, recording: SideRecording, what: Literal["ready", "done"], timeout_s: float) -> bool:
        """Wait for a recording to be ready or done."""
        with self._changed:
            return self._clock.wait_for(
                self._changed, lambda: recording.done or bool(getattr(recording, what)), timeout_s
            )

    def cancel(self, recording: SideRecording) -> None:
        """End a recording at the next frame or timeout."""
        with self._changed:
            recording.cancelled = True
            self._changed.notify_all()

    def _set(self, order: Literal["idle", "live", "record", "end"]) -> None:
        with self._changed:
            self._order = order
            self._changed.notify_all()

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    self._clock.wait_for(self._changed, lambda: self._order != "idle", 1.0)
                    order = self._order
                    if order in {"live", "record"}:
                        self._state = "start"  # idle() waits for a camera that is starting as for one that runs
                if order == "end":
                    self._camera.stop()
                    return
                if order == "live":
                    self._run_live()
                elif order == "record":
                    self._run_record()
                else:
                    self._read_temperature()
        except DeviceError as error:
            self._fail(error.message)

    def _read_temperature(self) -> None:
        temperature_c = self._camera.temperature_c()
        with self._changed:
            self._temperature_c = temperature_c

    def _start(self) -> None:
        with self._changed:
            settings = self._next_settings
        if settings != self._settings:
            self._camera.configure(settings)
            self._settings = settings
        self._camera.start()

    def _run_live(self) -> None:
        self._start()
        with self._changed:
            self._state = "live"
            self._changed.notify_all()
        while True:
            with self._changed:
                if self._order != "live":
                    break
                # Double buffer: the reader copies the half that was filled last while the driver fills the other one.
                back = self._live[(self._live_count + 1) % 2]
            frame = self._camera.next_frame(back, LIVE_TIMEOUT_S)
            if frame.status is FrameStatus.COMPLETE:
                with self._changed:
                    self._live_count += 1
                    self._changed.notify_all()
        self._camera.stop()
        with self._changed:
            self._state = "idle"
            self._changed.notify_all()

    def _run_record(self) -> None:
        with self._changed:
            recording = self._recording
        assert recording is not None
        self._start()
        # Read while the camera waits for its first pulse: later it would compete with the frames for the bus.
        clock = self._camera.read_clock()
        with self._changed:
            recording.clock = clock
            self._state = "record"
            recording.ready = True
            self._changed.notify_all()
        timeout_s = self._timeouts.first_frame_s
        for index, slot in enumerate(recording.slots):
            frame = self._camera.next_frame(slot, timeout_s)
            timeout_s = self._timeouts.next_frame_s
            with self._changed:
                recording.frames.append(frame)
                stop = recording.cancelled or frame.status is not FrameStatus.COMPLETE
            # The first bad frame ends the recording: later ones cannot make a cloud, and the play ends at the next blank.
            if stop:
                break
            recording.on_frame(index)
        else:
            self._expect_silence(recording)
        self._camera.stop()
        with self._changed:
            recording.done = True
            if self._recording is recording:  # not one that was ordered meanwhile
                self._recording = None
                if self._order == "record":
                    self._order = "idle"
            self._state = "idle"
            self._changed.notify_all()

    def _expect_silence(self, recording: SideRecording) -> None:
        """Record any frame after the last one: too many is evidence like too few."""
        frame = self._camera.next_frame(self._live[0], self._timeouts.silence_s)
        if frame.status is not FrameStatus.TIMEOUT:
            with self._changed:
                recording.frames.append(frame)

    def _fail(self, reason: str) -> None:
        with self._changed:
            self._lost = reason
            self._state = "idle"
            if self._recording is not None:
                self._recording.lost = reason
                self._recording.done = True
            self._changed.notify_all()
