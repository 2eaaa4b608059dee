"""The USB transfers of one camera: pyusb's backend interface, reduced to two pipes and four errors.

The backend interface (``usb.backend.IBackend``) is used directly, not through ``usb.core.Device``: only a backend reads
into memory that the caller owns, which saves a copy of every image.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import usb.core
from numpy.typing import NDArray

from drivers.api import DeviceError, DeviceGone, DeviceRefused
from drivers.camera import u3v
from drivers.camera.descriptors import (
    InterfaceDescription,
    MalformedDescriptor,
    U3vLayout,
    find_layout,
    parse_string,
)

_STRING_TIMEOUT_MS = 500
_DESCRIPTOR_STRING = 0x03
_GET_DESCRIPTOR = 0x06
_DEVICE_TO_HOST = 0x80
_HOST_TO_ENDPOINT, _SET_FEATURE, _ENDPOINT_HALT = 0x02, 0x03, 0x00
"""USB 2.0, tables 9-2, 9-4 and 9-6."""
_ENGLISH_US = 0x0409
_ENDPOINT_IN = 0x80
_TRANSFER_TYPE_MASK = 0x03
_TRANSFER_TYPE_BULK = 0x02


class TransferError(Exception):
    """A transfer failed, but the pipe may be used again."""


class TransferTimeout(TransferError):
    """No data came in time."""


class TransferStalled(TransferError):
    """The endpoint is halted until its halt is cleared."""


class TransferOverflow(TransferError):
    """The device sent more than was requested; the excess is lost."""


class TransferRefused(TransferError):
    """The host does not accept a transfer of this length."""


class Unplugged(Exception):
    """The device is gone from the bus; no transfer will succeed again."""


class TransferBuffer(np.ndarray[Any, np.dtype[np.uint8]]):
    """A view of memory with the interface of ``array.array`` that pyusb's backends need.

    ``buffer_info`` serves the libusb backend, the buffer protocol every other one. No byte is copied.
    """

    def buffer_info(self) -> tuple[int, int]:
        """Return (address, number of items), as ``array.array.buffer_info``."""
        return self.ctypes.data, self.size


def transfer_buffer(memory: NDArray[np.uint8]) -> TransferBuffer:
    """Return a flat view of ``memory``. Raises ValueError unless it is uint8, C-contiguous and writable."""
    if memory.dtype != np.uint8 or not memory.flags.c_contiguous or not memory.flags.writeable:
        raise ValueError(
            f"a transfer needs C-contiguous writable uint8 memory, not {memory.dtype} "
            f"(contiguous {memory.flags.c_contiguous}, writable {memory.flags.writeable})"
        )
    return memory.reshape(-1).view(TransferBuffer)


class ControlPipe(Protocol):
    """Pipe that the control channel needs: one packet out, one packet in."""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Write one transfer. Raises TransferError, Unplugged."""

    def read(self, size: int, timeout_s: float) -> bytes:
        """Read one transfer of at most ``size`` bytes. Raises TransferError, Unplugged."""

    def clear_halt(self) -> None:
        """Clear the halt of both directions. Raises Unplugged."""


class StreamPipe(Protocol):
    """Pipe that the stream reader needs: fill memory, one transfer at a time."""

    def read_into(self, buffer: TransferBuffer, timeout_s: float) -> int:
        """Read one transfer into ``buffer`` and return the number of bytes. Raises TransferError, Unplugged."""

    def set_halt(self) -> None:
        """Ask the device to halt the endpoint; it may refuse. Raises Unplugged."""

    def clear_halt(self) -> None:
        """Clear the halt of the endpoint. Raises Unplugged."""


def _as_milliseconds(timeout_s: float) -> int:
    # libusb waits for ever with 0, so a short wait must not be rounded to that.
    return max(1, round(timeout_s * 1000.0))


def _translate(error: usb.core.USBError) -> Exception:
    if isinstance(error, usb.core.USBTimeoutError) or error.errno == errno.ETIMEDOUT:
        return TransferTimeout(str(error))
    if error.errno == errno.EPIPE:
        return TransferStalled(str(error))
    if error.errno == errno.EOVERFLOW:
        return TransferOverflow(str(error))
    if error.errno in (errno.ENOMEM, errno.EINVAL):
        # The kernel has no room for a transfer this long (usbfs_memory_mb), or the controller takes none.
        return TransferRefused(str(error))
    # ENODEV means unplugged; a hub reports EIO, EPROTO or ESHUTDOWN in the moment before it notices.
    return Unplugged(str(error))


def default_backend() -> Any:
    """Return pyusb's libusb-1.0 backend. Raises DeviceGone when the library is not installed."""
    import usb.backend.libusb1

    backend = usb.backend.libusb1.get_backend()
    if backend is None:
        raise DeviceGone("usb", "libusb-1.0 was not found", "Install the package libusb-1.0-0")
    return backend


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A USB3 Vision device on the bus, not opened yet. ``serial`` is ``None`` when it could not be read."""

    backend: Any
    device: Any
    layout: U3vLayout
    serial: str | None
    link_speed_mbps: int | None
    location: str
    unreadable: str = ""
    """Reason why the serial number could not be read."""


def _interfaces(backend: Any, device: Any, count: int) -> list[InterfaceDescription]:
    interfaces: list[InterfaceDescription] = []
    for index in range(count):
        try:
            descriptor = backend.get_interface_descriptor(device, index, 0, 0)
        except IndexError:
            break
        bulk_in: list[int] = []
        bulk_out: list[int] = []
        for number in range(int(descriptor.bNumEndpoints)):
            endpoint = backend.get_endpoint_descriptor(device, number, index, 0, 0)
            if int(endpoint.bmAttributes) & _TRANSFER_TYPE_MASK == _TRANSFER_TYPE_BULK:
                address = int(endpoint.bEndpointAddress)
                (bulk_in if address & _ENDPOINT_IN else bulk_out).append(address)
        interfaces.append(
            InterfaceDescription(
                number=int(descriptor.bInterfaceNumber),
                interface_class=int(descriptor.bInterfaceClass),
                interface_subclass=int(descriptor.bInterfaceSubClass),
                protocol=int(descriptor.bInterfaceProtocol),
                bulk_in=tuple(bulk_in),
                bulk_out=tuple(bulk_out),
                extra=bytes(descriptor.extra_descriptors or ()),
            )
        )
    return interfaces


def _read_string(backend: Any, handle: Any, index: int) -> str | None:
    if index == 0:
        return None
    buffer = transfer_buffer(np.zeros(255, np.uint8))
    value = (_DESCRIPTOR_STRING << 8) | index
    count = backend.ctrl_transfer(
        handle, _DEVICE_TO_HOST, _GET_DESCRIPTOR, value, _ENGLISH_US, buffer, _STRING_TIMEOUT_MS
    )
    try:
        return parse_string(buffer[: int(count)].tobytes())
    except MalformedDescriptor:
        return None


def find_cameras(backend: Any) -> Iterator[FoundCamera]:
    """Yield every USB3 Vision device that the backend enumerates, by class descriptors alone.

    A device that may not be opened is reported without a serial number; one that vanishes meanwhile is left out.
    """
    for device in backend.enumerate_devices():
        try:
            descriptor = backend.get_device_descriptor(device)
            configuration = backend.get_configuration_descriptor(device, 0)
            interfaces = _interfaces(backend, device, int(configuration.bNumInterfaces))
        except (usb.core.USBError, IndexError):
            continue  # it left the bus meanwhile, or has no configuration: no usable camera
        layout = find_layout(int(configuration.bConfigurationValue), interfaces)
        # Serial numbers are read only from devices with a USB3 Vision control interface.
        if layout is None:
            continue
        index = int(descriptor.iSerialNumber)
        if layout.info is not None and layout.info.serial_index:
            index = layout.info.serial_index
        serial: str | None = None
        unreadable = ""
        try:
            handle = backend.open_device(device)
            try:
                serial = _read_string(backend, handle, index)
            finally:
                backend.close_device(handle)
        except usb.core.USBError as error:
            if error.errno == errno.ENODEV:
                continue  # unplugged, and the library's list is out of date: no problem of permissions
            unreadable = str(error)
        speed = getattr(descriptor, "speed", None)
        yield FoundCamera(
            backend=backend,
            device=device,
            layout=layout,
            serial=serial,
            link_speed_mbps=None if speed is None else u3v.SPEED_MBPS_OF_HOST.get(int(speed)),
            location=f"bus {getattr(descriptor, 'bus', '?')} address {getattr(descriptor, 'address', '?')}",
            unreadable=unreadable,
        )


def find_camera(backend: Any, name: str, serial: str) -> FoundCamera:
    """Return the camera with this serial number.

    Raises DeviceGone, which lists the others, or DeviceRefused.
    """
    other_serials: list[str] = []
    forbidden: list[str] = []
    for camera in find_cameras(backend):
        if camera.serial == serial:
            return camera
        if camera.serial is None:
            forbidden.append(f"{camera.location}: {camera.unreadable or 'no serial number'}")
        else:
            other_serials.append(camera.serial)
    if forbidden:
        raise DeviceRefused(
            name,
            f"serial number {serial} not found, and the serial number of a camera cannot be read "
            f"({'; '.join(forbidden)})",
            "Install the udev rules, or stop the program that uses the camera",
        )
    presence = (
        f"the bus has {', '.join(sorted(other_serials))}" if other_serials else "the bus has no USB3 Vision camera"
    )
    raise DeviceGone(name, f"serial number {serial} not found; {presence}", "Check the connector and the rig's serial")


class UsbCamera:
    """One opened camera: its two interfaces are claimed until ``close``."""

    def __init__(self, name: str, candidate: FoundCamera) -> None:
        self._backend = candidate.backend
        self._layout = candidate.layout
        self._claimed: list[int] = []
        try:
            self._handle: Any = self._backend.open_device(candidate.device)
        except usb.core.USBError as error:
            raise _opening_failed(name, error) from error
        try:
            # Setting a configuration that is active already would reset the device under others' feet.
            if int(self._backend.get_configuration(self._handle)) != self._layout.configuration:
                self._backend.set_configuration(self._handle, self._layout.configuration)
            for interface in (self._layout.control_interface, self._layout.stream_interface):
                self._backend.claim_interface(self._handle, interface)
                self._claimed.append(interface)
        except usb.core.USBError as error:
            self.close()
            raise _opening_failed(name, error) from error

    def control(self) -> ControlPipe:
        """Return the pipe of commands and acknowledges."""
        layout = self._layout
        return _Pipe(self._backend, self._handle, layout.control_interface, layout.control_in, layout.control_out)

    def stream(self) -> StreamPipe:
        """Return the pipe of images."""
        layout = self._layout
        return _Pipe(self._backend, self._handle, layout.stream_interface, layout.stream_in, None)

    def close(self) -> None:
        """Release and close; idempotent; a device that is gone closes silently."""
        handle, self._handle = self._handle, None
        if handle is None:
            return
        for interface in self._claimed:
            try:
                self._backend.release_interface(handle, interface)
            except usb.core.USBError:
                break  # unplugged: the kernel released all interfaces
        self._claimed.clear()
        self._backend.close_device(handle)


def _opening_failed(name: str, error: usb.core.USBError) -> DeviceError:
    if error.errno == errno.EBUSY:
        return DeviceRefused(name, "another program uses the camera", "Stop it, then try again")
    if error.errno in (errno.EACCES, errno.EPERM):
        return DeviceRefused(name, "no permission to open the camera", "Install the udev rules and re-plug it")
    return DeviceGone(name, f"could not be opened ({error})", "Re-plug the camera")


class _Pipe:
    """Transfers of one interface."""

    def __init__(self, backend: Any, handle: Any, interface: int, endpoint_in: int, endpoint_out: int | None) -> None:
        self._backend = backend
        self._handle = handle
        self._interface = interface
        self._in = endpoint_in
        self._out = endpoint_out

    def write(self, data: bytes, timeout_s: float) -> None:
        if self._out is None:
            raise ValueError("the stream pipe has no OUT direction")
        # Bytes are read-only, and a transfer needs writable memory.
        buffer = transfer_buffer(np.frombuffer(bytearray(data), np.uint8))
        try:
            sent = self._backend.bulk_write(
                self._handle, self._out, self._interface, buffer, _as_milliseconds(timeout_s)
            )
        except usb.core.USBError as error:
            raise _translate(error) from error
        if int(sent) != len(data):
            raise TransferTimeout(f"{sent} of {len(data)} bytes written")

    def read(self, size: int, timeout_s: float) -> bytes:
        buffer = transfer_buffer(np.empty(size, np.uint8))
        return buffer[: self.read_into(buffer, timeout_s)].tobytes()

    def read_into(self, buffer: TransferBuffer, timeout_s: float) -> int:
        try:
            count = self._backend.bulk_read(
                self._handle, self._in, self._interface, buffer, _as_milliseconds(timeout_s)
            )
        except usb.core.USBError as error:
            raise _translate(error) from error
        return int(count)

    def set_halt(self) -> None:
        nothing = transfer_buffer(np.zeros(0, np.uint8))
        try:
            self._backend.ctrl_transfer(
                self._handle, _HOST_TO_ENDPOINT, _SET_FEATURE, _ENDPOINT_HALT, self._in, nothing, _STRING_TIMEOUT_MS
            )
        except usb.core.USBError as error:
            # A device may refuse it, and then has no halt to clear.
            if error.errno == errno.ENODEV:
                raise Unplugged(str(error)) from error

    def clear_halt(self) -> None:
        try:
            self._backend.clear_halt(self._handle, self._in)
            if self._out is not None:
                self._backend.clear_halt(self._handle, self._out)
        except usb.core.USBError as error:
            translated = _translate(error)
            if isinstance(translated, Unplugged):
                raise translated from error
