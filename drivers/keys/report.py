"""The layout of the keypad's input report: bytes in, values out. Source: ``docs/protocols/keys.md``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import xor

from drivers.api import Key

REPORT_NUMBER = 0x01
REPORT_SIZE = 8
_CHECK_SEED = 0xA5

KEY_BITS: tuple[tuple[Key, int], ...] = ((Key.SCAN, 0x01), (Key.BACK, 0x02), (Key.UP, 0x04), (Key.DOWN, 0x08))
_ALL_BITS = 0x0F


class MalformedReport(ValueError):
    """The bytes are no report of the keypad."""


@dataclass(frozen=True, slots=True)
class KeyReport:
    """One report with the state of the coils, without debouncing."""

    pressed: frozenset[Key]
    faulty: frozenset[Key]
    counter: int
    """+1 with each report, wraps 255 → 0."""
    pad_time_ms: int
    """16 bit, wraps."""
    firmware: int


def checksum(data: bytes) -> int:
    """Return the XOR of all bytes and 0xA5."""
    return reduce(xor, data, _CHECK_SEED)


def _keys(mask: int) -> frozenset[Key]:
    return frozenset(key for key, bit in KEY_BITS if mask & bit)


def parse_report(data: bytes) -> KeyReport:
    """Parse a report. Raises MalformedReport for a wrong length, number or checksum, or for unknown keys."""
    if len(data) != REPORT_SIZE:
        raise MalformedReport(f"{len(data)} bytes; a report has {REPORT_SIZE}")
    if data[0] != REPORT_NUMBER:
        raise MalformedReport(f"report number {data[0]}, expected {REPORT_NUMBER}")
    if checksum(data[:7]) != data[7]:
        raise MalformedReport(f"checksum {data[7]:#04x}, computed {checksum(data[:7]):#04x}")
    if (data[1] | data[3]) & ~_ALL_BITS:
        raise MalformedReport(f"keys {data[1]:#04x}, faulty {data[3]:#04x}: there are four keys")
    return KeyReport(_keys(data[1]), _keys(data[3]), data[2], data[4] | data[5] << 8, data[6])
