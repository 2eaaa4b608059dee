"""Owns the functions of libaravis 0.8 that are called, with the types of their arguments: nothing else in the program knows it.

Source: the library's reference manual, version 0.8 (``ArvDevice``, ``ArvStream``, ``ArvBuffer``, ``ArvSystem``). ctypes lets go of the interpreter
during each call, so that one camera's thread waits without holding up the other's.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_int, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any

from drivers.errors import DeviceRefused

FILE = "libaravis-0.8.so.0"
_GOBJECT = "libgobject-2.0.so.0"
REMEDY = "Install it: apt install libaravis-0.8-0"
BUILT_IN = "Fake"
"""Name of the interface on which the library brings a camera of its own."""
USB_ASYNC = 1
"""``ARV_UV_USB_MODE_ASYNC``: several transfers wait in the kernel at once."""
END_S = 5.0
"""Longest wait for the end of a stream, which takes tenths of a second."""
STUCK = ("Aravis hangs while it ends a stream and keeps the camera", "Switch the instrument off and on")
"""The fault, and its remedy, once that wait was in vain."""


class DeviceCode(IntEnum):
    """``ArvDeviceError``, as far as one is treated in its own way; what the camera itself answered begins with its PROTOCOL_ERROR."""

    NOT_CONNECTED = 2
    PROTOCOL_ERROR = 3
    TRANSFER_ERROR = 4
    TIMEOUT = 5
    NOT_FOUND = 6
    NOT_CONTROLLER = 10
    NOT_IMPLEMENTED = 12
    BUSY = 18


class BufferCode(IntEnum):
    """``ArvBufferStatus``."""

    UNKNOWN = -1
    SUCCESS = 0
    CLEARED = 1
    TIMEOUT = 2
    MISSING_PACKETS = 3
    WRONG_PACKET_ID = 4
    SIZE_MISMATCH = 5
    FILLING = 6
    ABORTED = 7


class AravisError(Exception):
    """A call failed. ``code`` is of ``DeviceCode`` where the error is of the device's domain."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class Listed:
    """One camera that the library found. ``protocol`` is ``USB3Vision``, ``GigEVision`` or ``BUILT_IN``."""

    id: str
    serial: str
    protocol: str
    address: str


class _GError(ctypes.Structure):
    """GLib's ``GError``."""

    _fields_ = (("domain", c_uint32), ("code", c_int), ("message", c_char_p))


_ERROR = POINTER(POINTER(_GError))
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_get_major_version": (c_uint, ()),
    "arv_get_minor_version": (c_uint, ()),
    "arv_get_micro_version": (c_uint, ()),
    "arv_enable_interface": (None, (c_char_p,)),
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c_uint, ()),
    "arv_get_device_id": (c_char_p, (c_uint,)),
    "arv_get_device_serial_nbr": (c_char_p, (c_uint,)),
    "arv_get_device_protocol": (c_char_p, (c_uint,)),
    "arv_get_device_address": (c_char_p, (c_uint,)),
    "arv_open_device": (c_void_p, (c_char_p, _ERROR)),
    "arv_device_get_genicam_xml": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_device_read_memory": (c_int, (c_void_p, c_uint64, c_uint32, c_void_p, _ERROR)),
    "arv_device_write_memory": (c_int, (c_void_p, c_uint64, c_uint32, c_void_p, _ERROR)),
    "arv_device_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p, _ERROR)),
    "arv_gv_device_is_controller": (c_int, (c_void_p,)),
    "arv_gv_device_auto_packet_size": (c_uint, (c_void_p, _ERROR)),
    "arv_uv_device_set_usb_mode": (None, (c_void_p, c_int)),
    "arv_buffer_new_allocate": (c_void_p, (c_size_t,)),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_buffer_get_status": (c_int, (c_void_p,)),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_image_width": (c_int, (c_void_p,)),
    "arv_buffer_get_image_height": (c_int, (c_void_p,)),
    "arv_buffer_get_image_pixel_format": (c_uint32, (c_void_p,)),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p)),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64)),
}


class Aravis:
    """The loaded library. Its list of cameras is one for the process, so that it is asked and used under one lock."""

    def __init__(self) -> None:
        """Raises OSError where a library is not installed, AttributeError where it lacks a function."""
        functions = ctypes.CDLL(FILE)
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(functions, name)
            function.restype, function.argtypes = result, arguments
        self.call: Any = functions
        gobject: Any = ctypes.CDLL(_GOBJECT)
        gobject.g_object_unref.restype, gobject.g_object_unref.argtypes = None, (c_void_p,)
        self._glib: Any = gobject  # links GLib, so its symbols are found through it as well
        self._glib.g_error_free.restype, self._glib.g_error_free.argtypes = None, (c_void_p,)
        self._listing = threading.Lock()
        self.finding = threading.Lock()
        """Held while cameras are opened to be asked for their numbers, which would look like another program's use."""
        self._serials: dict[str, str] = {}
        self.stuck: set[str] = set()
        """Cameras from the end of whose stream it did not come back: it keeps them as long as this process lives."""
        functions.arv_enable_interface(BUILT_IN.encode())

    @property
    def version(self) -> str:
        """Version of the library, as in ``0.8.26``."""
        return ".".join(str(getattr(self.call, f"arv_get_{part}_version")()) for part in ("major", "minor", "micro"))

    def cameras(self) -> tuple[Listed, ...]:
        """Every camera on every interface, asked anew: with a network this takes a second."""
        with self._listing:
            self.call.arv_update_device_list()
            return tuple(
                Listed(*(self._word(what, index) for what in ("id", "serial_nbr", "protocol", "address")))
                for index in range(self.call.arv_get_n_devices())
            )

    def serial_of(self, camera_id: str) -> str | None:
        """Return the serial number that a camera told once; ``None``: not asked yet. What is opened here cannot be asked again."""
        return self._serials.get(camera_id)

    def remember(self, camera_id: str, serial: str) -> None:
        """Keep what a camera said."""
        self._serials[camera_id] = serial

    def open(self, camera_id: str) -> int:
        """Return a new device, to be released. Raises AravisError."""
        with self._listing:
            return self.checked(lambda error: self.call.arv_open_device(camera_id.encode(), error))

    def release(self, thing: int) -> None:
        """Give a device back; it goes when nobody else holds it."""
        self._glib.g_object_unref(thing)

    def end_stream(self, stream: int, camera: str) -> bool:
        """Give a camera's stream back; False: the library has not come back from it after ``END_S``, and never will.

        Aravis 0.8.26 looks whether a cancelled transfer is still out and then waits to be told, without a lock around the two: about one end of
        a USB stream in a thousand misses its last word.
        """
        ending = threading.Thread(target=self.release, args=(stream,), name="kf-aravis-end", daemon=True)
        ending.start()
        ending.join(END_S)
        if ending.is_alive():
            self.stuck.add(camera)
        return camera not in self.stuck

    def checked(self, call: Callable[[Any], Any]) -> int:
        """Return the true result of a call that takes a place for an error. Raises AravisError."""
        error = POINTER(_GError)()
        result = call(ctypes.byref(error))
        if error:
            message = (error.contents.message or b"").decode("utf-8", errors="replace")
            code = int(error.contents.code)
            self._glib.g_error_free(error)
            raise AravisError(message, code)
        if not result:
            raise AravisError("the library gave no reason", DeviceCode.NOT_FOUND)
        return int(result)

    def _word(self, what: str, index: int) -> str:
        said = getattr(self.call, f"arv_get_device_{what}")(index)
        return (said or b"").decode("utf-8", errors="replace").strip()


@cache
def loaded() -> Aravis:
    """The library, loaded at the first call. Raises what ``Aravis`` raises."""
    return Aravis()


def library(device: str) -> Aravis:
    """The library of this process. Raises DeviceRefused, with the remedy, where it is not installed or too old."""
    try:
        return loaded()
    except OSError as error:
        raise DeviceRefused(device, f"the library Aravis cannot be loaded ({error})", REMEDY) from error
    except AttributeError as error:
        raise DeviceRefused(device, f"the library Aravis is too old ({error})", "Install 0.8.22 or later") from error
