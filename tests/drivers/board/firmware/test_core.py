"""What the board's core does to its pins, beyond what it says: the trigger line, lasers, lost stamps, starts near an edge."""

from __future__ import annotations

import itertools

import pytest

from drivers.board.firmware.line import LONGEST, CommandFinder, crc16
from tests.drivers.board.firmware.desk import PERIOD_US, Desk, DeskHardware
from tests.drivers.board.firmware.test_conformance import Host


def host_of(desk: Desk) -> Host:
    return Host(desk, wired=False)


@pytest.fixture
def desk() -> Desk:
    made = Desk()
    made.exchange(b"", 150_000)
    return made


def before_a_sync(desk: Desk, time_us: int) -> None:
    """Run to so long before the next sync."""
    now_us = desk.hardware.time_us
    due_us = (now_us // PERIOD_US + 2) * PERIOD_US - time_us
    desk.exchange(b"", due_us - now_us)


def test_stop_silences_the_trigger_line(desk: Desk) -> None:
    host = host_of(desk)
    host.ask("LIVE", 1, 500, 1000)
    host.listen(200_000)
    assert len(desk.hardware.fired) > 8
    host.ask("STOP")
    fired = len(desk.hardware.fired)
    host.listen(300_000)
    assert len(desk.hardware.fired) == fired


def test_live_fires_on_every_so_many_syncs(desk: Desk) -> None:
    host_of(desk).ask("LIVE", 3, 500, 1000)
    desk.exchange(b"", 500_000)
    fired = desk.hardware.fired
    assert {b - a for a, b in itertools.pairwise(fired)} == {3 * PERIOD_US}
    assert {time_us % PERIOD_US for time_us in fired} == {500}


def test_a_laser_that_does_not_go_off_is_told_as_it_is(desk: Desk) -> None:
    host = host_of(desk)
    desk.hardware.stuck_left = True
    assert host.ask("LASER", 0, 0) == ["A", "LASER", "1", "0"]
    assert host.reports(520_000, "HB")[-1][2:4] == ["1", "0"]


def test_stamps_that_were_lost_end_the_series_because_the_count_is_wrong(desk: Desk) -> None:
    host = host_of(desk)
    assert host.ask("ARM", 5, host.count() + 40, 0, 50)[0] == "A"
    before_a_sync(desk, 8000)
    # Nine syncs in which nobody looks: one more than the FIFO holds, and none of those that are read is old.
    desk.hardware.advance(desk.hardware.time_us + 9 * PERIOD_US)
    assert [words for words in host.listen(20_000) if words[2] == "NOSYNC"]
    host.listen(1_000_000)
    assert not desk.hardware.fired


def test_a_sync_that_is_due_any_moment_is_past(desk: Desk) -> None:
    host = host_of(desk)
    before_a_sync(desk, 1000)
    due = desk.core._count + 1
    assert host.ask("ARM", 1, due, 0, 50)[:3] == ["N", "ARM", "5"]
    assert host.ask("ARM", 1, due + 4, 0, 50)[0] == "A"
    assert [int(words[1]) for words in host.reports(200_000, "PULSE")] == [due + 4]


def test_a_live_pulse_just_before_an_armed_series_is_none_of_it(desk: Desk) -> None:
    host = host_of(desk)
    host.ask("LIVE", 1, 0, 50)
    before_a_sync(desk, 1000)
    start = desk.core._count + 6
    desk.hardware.fired.clear()
    assert host.ask("ARM", 2, start, 0, 50)[0] == "A"
    reports = host.reports(300_000, "PULSE")
    assert len(desk.hardware.fired) == 3, "one was live, and fell into the wait"
    assert [int(words[2]) for words in reports] == desk.hardware.fired[1:]


class SlowStart(DeskHardware):
    """A chip that needs until behind the next sync for its first starts, as when memory is collected within them."""

    slow = 0

    def start(self, skip: int, every: int, pulses: int | None, delay_us: int, width_us: int) -> None:
        super().start(skip, every, pulses, delay_us, width_us)
        if self.slow > 0:
            self.slow -= 1
            self.advance((self.time_us // PERIOD_US + 1) * PERIOD_US + 5000)


@pytest.mark.parametrize("slow", [0, 1, 2])
def test_a_start_that_met_a_sync_is_made_anew_and_fires_on_the_right_one(slow: int) -> None:
    hardware = SlowStart()
    desk = Desk(hardware)
    desk.exchange(b"", 150_000)
    host = host_of(desk)
    _, _, count, sync_us, _ = host.ask("VSYNC")
    hardware.slow = slow
    start = int(count) + 10
    assert host.answers(b"$" + arm(3, start) + b"\r\n", 60_000)[0][0] == "A"
    host.listen(400_000)
    first_us = int(sync_us) + 10 * PERIOD_US + 700
    assert hardware.fired == [first_us, first_us + PERIOD_US, first_us + 2 * PERIOD_US]


def test_a_board_that_never_gets_clear_of_the_syncs_refuses_and_fires_nothing() -> None:
    hardware = SlowStart()
    desk = Desk(hardware)
    desk.exchange(b"", 150_000)
    hardware.slow = 99
    host = host_of(desk)
    assert host.answers(b"$" + arm(3, desk.core._count + 30) + b"\r\n", 90_000)[0][3] == "5"
    host.listen(1_000_000)
    assert not hardware.fired


def arm(pulses: int, start: int) -> bytes:
    body = f"C,900,ARM,{pulses},{start},700,50".encode()
    return body + f"*{crc16(body):04X}".encode()


def test_counts_wrap_and_a_series_goes_on_over_the_wrap(desk: Desk) -> None:
    host = host_of(desk)
    desk.core._count = 0xFFFF_FFF0
    assert host.ask("ARM", 8, 0xFFFF_FFFC, 0, 50)[0] == "A"
    numbers = [int(words[1]) for words in host.reports(600_000, "PULSE")]
    assert numbers == [0xFFFF_FFFC, 0xFFFF_FFFD, 0xFFFF_FFFE, 0xFFFF_FFFF, 0, 1, 2, 3]
    assert host.count() < 100


def test_report_numbers_wrap(desk: Desk) -> None:
    desk.core._reports = 65_535
    assert [int(words[1]) for words in host_of(desk).listen(1_100_000)] == [65_535, 0]


def test_every_turn_feeds_the_watchdog_and_gives_the_laser_gate_an_edge(desk: Desk) -> None:
    fed, beats = desk.hardware.fed, desk.hardware.beats
    desk.exchange(b"", 1_000_000)
    assert desk.hardware.fed - fed == desk.hardware.beats - beats == 4000


def test_an_endless_line_takes_no_memory() -> None:
    finder = CommandFinder()
    assert not finder.feed(b"$C,1,")
    for _ in range(1000):
        assert not finder.feed(b"x" * 250)
        assert len(finder._line) <= LONGEST + 256
