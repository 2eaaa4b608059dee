"""One opened device of Aravis: its register memory, its description, and the errors of failed calls."""

from __future__ import annotations

import ctypes
import threading
from typing import Self

from drivers.api import DeviceError, DeviceGone, DeviceRefused
from drivers.aravis.library import Aravis, AravisError, DeviceCode, ListedCamera
from drivers.camera.control import ControlRefused
from drivers.camera.description import MAX_FILE_SIZE

PIECE = 512
"""Largest number of bytes in one request: a network camera answers up to 536 in one packet (GigE
Vision 1.2, READMEM).
"""
_CONNECTOR = "Check the connector; the camera is opened again by itself"
_WORD = 4
"""Address and length of a request to a network camera are multiples of this (GigE Vision 1.2, READMEM)."""


class AravisDevice:
    """The register memory of one camera, safe to call from several threads.

    Every method raises DeviceGone (unplugged, silent, or its network control lost) and DeviceRefused (the camera
    refuses).
    """

    def __init__(self, name: str, aravis: Aravis, listed: ListedCamera) -> None:
        """Open the device; Aravis fetches its description by that."""
        self.name = name
        self.listed = listed
        self.aravis = aravis
        self._lock = threading.Lock()
        try:
            self._handle: int | None = aravis.open(listed.id)
        except AravisError as error:
            if error.code in (DeviceCode.NOT_FOUND, DeviceCode.NOT_CONNECTED):
                raise DeviceGone(name, f"could not be opened ({error})", _CONNECTOR) from error
            raise DeviceRefused(
                name,
                f"could not be opened ({error})",
                "Install the udev rules, or stop the program that uses the camera",
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def handle(self) -> int:
        """The library's device. Raises DeviceGone once closed."""
        if self._handle is None:
            raise DeviceGone(self.name, "closed", "It is opened again by itself")
        return self._handle

    def close(self) -> None:
        """Release the device; idempotent."""
        with self._lock:
            handle, self._handle = self._handle, None
        if handle is not None:
            self.aravis.release(handle)

    def description(self) -> str:
        """Return the GenICam description as XML text, as Aravis unpacked it."""
        size = ctypes.c_size_t()
        text = self.aravis.call.arv_device_get_genicam_xml(self.handle, ctypes.byref(size))
        if not text or not 0 < size.value <= MAX_FILE_SIZE:
            raise DeviceRefused(self.name, "it has no description that can be read", "Update the camera's firmware")
        return ctypes.string_at(text, size.value).rstrip(b"\0").decode("utf-8-sig", errors="replace")

    def read(self, address: int, count: int) -> bytes:
        """Return ``count`` bytes from ``address``."""
        # A description may have registers that are neither aligned nor whole words; the bytes around them are cut off.
        begin, end = address // _WORD * _WORD, -(-(address + count) // _WORD) * _WORD
        data = b"".join(self._read(position, min(PIECE, end - position)) for position in range(begin, end, PIECE))
        return data[address - begin : address - begin + count]

    def write(self, address: int, data: bytes) -> None:
        """Write ``data`` at ``address``."""
        for offset in range(0, len(data), PIECE):
            piece = data[offset : offset + PIECE]
            memory = ctypes.create_string_buffer(piece, len(piece))
            self._memory("write", address + offset, memory)

    def gone(self, why: str) -> DeviceGone:
        """Return the error of a camera that is lost."""
        return DeviceGone(self.name, why, _CONNECTOR)

    def failed(self, what: str, error: AravisError) -> DeviceError:
        """Return the error of a failed call: an answer of the camera means a refusal, no answer a loss."""
        answered = error.code == DeviceCode.PROTOCOL_ERROR or (
            DeviceCode.NOT_IMPLEMENTED <= error.code <= DeviceCode.BUSY
        )
        if answered:
            return ControlRefused(
                self.name, f"refused the {what}: {error}", "Check the rig's camera settings", error.code
            )
        return self.gone(f"no longer answers a {what} ({error})")

    def _read(self, address: int, count: int) -> bytes:
        memory = ctypes.create_string_buffer(count)
        self._memory("read", address, memory)
        return memory.raw

    def _memory(self, what: str, address: int, memory: ctypes.Array[ctypes.c_char]) -> None:
        size = ctypes.sizeof(memory)
        if address < 0 or address + size > 1 << 64:
            raise DeviceRefused(
                self.name, f"its description puts {size} bytes at {address:#x}, outside 64 bits", "Update the firmware"
            )
        with self._lock:
            function = getattr(self.aravis.call, f"arv_device_{what}_memory")
            handle = self.handle
            try:
                self.aravis.checked(lambda error: function(handle, address, size, memory, error))
            except AravisError as error:
                raise self.failed(f"{what} of {size} bytes at {address:#x}", error) from error
