"""The kernel's usbfs for a simulated camera: interfaces claimed, URBs submitted, completed and reaped.

Source: Linux ``include/uapi/linux/usbdevice_fs.h`` and ``drivers/usb/core/devio.c``, on 64 bits.
"""

from __future__ import annotations

import errno
import os
import struct
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from hw_sim.devices.u3v_camera import Stall, U3vCamera
from hw_sim.devices.u3v_stream import Overflow
from hw_sim.timing.world_time import LONGEST_WAIT_S, WorldTime
from hw_sim.wires.umockdev.preload import HostMemory
from hw_sim.wires.umockdev.readiness import Readiness

URB = struct.Struct("<BBxxiIxxxxQiiiIiIQ")
"""Type, endpoint, status, flags, buffer, length, actual length, start frame, stream, errors, signal, context."""
_STATUS_AT, _ACTUAL_AT = 4, 28
_CONTROL_TRANSFER = struct.Struct("<BBHHHIxxxxQ")
"""Request type, request, value, index, length, timeout, data."""
SETUP = struct.Struct("<BBHHH")
_TWO = struct.Struct("<II")
_DRIVER = struct.Struct("<I256s")
_CLAIM = struct.Struct("<II256s")
_POINTER = struct.Struct("<Q")
_U32 = struct.Struct("<I")
_TYPE = ord("U")
CONTROL, RESET_EP, SET_INTERFACE, SET_CONFIGURATION, GET_DRIVER = 0, 3, 4, 5, 8
SUBMIT, DISCARD, REAP, REAP_NO_DELAY, CLAIM, RELEASE, CONNECT_INFO = 10, 11, 12, 13, 15, 16, 17
DRIVER_IOCTL, RESET, CLEAR_HALT, GET_CAPABILITIES, DISCONNECT_CLAIM, GET_SPEED = 18, 20, 21, 26, 27, 31
CAPABILITIES = 0x01 | 0x04 | 0x08 | 0x10
"""Empty packets, transfers of any length, in one URB, reaped even after the device is gone: as with xHCI."""
URB_CONTROL, URB_BULK = 2, 3
SHORT_NOT_OK = 0x01
_IN = 0x80
LARGEST_CONTROL = 4096
URBS_AT_ONCE = 256
_SPEEDS = {3: 3, 4: 5}
"""Ours as the kernel numbers them: high, super."""


@dataclass(slots=True)
class Urb:
    """A transfer of the host."""

    address: int
    kind: int
    endpoint: int
    flags: int
    buffer: int
    length: int
    data: bytearray = field(default_factory=bytearray)
    """The data received, or to send."""
    done: int = 0
    status: int = 0
    setup: bytes = b""
    """Set-up packet of a control transfer, before the data in the host's buffer."""

    @property
    def is_in(self) -> bool:
        """True if data come from the device."""
        return bool((self.setup[0] if self.kind == URB_CONTROL else self.endpoint) & _IN)


Tap = Callable[[str, "UsbDevice", Urb], None]


class UsbDevice:
    """The state that all openings of one camera share while it is plugged in: claims of interfaces."""

    def __init__(
        self, camera: U3vCamera, time: WorldTime, ready: Readiness, bus: int, address: int, tap: Tap | None = None
    ) -> None:
        """``tap`` gets each URB that is submitted (``S``) or complete (``C``), with the lock held."""
        self.camera, self.time, self.ready, self.tap = camera, time, ready, tap
        self.bus, self.address = bus, address
        self.enumeration = camera.enumeration
        self.claims: dict[int, UsbFile] = {}
        self.files: list[UsbFile] = []

    @property
    def present(self) -> bool:
        """True while the camera has not left the bus. The caller holds the lock."""
        return not self.time.closed and self.camera.plugged and self.camera.enumeration == self.enumeration

    def completed(self) -> None:
        """Note a change of some file's finished transfers. The caller holds the lock."""
        self.ready.set(not self.present or any(file.finished for file in self.files))


class UsbFile:
    """One opening of ``/dev/bus/usb/BBB/DDD``. Takes the world's lock itself."""

    def __init__(self, device: UsbDevice) -> None:
        self._device, self._time, self._camera = device, device.time, device.camera
        self._waiting: dict[int, deque[Urb]] = {}
        """URBs that wait for data, by endpoint, in order."""
        self.finished: deque[Urb] = deque()
        self._spare: list[bytearray] = []
        """Memory of transfers that were reaped; a fresh image-sized one costs its page faults."""
        self._closed = False
        self._at = 0
        with self._time.condition:
            device.files.append(self)
        self._pump = threading.Thread(target=self._pump_forever, name=f"usbfs {device.camera.name}", daemon=True)
        self._pump.start()

    def close(self) -> None:
        """Cancel all pending transfers and release all interfaces."""
        with self._time.condition:
            self._closed = True
            self._device.files.remove(self)
            for number in [n for n, owner in self._device.claims.items() if owner is self]:
                del self._device.claims[number]
            self._time.condition.notify_all()
        self._pump.join(5.0)

    def read(self, size: int) -> bytes:
        """Return the descriptors in the format of usbfs."""
        with self._time.condition:
            self._check()
            descriptors = self._camera.device_descriptor() + self._camera.configuration_descriptor()
            part = descriptors[self._at : self._at + size]
            self._at += len(part)
            return part

    def write(self, data: bytes) -> int:
        """Refuse: usbfs has no ``write``. Raises OSError(EINVAL)."""
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def ioctl(self, request: int, argument: int, memory: HostMemory) -> int:
        if request >> 8 & 0xFF != _TYPE:
            raise _error(errno.ENOTTY)
        number = request & 0xFF
        # Transfers that ended before the device left can still be reaped.
        match number:
            case 12 | 13:
                return self._reap(argument, memory, wait=number == REAP)
            case 11:
                return self._discard(argument)
        with self._time.condition:
            self._check()
        call = self._calls().get(number)
        if call is None:
            raise _error(errno.ENOTTY)
        return call(argument, memory)

    def _calls(self) -> dict[int, Callable[[int, HostMemory], int]]:
        return {
            CONTROL: self._control,
            RESET_EP: lambda argument, memory: self._clear_halt(argument, memory, at_device=False),
            CLEAR_HALT: self._clear_halt,
            SET_INTERFACE: self._set_interface,
            SET_CONFIGURATION: self._set_configuration,
            GET_DRIVER: self._get_driver,
            SUBMIT: self._submit,
            CLAIM: lambda argument, memory: self._claim(_u32(memory, argument)),
            DISCONNECT_CLAIM: lambda argument, memory: self._claim(
                _CLAIM.unpack(memory.copy_from_user(argument, _CLAIM.size))[0]
            ),
            RELEASE: self._release,
            CONNECT_INFO: self._connect_info,
            DRIVER_IOCTL: self._driver_ioctl,
            RESET: self._reset,
            GET_CAPABILITIES: self._capabilities,
            GET_SPEED: lambda argument, memory: _SPEEDS[int(self._camera.speed)],
        }

    def _check(self) -> None:
        if not self._device.present:
            raise _error(errno.ENODEV)

    # ------------------------------------------------------------------------------------------ interfaces

    def _claim(self, interface: int) -> int:
        with self._time.condition:
            self._check()
            if interface >= self._camera.configuration_descriptor()[4]:
                raise _error(errno.ENOENT)
            if self._device.claims.setdefault(interface, self) is not self:
                raise _error(errno.EBUSY)
        return 0

    def _release(self, argument: int, memory: HostMemory) -> int:
        interface = _u32(memory, argument)
        with self._time.condition:
            if self._device.claims.get(interface) is not self:
                raise _error(errno.EINVAL)
            del self._device.claims[interface]
        return 0

    def _get_driver(self, argument: int, memory: HostMemory) -> int:
        interface, _ = _DRIVER.unpack(memory.copy_from_user(argument, _DRIVER.size))
        with self._time.condition:
            claimed = interface in self._device.claims
        if not claimed:
            raise _error(errno.ENODATA)
        memory.copy_to_user(argument, _DRIVER.pack(interface, b"usbfs"))
        return 0

    def _driver_ioctl(self, argument: int, memory: HostMemory) -> int:
        """Refuse to attach or detach a kernel driver: these interfaces have none. Raises OSError(ENODATA)."""
        raise _error(errno.ENODATA)

    def _set_interface(self, argument: int, memory: HostMemory) -> int:
        interface, setting = _TWO.unpack(memory.copy_from_user(argument, _TWO.size))
        self._request(0x01, 0x0B, setting, interface, 0)
        return 0

    def _set_configuration(self, argument: int, memory: HostMemory) -> int:
        value = _u32(memory, argument)
        with self._time.condition:
            if self._device.claims:
                raise _error(errno.EBUSY)
        self._request(0x00, 0x09, value, 0, 0)
        return 0

    def _connect_info(self, argument: int, memory: HostMemory) -> int:
        memory.copy_to_user(argument, _TWO.pack(self._device.address, 0))
        return 0

    def _capabilities(self, argument: int, memory: HostMemory) -> int:
        memory.copy_to_user(argument, _U32.pack(CAPABILITIES))
        return 0

    def _reset(self, argument: int, memory: HostMemory) -> int:
        """Reset the port: the same device, its registers as after plugging in."""
        with self._time.condition:
            self._check()
            self._camera.restart()
            self._device.enumeration = self._camera.enumeration
        return 0

    # ------------------------------------------------------------------------------------------ requests

    def _request(self, kind: int, request: int, value: int, index: int, length: int) -> bytes:
        with self._time.condition:
            self._check()
            try:
                return self._camera.request(kind, request, value, index, length)
            except Stall:
                raise _error(errno.EPIPE) from None

    def _control(self, argument: int, memory: HostMemory) -> int:
        fields = _CONTROL_TRANSFER.unpack(memory.copy_from_user(argument, _CONTROL_TRANSFER.size))
        kind, request, value, index, length, _, address = fields
        answer = self._request(kind, request, value, index, length)
        memory.copy_to_user(address, answer)
        return len(answer) if kind & _IN else length

    def _clear_halt(self, argument: int, memory: HostMemory, at_device: bool = True) -> int:
        endpoint = _u32(memory, argument)
        if at_device:
            self._request(0x02, 0x01, 0, endpoint, 0)
        return 0

    # ------------------------------------------------------------------------------------------ URBs

    def _submit(self, argument: int, memory: HostMemory) -> int:
        kind, endpoint, _, flags, buffer, length, *_ = URB.unpack(memory.copy_from_user(argument, URB.size))
        urb = Urb(argument, kind, endpoint, flags, buffer, length)
        if kind not in (URB_CONTROL, URB_BULK) or length < 0:
            raise _error(errno.EINVAL)
        if kind == URB_CONTROL:
            if not SETUP.size <= length <= LARGEST_CONTROL + SETUP.size:
                raise _error(errno.EINVAL)
            urb.setup = memory.copy_from_user(buffer, SETUP.size)
            self._submit_control(urb)
        elif endpoint & _IN:
            self._submit_in(urb)
        else:
            urb.data = bytearray(memory.copy_from_user(buffer, length))
            self._submit_out(urb)
        return 0

    def _submit_control(self, urb: Urb) -> None:
        kind, request, value, index, length = SETUP.unpack(urb.setup)
        with self._time.condition:
            self._check()
            self._tap("S", urb)
            try:
                urb.data = bytearray(self._camera.request(kind, request, value, index, length))
                urb.done = len(urb.data) if urb.is_in else length
            except Stall:
                urb.status = -errno.EPIPE
            self._finish(urb)

    def _submit_out(self, urb: Urb) -> None:
        with self._time.condition:
            self._check()
            self._may_use(urb.endpoint)
            self._tap("S", urb)
            try:
                urb.done = self._camera.write(urb.endpoint, bytes(urb.data))
            except Stall:
                urb.status = -errno.EPIPE
            self._finish(urb)

    def _submit_in(self, urb: Urb) -> None:
        with self._time.condition:
            self._check()
            self._may_use(urb.endpoint)
            if sum(map(len, self._waiting.values())) + len(self.finished) >= URBS_AT_ONCE:
                raise _error(errno.ENOMEM)
            spare = next((i for i, data in enumerate(self._spare) if len(data) == urb.length), None)
            urb.data = bytearray(urb.length) if spare is None else self._spare.pop(spare)
            self._tap("S", urb)
            self._waiting.setdefault(urb.endpoint, deque()).append(urb)
            self._advance()
            self._time.condition.notify_all()

    def _may_use(self, endpoint: int) -> None:
        """Check the claim like the kernel: an unclaimed interface is claimed by its first transfer."""
        interface = _interface_of(self._camera.configuration_descriptor(), endpoint)
        if interface is None:
            raise _error(errno.ENOENT)
        if self._device.claims.setdefault(interface, self) is not self:
            raise _error(errno.EBUSY)

    def _pump_forever(self) -> None:
        with self._time.condition:
            while not self._closed:
                if not self._advance():
                    self._time.condition.wait(LONGEST_WAIT_S)

    def _advance(self) -> bool:
        """Fill waiting transfers with the available data; return True if any ended. The caller holds the lock."""
        ended = False
        if not self._device.present:
            for queue in self._waiting.values():
                while queue:
                    urb = queue.popleft()
                    # The kernel's status for transfers of a device that has left the bus.
                    urb.status = -errno.ESHUTDOWN
                    self._finish(urb)
                    ended = True
            self._device.completed()
            return ended
        for endpoint, queue in self._waiting.items():
            while queue and self._fill(endpoint, queue[0]):
                self._finish(queue.popleft())
                ended = True
        return ended

    def _fill(self, endpoint: int, urb: Urb) -> bool:
        """Fill a transfer with the available data; return True if it ended."""
        try:
            filled, ends = self._camera.read(endpoint, memoryview(urb.data)[urb.done :])
        except Stall:
            urb.status = -errno.EPIPE
            return True
        except Overflow:
            urb.status = -errno.EOVERFLOW
            return True
        urb.done += filled
        # URB_SHORT_NOT_OK: a transfer that ends early is an error for the host.
        if ends and urb.flags & SHORT_NOT_OK and urb.done < urb.length:
            urb.status = -errno.EREMOTEIO
        return ends

    def _finish(self, urb: Urb) -> None:
        self._tap("C", urb)
        self.finished.append(urb)
        self._device.completed()
        self._time.condition.notify_all()

    def _discard(self, argument: int) -> int:
        with self._time.condition:
            for queue in self._waiting.values():
                for urb in queue:
                    if urb.address == argument:
                        queue.remove(urb)
                        urb.status = -errno.ENOENT
                        self._finish(urb)
                        return 0
        raise _error(errno.EINVAL)

    def _reap(self, argument: int, memory: HostMemory, wait: bool) -> int:
        with self._time.condition:
            while wait and not self.finished and self._device.present:
                self._time.condition.wait(LONGEST_WAIT_S)
            if not self.finished:
                raise _error(errno.EAGAIN if self._device.present else errno.ENODEV)
            urb = self.finished.popleft()
            self._device.completed()
        # The host waits for this answer, and no other thread uses the URB, so the lock is free meanwhile.
        if urb.is_in:
            memory.copy_to_user(urb.buffer + len(urb.setup), memoryview(urb.data)[: urb.done])
        memory.copy_to_user(urb.address + _STATUS_AT, struct.pack("<i", urb.status))
        memory.copy_to_user(urb.address + _ACTUAL_AT, struct.pack("<i", urb.done))
        memory.copy_to_user(argument, _POINTER.pack(urb.address))
        if urb.is_in and urb.kind == URB_BULK and len(self._spare) < 4:
            self._spare.append(urb.data)
        return 0

    def _tap(self, event: str, urb: Urb) -> None:
        if self._device.tap is not None:
            self._device.tap(event, self._device, urb)


def _u32(memory: HostMemory, address: int) -> int:
    value: int = _U32.unpack(memory.copy_from_user(address, _U32.size))[0]
    return value


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


def _interface_of(configuration: bytes, endpoint: int) -> int | None:
    """Return the interface of an endpoint; ``None``: no such endpoint."""
    offset, interface = 0, None
    while offset < len(configuration):
        length, kind = configuration[offset], configuration[offset + 1]
        if kind == 4:
            interface = configuration[offset + 2]
        elif kind == 5 and configuration[offset + 2] == endpoint:
            return interface
        offset += length
    return None
