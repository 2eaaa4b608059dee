"""The trigger board byte by byte: lines, pulses, clock, lasers, faults."""

from __future__ import annotations

import binascii
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from hw_sim.clocks import Clocks
from hw_sim.devices.board import Board, Shot
from hw_sim.timing.world_time import BLANK_NS, START_NS
from tests.hw_sim.devices.bench import Bench, bench


def framed(body: str) -> bytes:
    return f"${body}*{binascii.crc_hqx(body.encode(), 0xFFFF):04X}\r\n".encode()


@dataclass
class Fired:
    time_ns: int
    width_ns: int
    shot: Shot


@dataclass
class Desk:
    """A board with wires soldered to its trigger lines, and a terminal."""

    bench: Bench
    seed: int = 1
    clocks: Clocks | None = None
    fired: list[Fired] = field(default_factory=list)
    vsync_times_ns: list[int] = field(default_factory=list)
    sensors: dict[str, str] = field(default_factory=dict)
    synced: bool = True
    number: int = 0

    def __post_init__(self) -> None:
        faults = self.bench.faults
        self.board = Board(
            *(self.bench.time, faults, self._fire, lambda name: self.sensors.get(name, "1.0"), self.seed),
            clocks=self.clocks,
        )
        self.board.open = True
        self.bench.changed.append(self.board.refresh)
        self.bench.on_blank = self._blank

    def _fire(self, time_ns: int, width_ns: int, shot: Shot) -> None:
        self.fired.append(Fired(time_ns, width_ns, shot))

    def _blank(self, time_ns: int) -> None:
        if self.synced:
            self.vsync_times_ns.append(time_ns)
            self.board.vsync(time_ns)
        else:
            self.board.no_vsync(time_ns)

    def raw(self) -> bytes:
        return self.board.take(self.board.waiting)

    def lines(self) -> list[list[str]]:
        """All lines since the last call, each checked to the last byte."""
        raw = self.raw()
        got = []
        for one in raw.splitlines(keepends=True):
            body = one[1:-7].decode("ascii")
            assert one == framed(body)
            assert len(one) <= 160
            got.append(body.split(","))
        return got

    def ask(self, *words: object) -> list[str]:
        """Answer without its number; reports that were waiting are thrown away."""
        self.raw()
        self.number += 1
        self.board.receive(framed(",".join(["C", str(self.number), *map(str, words)])))
        kind, number, *rest = self.lines()[-1]
        assert number == str(self.number)
        return [kind, *rest]

    def count(self) -> int:
        return int(self.ask("VSYNC")[2])

    def arm(self, pulses: int = 3, ahead: int = 2, delay_us: int = 500, width_us: int = 12_000) -> int:
        """Arm and return the number of the first vertical sync."""
        first = self.count() + ahead
        assert self.ask("ARM", pulses, first, delay_us, width_us) == [
            *("A", "ARM", str(pulses), str(first), str(delay_us), str(width_us))
        ]
        return first


@pytest.fixture
def desk() -> Iterator[Desk]:
    with bench() as made:
        desk = Desk(made)
        made.blanks(3)
        yield desk


# ---------------------------------------------------------------------------------------------- lines


def test_the_printed_examples_are_understood(desk: Desk) -> None:
    desk.raw()
    desk.board.receive(b"$C,7,PING*B7B3\r\n")
    ((kind, number, verb, _),) = desk.lines()
    assert (kind, number, verb) == ("A", "7", "PING")
    desk.board.receive(b"$C,8,ARM,24,90124,500,12000*1E87\r\n")
    assert desk.raw() == framed("A,8,ARM,24,90124,500,12000")


@pytest.mark.parametrize(
    "noise",
    [b"", b"\x00\xff\r\n", b"$C,1,PI", b"$C,1,PING*0000\r\n", b"PING\r\n", b"$" * 300, b"$" + b"x" * 400],
    ids=["none", "binary", "half a line", "wrong checksum", "no frame", "dollars", "endless line"],
)
def test_a_command_behind_garbage_is_answered_once(desk: Desk, noise: bytes) -> None:
    desk.raw()
    for byte in noise + framed("C,65535,PING"):
        desk.board.receive(bytes([byte]))
    ((kind, number, *_),) = desk.lines()
    assert (kind, number) == ("A", "65535")


@pytest.mark.parametrize(
    "line",
    [
        framed("C,5,PING").replace(b"\r\n", b"\n"),
        framed("C,5,PING").lower(),
        framed("C,65536,PING"),
        framed("C,-1,PING"),
        framed("C,,PING"),
        framed("R,5,PING"),
        framed("C,5"),
        framed("C,5,PI*NG"),
        framed("C,5,PI\x7fNG"),
        framed("C,5," + "P" * 149),
    ],
    ids=["no CR", "lower case", "big number", "negative", "no number", "report", "no verb", "star", "DEL", "161 bytes"],
)
def test_what_is_no_command_is_not_answered(desk: Desk, line: bytes) -> None:
    desk.raw()
    desk.board.receive(line)
    assert desk.raw() == b""


def test_the_longest_line_is_answered(desk: Desk) -> None:
    desk.raw()
    line = framed("C,5," + "P" * 148)
    assert len(line) == 160
    desk.board.receive(line)
    ((kind, _, _, code, _),) = desk.lines()
    assert (kind, code) == ("N", "1")


def test_a_repeated_command_repeats_the_answer_and_nothing_else(desk: Desk) -> None:
    first = desk.count() + 2
    line = framed(f"C,900,ARM,4,{first},0,1000")
    desk.board.receive(line)
    answer = desk.raw()
    desk.board.receive(line)
    assert desk.raw() == answer, "executed twice it would be refused: busy"
    desk.bench.blanks(8)
    assert len(desk.fired) == 4


def test_reports_count_on_their_own_and_start_with_boot() -> None:
    with bench() as made:
        desk = Desk(made)
        made.faults.add("board wrong how=reset")
        made.run_s(1.7)
        reports = [line for line in desk.lines() if line[0] == "R"]
        assert [r[1] for r in reports] == ["0", "1", "2", "3"]
        assert reports[0][2] == "BOOT"
        assert reports[0][-1] == "WATCHDOG"
        assert [r[2] for r in reports[1:]] == ["HB"] * 3


# ---------------------------------------------------------------------------------------------- pulses


def test_armed_pulses_rise_on_consecutive_syncs_after_the_delay(desk: Desk) -> None:
    first = desk.arm(pulses=3, ahead=2, delay_us=500, width_us=12_000)
    before = len(desk.vsync_times_ns)
    desk.raw()
    desk.bench.blanks(6)
    wanted_ns = [t + 500_000 for t in desk.vsync_times_ns[before + 1 : before + 4]]
    assert [f.time_ns for f in desk.fired] == wanted_ns
    assert {f.width_ns for f in desk.fired} == {12_000_000}
    assert [(f.shot.index, f.shot.count) for f in desk.fired] == [(0, 3), (1, 3), (2, 3)]
    *pulses, done = [line[2:] for line in desk.lines() if line[2] in ("PULSE", "DONE")]
    assert [p[:3] for p in pulses] == [["PULSE", str(k), str(first + k)] for k in range(3)]
    board_us = [int(p[3]) for p in pulses]
    # The board's clock is not the world's, but no more than 50 ppm away from it.
    assert board_us[2] - board_us[0] == pytest.approx(2 * BLANK_NS / 1000, abs=4)
    assert board_us[0] == pytest.approx((wanted_ns[0] - START_NS) / 1000, abs=10)
    assert done == ["DONE", "3"]
    assert desk.board.armed is None


def test_the_board_knows_the_frame_of_the_next_sync(desk: Desk) -> None:
    desk.arm(pulses=2, ahead=2)
    seen = []
    for _ in range(4):
        seen.append(desk.board.upcoming_frame())
        desk.bench.blanks(1)
    assert seen == [None, 0, 1, None]


def test_two_sequences_have_different_numbers(desk: Desk) -> None:
    for _ in range(2):
        desk.arm(pulses=1)
        desk.bench.blanks(4)
    first, second = desk.fired
    assert first.shot.series != second.shot.series


@pytest.mark.parametrize("blanks_later", [0, 1, 3])
def test_stop_ends_a_sequence_where_it_is(desk: Desk, blanks_later: int) -> None:
    desk.arm(pulses=5, ahead=1)
    desk.bench.blanks(blanks_later)
    desk.bench.run_s(0.001)  # past the delay of the last sync
    assert desk.ask("STOP") == ["A", "STOP"]
    desk.bench.blanks(8)
    assert len(desk.fired) == blanks_later
    assert not any(line[2] == "DONE" for line in desk.lines())


@pytest.mark.parametrize("every", [1, 2, 60])
def test_live_pulses_keep_their_pace_and_are_not_reported(desk: Desk, every: int) -> None:
    assert desk.ask("LIVE", every, 100, 4000) == ["A", "LIVE", str(every), "100", "4000"]
    desk.raw()
    desk.bench.blanks(3 * every)
    desk.bench.run_s(0.001)
    gaps = {b.time_ns - a.time_ns for a, b in zip(desk.fired, desk.fired[1:], strict=False)}
    assert gaps == {every * BLANK_NS}
    assert {line[2] for line in desk.lines()} <= {"HB"}
    assert desk.board.armed is None
    assert all(f.shot.count is None for f in desk.fired)


def test_arm_takes_over_from_live(desk: Desk) -> None:
    desk.ask("LIVE", 1, 0, 4000)
    desk.arm(pulses=2, ahead=3)
    desk.bench.blanks(8)
    assert [f.shot.index for f in desk.fired if f.shot.count is not None] == [0, 1]
    assert all(f.shot.count is not None for f in desk.fired), "ARM ends the live pulses"


@pytest.mark.parametrize(
    "command",
    [
        *("ARM,0,99,0,50", "ARM,65,99,0,50", "ARM,1,4294967296,0,50", "ARM,1,99,15001,50", "ARM,1,99,0,49"),
        *("ARM,1,99,0,16001", "ARM,1,99,0", "ARM,1,99,0,50,1", "ARM,1,99,0,x", "ARM,1,99,-1,50", "ARM,1,99,0,5e2"),
        *("LIVE,0,0,50", "LIVE,61,0,50", "LASER,2,0", "LASER,1", "PING,1", "STOP,1"),
    ],
)
def test_arguments_out_of_range_are_refused(desk: Desk, command: str) -> None:
    kind, verb, code, text = desk.ask(command)
    assert (kind, verb, code) == ("N", command.partition(",")[0], "2")
    assert text
    desk.bench.blanks(2)
    assert desk.fired == []


@pytest.mark.parametrize(("delay", "width"), [(0, 50), (15_000, 16_000)])
def test_the_limits_themselves_are_allowed(desk: Desk, delay: int, width: int) -> None:
    desk.arm(pulses=64, ahead=1, delay_us=delay, width_us=width)
    desk.bench.blanks(66)
    assert len(desk.fired) == 64
    assert {f.width_ns for f in desk.fired} == {width * 1000}


def test_busy_past_unknown(desk: Desk) -> None:
    now = desk.count()
    assert desk.ask("ARM", 1, now, 0, 50)[2] == "5"
    assert desk.ask("ARM", 1, now - 1, 0, 50)[2] == "5"
    desk.arm(pulses=1, ahead=10)
    assert desk.ask("ARM", 1, now + 20, 0, 50)[2] == "3"
    assert desk.ask("LIVE", 1, 0, 50)[2] == "3"
    assert desk.ask("FIRE")[:3] == ["N", "FIRE", "1"]


def test_without_vertical_sync_nothing_is_armed_and_what_was_armed_stops(desk: Desk) -> None:
    desk.arm(pulses=5, ahead=1)
    desk.bench.blanks(2)
    desk.bench.run_s(0.001)
    desk.synced = False
    desk.raw()
    desk.bench.blanks(6)
    assert len(desk.fired) == 2
    assert [line[2] for line in desk.lines() if line[2] != "HB"] == ["NOSYNC"], "said once"
    assert desk.board.armed is None
    assert desk.ask("VSYNC")[2] == "4"
    assert desk.ask("ARM", 1, 500, 0, 50)[2] == "4"
    assert desk.ask("LIVE", 1, 0, 50)[2] == "4"


# ---------------------------------------------------------------------------------------------- clock, sensors


def test_each_board_has_its_own_crystal() -> None:
    drifts = []
    for seed in range(6):
        with bench() as made:
            desk = Desk(made, seed=seed)
            begin_us, begin_ns = int(desk.ask("PING")[2]), made.time.now_ns()
            made.run_s(60.0)
            board_us = int(desk.ask("PING")[2]) - begin_us
            true_us = (made.time.now_ns() - begin_ns) / 1000
            drifts.append((board_us / true_us - 1) * 1e6)
            assert begin_us < 1_000_000, "starts near 0"
    assert max(map(abs, drifts)) <= 50
    assert len({round(d) for d in drifts}) > 3
    assert max(map(abs, drifts)) > 5, "a perfect crystal would hide a host that does not follow it"


def test_vsync_names_number_and_time_of_the_latest(desk: Desk) -> None:
    _, _, count, sync_us, now_us = desk.ask("VSYNC")
    assert int(count) == len(desk.vsync_times_ns)
    true_age_us = (desk.bench.time.now_ns() - desk.vsync_times_ns[-1]) / 1000
    assert int(now_us) - int(sync_us) == pytest.approx(true_age_us, abs=1)
    desk.bench.blanks(1)
    assert desk.count() == int(count) + 1


def test_heartbeats_every_half_second_carry_lasers_and_sensors(desk: Desk) -> None:
    desk.sensors.update(TPROJ="41.5", LEAK="0", HUM="-")
    desk.ask("LASER", 1, 0)
    desk.raw()
    desk.bench.run_s(3.0)
    beats = [line[2:] for line in desk.lines()]
    assert len(beats) == 6
    gaps = [int(b[1]) - int(a[1]) for a, b in itertools.pairwise(beats)]
    assert all(gap == pytest.approx(500_000, abs=2) for gap in gaps)
    assert beats[-1][3:5] == ["1", "0"]
    assert int(beats[-1][2]) == pytest.approx(len(desk.vsync_times_ns), abs=31)
    words = dict(word.split("=") for word in beats[-1][5:])
    assert list(words) == ["TPROJ", "TCASE", "TBOARD", "LEAK", "HUM", "SUPPLY"]
    assert (words["TPROJ"], words["LEAK"], words["HUM"]) == ("41.5", "0", "-")
    assert desk.ask("SENSE")[2:] == beats[-1][5:]


def test_info_lists_what_is_fitted(desk: Desk) -> None:
    _, _, firmware, serial_number, capabilities = desk.ask("INFO")
    assert firmware
    assert serial_number
    assert capabilities == "TPROJ+TCASE+TBOARD+LEAK+HUM+SUPPLY"


# ---------------------------------------------------------------------------------------------- lasers and faults


def test_the_laser_answer_is_read_back_not_echoed(desk: Desk) -> None:
    assert desk.ask("LASER", 1, 1)[2:] == ["1", "1"]
    assert desk.board.lasers_on == (True, True)
    desk.bench.faults.add("laser.left off")
    assert desk.ask("LASER", 1, 1)[2:] == ["0", "1"]
    desk.bench.faults.clear()
    desk.bench.faults.add("laser.right stuck")
    assert desk.ask("LASER", 0, 0)[2:] == ["0", "1"]
    assert desk.board.lasers_on == (False, True)


def test_a_pulse_that_is_not_fired_is_not_reported(desk: Desk) -> None:
    desk.bench.faults.add("board intermittent frame=1")
    desk.arm(pulses=3, ahead=1)
    desk.bench.blanks(6)
    assert [f.shot.index for f in desk.fired] == [0, 2]
    reports = [line[2:] for line in desk.lines()]
    assert [r[1] for r in reports if r[0] == "PULSE"] == ["0", "2"]
    assert ["DONE", "3"] in reports


def test_a_report_may_name_the_wrong_vertical_sync(desk: Desk) -> None:
    desk.bench.faults.add("board wrong how=vsync frame=1")
    desk.arm(pulses=3, ahead=1)
    desk.bench.blanks(6)
    pulses = [line[2:] for line in desk.lines() if line[2] == "PULSE"]
    first = int(pulses[0][2])
    assert [int(vsync) - first for _, _, vsync, _ in pulses] == [0, 2, 2]
    apart_us = np.diff([int(time_us) for *_, time_us in pulses])
    assert np.ptp(apart_us) <= 2, "it is fired where it belongs"


def test_an_answer_may_count_a_vertical_sync_too_many(desk: Desk) -> None:
    desk.bench.blanks(3)
    before = int(desk.ask("VSYNC")[2])
    desk.bench.faults.add("board wrong how=query count=2")
    assert [int(desk.ask("VSYNC")[2]) - before for _ in range(3)] == [1, 1, 0]


def test_a_late_pulse_is_dated_as_it_was_fired(desk: Desk) -> None:
    desk.bench.faults.add("board delayed frame=1 amount=5")
    desk.arm(pulses=3, ahead=1)
    desk.bench.blanks(6)
    times_us = [int(line[-1]) for line in desk.lines() if line[2] == "PULSE"]
    late_us = np.diff(times_us) - 1e6 / 60
    assert late_us == pytest.approx([5000, -5000], abs=3)
    fired_ns = np.diff([f.time_ns for f in desk.fired]) - 1e9 / 60
    assert fired_ns == pytest.approx([5e6, -5e6], abs=2000)


def test_a_reset_in_a_sequence_forgets_everything(desk: Desk) -> None:
    desk.ask("LASER", 1, 1)
    desk.bench.faults.add("board wrong how=reset frame=2")
    desk.arm(pulses=5, ahead=1)
    desk.raw()
    desk.bench.blanks(8)
    assert [f.shot.index for f in desk.fired] == [0, 1]
    boot = next(line for line in desk.lines() if line[2] == "BOOT")
    assert (boot[1], boot[-1]) == ("0", "WATCHDOG")
    assert desk.board.lasers_on == (False, False)
    assert int(desk.ask("PING")[2]) < 200_000, "the clock starts again"
    assert desk.count() < 8, "so does the counter"


def test_a_board_without_power_is_silent_and_boots_when_it_returns(desk: Desk) -> None:
    desk.ask("LASER", 1, 1)
    desk.raw()
    desk.bench.faults.add("board off for_s=2.0")
    assert desk.board.lasers_on == (False, False)
    desk.board.receive(framed("C,1,PING"))
    desk.bench.run_s(1.9)
    assert desk.raw() == b""
    desk.bench.run_s(0.2)
    (boot,) = desk.lines()
    assert boot[2] == "BOOT"
    assert boot[-1] == "POWER"


def test_a_slow_board_answers_after_half_a_second(desk: Desk) -> None:
    desk.bench.faults.add("board slow")
    desk.raw()
    desk.board.receive(framed("C,77,STOP"))
    desk.bench.run_s(0.49)
    assert not [line for line in desk.lines() if line[0] == "A"]
    desk.bench.run_s(0.02)
    assert [line for line in desk.lines() if line[0] == "A"] == [["A", "77", "STOP"]]


def test_noise_between_lines_leaves_the_lines_whole(desk: Desk) -> None:
    desk.bench.faults.add("board garbage")
    desk.raw()
    desk.board.receive(framed("C,78,STOP"))
    raw = desk.raw()
    assert raw.endswith(framed("A,78,STOP"))
    assert len(raw) > len(framed("A,78,STOP"))


def test_lines_that_nobody_reads_are_lost_whole(desk: Desk) -> None:
    desk.raw()
    for number in range(4000):
        desk.board.receive(framed(f"C,{number},PING"))
    assert desk.board.waiting <= 65_536
    lines = desk.lines()
    assert [line[1] for line in lines] == [str(i) for i in range(len(lines))], "the newest are lost"


# ---------------------------------------------------------------------------------------------- the world outside


def test_pulses_that_jitter_are_dated_as_they_were_fired() -> None:
    with bench() as made:
        desk = Desk(made, clocks=Clocks(board_jitter_us=40.0))
        made.blanks(3)
        for _ in range(4):
            desk.arm(pulses=60)
            desk.fired.clear()
            first_sync = len(desk.vsync_times_ns) + 1
            made.blanks(63)
            syncs = np.array(desk.vsync_times_ns[first_sync : first_sync + 60])
            fired = np.array([f.time_ns for f in desk.fired])
            late_us = (fired - syncs) / 1000 - 500.0
            assert 25.0 < late_us.std() < 60.0
            assert abs(late_us.mean()) < 25.0
            dated_us = np.array([int(line[-1]) for line in desk.lines() if line[2] == "PULSE"])
            # Crystal of the board: 45 ppm at most of the second that this takes.
            assert np.abs(np.diff(dated_us) - np.diff(fired) / 1000).max() < 3.0


def test_a_glitch_on_the_sync_line_puts_pulses_on_the_wrong_sync() -> None:
    with bench() as made:
        desk = Desk(made)
        made.blanks(3)
        made.faults.add("board wrong how=glitch frame=2")
        desk.arm(pulses=5)
        syncs_before = len(desk.vsync_times_ns)
        made.blanks(8)
        own = np.array(desk.vsync_times_ns[syncs_before + 1 : syncs_before + 6])
        off = (np.array([f.time_ns for f in desk.fired]) - own) / BLANK_NS - 500_000 / BLANK_NS
        np.testing.assert_allclose(off, [0.0, 0.0, -0.5, -1.0, -1.0], atol=1e-3)
        named = [int(line[4]) for line in desk.lines() if line[2] == "PULSE"]
        assert named == list(range(named[0], named[0] + 5)), "the board itself believes that all is well"
