"""Owns a desk for the pad's core: coils, fingers, drift and a host, in time that only its owner turns.

Runs under CPython and under MicroPython alike, so it has nothing that MicroPython lacks.
"""

from drivers.keys.firmware.core import PadCore
from drivers.keys.firmware.hardware import PadHardware

TURN_MS = 2
"""Time of one turn of the firmware's loop."""
RESTING = (4_000_000, 4_100_000, 3_900_000, 4_050_000)
PRESS_PPM = 900
RISE_MS = 30
"""Time a finger needs to bend the wall."""


class PadDeskHardware(PadHardware):
    """Four coils whose counts rest, drift, tremble and bend; everything sent is kept with its time."""

    def __init__(self) -> None:
        self.time_ms = 0
        self.down = [False] * 4
        self.bend_ppm = [0.0] * 4
        self.drift_ppm_s = 0.0
        self.offset_ppm = [0.0] * 4
        self.noise_ppm = 10
        self.broken = [False] * 4
        self.press_raises = True
        self.listening = True
        self.sent: list[tuple[int, bytes]] = []
        self.fed = 0
        self.lit = False
        self._seed = 1

    def advance(self, time_ms: int) -> None:
        self.time_ms += time_ms
        step = PRESS_PPM * time_ms / RISE_MS
        for i in range(4):
            if self.down[i]:
                self.bend_ppm[i] = min(self.bend_ppm[i] + step, PRESS_PPM)
            else:
                self.bend_ppm[i] = max(self.bend_ppm[i] - step, 0)

    def _noise(self) -> float:
        """Return noise of triangular shape, the same in each run (Numerical Recipes, section 7.1)."""
        total = 0.0
        for _ in range(2):
            self._seed = (self._seed * 1664525 + 1013904223) & 0xFFFFFFFF
            total += self._seed / 4294967296 - 0.5
        return total * 2 * self.noise_ppm

    def now_ms(self) -> int:
        return self.time_ms

    def counts(self) -> list[int | None]:
        found: list[int | None] = []
        for i in range(4):
            ppm = self.drift_ppm_s * self.time_ms / 1000 + self.offset_ppm[i] + self._noise()
            ppm += self.bend_ppm[i] if self.press_raises else -self.bend_ppm[i]
            found.append(None if self.broken[i] else int(RESTING[i] * (1 + ppm / 1_000_000)))
        return found

    def raises(self) -> bool:
        return self.press_raises

    def send(self, report: bytes) -> bool:
        if self.listening:
            self.sent.append((self.time_ms, report))
        return self.listening

    def show(self, pressed: bool) -> None:
        self.lit = pressed

    def feed(self) -> None:
        self.fed += 1


class PadDesk:
    def __init__(self) -> None:
        self.hardware = PadDeskHardware()
        self.core = PadCore(self.hardware)

    def run(self, time_ms: int) -> list[tuple[int, bytes]]:
        """Let ``time_ms`` pass and return what was reported, with the desk's time in ms."""
        for _ in range(time_ms // TURN_MS):
            self.hardware.advance(TURN_MS)
            self.core.step()
        sent = self.hardware.sent
        self.hardware.sent = []
        return sent

    def finger(self, key: int, down: bool) -> None:
        """Put a finger on key 0..3, or take it off."""
        self.hardware.down[key] = down
