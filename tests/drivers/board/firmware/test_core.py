"""What the board's core does to its pins, beyond what it says: the trigger line, lasers, lost stamps, starts near an edge."""

from __future__ import annotations

import itertools
import re

import pytest

from drivers.board.firmware.line import LONGEST, CommandFinder
from tests.drivers.board.firmware.desk import PERIOD_US, Desk, DeskHardware
from tests.drivers.board.firmware.test_conformance import Host
from tests.hw_sim.devices.host import framed
from tests.support.micropython import ROOT


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


def test_live_fires_on_every_so_many_syncs_until_it_is_stopped_and_a_laser_is_told_as_it_is(desk: Desk) -> None:
    host = Host(desk)
    host.ask("LIVE", 3, 500, 1000)
    host.listen(500_000)
    fired = list(desk.hardware.fired)
    assert {b - a for a, b in itertools.pairwise(fired)} == {3 * PERIOD_US}
    assert {time_us % PERIOD_US for time_us in fired} == {500}
    host.ask("STOP")
    fired = list(desk.hardware.fired)
    host.listen(300_000)
    assert desk.hardware.fired == fired
    desk.hardware.stuck_left = True
    assert host.ask("LASER", 0, 0) == ["A", "LASER", "1", "0"]
    finder = CommandFinder()
    for _ in range(1000):  # an endless line takes no memory
        assert not finder.feed(b"$C,1," + b"x" * 250)
        assert len(finder._line) <= LONGEST + 256


def test_stamps_that_were_lost_end_the_series_because_the_count_is_wrong(desk: Desk) -> None:
    host = Host(desk)
    assert host.ask("ARM", 5, host.count() + 40, 0, 50)[0] == "A"
    before_a_sync(desk, 8000)
    # Nine syncs in which nobody looks: one more than the FIFO holds, and none of those that are read is old.
    desk.hardware.advance(desk.hardware.time_us + 9 * PERIOD_US)
    assert [words for words in host.listen(20_000) if words[2] == "NOSYNC"]
    host.listen(1_000_000)
    assert not desk.hardware.fired


def test_a_sync_that_is_due_any_moment_is_past(desk: Desk) -> None:
    host = Host(desk)
    before_a_sync(desk, 1000)
    due = desk.core._count + 1
    assert host.ask("ARM", 1, due, 0, 50)[:3] == ["N", "ARM", "5"]
    assert host.ask("ARM", 1, due + 4, 0, 50)[0] == "A"
    assert [int(words[1]) for words in host.reports(200_000, "PULSE")] == [due + 4]


def test_a_live_pulse_just_before_an_armed_series_is_none_of_it(desk: Desk) -> None:
    host = Host(desk)
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


@pytest.mark.parametrize("slow", [0, 1, 2, 99])
def test_a_start_that_met_a_sync_is_made_anew_and_one_that_always_does_is_refused(slow: int) -> None:
    hardware = SlowStart()
    desk = Desk(hardware)
    host = Host(desk)
    host.listen(150_000)
    _, _, count, sync_us, _ = host.ask("VSYNC")
    hardware.slow = slow
    (answer,) = host.answers(framed(f"C,900,ARM,3,{int(count) + 10},700,50"), 90_000)
    host.listen(400_000)
    if slow == 99:
        assert answer[3] == "5"
        assert not hardware.fired
    else:
        first_us = int(sync_us) + 10 * PERIOD_US + 700
        assert answer[0] == "A"
        assert hardware.fired == [first_us, first_us + PERIOD_US, first_us + 2 * PERIOD_US]


def test_counts_wrap_and_a_series_goes_on_over_the_wrap(desk: Desk) -> None:
    host = Host(desk)
    desk.core._count = 0xFFFF_FFF0
    assert host.ask("ARM", 8, 0xFFFF_FFFC, 0, 50)[0] == "A"
    numbers = [int(words[1]) for words in host.reports(600_000, "PULSE")]
    assert numbers == [0xFFFF_FFFC, 0xFFFF_FFFD, 0xFFFF_FFFE, 0xFFFF_FFFF, 0, 1, 2, 3]
    assert host.count() < 100


def test_report_numbers_wrap_and_every_turn_feeds_the_watchdog_and_gives_the_laser_gate_an_edge(desk: Desk) -> None:
    desk.core._reports = 65_535
    fed, beats = desk.hardware.fed, desk.hardware.beats
    assert [int(words[1]) for words in Host(desk).listen(1_000_000)] == [65_535, 0]
    assert desk.hardware.fed - fed == desk.hardware.beats - beats == 4000


def test_the_lines_to_paste_of_the_wiring_page_are_obeyed(desk: Desk) -> None:
    page = (ROOT / "docs" / "build" / "wiring.md").read_text(encoding="utf-8")
    lines = re.findall(r"`(\$C,\d+,([A-Z]+)[^`]*)`", page)
    assert [verb for _, verb in lines] == ["INFO", "VSYNC", "SENSE", "LASER", "LASER"]
    for line, verb in lines:
        said = desk.exchange(line.encode() + b"\r\n", 20_000).decode()
        assert re.search(rf"\$A,\d+,{verb}", said), line
