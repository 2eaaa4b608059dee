"""The key pad's report against bytes worked out by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import Key
from drivers.keys.report import KeyReport, MalformedReport, parse_report
from tests.support.damage import damaged

# number 1, SCAN and DOWN pressed, counter 0x7F, UP faulty, 0x1234 ms, firmware 3;
# 01^09=08, ^7F=77, ^04=73, ^34=47, ^12=55, ^03=56, ^A5=F3
REPORT = bytes.fromhex("01 09 7f 04 34 12 03 f3")


def test_a_report_is_taken_apart() -> None:
    assert parse_report(REPORT) == KeyReport(frozenset({Key.SCAN, Key.DOWN}), frozenset({Key.UP}), 0x7F, 0x1234, 3)


@pytest.mark.parametrize("position", range(8))
@pytest.mark.parametrize("bit", [0x01, 0x80])
def test_one_flipped_bit_anywhere_is_garbage(position: int, bit: int) -> None:
    damaged = bytearray(REPORT)
    damaged[position] ^= bit
    with pytest.raises(MalformedReport):
        parse_report(bytes(damaged))


def test_a_fifth_key_is_garbage_even_with_a_right_checksum() -> None:
    with pytest.raises(MalformedReport, match="four keys"):
        parse_report(bytes([0x01, 0x10, 0, 0, 0, 0, 3, 0x01 ^ 0x10 ^ 3 ^ 0xA5]))


@given(st.binary(max_size=12) | damaged([REPORT]))
def test_arbitrary_bytes_are_a_report_or_a_named_error(data: bytes) -> None:
    try:
        parse_report(data)
    except MalformedReport:
        return
    assert len(data) == 8
