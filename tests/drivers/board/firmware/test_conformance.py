"""What ``docs/protocols/board.md`` promises, asked of every board that there is: one suite for simulator and firmware.

The suite has its own checksum and its own parser, and shares no number with what it judges.
"""

from __future__ import annotations

import binascii
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.drivers.board.firmware.targets import TARGETS, Target
from tests.hw_sim.devices.host import framed

pytestmark = pytest.mark.devices

ANSWER_US = 20_000
PERIOD_US = 1e6 / 60.0
SENSORS = ["TPROJ", "TCASE", "TBOARD", "LEAK", "HUM", "SUPPLY"]
DRIFT = 100e-6
"""50 ppm of the board, and as much for the host."""


@dataclass
class Host:
    """A host that believes nothing: each line is checked to the last byte."""

    target: Target
    number: int = 0

    def listen(self, time_us: int, data: bytes = b"") -> list[list[str]]:
        raw = self.target.exchange(data, time_us)
        lines = []
        for line in raw.splitlines(keepends=True):
            assert len(line) <= 160
            match = re.fullmatch(rb"\$([ -~]+)\*([0-9A-F]{4})\r\n", line)
            assert match, line
            assert b"$" not in match[1]
            assert b"*" not in match[1]
            assert int(match[2], 16) == binascii.crc_hqx(match[1], 0xFFFF), line
            kind, number, *words = match[1].decode().split(",")
            assert kind in {"A", "N", "R"}
            assert 0 <= int(number) <= 65535
            lines.append([kind, number, *words])
        return lines

    def answers(self, data: bytes, time_us: int = ANSWER_US) -> list[list[str]]:
        return [line for line in self.listen(time_us, data) if line[0] != "R"]

    def ask(self, *words: object) -> list[str]:
        """The answer's kind, verb and fields; it came within 20 ms, and once."""
        self.number += 1
        (answer,) = self.answers(framed(",".join(["C", str(self.number), *map(str, words)])))
        assert answer[1] == str(self.number)
        return [answer[0], *answer[2:]]

    def count(self) -> int:
        kind, _, count, *_ = self.ask("VSYNC")
        assert kind == "A"
        return int(count)

    def reports(self, time_us: int, verb: str) -> list[list[str]]:
        return [words for kind, _, said, *words in self.listen(time_us) if kind == "R" and said == verb]


@pytest.fixture(params=TARGETS)
def host(request: pytest.FixtureRequest) -> Iterator[Host]:
    with TARGETS[str(request.param)]() as target:
        yield Host(target)


@pytest.fixture
def running(host: Host) -> Host:
    """A board that has seen syncs for 150 ms."""
    host.listen(150_000)
    return host


def test_after_a_reset_it_says_who_it_is_and_beats_twice_a_second(host: Host) -> None:
    said = host.listen(3_100_000)
    first = next(i for i, line in enumerate(said) if line[2] == "BOOT")
    assert (said[first][1], len(said[first])) == ("0", 6)
    assert said[first][5] in {"POWER", "WATCHDOG", "BROWNOUT", "HOST"}
    assert [(kind, int(number)) for kind, number, *_ in said[first:]] == [("R", k) for k in range(len(said) - first)]
    beats = [line[3:] for line in said[first:] if line[2] == "HB"]
    times_us = [int(beat[0]) for beat in beats]
    assert len(beats) in {5, 6}
    assert all(abs(b - a - 500_000) < 5000 for a, b in itertools.pairwise(times_us))
    assert abs(times_us[0] - 500_000) < 20_000
    for beat in beats:
        assert beat[2:4] == ["0", "0"]
        assert [word.partition("=")[0] for word in beat[4:]] == SENSORS


def test_the_clock_is_in_microseconds_and_syncs_are_counted_and_dated_by_it(running: Host) -> None:
    before_us = int(running.ask("PING")[2])
    _, _, count, at_us, now_us = running.ask("VSYNC")
    assert 0 <= int(now_us) - int(at_us) <= PERIOD_US + 500
    running.listen(980_000)
    after_us = int(running.ask("PING")[2])
    assert abs(after_us - before_us - 980_000 - 2 * ANSWER_US) < 500 + 1e6 * DRIFT
    _, _, later, later_us, _ = running.ask("VSYNC")
    passed = int(later) - int(count)
    assert abs(passed - 60) <= 2
    assert abs((int(later_us) - int(at_us)) / passed - PERIOD_US) < PERIOD_US * DRIFT + 1.0


def test_it_understands_the_printed_examples_and_says_what_is_fitted_and_senses_that(running: Host) -> None:
    (answer,) = running.answers(b"$C,7,PING*B7B3\r\n")
    assert answer[:3] == ["A", "7", "PING"]
    (answer,) = running.answers(b"$C,8,ARM,24,90124,500,12000*1E87\r\n")
    assert answer == ["A", "8", "ARM", "24", "90124", "500", "12000"]
    kind, verb, firmware, serial, capabilities = running.ask("INFO")
    assert (kind, verb, capabilities.split("+")) == ("A", "INFO", SENSORS)
    assert firmware
    assert serial
    kind, verb, *fields = running.ask("SENSE")
    values = dict(field.split("=") for field in fields)
    assert (kind, verb, list(values)) == ("A", "SENSE", SENSORS)
    assert values["LEAK"] in {"0", "1"}
    assert all(value == "-" or re.fullmatch(r"-?\d+(\.\d+)?", value) for value in values.values())


def test_armed_pulses_come_on_their_syncs_after_their_delay_and_nothing_else_behind_them(running: Host) -> None:
    for pulses, delay_us, width_us in ((1, 0, 50), (5, 500, 12_000), (64, 15_000, 1000)):
        start = running.count() + 20
        order = ["ARM", str(pulses), str(start), str(delay_us), str(width_us)]
        assert running.ask(*order) == ["A", *order], "it is not busy any more"
        _, _, count, sync_us, _ = running.ask("VSYNC")
        said = running.listen(round((pulses + 40) * PERIOD_US))
        fired = [(int(w[0]), int(w[1]), int(w[2])) for _, _, verb, *w in said if verb == "PULSE"]
        assert [(k, vsync) for k, vsync, _ in fired] == [(k, start + k) for k in range(pulses)]
        for _, vsync, time_us in fired:
            due_us = int(sync_us) + (vsync - int(count)) * PERIOD_US + delay_us
            assert abs(time_us - due_us) < 3 + (vsync - int(count)) * PERIOD_US * (DRIFT + 1 / PERIOD_US)
        assert [w for _, _, verb, *w in said if verb == "DONE"] == [[str(pulses)]]


WRONG: list[Any] = [
    *(["ARM", 0, "+9", 0, 50], ["ARM", 65, "+9", 0, 50], ["ARM", 1, "+9", 15_001, 50], ["ARM", 1, "+9", 0, 49]),
    *(["ARM", 1, "+9", 0, 16_001], ["ARM", 1, 4_294_967_296, 0, 50], ["ARM", 1, "+9", 0], ["ARM", 1, "x", 0, 50]),
    *(["ARM", 1, "+9", -1, 50], ["ARM", 1, "+9", 0, 50, 0], ["ARM"], ["ARM", "", "+9", 0, 50]),
    *(["LIVE", 0, 0, 50], ["LIVE", 61, 0, 50], ["LIVE", 1, 15_001, 50], ["LIVE", 1, 0, 16_001], ["LIVE", 1, 0]),
    *(["LASER", 2, 0], ["LASER", 0], ["LASER", "on", "off"], ["PING", 1], ["VSYNC", 0], ["STOP", ""]),
    *(["INFO", "x"], ["SENSE", "LEAK"]),
]


def test_arguments_out_of_range_and_unknown_verbs_are_refused_and_the_ends_of_the_ranges_allowed(running: Host) -> None:
    for words in WRONG:
        start = running.count() + 9
        kind, verb, code, text = running.ask(*[start if word == "+9" else word for word in words])
        assert (kind, verb, code) == ("N", words[0], "2"), words
        assert text
    for allowed in (["LIVE", 60, 15_000, 50], ["LIVE", 1, 0, 16_000], ["LASER", 1, 0]):
        assert running.ask(*allowed) == ["A", *map(str, allowed)]
    kind, verb, code, text = running.ask("FLY", 1)
    assert (kind, verb, code) == ("N", "FLY", "1")
    assert text


def test_an_armed_board_is_busy_until_it_is_stopped(running: Host) -> None:
    start = running.count() + 40
    running.ask("ARM", 3, start, 0, 1000)
    assert running.ask("ARM", 3, start, 0, 1000)[:3] == ["N", "ARM", "3"]
    assert running.ask("LIVE", 1, 0, 1000)[:3] == ["N", "LIVE", "3"]
    assert running.ask("STOP") == ["A", "STOP"] == running.ask("STOP")
    said = running.listen(1_000_000)
    assert not [line for line in said if line[2] in {"PULSE", "DONE", "NOSYNC"}]
    assert running.ask("ARM", 1, running.count() + 20, 0, 1000)[0] == "A"


def test_a_sync_that_has_been_is_past(running: Host) -> None:
    for back in (0, 1, 100, 0x7FFF_FF00):
        now = running.count()
        assert running.ask("ARM", 1, (now - back) & 0xFFFFFFFF, 0, 50)[:3] == ["N", "ARM", "5"]
        assert running.ask("LIVE", 1, 0, 50)[0] == "A", "what was refused is not armed"


def test_live_pulses_are_not_reported_and_give_way_to_armed_ones(running: Host) -> None:
    assert running.ask("LIVE", 2, 500, 4000) == ["A", "LIVE", "2", "500", "4000"]
    assert not running.reports(500_000, "PULSE")
    start = running.count() + 20
    assert running.ask("ARM", 3, start, 700, 4000)[0] == "A"
    assert [int(w[1]) for w in running.reports(600_000, "PULSE")] == [start, start + 1, start + 2]


def test_the_lasers_answer_with_their_currents_and_the_heartbeat_tells_them(running: Host) -> None:
    for left, right in ((1, 0), (0, 1), (1, 1), (0, 0)):
        assert running.ask("LASER", left, right) == ["A", "LASER", str(left), str(right)]
        assert running.reports(520_000, "HB")[-1][2:4] == [str(left), str(right)]


def test_a_command_that_is_sent_again_is_answered_again_and_not_obeyed_again(running: Host) -> None:
    arm = framed(f"C,500,ARM,2,{running.count() + 40},0,50")
    first = running.answers(arm)
    assert first[0][0] == "A"
    assert running.answers(arm) == first == running.answers(arm)
    ping = framed("C,501,PING")
    assert running.answers(ping) == running.answers(ping), "the time of its first execution"
    assert len(running.reports(1_000_000, "PULSE")) == 2
    # Another command under the same number is a new one.
    assert running.answers(framed("C,501,LASER,1,1")) == [["A", "501", "LASER", "1", "1"]]
    assert running.answers(framed("C,501,LASER,0,0")) == [["A", "501", "LASER", "0", "0"]]


NOISE = [
    b"\x00\xff\r\n",
    b"$C,1,PI",
    b"$C,1,PING*0000\r\n",
    b"PING\r\n",
    b"$" * 300,
    b"$" + b"x" * 400,
    b"$C,1,P\xc4NG",
]
PING = framed("C,5,PING")
NO_COMMANDS = [
    *(PING.replace(b"\r\n", b"\n"), PING.lower(), PING[:-6] + b"\r\n", framed("C,6," + "P" * 149)),
    *(
        framed(body)
        for body in ("C,65536,PING", "C,-1,PING", "C,,PING", "R,5,PING", "C,5", "C,5,PI*NG", "C,5,PI\x7fNG")
    ),
]


def test_a_command_behind_garbage_is_answered_once_and_what_is_no_command_not_at_all(running: Host) -> None:
    for noise in NOISE:
        ((kind, number, *_),) = running.answers(noise + framed("C,65535,PING"))
        assert (kind, number) == ("A", "65535"), noise
        ((kind, number, *_),) = running.answers(framed("C,0,PING"))
        assert (kind, number) == ("A", "0")
    for line in NO_COMMANDS:
        assert not running.answers(line), line
    longest = framed("C,5," + "P" * 148)
    assert len(longest) == 160
    ((kind, number, verb, code, _),) = running.answers(longest)
    assert (kind, number, verb, code) == ("N", "5", "P" * 16, "1")
    answers = running.answers(framed("C,11,PING") + framed("C,12,STOP"))
    assert [line[1:3] for line in answers] == [["11", "PING"], ["12", "STOP"]], "two commands in one packet"


def test_a_lost_sync_ends_what_was_being_fired(running: Host) -> None:
    for order in (["ARM", 8, "+9", 0, 50], ["LIVE", 1, 0, 50]):
        start = running.count() + 9
        assert running.ask(*[start if word == "+9" else word for word in order])[0] == "A"
        running.target.sync(False)
        said = running.listen(200_000)
        assert [line[2] for line in said if line[2] != "HB"] == ["NOSYNC"]
        for refused in (["VSYNC"], ["ARM", 1, start + 50, 0, 50], ["LIVE", 1, 0, 50]):
            assert running.ask(*refused)[:3] == ["N", refused[0], "4"]
        running.target.sync(True)
        said = running.listen(500_000)
        assert not [line for line in said if line[2] in {"PULSE", "NOSYNC"}], "it does not begin again by itself"
    assert running.ask("ARM", 1, running.count() + 20, 0, 50)[0] == "A"
