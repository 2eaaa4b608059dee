"""Owns what the pad's core asks of the electronics: clock, coils, USB, watchdog and light behind one small door.

``chip.py`` is that door on the microcontroller; tests put a model of coils and fingers there.
"""


class PadHardware:
    """The electronics as the core sees them."""

    def now_ms(self) -> int:
        """Return the pad's clock in ms: it starts near 0 and never goes backwards."""
        raise NotImplementedError

    def counts(self) -> list[int | None]:
        """Return the latest count of each coil, in the order of ``pins.COILS``; ``None`` where a coil gives none."""
        raise NotImplementedError

    def raises(self) -> bool:
        """Tell whether a press raises the counts of this chip or lowers them."""
        raise NotImplementedError

    def send(self, report: bytes) -> bool:
        """Hand a report to USB; ``False`` if the one before has not been fetched yet, or nobody is there."""
        raise NotImplementedError

    def show(self, pressed: bool) -> None:
        """Switch the status light."""
        raise NotImplementedError

    def feed(self) -> None:
        """Keep the watchdog from resetting the pad."""
        raise NotImplementedError
