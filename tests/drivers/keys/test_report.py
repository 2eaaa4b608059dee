"""The key pad's report against bytes worked out by hand, and when it was made: by the pad's own clock where the host was late."""

import pytest

from drivers.api import Key
from drivers.keys.keypad import PadTime
from drivers.keys.report import KeyReport, MalformedReport, parse_report

# number 1, SCAN and DOWN pressed, counter 0x7F, UP faulty, 0x1234 ms, firmware 3;
# 01^09=08, ^7F=77, ^04=73, ^34=47, ^12=55, ^03=56, ^A5=F3
REPORT = bytes.fromhex("01 09 7f 04 34 12 03 f3")
MS = 1_000_000
T0 = 7_000 * MS


def test_a_report_is_taken_apart_and_a_flipped_bit_a_byte_more_or_less_or_a_fifth_key_is_garbage() -> None:
    assert parse_report(REPORT) == KeyReport(frozenset({Key.SCAN, Key.DOWN}), frozenset({Key.UP}), 0x7F, 0x1234, 3)
    flipped = [REPORT[:at] + bytes([REPORT[at] ^ bit]) + REPORT[at + 1 :] for at in range(8) for bit in (0x01, 0x80)]
    for bad in (*flipped, REPORT[:7], REPORT + b"\0"):
        with pytest.raises(MalformedReport):
            parse_report(bad)
    with pytest.raises(MalformedReport, match="four keys"):
        parse_report(bytes([0x01, 0x10, 0, 0, 0, 0, 3, 0x01 ^ 0x10 ^ 3 ^ 0xA5]))


@pytest.mark.parametrize(
    "reports",
    [
        [(100, 0, True, 0), (5, 250, True, 250)],  # waited for: dated to its arrival whatever the pad's clock says
        [(100, 0, False, 0)],  # the first one has none before it
        [(65_500, 0, True, 0), (65_535, 60_000, False, 35), (14, 60_000, False, 50), (40_014, 60_000, False, 40_050)],
        [(0, 0, True, 0), (500, 100, False, 100), (510, 200, False, 110), (520, 105, True, 110)],
    ],
    ids=["waited for", "first", "across the wrap", "neither later than its arrival nor before the one before"],
)
def test_reports_that_lay_there_keep_their_distance_by_the_pads_clock(
    reports: list[tuple[int, int, bool, int]],
) -> None:
    time = PadTime()
    for pad_ms, arrived_ms, waited_for, dated_ms in reports:
        assert time.date(pad_ms, T0 + arrived_ms * MS, waited_for=waited_for) == T0 + dated_ms * MS
