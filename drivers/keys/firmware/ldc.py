"""The registers of the two coil chips: identity, set-up and counts, on any bus like MicroPython's.

Sources: LDC3114 datasheet SNOSDB4, section 8.6; LDC1614 datasheet SNOSCY9, section 7.6. Both lie at address 0x2A.
"""

COILS = 4
MANUFACTURER = 0x5449


class RegisterBus:
    """The part of ``machine.I2C`` that is needed here; its methods raise OSError where no chip answers."""

    def readfrom_mem(self, address: int, register: int, count: int) -> bytes:
        """Return ``count`` bytes from ``register`` on."""
        raise NotImplementedError

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        """Write ``data`` from ``register`` on."""
        raise NotImplementedError


class CoilChip:
    """A chip with four coils. ``raises``: a press, which lowers the inductance, raises its counts."""

    raises = True

    def __init__(self, bus: RegisterBus, address: int) -> None:
        self._bus = bus
        self._address = address

    def present(self) -> bool:
        """Return True if this chip is on the bus; never raises."""
        raise NotImplementedError

    def set_up(self) -> None:
        """Set the chip to convert all coils for ever. Raises OSError where it does not accept that."""
        raise NotImplementedError

    def counts(self) -> list[int | None]:
        """Return the latest count of each coil, ``None`` where its oscillation failed. Raises OSError."""
        raise NotImplementedError


class Ldc3114(CoilChip):
    """Four channels with raw data of 24 bit, 80 times a second, at 1.8 V.

    Its own baseline and button logic are off: they forget a key that is held, and this firmware separates drift from
    fingers itself. A count is the reference clocks of so many oscillations: a press, which makes them faster, lowers
    it.
    """

    raises = False
    STATUS, RESET, ENABLE, SCAN_RATE, POLARITY, RAW = 0x00, 0x0A, 0x0C, 0x0D, 0x11, 0x59
    IDENTITY, DEVICE = 0xFC, 0x4000
    READY_TO_WRITE, CONFIGURE = 0x20, 0x01
    ALL_COILS, FASTEST, NO_BUTTONS = 0x0F, 0x00, 0x10
    TRIES = 50
    FULL = 0xFFFFFF

    def present(self) -> bool:
        """Return True if maker and device are those of an LDC3114."""
        try:
            raw = self._bus.readfrom_mem(self._address, self.IDENTITY, 4)
        except OSError:
            return False
        return raw[0] | raw[1] << 8 == MANUFACTURER and raw[2] | raw[3] << 8 == self.DEVICE

    def set_up(self) -> None:
        """Write the set-up in configuration mode, outside of which the chip ignores it."""
        self._write(self.RESET, self.CONFIGURE)
        for _ in range(self.TRIES):
            if self._read(self.STATUS) & self.READY_TO_WRITE:
                break
        else:
            raise OSError("the LDC3114 cannot be configured")
        self._write(self.ENABLE, self.ALL_COILS)
        self._write(self.SCAN_RATE, self.FASTEST)
        self._write(self.POLARITY, self.NO_BUTTONS)
        self._write(self.RESET, 0)
        if self._read(self.POLARITY) != self.NO_BUTTONS:
            raise OSError("the LDC3114 has not kept its configuration")

    def counts(self) -> list[int | None]:
        """Return 24-bit counts, the low byte first on the bus; all bits alike is no oscillation."""
        raw = self._bus.readfrom_mem(self._address, self.RAW, 3 * COILS)
        counts: list[int | None] = []
        for i in range(COILS):
            count = raw[3 * i] | raw[3 * i + 1] << 8 | raw[3 * i + 2] << 16
            counts.append(None if count in (0, self.FULL) else count)
        return counts

    def _read(self, register: int) -> int:
        return self._bus.readfrom_mem(self._address, register, 1)[0]

    def _write(self, register: int, value: int) -> None:
        self._bus.writeto_mem(self._address, register, bytes([value]))


class Ldc1614(CoilChip):
    """Four channels of 28 bit with a reference of 40 MHz, each converted for 2 ms, at 3.3 V.

    A count is the coil's frequency over the reference's: a press raises it.
    """

    DATA, RCOUNT, SETTLE, DIVIDERS, ERRORS, CONFIG, MUX, DRIVE = 0x00, 0x08, 0x10, 0x14, 0x19, 0x1A, 0x1B, 0x1E
    IDENTITY, DEVICE = 0x7E, 0x3055
    REFERENCE_COUNTS = 5000
    """Conversion time x 40 MHz / 16."""
    SETTLE_COUNTS = 10
    UNDIVIDED = 0x1001
    DRIVE_CURRENT = 0x9000
    """0.2 mA: to be matched to the coil (section 8.1.4 there)."""
    ERRORS_IN_DATA = 0xF801
    ALL_COILS_IN_TURN = 0xC20D
    ASLEEP, AWAKE = 0x2801, 0x1601
    """AWAKE: reference from the pin, no automatic amplitude."""

    def present(self) -> bool:
        """Return True if maker and device are those of an LDC1614."""
        try:
            return self._read(self.IDENTITY) == MANUFACTURER and self._read(self.IDENTITY + 1) == self.DEVICE
        except OSError:
            return False

    def set_up(self) -> None:
        """Write the set-up in sleep mode, outside of which the chip ignores it."""
        self._write(self.CONFIG, self.ASLEEP)
        for i in range(COILS):
            self._write(self.RCOUNT + i, self.REFERENCE_COUNTS)
            self._write(self.SETTLE + i, self.SETTLE_COUNTS)
            self._write(self.DIVIDERS + i, self.UNDIVIDED)
            self._write(self.DRIVE + i, self.DRIVE_CURRENT)
        self._write(self.ERRORS, self.ERRORS_IN_DATA)
        self._write(self.MUX, self.ALL_COILS_IN_TURN)
        if self._read(self.MUX) != self.ALL_COILS_IN_TURN:
            raise OSError("the LDC1614 has not kept its configuration")
        self._write(self.CONFIG, self.AWAKE)

    def counts(self) -> list[int | None]:
        """Return 28-bit counts; the four bits above them are the coil's errors."""
        counts: list[int | None] = []
        for i in range(COILS):
            high = self._read(self.DATA + 2 * i)
            count = (high & 0x0FFF) << 16 | self._read(self.DATA + 2 * i + 1)
            counts.append(None if high & 0xF000 or count == 0 else count)
        return counts

    def _read(self, register: int) -> int:
        raw = self._bus.readfrom_mem(self._address, register, 2)
        return raw[0] << 8 | raw[1]

    def _write(self, register: int, value: int) -> None:
        self._bus.writeto_mem(self._address, register, bytes([value >> 8, value & 0xFF]))


def found_on(bus: RegisterBus, address: int) -> CoilChip | None:
    """Return the chip that answers, not set up yet; ``None`` if none of the two does."""
    for chip in (Ldc3114(bus, address), Ldc1614(bus, address)):
        if chip.present():
            return chip
    return None
