"""libaravis 0.8 and GObject as the tests have them: the functions of the reference manual, over cameras that are a register memory.

Numbers (codes of errors and buffers, the mode of USB) are the library's headers', not the driver's.
"""

from __future__ import annotations

import ctypes
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from tests.drivers.camera.scripted import OF_ADDRESS, ScriptedCamera, description
from tests.drivers.clock import SteppedClock

LATCH, TICKS = 0x944, 0x948
"""Registers of GigE Vision 1.2: timestamp control and value."""


@dataclass
class SentImage:
    """One buffer as the library gives it back."""

    data: bytes = b""
    status: int = 0
    number: int = 1
    stamp_ns: int = 7_000_000_000
    size_px: tuple[int, int] = (64, 48)
    pixel_format: int = 0x01080001
    after_s: float = 0.0
    claimed_bytes: int | None = None


OF_AN_IMAGE: dict[str, Callable[[SentImage], int]] = {
    "status": lambda sent: sent.status,
    "frame_id": lambda sent: sent.number,
    "timestamp": lambda sent: sent.stamp_ns,
    "image_width": lambda sent: sent.size_px[0],
    "image_height": lambda sent: sent.size_px[1],
    "image_pixel_format": lambda sent: sent.pixel_format,
}


@dataclass
class OnABus:
    """One camera that the library sees, and everything that was done with it."""

    id: str | None
    serial: str | None
    protocol: str
    address: str | None
    camera: ScriptedCamera
    xml: bytes = field(default_factory=lambda: description().encode())
    claimed_bytes: int | None = None
    """Length of the description as the library tells it."""
    opens: tuple[int, str] | None = None
    refusing: dict[int, int] = field(default_factory=dict)
    fails: dict[str, int] = field(default_factory=dict)
    controlled: bool = True
    lost: bool = False
    asked: list[tuple[str, int, int]] = field(default_factory=list)
    coming: deque[SentImage] = field(default_factory=deque)
    free: deque[int] = field(default_factory=deque)
    """Buffers that wait for an image."""
    waits_us: list[int] = field(default_factory=list)
    usb_mode: int | None = None


class ForeignLibrary:
    """Stands where ``ctypes.CDLL`` of both libraries does."""

    def __init__(self, clock: SteppedClock) -> None:
        self.clock = clock
        self.devices: list[OnABus] = []
        self.enabled: list[bytes] = []
        self.looked = 0
        self.open: dict[int, OnABus] = {}
        """Devices and streams that are not released."""
        self.freed_errors = 0
        self.buffers: dict[int, tuple[Any, SentImage]] = {}
        self._handles = itertools.count(1000)
        self._kept: list[Any] = []
        # A function of ctypes takes attributes: types of its arguments and its result.
        for name in dir(self):
            if name.startswith(("arv_", "g_")):
                setattr(self, name, partial(getattr(self, name)))
        for name, number in (("major", 0), ("minor", 8), ("micro", 26)):
            setattr(self, f"arv_get_{name}_version", partial(lambda number: number, number))
        for name in ("id", "serial_nbr", "protocol", "address"):
            setattr(self, f"arv_get_device_{name}", partial(self._word, name.removesuffix("_nbr")))
        for name, told in OF_AN_IMAGE.items():
            setattr(self, f"arv_buffer_get_{name}", partial(self._of_buffer, told))

    def add(self, protocol: str, **more: Any) -> OnABus:
        of_a_kind = {"id": f"Reef-{len(self.devices)}", "serial": f"S{len(self.devices)}", "address": "10.0.0.2"}
        device = OnABus(**{**of_a_kind, "protocol": protocol, "camera": ScriptedCamera(self.clock), **more})
        self.devices.append(device)
        return device

    @staticmethod
    def fail(error: Any, code: int, message: bytes | None = b"no luck") -> int:
        """What a function does that takes a place for an error."""
        place = error._obj
        place.contents = place._type_(77, code, message)
        return 0

    # ---- the system

    def arv_enable_interface(self, name: bytes) -> None:
        self.enabled.append(name)

    def arv_update_device_list(self) -> None:
        self.looked += 1

    def arv_get_n_devices(self) -> int:
        return len(self.devices) if self.looked else 0

    def _word(self, name: str, index: int) -> bytes | None:
        word: str | None = getattr(self.devices[index], name)
        return None if word is None else word.encode()

    def arv_open_device(self, name: bytes, error: Any) -> int:
        device = next(one for one in self.devices if one.id == name.decode())
        if device.opens is not None:
            return self.fail(error, device.opens[0], device.opens[1].encode())
        return self._opened(device)

    def _opened(self, device: OnABus) -> int:
        handle = next(self._handles)
        self.open[handle] = device
        return handle

    def g_object_unref(self, handle: int) -> None:
        del self.open[handle]

    def g_error_free(self, error: Any) -> None:
        assert error
        self.freed_errors += 1

    # ---- a device

    def arv_device_get_genicam_xml(self, handle: int, size: Any) -> int:
        device = self.open[handle]
        text = ctypes.create_string_buffer(device.xml, len(device.xml) or 1)
        self._kept.append(text)
        size._obj.value = len(device.xml) if device.claimed_bytes is None else device.claimed_bytes
        return ctypes.addressof(text) if device.xml else 0

    def _refuses(self, device: OnABus, what: str, address: int, size: int, error: Any) -> bool:
        device.asked.append((what, address, size))
        refused = device.lost or address in device.refusing
        if refused:
            self.fail(error, 5 if device.lost else device.refusing[address])
        return refused

    def arv_device_read_memory(self, handle: int, address: int, size: int, memory: Any, error: Any) -> int:
        device = self.open[handle]
        if self._refuses(device, "read", address, size, error):
            return 0
        memory.raw = device.camera.get(address, size)
        return 1

    def arv_device_write_memory(self, handle: int, address: int, size: int, memory: Any, error: Any) -> int:
        device = self.open[handle]
        if self._refuses(device, "write", address, size, error):
            return 0
        assert len(memory.raw) == size
        if address == LATCH:
            assert memory.raw == bytes((0, 0, 0, 2)), "bit 1 latches"
            device.camera.log.append(("latch", 2))
            self.clock.advance_s(1e-4)
        elif address in OF_ADDRESS:
            device.camera.written(address, memory.raw)
        else:
            device.camera.set(address, memory.raw)
        return 1

    def arv_gv_device_is_controller(self, handle: int) -> int:
        return int(self.open[handle].controlled)

    def arv_gv_device_auto_packet_size(self, handle: int, error: Any) -> int:
        device = self.open[handle]
        return self.fail(error, device.fails["packet"]) if "packet" in device.fails else 8192

    def arv_uv_device_set_usb_mode(self, handle: int, mode: int) -> None:
        self.open[handle].usb_mode = mode

    # ---- a stream

    def arv_device_create_stream(self, handle: int, called: None, data: None, error: Any) -> int:
        device = self.open[handle]
        if "stream" in device.fails:
            return self.fail(error, device.fails["stream"])
        device.free.clear()
        device.camera.log.append(("stream", 1))
        return self._opened(device)

    def arv_buffer_new_allocate(self, size: int) -> int:
        handle = next(self._handles)
        self.buffers[handle] = (ctypes.create_string_buffer(size), SentImage())
        return handle

    def arv_stream_push_buffer(self, stream: int, buffer: int) -> None:
        assert buffer in self.buffers
        self.open[stream].free.append(buffer)

    def arv_stream_timeout_pop_buffer(self, stream: int, wait_us: int) -> int | None:
        device = self.open[stream]
        device.waits_us.append(wait_us)
        wait_s = wait_us * 1e-6
        if not device.coming or device.coming[0].after_s > wait_s:
            self.clock.advance_s(wait_s)
            if device.coming:
                device.coming[0].after_s -= wait_s
            return None
        sent = device.coming.popleft()
        self.clock.advance_s(sent.after_s)
        buffer = device.free.popleft()
        memory = self.buffers[buffer][0]
        ctypes.memmove(memory, sent.data, min(len(sent.data), len(memory)))
        self.buffers[buffer] = (memory, sent)
        return buffer

    def arv_buffer_get_data(self, buffer: int, size: Any) -> int:
        memory, sent = self.buffers[buffer]
        size._obj.value = len(sent.data) if sent.claimed_bytes is None else sent.claimed_bytes
        return ctypes.addressof(memory)

    def _of_buffer(self, told: Callable[[SentImage], int], buffer: int) -> int:
        return told(self.buffers[buffer][1])
