"""The keypad's pin assignment: every wire between microcontroller, coil chip and coils, as data.

The module is a Raspberry Pi Pico (RP2040). Read by MicroPython on the pad and by CPython where wiring is drawn.
"""

from collections import namedtuple

Line = namedtuple("Line", ("name", "gpio", "header_pin", "direction", "at_reset", "purpose"))
"""One wire of 3.3 V: ``gpio`` as the chip counts, ``header_pin`` as the Pico's header does (``None``: on the module),
``direction`` of ``in out i2c``, ``at_reset`` what holds the level before the firmware runs."""

LINES = (
    Line(
        "SDA",
        4,
        6,
        "i2c",
        "pull-up 4.7 k",
        "data of the coil chip, I2C0; LDC3114: through a level shifter to its 1.8 V",
    ),
    Line("SCL", 5, 7, "i2c", "pull-up 4.7 k", "clock of the coil chip, I2C0; LDC3114: through a level shifter"),
    Line("COILS_READY", 6, 9, "in", "pull-up 10 k", "INTB of the coil chip: low when a conversion is ready"),
    Line(
        "COILS_POWER",
        7,
        10,
        "out",
        "pull-up 10 k",
        "LPWRB of an LDC3114 (high: normal power), or SD of an LDC1614 (low: on)",
    ),
    Line("SERVICE", 22, 29, "in", "pull-up inside", "to ground at reset: the firmware does not start"),
    Line("LED", 25, None, "out", "none", "status light on the module: on while a key is pressed"),
)

Coil = namedtuple("Coil", ("channel", "key", "bit"))
"""One coil: the chip's channel, the key of ``docs/protocols/keys.md`` and its bit in the report."""

COILS = (Coil(0, "SCAN", 0x01), Coil(1, "BACK", 0x02), Coil(2, "UP", 0x04), Coil(3, "DOWN", 0x08))

LDC3114_ADDRESS = 0x2A
LDC1614_ADDRESS = 0x2A
"""The LDC3114's only address, and the LDC1614's while its pin ADDR is low: the identity registers tell them apart."""
I2C_NUMBER, I2C_HZ, I2C_TIMEOUT_US = 0, 400_000, 2000


def gpio(name: str) -> int:
    """Return the chip's number of the line ``name``. Raises ValueError for an unknown line."""
    for line in LINES:
        if line.name == name:
            return int(line.gpio)
    raise ValueError(f"line '{name}'; there are {', '.join([line.name for line in LINES])}")
