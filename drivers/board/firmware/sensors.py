"""Conversion of the sensors' bits: registers and converter counts in, values of the protocol out.

Sources: TMP117 datasheet SNOSD82, table 7-3; SHT4x datasheet, sections 4.4 and 4.5; INA180 gain of ``pins.py``.
"""

MISSING = "-"
ADC_FULL = 65535
SHT40_MEASURE = 0xFD
"""Both values with high precision, ready after 8.3 ms."""
TMP117_VALUE, TMP117_IDENTITY, TMP117_PART = 0x00, 0x0F, 0x0117
_TMP117_NOT_YET = 0x8000


def tmp117_c(raw: bytes) -> float | None:
    """Return the temperature in a TMP117's two bytes, steps of 1/128 °C.

    It is ``None`` before the first conversion.
    """
    value = raw[0] << 8 | raw[1]
    if value == _TMP117_NOT_YET:
        return None
    return (value - 65536 if value & 0x8000 else value) / 128


def sht40(raw: bytes) -> tuple[float, float] | None:
    """Return temperature in °C and relative humidity in % of an SHT40's six bytes.

    They are ``None`` if a checksum is wrong.
    """
    if len(raw) != 6 or crc8(raw[0:2]) != raw[2] or crc8(raw[3:5]) != raw[5]:
        return None
    temperature_c = -45 + 175 * (raw[0] << 8 | raw[1]) / 65535
    humidity_percent = -6 + 125 * (raw[3] << 8 | raw[4]) / 65535
    return temperature_c, min(max(humidity_percent, 0.0), 100.0)


def crc8(data: bytes) -> int:
    """Return the checksum of an SHT40: polynomial 0x31, initial value 0xFF; of BE EF it is 92."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x31 if crc & 0x80 else crc << 1) & 0xFF
    return crc


def supply_v(counts: int, full_mv: float, divider: float) -> float:
    """Return the supply in V from a 16-bit reading of its divided voltage."""
    return counts * full_mv / ADC_FULL * divider / 1000


def laser_conducts(counts: int, full_mv: float, mv_per_ma: float, on_ma: float) -> bool:
    """Return True if a 16-bit reading of the shunt amplifier shows a laser's current."""
    return counts * full_mv / ADC_FULL >= mv_per_ma * on_ma


def leak(driven: tuple[int, ...], undriven: tuple[int, ...]) -> str:
    """Return LEAK from the electrodes' levels while the common one is driven, and while it is not.

    An electrode that is high without being driven is wet, too: by water at another voltage.
    """
    return "1" if any(driven) or any(undriven) else "0"


def written(value: float | None, digits: int) -> str:
    """Return a value as the protocol writes it; ``-`` for none."""
    if value is None:
        return MISSING
    return f"{value:.{digits}f}"
