"""The key pad's report against bytes worked out by hand."""

import pytest

from drivers.api import Key
from drivers.keys.report import KeyReport, MalformedReport, parse_report

# number 1, SCAN and DOWN pressed, counter 0x7F, UP faulty, 0x1234 ms, firmware 3;
# 01^09=08, ^7F=77, ^04=73, ^34=47, ^12=55, ^03=56, ^A5=F3
REPORT = bytes.fromhex("01 09 7f 04 34 12 03 f3")


def test_a_report_is_taken_apart() -> None:
    assert parse_report(REPORT) == KeyReport(frozenset({Key.SCAN, Key.DOWN}), frozenset({Key.UP}), 0x7F, 0x1234, 3)


def test_one_flipped_bit_anywhere_or_a_byte_more_or_less_is_garbage() -> None:
    flipped = [REPORT[:at] + bytes([REPORT[at] ^ bit]) + REPORT[at + 1 :] for at in range(8) for bit in (0x01, 0x80)]
    for bad in (*flipped, REPORT[:7], REPORT + b"\0"):
        with pytest.raises(MalformedReport):
            parse_report(bad)


def test_a_fifth_key_is_garbage_even_with_a_right_checksum() -> None:
    with pytest.raises(MalformedReport, match="four keys"):
        parse_report(bytes([0x01, 0x10, 0, 0, 0, 0, 3, 0x01 ^ 0x10 ^ 3 ^ 0xA5]))
