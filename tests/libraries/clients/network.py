"""Cameras with GigE Vision on this machine's loop, as the library Aravis makes them: each sends a frame for every pulse of a line.

Arguments: pulses a second, then serial numbers, one camera each at 127.0.0.1, 127.0.0.2 and so on. A frame's pixels all have the number of the
frame of that camera, modulo 251. The fake camera knows no line, so that a pulse is written into the register of its software trigger.
"""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from ctypes import c_char_p, c_size_t, c_uint32, c_void_p
from typing import Any

from tests.libraries.clients import say, wait

SOFTWARE_TRIGGER = 0x30C
"""Register of the fake camera's own description."""
LOOKS_HZ = 1000.0
"""How often the fake camera looks at that register."""
MODULUS = 251
FILL = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32, c_uint32, c_uint32)


def library() -> Any:
    made = ctypes.CDLL("libaravis-0.8.so.0")
    for name, result, arguments in (
        ("arv_gv_fake_camera_new", c_void_p, (c_char_p, c_char_p)),
        ("arv_gv_fake_camera_is_running", ctypes.c_int, (c_void_p,)),
        ("arv_gv_fake_camera_get_fake_camera", c_void_p, (c_void_p,)),
        ("arv_fake_camera_set_fill_pattern", None, (c_void_p, FILL, c_void_p)),
        ("arv_fake_camera_write_register", ctypes.c_int, (c_void_p, c_uint32, c_uint32)),
        ("arv_fake_camera_set_trigger_frequency", None, (c_void_p, ctypes.c_double)),
        ("arv_buffer_get_data", c_void_p, (c_void_p, ctypes.POINTER(c_size_t))),
        ("arv_buffer_get_image_width", ctypes.c_int, (c_void_p,)),
        ("arv_buffer_get_image_height", ctypes.c_int, (c_void_p,)),
    ):
        function = getattr(made, name)
        function.restype, function.argtypes = result, arguments
    return made


class Cameras:
    def __init__(self, serials: list[str]) -> None:
        self._aravis = library()
        self._pixels: list[Any] = []  # held: the library has only their addresses
        self._cameras: list[int] = []
        for number, serial in enumerate(serials):
            network = self._aravis.arv_gv_fake_camera_new(f"127.0.0.{number + 1}".encode(), serial.encode())
            if not self._aravis.arv_gv_fake_camera_is_running(network):
                raise OSError(f"127.0.0.{number + 1} is no address of this machine")
            camera = self._aravis.arv_gv_fake_camera_get_fake_camera(network)
            pixels = filler(self._aravis)
            self._aravis.arv_fake_camera_set_fill_pattern(camera, pixels, None)
            self._aravis.arv_fake_camera_set_trigger_frequency(camera, LOOKS_HZ)
            self._pixels.append(pixels)
            self._cameras.append(camera)

    def pulse(self) -> None:
        """One frame of each, if it is set to be triggered so."""
        for camera in self._cameras:
            self._aravis.arv_fake_camera_write_register(camera, SOFTWARE_TRIGGER, 1)


def filler(aravis: Any) -> Any:
    """What a fake camera is to call for each image; it must be kept as long as the camera."""
    numbers = iter(range(1 << 62))

    def fill(buffer: int, _data: int, _exposure_us: int, _gain: int, _format: int) -> None:
        data = aravis.arv_buffer_get_data(buffer, ctypes.byref(c_size_t()))
        size = aravis.arv_buffer_get_image_width(buffer) * aravis.arv_buffer_get_image_height(buffer)
        ctypes.memset(data, next(numbers) % MODULUS, size)

    return FILL(fill)


def pulses(cameras: Cameras, rate_hz: float, ended: threading.Event) -> None:
    """As even as this machine can, and never two to make up for one that was late."""
    due_s = time.monotonic()
    while not ended.wait(max(0.0, due_s - time.monotonic())):
        cameras.pulse()
        due_s = max(due_s, time.monotonic() - 1 / rate_hz) + 1 / rate_hz


if __name__ == "__main__":
    there = Cameras(sys.argv[2:])
    ended = threading.Event()
    line = threading.Thread(target=pulses, args=(there, float(sys.argv[1]), ended))
    line.start()
    say(ready=len(sys.argv) - 2)
    wait()
    ended.set()
    line.join()
    say(cpu_s=time.process_time())
