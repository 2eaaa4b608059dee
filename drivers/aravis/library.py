"""The functions of libaravis 0.8 that the driver calls, with the types of their arguments.

No other module calls the library. Source: its reference manual, version 0.8 (``ArvDevice``, ``ArvStream``,
``ArvBuffer``, ``ArvSystem``). ctypes releases the interpreter lock during each call, so that one camera's thread waits
without blocking the other's.
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
STUCK = ("Aravis does not end a stream, and holds the camera", "Switch the instrument off and on")
"""The fault, and its remedy, once that wait was in vain."""


class DeviceCode(IntEnum):
    """The codes of ``ArvDeviceError`` that are treated differently.

    An answer of the camera itself is PROTOCOL_ERROR.
    """

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
    """Error of a failed call. ``code`` is of ``DeviceCode`` where the error is of the device's domain."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class ListedCamera:
    """One camera in the library's list. ``protocol`` is ``USB3Vision``, ``GigEVision`` or ``BUILT_IN``."""

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
    """The loaded library.

    Its list of cameras is one for the process, so that it is updated and used under one lock.
    """

    def __init__(self) -> None:
        """Load the library.

        Raises OSError where it is not installed, AttributeError where it lacks a function.
        """
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
        """Held while cameras are opened to read their numbers, which would look like another program's use."""
        self._serials: dict[str, str] = {}
        self.stuck: set[str] = set()
        """Cameras at the end of whose stream the library hung: it keeps them as long as this process lives."""
        functions.arv_enable_interface(BUILT_IN.encode())

    @property
    def version(self) -> str:
        """Version of the library, as in ``0.8.26``."""
        return ".".join(str(getattr(self.call, f"arv_get_{part}_version")()) for part in ("major", "minor", "micro"))

    def cameras(self) -> tuple[ListedCamera, ...]:
        """Return every camera on every interface. With a network this takes a second."""
        with self._listing:
            self.call.arv_update_device_list()
            return tuple(
                ListedCamera(
                    *(self._word(property_name, index) for property_name in ("id", "serial_nbr", "protocol", "address"))
                )
                for index in range(self.call.arv_get_n_devices())
            )

    def serial_of(self, camera_id: str) -> str | None:
        """Return the serial number that a camera once reported; ``None``: not read yet.

        A camera that is open in this process cannot be read again.
        """
        return self._serials.get(camera_id)

    def remember(self, camera_id: str, serial: str) -> None:
        """Keep the serial number of a camera."""
        self._serials[camera_id] = serial

    def open(self, camera_id: str) -> int:
        """Return a new device, to be released. Raises AravisError."""
        with self._listing:
            return self.checked(lambda error: self.call.arv_open_device(camera_id.encode(), error))

    def release(self, thing: int) -> None:
        """Release a reference to a device; the last one frees it."""
        self._glib.g_object_unref(thing)

    def end_stream(self, stream: int, camera: str) -> bool:
        """Release a camera's stream; return False if the library has hung in that for ``END_S``.

        Aravis 0.8.26 checks whether a cancelled transfer is still pending and then waits for its end, without a lock
        around the two: about one end of a USB stream in a thousand misses the end and waits for ever.
        """
        ending = threading.Thread(target=self.release, args=(stream,), name="kf-aravis-end", daemon=True)
        ending.start()
        ending.join(END_S)
        if ending.is_alive():
            self.stuck.add(camera)
        return camera not in self.stuck

    def checked(self, call: Callable[[Any], Any]) -> int:
        """Return the true result of a call with an error argument. Raises AravisError."""
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

    def _word(self, property_name: str, index: int) -> str:
        text = getattr(self.call, f"arv_get_device_{property_name}")(index)
        return (text or b"").decode("utf-8", errors="replace").strip()


@cache
def load_library() -> Aravis:
    """Return the library, loaded at the first call. Raises the errors of ``Aravis``."""
    return Aravis()


def library(device: str) -> Aravis:
    """Return the library of this process.

    Raises DeviceRefused, with the remedy, where it is not installed or too old.
    """
    try:
        return load_library()
    except OSError as error:
        raise DeviceRefused(device, f"the library Aravis cannot be loaded ({error})", REMEDY) from error
    except AttributeError as error:
        raise DeviceRefused(device, f"the library Aravis is too old ({error})", "Install 0.8.22 or later") from error
