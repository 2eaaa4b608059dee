"""The hidapi end of the key pad's wire: an object of the shape of hidapi's module ``hidraw``."""

from __future__ import annotations

from collections import deque
from typing import Any

from hw_sim.devices import keypad as pad
from hw_sim.devices.keypad import Keypad
from hw_sim.timing.world_time import WorldTime

REPORTS_KEPT = 63
"""The kernel's hidraw has a ring of 64, one of them unused; without a reader the newest reports are lost."""
BUS_TYPE_USB = 1


class HidrawModule:
    """``enumerate`` and ``device``, as in ``import hidraw``."""

    def __init__(self, keypad: Keypad, time: WorldTime) -> None:
        self._keypad, self._time = keypad, time

    def enumerate(self, vendor_id: int = 0, product_id: int = 0) -> list[dict[str, Any]]:
        """Return the devices of that vendor and product; 0 matches all."""
        with self._time.condition:
            matches = vendor_id in (0, pad.VENDOR) and product_id in (0, pad.PRODUCT)
            if not matches or not self._keypad.plugged or self._time.closed:
                return []
            return [
                {
                    "path": self._path(),
                    "vendor_id": pad.VENDOR,
                    "product_id": pad.PRODUCT,
                    "serial_number": pad.SERIAL,
                    "release_number": pad.RELEASE,
                    "manufacturer_string": pad.MANUFACTURER,
                    "product_string": pad.NAME,
                    "usage_page": pad.USAGE_PAGE,
                    "usage": pad.USAGE,
                    "interface_number": 0,
                    "bus_type": BUS_TYPE_USB,
                }
            ]

    def _path(self) -> bytes:
        # Each time the device appears it has another path, as with udev: an old path never leads to the new device.
        return b"/dev/hidraw%d" % self._keypad.enumeration

    def device(self) -> HidDevice:
        """Return a device that is not opened yet."""
        return HidDevice(self, self._keypad, self._time)

    def is_there(self, path: bytes) -> bool:
        """Return whether the path leads to the pad. The caller holds the lock."""
        return self._keypad.plugged and not self._time.closed and path == self._path()


class HidDevice:
    """hidapi's ``device``. Raises OSError where hidapi does, ValueError when it is not open."""

    def __init__(self, module: HidrawModule, keypad: Keypad, time: WorldTime) -> None:
        self._module, self._keypad, self._time = module, keypad, time
        self._path: bytes | None = None
        self._nonblocking = False
        self._reports: deque[bytes] = deque()

    def open_path(self, path: bytes) -> None:
        """Open by path."""
        with self._time.condition:
            if not self._module.is_there(path):
                raise OSError("open failed")
            self._path = path
            self._reports.clear()
            self._keypad.listen(self._receive)

    def open(self, vendor_id: int = 0, product_id: int = 0, serial_number: str | None = None) -> None:
        """Open the first that matches."""
        for device in self._module.enumerate(vendor_id, product_id):
            if serial_number in (None, device["serial_number"]):
                self.open_path(device["path"])
                return
        raise OSError("open failed")

    def close(self) -> None:
        """Close; may be called again."""
        with self._time.condition:
            self._path = None
            self._keypad.forget(self._receive)
            self._time.condition.notify_all()

    def set_nonblocking(self, v: int) -> int:
        """Let ``read`` without a timeout return at once."""
        self._check_open()
        self._nonblocking = bool(v)
        return 0

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """Return a report, cut to ``max_length``; empty after the timeout. Without a timeout it waits for ever."""
        path = self._check_open()
        with self._time.condition:
            if timeout_ms > 0:
                limit_s: float | None = timeout_ms / 1000
            else:
                # hidapi's read without a timeout waits for ever, unless the device is in non-blocking mode.
                limit_s = 0.0 if self._nonblocking else None
            self._time.wait_for(lambda: bool(self._reports) or not self._usable(path), limit_s)
            if self._reports:
                return list(self._reports.popleft()[:max_length])
            if not self._usable(path):
                raise OSError("read error")
            return []

    def write(self, buff: bytes) -> int:
        """Refuse an output report, of which the pad has none: -1, as hidapi says it."""
        self._check_open()
        return -1

    def error(self) -> str:
        """Return hidapi's last error."""
        self._check_open()
        return "Success"

    def get_manufacturer_string(self) -> str:
        """Return iManufacturer."""
        self._check_open()
        return pad.MANUFACTURER

    def get_product_string(self) -> str:
        """Return iProduct."""
        self._check_open()
        return pad.NAME

    def get_serial_number_string(self) -> str:
        """Return iSerialNumber."""
        self._check_open()
        return pad.SERIAL

    def get_report_descriptor(self) -> list[int]:
        """Return the HID report descriptor."""
        self._check_open()
        return list(pad.REPORT_DESCRIPTOR)

    def _usable(self, path: bytes) -> bool:
        return self._path == path and self._module.is_there(path)

    def _check_open(self) -> bytes:
        if self._path is None:
            raise ValueError("not open")
        return self._path

    def _receive(self, report: bytes) -> None:
        if len(self._reports) < REPORTS_KEPT:
            self._reports.append(report)
