"""The reports of the keypad: each change as the coils see it, and four times a second.

It knows no pin: all electronics are behind ``hardware.PadHardware``. Source: ``docs/protocols/keys.md``.
"""

from drivers.keys.firmware.coils import CoilFollower
from drivers.keys.firmware.hardware import PadHardware
from drivers.keys.firmware.pins import COILS
from drivers.keys.firmware.report import report

SAMPLE_MS = 12
"""Both chips are set to convert all four coils within that time."""
PERIOD_MS = 250


class PadCore:
    """The keypad's logic: call ``step`` at least every few ms."""

    def __init__(self, hardware: PadHardware) -> None:
        self._hardware = hardware
        self._coils = [CoilFollower() for _ in COILS]
        self._counter = 0
        self._pressed = 0
        self._faulty = 0
        now_ms = hardware.now_ms()
        self._sample_ms = now_ms
        self._report_ms = now_ms + PERIOD_MS
        self._unsaid = False

    def step(self) -> None:
        """Sample the coils when that is due, and send the reports."""
        hardware = self._hardware
        hardware.feed()
        now_ms = hardware.now_ms()
        if now_ms >= self._sample_ms:
            # From now, not from the last sample: late samples are not made up for.
            self._sample_ms = now_ms + SAMPLE_MS
            self._sample()
        if now_ms >= self._report_ms:
            self._report_ms += PERIOD_MS
            self._unsaid = True
        if self._unsaid and hardware.send(report(self._pressed, self._counter, self._faulty, now_ms)):
            # Only reports that USB has taken count: a gap in the numbers means a report that was lost later.
            self._counter = self._counter + 1 & 0xFF
            self._unsaid = False

    def _sample(self) -> None:
        counts = self._hardware.counts()
        raises = self._hardware.raises()
        pressed = faulty = 0
        for i in range(len(COILS)):
            coil = self._coils[i]
            coil.follow(counts[i], raises)
            if coil.pressed:
                pressed |= COILS[i].bit
            if coil.faulty:
                faulty |= COILS[i].bit
        if pressed != self._pressed or faulty != self._faulty:
            self._pressed = pressed
            self._faulty = faulty
            self._unsaid = True
            self._hardware.show(pressed != 0)
