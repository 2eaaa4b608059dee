"""The frames of one running acquisition: buffers wait in Aravis' queue and return with a status."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.api import Clock, DeviceRefused, Frame, FrameStatus
from drivers.aravis.buses import Bus
from drivers.aravis.device import AravisDevice
from drivers.aravis.library import STUCK, AravisError, BufferCode
from drivers.camera.pixels import PixelFormat
from drivers.camera.usb import TransferBuffer, transfer_buffer

LEAST_BUFFERS = 16
"""Number of buffers: a reader may be late by a quarter of a second at 60 Hz. A frame without a free buffer is lost, and
its number is missing.
"""
ROOM = 12 * 1024 * 1024
"""Smallest total size of buffers, for small images: with less than the 8 MiB that Aravis submits over USB, its thread
spins in an empty loop.
"""
LOOK_S = 0.25
"""Time without a frame after which the camera is checked."""
STALE_LIMIT = 32
"""Largest number of frames of an earlier acquisition that are dropped in one call."""
_STATUS = {
    BufferCode.TIMEOUT: FrameStatus.TRUNCATED,
    BufferCode.MISSING_PACKETS: FrameStatus.TRUNCATED,
    BufferCode.SIZE_MISMATCH: FrameStatus.TRUNCATED,
    BufferCode.ABORTED: FrameStatus.TRUNCATED,
}
"""Statuses of truncated frames; all others but success count as corrupt."""


class AravisStream:
    """The frames of one acquisition, for one thread; ``close`` ends it.

    Images arrive in the library's buffers, also between two calls. One copy, or the reduction of more than 8 bits,
    brings each into the caller's array, and the buffer returns to the queue.
    """

    def __init__(
        self,
        device: AravisDevice,
        bus: Bus,
        clock: Clock,
        size_px: tuple[int, int],
        pixels: PixelFormat,
        payload_size: int,
    ) -> None:
        """Make the stream and its buffers for images of ``size_px`` (width, height).

        Raises DeviceGone, DeviceRefused.
        """
        self._device, self._bus, self._clock = device, bus, clock
        self._width_px, self._height_px = size_px
        self._pixels, self._payload_size = pixels, payload_size
        self._since_ns: int | None = None
        self._ended = False
        call = self._call = device.aravis.call
        try:
            self._handle: int | None = device.aravis.checked(
                lambda error: call.arv_device_create_stream(device.handle, None, None, error)
            )
        except AravisError as error:
            raise device.failed("request for its images", error) from error
        for _ in range(max(LEAST_BUFFERS, -(-ROOM // payload_size))):
            call.arv_stream_push_buffer(self._handle, call.arv_buffer_new_allocate(payload_size))

    def end(self) -> None:
        """Make a reader return within ``LOOK_S``: from any thread, before ``close``."""
        self._ended = True

    def close(self) -> None:
        """End the stream and free its buffers; idempotent. Raises DeviceRefused when the library hangs."""
        handle, self._handle = self._handle, None
        if handle is not None and not self._device.aravis.end_stream(handle, self._device.name):
            raise DeviceRefused(self._device.name, *STUCK)

    def expect_since(self, camera_ns: int | None) -> None:
        """Drop frames that are older than this time of the camera's clock, up to the first that is not.

        ``None``: take every frame.
        """
        self._since_ns = camera_ns

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> Frame:
        """Return the next frame, with its image in ``slot``; see ``drivers.api.Camera``.

        Raises ValueError for a slot of another shape or kind, DeviceGone when the camera is lost.
        """
        if slot.shape != (self._height_px, self._width_px):
            raise ValueError(
                f"slot of shape {slot.shape}, but the frames of {self._device.name} are {self._height_px} x {self._width_px}"
            )
        target = transfer_buffer(slot)
        deadline_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        for _ in range(STALE_LIMIT):
            frame = self._take(target, deadline_ns)
            if not self._stale(frame):
                break
        if frame.camera_time_ns is not None:
            self._since_ns = None
        if frame.status not in (FrameStatus.COMPLETE, FrameStatus.TIMEOUT):
            self._bus.check()  # one that is unplugged in the middle of a frame is lost, not damaged
        return frame

    def _stale(self, frame: Frame) -> bool:
        stamp_ns, since_ns = frame.camera_time_ns, self._since_ns
        return stamp_ns is not None and since_ns is not None and stamp_ns < since_ns

    def _take(self, target: TransferBuffer, deadline_ns: int) -> Frame:
        for _ in range(STALE_LIMIT):
            buffer = self._wait(deadline_ns)
            if buffer is None:
                break
            received_ns = self._clock.now_ns()
            try:
                block_id = self._bus.block_id(int(self._call.arv_buffer_get_frame_id(buffer)))
                if block_id is not None:
                    return self._judge(buffer, block_id, target, received_ns)
            finally:
                self._call.arv_stream_push_buffer(self._handle, buffer)
        return Frame(FrameStatus.TIMEOUT, None, None, self._clock.now_ns(), "no frame")

    def _wait(self, deadline_ns: int) -> int | None:
        """Return the next buffer from the library; ``None`` after the time. Raises DeviceGone."""
        while True:
            left_s = max(0.0, (deadline_ns - self._clock.now_ns()) * 1e-9)
            wait_us = round(min(left_s, LOOK_S) * 1e6)
            buffer: int | None = self._call.arv_stream_timeout_pop_buffer(self._handle, wait_us)
            if buffer is not None:
                return buffer
            if self._ended:
                return None
            self._bus.check()
            if left_s <= LOOK_S:
                return None

    def _judge(self, buffer: int, block_id: int, target: TransferBuffer, received_ns: int) -> Frame:
        """Return the frame of a buffer with its status; a complete image is copied into ``target``."""
        call = self._call
        code = BufferCode(call.arv_buffer_get_status(buffer))
        if code in (BufferCode.UNKNOWN, BufferCode.CLEARED):
            return Frame(FrameStatus.CORRUPT, None, None, received_ns, code.name.lower())
        if code is not BufferCode.SUCCESS:
            # Its numbers may be those of the frame that was in this buffer before.
            return _frames(None, 0, received_ns)(
                _STATUS.get(code, FrameStatus.CORRUPT), code.name.lower().replace("_", " ")
            )
        make_frame = _frames(block_id, int(call.arv_buffer_get_timestamp(buffer)), received_ns)
        problem = self._unexpected(buffer)
        if problem:
            return make_frame(FrameStatus.CORRUPT, problem)
        size = ctypes.c_size_t()
        data = call.arv_buffer_get_data(buffer, ctypes.byref(size))
        if size.value < self._payload_size:
            return make_frame(FrameStatus.TRUNCATED, f"payload of {size.value} of {self._payload_size} bytes")
        if self._pixels.reduce is None:
            ctypes.memmove(target.ctypes.data, data, self._payload_size)
        else:
            raw = (ctypes.c_uint8 * self._payload_size).from_address(data)
            self._pixels.reduce(np.ctypeslib.as_array(raw), target)
        return make_frame(FrameStatus.COMPLETE, "")

    def _unexpected(self, buffer: int) -> str:
        """Return the fault of the geometry that the frame itself states; empty: none."""
        call = self._call
        pixel_format = int(call.arv_buffer_get_image_pixel_format(buffer))
        if pixel_format != self._pixels.code:
            return f"pixel format {pixel_format:#010x}, expected {self._pixels.name}"
        width_px, height_px = call.arv_buffer_get_image_width(buffer), call.arv_buffer_get_image_height(buffer)
        if (width_px, height_px) != (self._width_px, self._height_px):
            return f"image of {width_px} x {height_px}, expected {self._width_px} x {self._height_px}"
        return ""


def _frames(block_id: int | None, camera_time_ns: int, received_ns: int) -> Callable[[FrameStatus, str], Frame]:
    """Return a function that makes the frame from a status.

    A stamp of 0 is none: the camera keeps no time.
    """

    def made(status: FrameStatus, detail: str) -> Frame:
        return Frame(status, block_id, camera_time_ns or None, received_ns, detail)

    return made
