"""The board keeps its protocol: lines, commands, pulses on vertical syncs, and what becomes of it when it breaks."""

from __future__ import annotations

import binascii
import itertools
import re
from pathlib import Path

import pytest

from hw_sim.devices.board import Board
from hw_sim.devices.shot import Shot
from hw_sim.faults import FaultBook
from hw_sim.pace import BLANK_NS
from tests.hw_sim.devices.conftest import Bench, HandTime

MANUAL = Path(__file__).parents[3] / "docs" / "protocols" / "board.md"
SENSORS = {"TPROJ": "31.5", "TCASE": "24.0", "TBOARD": "28.0", "LEAK": "0", "HUM": "38.0", "SUPPLY": "12.1"}


class Rig:
    """A board on a table: vertical syncs and bytes by hand."""

    def __init__(self, time: HandTime) -> None:
        self.time = time
        self.fired: list[tuple[int, int, Shot]] = []
        self.faults = FaultBook(time.now_ns, time.at, lambda t: self.board.refresh(t))
        with time.condition:
            self.board = Board(time, self.faults, self._fire, lambda name: SENSORS[name], seed=7)
            self.board.open = True

    def _fire(self, time_ns: int, width_ns: int, shot: Shot) -> None:
        self.fired.append((time_ns, width_ns, shot))

    def syncs(self, count: int) -> None:
        for _ in range(count):
            with self.time.condition:
                self.board.vsync(self.time.now_ns())
            self.time.run(BLANK_NS / 1e9)

    def send(self, raw: bytes) -> list[str]:
        with self.time.condition:
            self.board.receive(raw)
            return self.lines()

    def say(self, body: str) -> list[str]:
        return self.send(f"${body}*{binascii.crc_hqx(body.encode(), 0xFFFF):04X}\r\n".encode())

    def lines(self) -> list[str]:
        """Bodies of all good lines so far."""
        with self.time.condition:
            raw = self.board.take(1 << 20).decode("latin-1")
        found = re.findall(r"\$([^$*]*)\*([0-9A-F]{4})\r\n", raw)
        return [body for body, crc in found if crc == f"{binascii.crc_hqx(body.encode(), 0xFFFF):04X}"]


@pytest.fixture
def rig(hand_time: HandTime) -> Rig:
    rig = Rig(hand_time)
    rig.lines()
    return rig


def test_the_checksum_is_that_of_the_manual() -> None:
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    for body, crc in re.findall(r"\$([^*$]+)\*([0-9A-F]{4})", MANUAL.read_text()):
        assert f"{binascii.crc_hqx(body.encode(), 0xFFFF):04X}" == crc, body


def test_a_command_of_the_manual_is_answered(rig: Rig) -> None:
    assert [line.split(",")[:3] for line in rig.send(b"$C,7,PING*B7B3\r\n")] == [["A", "7", "PING"]]


@pytest.mark.parametrize(
    ("body", "answer"),
    [
        ("C,1,INFO", "A,1,INFO,1.4.2,KF-BRD-0001,TPROJ+TCASE+TBOARD+LEAK+HUM+SUPPLY"),
        ("C,2,SENSE", "A,2,SENSE,TPROJ=31.5,TCASE=24.0,TBOARD=28.0,LEAK=0,HUM=38.0,SUPPLY=12.1"),
        ("C,3,LASER,1,0", "A,3,LASER,1,0"),
        ("C,4,STOP", "A,4,STOP"),
        ("C,5,DANCE", "N,5,DANCE,1,unknown verb"),
        ("C,6,LASER,2,0", "N,6,LASER,2,argument out of range"),
        ("C,7,LASER,1", "N,7,LASER,2,argument out of range"),
        ("C,8,ARM,65,100,500,12000", "N,8,ARM,2,argument out of range"),
        ("C,9,ARM,24,100,15001,12000", "N,9,ARM,2,argument out of range"),
        ("C,10,ARM,24,100,500,49", "N,10,ARM,2,argument out of range"),
        ("C,11,LIVE,0,500,12000", "N,11,LIVE,2,argument out of range"),
        ("C,12,VSYNC", "N,12,VSYNC,4,no vertical sync"),
        ("C,13,LIVE,6,500,12000", "N,13,LIVE,4,no vertical sync"),
        ("C,14,PING,1", "N,14,PING,2,argument out of range"),
        ("C,65535,STOP", "A,65535,STOP"),
    ],
)
def test_commands(rig: Rig, body: str, answer: str) -> None:
    assert rig.say(body) == [answer]


@pytest.mark.parametrize(
    "raw",
    [
        b"$C,7,PING*0000\r\n",
        b"$C,7,PING*B7B3\n",
        b"$C,7,PING*b7b3\r\n",
        b"$C,70000,PING*9F38\r\n",
        b"C,7,PING*B7B3\r\n",
        b"$" + b"A" * 200 + b"\r\n",
        b"\xff\x00garbage\r\n",
    ],
)
def test_garbage_is_not_answered_and_the_next_line_is(rig: Rig, raw: bytes) -> None:
    assert rig.send(raw) == []
    assert len(rig.send(b"half a line $C,7,PING*B7B3\r\n")) == 1


def test_a_repeated_command_is_answered_alike_and_not_done_twice(rig: Rig) -> None:
    rig.syncs(1)
    first = rig.say("C,20,PING")
    rig.syncs(2)
    assert rig.say("C,20,PING") == first
    assert rig.say("C,21,ARM,2,10,0,100") == ["A,21,ARM,2,10,0,100"]
    assert rig.say("C,21,ARM,2,10,0,100") == ["A,21,ARM,2,10,0,100"], "a retry is not busy"
    assert rig.say("C,22,ARM,2,10,0,100") == ["N,22,ARM,3,busy"]


def test_pulses_come_on_their_vertical_syncs_and_are_reported(rig: Rig) -> None:
    rig.syncs(3)
    start_ns = rig.time.now_ns()
    assert rig.say("C,1,ARM,3,5,500,12000") == ["A,1,ARM,3,5,500,12000"]
    rig.syncs(6)
    # The next sync is number 4, at start_ns.
    assert [t for t, _, _ in rig.fired] == [start_ns + (1 + k) * BLANK_NS + 500_000 for k in range(3)]
    assert {width for _, width, _ in rig.fired} == {12_000_000}
    assert [shot.frame for _, _, shot in rig.fired] == [0, 1, 2]
    reports = [line.split(",")[2:] for line in rig.lines() if line.startswith("R") and ",HB," not in line]
    assert [r[:3] for r in reports] == [["PULSE", "0", "5"], ["PULSE", "1", "6"], ["PULSE", "2", "7"], ["DONE", "3"]]
    times_us = [int(r[3]) for r in reports[:3]]
    assert all(abs(b - a - BLANK_NS / 1000) <= 2 for a, b in itertools.pairwise(times_us))


def test_a_vertical_sync_that_is_past_cannot_be_armed(rig: Rig) -> None:
    rig.syncs(5)
    assert rig.say("C,1,ARM,3,5,500,12000") == ["N,1,ARM,5,at_vsync is past"]
    assert rig.say("C,2,ARM,3,6,500,12000") == ["A,2,ARM,3,6,500,12000"]


def test_live_fires_every_so_often_until_stop_and_is_not_reported(rig: Rig) -> None:
    rig.syncs(1)
    rig.say("C,1,LIVE,6,500,12000")
    rig.syncs(18)
    assert len(rig.fired) == 3
    assert {shot.frame for _, _, shot in rig.fired} == {None}
    rig.say("C,2,STOP")
    rig.syncs(12)
    assert len(rig.fired) == 3
    assert not [line for line in rig.lines() if "PULSE" in line]


def test_lost_sync_stops_the_pulses_and_is_said(rig: Rig) -> None:
    rig.syncs(1)
    rig.say("C,1,ARM,3,3,500,12000")
    for _ in range(5):
        with rig.time.condition:
            rig.board.no_vsync(rig.time.now_ns())
        rig.time.run(BLANK_NS / 1e9)
    assert [line.split(",")[2] for line in rig.lines()] == ["NOSYNC"]
    rig.syncs(5)
    assert not rig.fired


def test_the_heart_beats_twice_a_second_and_reports_are_numbered(hand_time: HandTime) -> None:
    rig = Rig(hand_time)
    rig.time.run(2.1)
    reports = [line.split(",") for line in rig.lines()]
    assert [r[2] for r in reports] == ["HB"] * 4
    assert [int(r[1]) for r in reports] == [1, 2, 3, 4], "number 0 was the banner, before the port was open"
    times_us = [int(r[3]) for r in reports]
    assert all(abs(t - 500_000 * (k + 1)) <= 2 for k, t in enumerate(times_us))


def test_the_clock_drifts_within_its_promise(rig: Rig) -> None:
    rig.time.run(1000.0)
    board_us = int(rig.say("C,1,PING")[-1].split(",")[3])
    drift_ppm = (board_us - 1000e6) / 1000
    assert 0.1 < abs(drift_ppm) < 50


def test_lasers_answer_what_shines_not_what_was_said(rig: Rig) -> None:
    with rig.time.condition:
        rig.faults.add("laser.left stuck")
        rig.faults.add("laser.right off")
    assert rig.say("C,1,LASER,0,1") == ["A,1,LASER,1,0"]
    assert rig.board.lasers_on == (True, False)


def test_a_missing_pulse_is_missing_everywhere(rig: Rig) -> None:
    with rig.time.condition:
        rig.faults.add("board intermittent frame=1")
    rig.syncs(1)
    rig.say("C,1,ARM,3,2,500,12000")
    rig.syncs(4)
    assert [shot.frame for _, _, shot in rig.fired] == [0, 2]
    assert [line.split(",")[2:4] for line in rig.lines() if ",HB," not in line] == [
        *(["PULSE", "0"], ["PULSE", "2"], ["DONE", "3"])
    ]


def test_a_reset_forgets_everything(rig: Rig) -> None:
    rig.syncs(3)
    rig.say("C,1,LASER,1,1")
    rig.say("C,2,ARM,24,5,500,12000")
    with rig.time.condition:
        rig.faults.add("board wrong how=reset")
    assert rig.lines() == ["R,0,BOOT,1.4.2,KF-BRD-0001,WATCHDOG"]
    assert rig.board.lasers_on == (False, False)
    rig.syncs(10)
    assert not rig.fired
    assert rig.say("C,3,VSYNC")[-1].split(",")[3] == "10", "the count begins again"


def test_a_reset_in_the_middle_of_a_sequence(rig: Rig) -> None:
    with rig.time.condition:
        rig.faults.add("board wrong how=reset frame=2")
    rig.syncs(1)
    rig.say("C,1,ARM,5,2,500,12000")
    rig.syncs(8)
    assert [shot.frame for _, _, shot in rig.fired] == [0, 1]
    assert "R,0,BOOT,1.4.2,KF-BRD-0001,WATCHDOG" in rig.lines()


def test_switched_off_it_is_silent_and_comes_back_with_a_banner(rig: Rig) -> None:
    with rig.time.condition:
        rig.faults.add("board off for_s=3")
    assert rig.say("C,1,PING") == []
    rig.time.run(2.9)
    assert rig.lines() == []
    rig.time.run(0.2)
    assert rig.lines() == ["R,0,BOOT,1.4.2,KF-BRD-0001,POWER"]


def test_a_slow_board_answers_after_half_a_second(rig: Rig) -> None:
    with rig.time.condition:
        rig.faults.add("board slow")
    assert rig.say("C,1,STOP") == []
    rig.time.run(0.49)
    assert "A,1,STOP" not in rig.lines()
    rig.time.run(0.02)
    assert "A,1,STOP" in rig.lines()


def test_noise_between_the_lines_leaves_the_lines_readable(rig: Rig) -> None:
    with rig.time.condition:
        rig.faults.add("board garbage")
    with rig.time.condition:
        rig.board.receive(b"$C,7,PING*B7B3\r\n")
        raw = rig.board.take(1 << 16)
    assert not raw.startswith(b"$A,7,PING")
    assert re.search(rb"\$A,7,PING,\d+\*[0-9A-F]{4}\r\n$", raw)


def test_nothing_is_kept_for_a_host_that_has_not_opened_the_port(rig: Rig) -> None:
    rig.board.open = False
    rig.time.run(2.1)
    rig.board.open = True
    rig.time.run(0.5)
    assert [line.split(",")[1:3] for line in rig.lines()] == [["5", "HB"]], "the gap in the numbers tells"


def test_a_host_that_does_not_read_loses_whole_lines_and_no_memory(rig: Rig) -> None:
    rig.time.run(500.0)
    assert rig.board.waiting <= 65_536
    bodies = rig.lines()
    assert len(bodies) > 400
    assert [int(body.split(",")[1]) for body in bodies] == list(range(1, len(bodies) + 1))


def test_a_broken_sensor_has_no_value(bench: Bench) -> None:
    bench.world.fault("sensor.TPROJ off")
    bench.world.fault("sensor.SUPPLY wrong amount=9.5")
    bench.world.fault("leak wrong")
    values = dict(word.split("=") for word in bench.board.ask("SENSE"))
    assert values["TPROJ"] == "-"
    assert float(values["SUPPLY"]) == 9.5
    assert values["LEAK"] == "1"
    assert 15 < float(values["TCASE"]) < 30


def test_the_board_sees_the_projector_and_loses_it(bench: Bench) -> None:
    projector = bench.projector()
    before = int(bench.board.ask("VSYNC")[0])
    first, _ = projector.show(0), projector.show(0)
    assert int(bench.board.ask("VSYNC")[0]) >= before + 2
    bench.board.ask("LIVE", 6, 500, 8000)
    projector.set_property("DPMS", "Off")
    bench.board.wait_report("NOSYNC")
    assert bench.board.ask("VSYNC") == ["N", "4", "no vertical sync"]
    assert first["sequence"] != before, "the two counters start at different numbers"
