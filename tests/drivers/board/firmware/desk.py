"""Owns a desk for the firmware's core: pins, PIO and clock as a model in time that only its owner turns.

Runs under CPython and under MicroPython alike, so it has nothing that MicroPython lacks.
"""

from drivers.board.firmware.core import BoardCore
from drivers.board.firmware.hardware import BoardHardware

PERIOD_US = 16_667
TURN_US = 250
"""Time of one turn of the firmware's loop."""
SENSORS = (("TPROJ", "31.25"), ("TCASE", "18.5"), ("TBOARD", "-"), ("LEAK", "0"), ("HUM", "41.0"), ("SUPPLY", "23.87"))


class DeskHardware(BoardHardware):
    """What PIO and pins do, by the clock: syncs each 16,667 us while there are any, and pulses behind them."""

    def __init__(self) -> None:
        self.time_us = 0
        self.synced = True
        self.stuck_left = False
        self.sent = bytearray()
        self.fired: list[int] = []
        self.fed = 0
        self.beats = 0
        self._received = b""
        self._syncs: list[int] = []
        self._edges = 0
        self._pending: list[int] = []
        self._pulses: list[int] = []
        self._job: tuple[int, int, int, int] | None = None
        self._lasers = (False, False)
        self._lost = False

    def hear(self, data: bytes) -> None:
        """Lay bytes from the host into the wire."""
        self._received += data

    def advance(self, to_us: int) -> None:
        """Let time pass, and let everything happen that is due until then."""
        while self.time_us < to_us:
            self.time_us = min(to_us, self._next_event_us())
            if self.time_us % PERIOD_US == 0 and self.synced:
                self._sync()
            while self._pending and self._pending[0] <= self.time_us:
                self._pending.pop(0)
                self._pulses.append(self.time_us)
                self.fired.append(self.time_us)

    def _next_event_us(self) -> int:
        due_us = (self.time_us // PERIOD_US + 1) * PERIOD_US
        return min(due_us, self._pending[0]) if self._pending else due_us

    def _sync(self) -> None:
        self._edges += 1
        # The stamps' FIFO holds eight.
        if len(self._syncs) < 8:
            self._syncs.append(self.time_us)
        else:
            self._lost = True
        if self._job is None:
            return
        first, every, pulses, delay_us = self._job
        since = self._edges - first
        if since >= 0 and since % every == 0 and since // every < pulses:
            self._pending.append(self.time_us + delay_us)

    def now_us(self) -> int:
        return self.time_us

    def wait_us(self, time_us: int) -> None:
        self.advance(self.time_us + time_us)

    def next_sync(self) -> int | None:
        return self._syncs.pop(0) if self._syncs else None

    def next_pulse(self) -> int | None:
        return self._pulses.pop(0) if self._pulses else None

    def syncs_lost(self) -> bool:
        lost = self._lost
        self._lost = False
        return lost

    def start(self, skip: int, every: int, pulses: int | None, delay_us: int, width_us: int) -> None:
        self.stop()
        self._job = (self._edges + 1 + skip, every, 1 << 32 if pulses is None else pulses, delay_us)

    def stop(self) -> None:
        self._job = None
        self._pending = []

    def set_lasers(self, left: bool, right: bool) -> None:
        self._lasers = (left, right)

    def lasers(self) -> tuple[bool, bool]:
        return self._lasers[0] or self.stuck_left, self._lasers[1]

    def beat(self) -> None:
        self.beats += 1

    def feed(self) -> None:
        self.fed += 1

    def fitted(self) -> list[str]:
        return [name for name, _ in SENSORS]

    def measure(self, name: str) -> str:
        return dict(SENSORS)[name]

    def read(self) -> bytes:
        data = self._received[:256]
        self._received = self._received[256:]
        return data

    def write(self, line: bytes) -> None:
        self.sent += line


class Desk:
    """A core on its desk; ``exchange`` is all that a host needs."""

    def __init__(self, hardware: DeskHardware | None = None) -> None:
        self.hardware = hardware or DeskHardware()
        self.core = BoardCore(self.hardware, "KF-DESK-1", "POWER")

    def exchange(self, data: bytes, time_us: int) -> bytes:
        """Give the board ``data``, let ``time_us`` pass, and return what it said."""
        hardware = self.hardware
        hardware.hear(data)
        end_us = hardware.time_us + time_us
        while hardware.time_us < end_us:
            hardware.advance(min(end_us, hardware.time_us + TURN_US))
            self.core.step()
        said = bytes(hardware.sent)
        hardware.sent = bytearray()
        return said

    def sync(self, there: bool) -> None:
        """Connect or disconnect the video signal."""
        self.hardware.synced = there
