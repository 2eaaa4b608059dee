"""The interface between the board's core and its electronics: pins, stamps, clock and wire.

``chip.py`` implements it on the microcontroller; tests implement it with a model of the pins.
"""


class BoardHardware:
    """The electronics as the core sees them.

    Times are in us of the board's clock, which starts near 0 at reset.
    """

    def now_us(self) -> int:
        """Return the board's clock: 64 bit, never backwards."""
        raise NotImplementedError

    def wait_us(self, time_us: int) -> None:
        """Let ``time_us`` pass: at most 2000."""
        raise NotImplementedError

    def next_sync(self) -> int | None:
        """Return the time of the oldest unread vertical sync; ``None`` when all were read."""
        raise NotImplementedError

    def next_pulse(self) -> int | None:
        """Return the time of the oldest unread rising edge of the trigger line; ``None`` when all were read."""
        raise NotImplementedError

    def syncs_lost(self) -> bool:
        """Return True if stamps of syncs were lost since the last call, because they were not read in time."""
        raise NotImplementedError

    def start(self, skip: int, every: int, pulses: int | None, delay_us: int, width_us: int) -> None:
        """Fire on the sync after the next ``skip`` ones and on each ``every``-th behind it.

        It fires ``pulses`` times or for ever. Replaces an earlier series; a pulse that has begun keeps its width.
        """
        raise NotImplementedError

    def stop(self) -> None:
        """Begin no more pulses; one that has begun keeps its width."""
        raise NotImplementedError

    def set_lasers(self, left: bool, right: bool) -> None:
        """Switch both laser drivers, and let their currents settle."""
        raise NotImplementedError

    def lasers(self) -> tuple[bool, bool]:
        """Return whether a current flows through the left and the right laser."""
        raise NotImplementedError

    def beat(self) -> None:
        """Give the laser gate one more edge; without one for 100 ms it opens and no laser shines."""
        raise NotImplementedError

    def feed(self) -> None:
        """Keep the watchdog from resetting the board."""
        raise NotImplementedError

    def fitted(self) -> list[str]:
        """Return the names of the sensors that answered at reset, in the order of the protocol."""
        raise NotImplementedError

    def measure(self, name: str) -> str:
        """Return the value of a sensor as the protocol writes it; ``-`` when it does not answer."""
        raise NotImplementedError

    def read(self) -> bytes:
        """Return the bytes from the host, at most 256; empty if there are none."""
        raise NotImplementedError

    def write(self, line: bytes) -> None:
        """Send a line to the host; it is lost as a whole when no host listens or the buffer is full."""
        raise NotImplementedError
