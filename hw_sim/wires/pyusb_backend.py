"""The pyusb end of the cameras' wires: transfers, timeouts in world time, and libusb's errors."""

from __future__ import annotations

import ctypes
import errno
from array import array
from collections.abc import Iterator, Sequence
from types import SimpleNamespace

import usb.backend
from usb.core import USBError, USBTimeoutError

from hw_sim.devices.u3v_camera import Stall, U3vCamera
from hw_sim.devices.u3v_stream import Overflow
from hw_sim.timing.world_time import WorldTime
from hw_sim.wires.usb_descriptors import Interface, parse_configuration, parse_device

BUS = 2


class Handle:
    """An opened device; invalid once the device has left the bus, even if it comes back."""

    def __init__(self, camera: U3vCamera) -> None:
        self.camera = camera
        self.enumeration = camera.enumeration
        self.claimed: set[int] = set()
        self.open = True


def _no_device() -> USBError:
    return USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def _timed_out() -> USBTimeoutError:
    return USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)


def _pipe_error() -> USBError:
    return USBError("Pipe error", -9, errno.EPIPE)


def _overflow() -> USBError:
    return USBError("Overflow", -8, errno.EOVERFLOW)


def _busy() -> USBError:
    return USBError("Resource busy", -6, errno.EBUSY)


def _not_found() -> USBError:
    return USBError("Entity not found", -5, errno.ENOENT)


def _memory(buffer: array[int]) -> memoryview:
    """Return the bytes of an array, by address and length as libusb takes them."""
    address, length = buffer.buffer_info()
    size = length * buffer.itemsize
    return memoryview((ctypes.c_ubyte * size).from_address(address)).cast("B") if size else memoryview(bytearray())


class UsbBackend(usb.backend.IBackend):  # type: ignore[misc]
    """All simulated USB cameras on one bus. Device objects are ``U3vCamera``; every call may come from any thread."""

    def __init__(self, cameras: Sequence[U3vCamera], time: WorldTime) -> None:
        super().__init__()
        self._cameras = tuple(cameras)
        self._time = time
        self._claims: dict[tuple[str, int, int], Handle] = {}

    # -- what is on the bus

    def enumerate_devices(self) -> Iterator[U3vCamera]:
        with self._time.condition:
            return iter([c for c in self._cameras if c.plugged and not self._time.closed])

    def get_parent(self, dev: U3vCamera) -> None:
        return None

    def get_device_descriptor(self, dev: U3vCamera) -> SimpleNamespace:
        with self._time.condition:
            port = self._cameras.index(dev) + 1
            # The kernel assigns a new address each time a device appears; 1 is the root hub.
            address = 2 + port + len(self._cameras) * dev.enumeration
            where = {"bus": BUS, "address": address, "port_number": port, "port_numbers": (port,)}
            return SimpleNamespace(**parse_device(dev.device_descriptor()), **where, speed=int(dev.speed))

    def get_configuration_descriptor(self, dev: U3vCamera, config: int) -> SimpleNamespace:
        if config != 0:
            raise IndexError(f"Invalid configuration index {config}")
        fields, _ = parse_configuration(dev.configuration_descriptor())
        return SimpleNamespace(**fields)

    def get_interface_descriptor(self, dev: U3vCamera, intf: int, alt: int, config: int) -> SimpleNamespace:
        return SimpleNamespace(**self._interface(dev, intf, alt).fields)

    def get_endpoint_descriptor(self, dev: U3vCamera, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        endpoints = self._interface(dev, intf, alt).endpoints
        if ep >= len(endpoints):
            raise IndexError(f"Invalid endpoint index {ep}")
        return SimpleNamespace(**endpoints[ep])

    def _interface(self, dev: U3vCamera, intf: int, alt: int) -> Interface:
        _, interfaces = parse_configuration(dev.configuration_descriptor())
        if intf >= len(interfaces):
            raise IndexError(f"Invalid interface index {intf}")
        if alt != 0:
            raise IndexError(f"Invalid alternate setting index {alt}")
        return interfaces[intf]

    # -- handles

    def open_device(self, dev: U3vCamera) -> Handle:
        with self._time.condition:
            if not dev.plugged or self._time.closed:
                raise _no_device()
            return Handle(dev)

    def close_device(self, dev_handle: Handle) -> None:
        with self._time.condition:
            dev_handle.open = False
            for key in [key for key, owner in self._claims.items() if owner is dev_handle]:
                del self._claims[key]
            self._time.condition.notify_all()

    def _check(self, handle: Handle) -> U3vCamera:
        camera = handle.camera
        if self._time.closed or not camera.plugged or camera.enumeration != handle.enumeration or not handle.open:
            raise _no_device()
        return camera

    def claim_interface(self, dev_handle: Handle, intf: int) -> None:
        with self._time.condition:
            camera = self._check(dev_handle)
            if intf >= len(parse_configuration(camera.configuration_descriptor())[1]):
                raise _not_found()
            # A claim ends when the device leaves the bus: one that comes back is unclaimed.
            key = (camera.name, camera.enumeration, intf)
            if self._claims.setdefault(key, dev_handle) is not dev_handle:
                raise _busy()
            dev_handle.claimed.add(intf)

    def release_interface(self, dev_handle: Handle, intf: int) -> None:
        with self._time.condition:
            camera = self._check(dev_handle)
            if intf not in dev_handle.claimed:
                raise _not_found()
            dev_handle.claimed.discard(intf)
            self._claims.pop((camera.name, camera.enumeration, intf), None)

    def is_kernel_driver_active(self, dev_handle: Handle, intf: int) -> bool:
        return False

    def detach_kernel_driver(self, dev_handle: Handle, intf: int) -> None:
        raise _not_found()

    def attach_kernel_driver(self, dev_handle: Handle, intf: int) -> None:
        raise _not_found()

    # -- standard requests

    def set_configuration(self, dev_handle: Handle, config_value: int) -> None:
        self._request(dev_handle, 0x00, 0x09, config_value, 0, 0)

    def get_configuration(self, dev_handle: Handle) -> int:
        return self._request(dev_handle, 0x80, 0x08, 0, 0, 1)[0]

    def set_interface_altsetting(self, dev_handle: Handle, intf: int, altsetting: int) -> None:
        self._request(dev_handle, 0x01, 0x0B, altsetting, intf, 0)

    def clear_halt(self, dev_handle: Handle, ep: int) -> None:
        self._request(dev_handle, 0x02, 0x01, 0, ep, 0)

    def reset_device(self, dev_handle: Handle) -> None:
        """Reset the port: the device remains the same one, with its registers as after plugging in."""
        with self._time.condition:
            camera = self._check(dev_handle)
            camera.restart()
            dev_handle.enumeration = camera.enumeration

    def ctrl_transfer(
        self,
        dev_handle: Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        memory = _memory(data)
        answer = self._request(dev_handle, bmRequestType, bRequest, wValue, wIndex, len(memory))
        if not bmRequestType & 0x80:
            return len(memory)
        memory[: len(answer)] = answer
        return len(answer)

    def _request(self, handle: Handle, kind: int, request: int, value: int, index: int, length: int) -> bytes:
        with self._time.condition:
            camera = self._check(handle)
            try:
                return camera.request(kind, request, value, index, length)
            except Stall:
                raise _pipe_error() from None

    # -- data

    def bulk_write(self, dev_handle: Handle, ep: int, intf: int, data: array[int], timeout: int) -> int:
        with self._time.condition:
            camera = self._check(dev_handle)
            self._check_claim(dev_handle, intf)
            try:
                return camera.write(ep, bytes(_memory(data)))
            except Stall:
                raise _pipe_error() from None

    def bulk_read(self, dev_handle: Handle, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        memory, filled, done = _memory(buff), 0, False

        def finished() -> bool:
            nonlocal filled, done
            camera = self._check(dev_handle)
            more, done = camera.read(ep, memory[filled:])
            filled += more
            return done

        with self._time.condition:
            self._check_claim(dev_handle, intf)
            try:
                # libusb takes 0 for no limit.
                self._time.wait_for(finished, timeout / 1000 if timeout else None)
            except Stall:
                raise _pipe_error() from None
            except Overflow:
                raise _overflow() from None
        # As in libusb, a transfer that timed out half way returns the data so far.
        if not done and not filled:
            raise _timed_out()
        return filled

    def intr_write(self, dev_handle: Handle, ep: int, intf: int, data: array[int], timeout: int) -> int:
        raise _not_found()

    def intr_read(self, dev_handle: Handle, ep: int, intf: int, size: array[int], timeout: int) -> int:
        raise _not_found()

    def _check_claim(self, handle: Handle, intf: int) -> None:
        self._check(handle)
        if intf not in handle.claimed:
            raise _not_found()
