"""The interface between the keypad's core and its electronics: clock, coils, USB, watchdog and light.

``chip.py`` implements it on the microcontroller; tests implement it with a model of coils and fingers.
"""


class PadHardware:
    """The electronics as the core sees them."""

    def now_ms(self) -> int:
        """Return the pad's clock in ms: it starts near 0 and never goes backwards."""
        raise NotImplementedError

    def counts(self) -> list[int | None]:
        """Return the latest count of each coil, in the order of ``pins.COILS``.

        It is ``None`` where a coil gives none.
        """
        raise NotImplementedError

    def raises(self) -> bool:
        """Return True if a press raises the counts of this chip, False if it lowers them."""
        raise NotImplementedError

    def send(self, report: bytes) -> bool:
        """Hand a report to USB; return False if the earlier one was not fetched yet, or no host is there."""
        raise NotImplementedError

    def show(self, pressed: bool) -> None:
        """Switch the status light."""
        raise NotImplementedError

    def feed(self) -> None:
        """Keep the watchdog from resetting the pad."""
        raise NotImplementedError
