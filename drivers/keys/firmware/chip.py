"""The keypad's electronics on RP2040: pins, coil chip, watchdog and USB.

The only module beside ``main.py`` that needs MicroPython's ``machine``; it runs on the chip alone.
"""

import time

import machine
import usb.device
from usb.device.hid import HIDInterface

from drivers.keys.firmware import instrument, pins
from drivers.keys.firmware.hardware import PadHardware
from drivers.keys.firmware.ldc import COILS, CoilChip, found_on
from drivers.keys.firmware.report import DESCRIPTOR

RELEASE = 0x0200
WATCHDOG_MS = 2000
START_MS = 50
RETRY_MS = 1000
"""Interval after which a chip that does not answer is tried again."""


class ChipPad(PadHardware):
    """The pad's electronics; made once after a reset."""

    def __init__(self, serial: str) -> None:
        """Set up every pin and appear on the bus as the keypad; MicroPython's own serial port goes."""
        self._began_ms = time.ticks_ms()  # type: ignore[attr-defined]
        self._passed_ms = 0
        self._power = machine.Pin(pins.gpio("COILS_POWER"), machine.Pin.OUT, value=1)
        self._led = machine.Pin(pins.gpio("LED"), machine.Pin.OUT, value=0)
        self._bus = machine.I2C(
            pins.I2C_NUMBER,
            sda=machine.Pin(pins.gpio("SDA")),
            scl=machine.Pin(pins.gpio("SCL")),
            freq=pins.I2C_HZ,
            timeout=pins.I2C_TIMEOUT_US,
        )
        self._chip = self._found()
        self._retry_ms = 0
        self._hid = HIDInterface(DESCRIPTOR)
        usb.device.get().init(
            self._hid,
            builtin_driver=False,
            id_vendor=instrument.VENDOR,
            id_product=instrument.PRODUCT,
            bcd_device=RELEASE,
            manufacturer_str="Kingfisher",
            product_str="Key pad",
            serial_str=serial,
        )
        self._watchdog = machine.WDT(timeout=WATCHDOG_MS)

    def _found(self) -> CoilChip | None:
        """Return the coil chip, set up; ``None`` if none answers.

        It is tried with its power pin high (LDC3114: full power), then low (LDC1614: not shut down).
        """
        for level in (1, 0):
            self._power.value(level)
            time.sleep_ms(START_MS)  # type: ignore[attr-defined]
            chip = found_on(self._bus, pins.LDC3114_ADDRESS)
            if chip is not None:
                try:
                    chip.set_up()
                except OSError:
                    return None
                return chip
        return None

    def now_ms(self) -> int:
        # ticks_ms wraps; the pad's clock does not.
        now = time.ticks_ms()  # type: ignore[attr-defined]
        self._passed_ms += time.ticks_diff(now, self._began_ms)  # type: ignore[attr-defined]
        self._began_ms = now
        return self._passed_ms

    def raises(self) -> bool:
        return self._chip is None or self._chip.raises

    def counts(self) -> list[int | None]:
        no_counts: list[int | None] = [None] * COILS
        if self._chip is None:
            if self.now_ms() >= self._retry_ms:
                self._retry_ms = self.now_ms() + RETRY_MS
                self._chip = self._found()
            return no_counts
        try:
            return self._chip.counts()
        except OSError:
            # It may have lost its power and so its set-up.
            self._chip = None
            return no_counts

    def send(self, report: bytes) -> bool:
        # No timeout: a host that does not fetch reports must not stop the sampling of coils.
        return bool(self._hid.is_open() and not self._hid.busy() and self._hid.send_report(report, timeout_ms=0))

    def show(self, pressed: bool) -> None:
        self._led.value(pressed)

    def feed(self) -> None:
        self._watchdog.feed()
