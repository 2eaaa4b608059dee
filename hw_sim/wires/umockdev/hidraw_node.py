"""The kernel's hidraw for the simulated key pad: one report for each read, and the pad's description.

Source: Linux ``include/uapi/linux/hidraw.h`` and ``drivers/hid/hidraw.c``.
"""

from __future__ import annotations

import errno
import os
import struct
from collections import deque

from hw_sim.devices import keypad as pad
from hw_sim.devices.keypad import Keypad
from hw_sim.timing.world_time import LONGEST_WAIT_S, WorldTime
from hw_sim.wires.umockdev.preload import HostMemory
from hw_sim.wires.umockdev.readiness import Readiness

REPORTS_KEPT = 63
"""A ring of 64, one of them unused; without a reader the newest reports are lost."""
BUS_USB = 3
_TYPE = ord("H")
DESCRIPTOR_SIZE, DESCRIPTOR, RAW_INFO, RAW_NAME, RAW_PHYS, RAW_UNIQUE = 1, 2, 3, 4, 5, 8
PHYS = "usb-0000:00:14.0-1/input0"


class PluggedPad:
    """The state that all openings of the pad share while it is plugged in."""

    def __init__(self, keypad: Keypad, time: WorldTime, ready: Readiness) -> None:
        self.keypad, self.time, self.ready = keypad, time, ready
        self.enumeration = keypad.enumeration
        self.files: list[HidFile] = []

    @property
    def present(self) -> bool:
        """True while the pad has not left the bus. The caller holds the lock."""
        return not self.time.closed and self.keypad.plugged and self.keypad.enumeration == self.enumeration

    def changed(self) -> None:
        """Note a change of some file's reports, or the pad's removal. The caller holds the lock."""
        self.ready.set(not self.present or any(file.reports for file in self.files))


class HidFile:
    """One opening of ``/dev/hidrawN``. Takes the world's lock itself."""

    def __init__(self, device: PluggedPad) -> None:
        self._device = device
        self.reports: deque[bytes] = deque()
        with device.time.condition:
            device.files.append(self)
            device.keypad.listen(self._receive)

    def _receive(self, report: bytes) -> None:
        if len(self.reports) < REPORTS_KEPT:
            self.reports.append(report)
            self._device.changed()

    def close(self) -> None:
        """End the opening: no more reports."""
        with self._device.time.condition:
            self._device.keypad.forget(self._receive)
            self._device.files.remove(self)

    def read(self, size: int) -> bytes:
        """Wait for one report and return it, cut to ``size``. Raises OSError(EIO) when the pad is gone."""
        time = self._device.time
        with time.condition:
            while not self.reports:
                if not self._device.present:
                    raise _error(errno.EIO)
                time.condition.wait(LONGEST_WAIT_S)
            report = self.reports.popleft()
            self._device.changed()
            return report[:size]

    def write(self, data: bytes) -> int:
        """Refuse an output report, of which the pad has none. Raises OSError(EPIPE)."""
        raise _error(errno.EPIPE)

    def ioctl(self, request: int, argument: int, memory: HostMemory) -> int:
        if request >> 8 & 0xFF != _TYPE:
            raise _error(errno.ENOTTY)
        with self._device.time.condition:
            if not self._device.present:
                raise _error(errno.ENODEV)
        descriptor, room = pad.REPORT_DESCRIPTOR, request >> 16 & 0x3FFF
        match request & 0xFF:
            # HIDIOCGRDESCSIZE, HIDIOCGRDESC, HIDIOCGRAWINFO, HIDIOCGRAWNAME, HIDIOCGRAWPHYS, HIDIOCGRAWUNIQ.
            case 1:
                memory.copy_to_user(argument, struct.pack("<I", len(descriptor)))
            case 2:
                (size,) = struct.unpack("<I", memory.copy_from_user(argument, 4))
                memory.copy_to_user(argument + 4, descriptor[:size])
            case 3:
                memory.copy_to_user(argument, struct.pack("<IHH", BUS_USB, pad.VENDOR, pad.PRODUCT))
            case 4:
                return _text(memory, argument, room, f"{pad.MANUFACTURER} {pad.NAME}")
            case 5:
                return _text(memory, argument, room, PHYS)
            case 8:
                return _text(memory, argument, room, pad.SERIAL)
            case _:
                raise _error(errno.ENOTTY)
        return 0


def _text(memory: HostMemory, address: int, room: int, text: str) -> int:
    data = (text.encode() + b"\0")[:room]
    memory.copy_to_user(address, data)
    return len(data)


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))
