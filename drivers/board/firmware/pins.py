"""The trigger board's pin assignment: every wire of the microcontroller, as data.

The module is a Raspberry Pi Pico (RP2040) or Pico 2 (RP2350), without radio: same header, same GPIO numbers. All lines
are 3.3 V. Read by MicroPython on the board and by CPython where wiring is drawn.
"""

from collections import namedtuple

Line = namedtuple("Line", ("name", "gpio", "header_pin", "direction", "at_reset", "purpose"))
"""One wire: ``gpio`` as the chip counts, ``header_pin`` as the Pico's header does (``None``: on the module itself),
``direction`` of ``in out adc i2c``, ``at_reset`` what holds the level before the firmware runs."""

LINES = (
    Line(
        "VSYNC",
        2,
        4,
        "in",
        "pull-down 100 k",
        "vertical sync of the projector's video, 3.3 V, through 1 k with 100 pF to ground",
    ),
    Line("TRIGGER", 3, 5, "out", "pull-down 10 k", "inputs of two gates of one 74HCT125: left and right camera"),
    Line("LASER_LEFT", 6, 9, "out", "pull-down 10 k", "enable of the left laser's constant-current driver"),
    Line("LASER_RIGHT", 7, 10, "out", "pull-down 10 k", "enable of the right laser's constant-current driver"),
    Line(
        "LASER_BEAT",
        8,
        11,
        "out",
        "pull-down 10 k",
        "edges that keep the laser gate open; it drops 100 ms after the last",
    ),
    Line(
        "LEAK_DRIVE", 10, 14, "out", "pull-down 10 k", "common leak electrode, driven for 200 us at a time through 1 k"
    ),
    Line("LEAK_FRONT", 11, 15, "in", "pull-down 100 k", "leak electrode below the front windows"),
    Line("LEAK_REAR", 12, 16, "in", "pull-down 100 k", "leak electrode below the rear cover"),
    Line("SDA", 20, 26, "i2c", "pull-up 4.7 k", "data of the sensors' bus, I2C0"),
    Line("SCL", 21, 27, "i2c", "pull-up 4.7 k", "clock of the sensors' bus, I2C0"),
    Line(
        "SERVICE",
        22,
        29,
        "in",
        "pull-up inside",
        "to ground at reset: the firmware does not start, MicroPython's prompt does",
    ),
    Line("LED", 25, None, "out", "none", "status light on the module: toggles with each heartbeat"),
    Line("LASER_LEFT_SENSE", 26, 31, "adc", "none", "ADC0: shunt amplifier of the left laser"),
    Line("LASER_RIGHT_SENSE", 27, 32, "adc", "none", "ADC1: shunt amplifier of the right laser"),
    Line("SUPPLY_SENSE", 28, 34, "adc", "none", "ADC2: supply of the instrument through a divider"),
)

CAMERA_OUTPUTS = (("left", "TRIGGER", "1A", "1Y"), ("right", "TRIGGER", "2A", "2Y"))
"""Camera, line, input and output of the 74HCT125. One line and one chip: the cameras' edges differ by less than 1 ns
before the cables, and no fault of the firmware triggers one camera without the other."""
CAMERA_GATE_V = 5.0
"""Supply of that chip."""
CAMERA_OPTO_V = 1.5
"""Forward voltage of the light-emitting diode in a camera's opto-isolated input."""
CAMERA_OPTO_MA = (3.5, 7.0)
"""Current that such an input wants (FLIR, Blackfly S: input current of OPTOIN)."""
CAMERA_SERIES_OHM = 680
"""Resistor in each camera's line: 5.1 mA into such an input, and within its range at any supply, diode and gate."""

LASER_SENSE_MV_PER_MA = 20.0
"""INA180A1 (20 V/V) over 1 ohm."""
LASER_ON_MA = 10.0
"""Current from which a laser counts as on, far below its working current and far above the amplifier's offset."""
SUPPLY_DIVIDER = 11.0
"""Voltage of the supply over that of the pin: 100 k and 10 k, up to 36 V."""
ADC_FULL_MV = 3300.0

Chip = namedtuple("Chip", ("part", "address", "values"))
"""One device on the I2C bus: its part, seven-bit address and the sensors of
``docs/protocols/board.md`` that it gives.
"""

CHIPS = (
    Chip("TMP117", 0x48, ("TPROJ",)),
    Chip("TMP117", 0x49, ("TCASE",)),
    Chip("SHT40", 0x44, ("HUM", "TBOARD")),
)
"""LEAK and SUPPLY are pins of the board itself. A chip that does not answer at the start is not fitted."""
I2C_NUMBER, I2C_HZ, I2C_TIMEOUT_US = 0, 100_000, 2000


def gpio(name: str) -> int:
    """Return the chip's number of the line ``name``. Raises ValueError for an unknown line."""
    for line in LINES:
        if line.name == name:
            return int(line.gpio)
    raise ValueError(f"line '{name}'; there are {', '.join([line.name for line in LINES])}")
