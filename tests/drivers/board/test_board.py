"""The conversation with a board at the other end of a pseudo terminal: real bytes through the real pyserial."""

from __future__ import annotations

import binascii
import errno
import re
import subprocess
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.api import BoardBooted, BoardEvent, BoardLost, DeviceGone, DeviceRefused, LaserState, Pulse, Telemetry
from drivers.board import BoardSpec, TriggerBoard
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from drivers.native import MonotonicClock
from tests.drivers.board.terminal import Terminal
from tests.support.damage import damaged

Respond = Callable[[int, str, list[str]], list[bytes]]
Event = TypeVar("Event", bound=BoardEvent)


def line(*parts: object) -> bytes:
    body = ",".join(str(part) for part in parts).encode()
    return b"$" + body + b"*%04X\r\n" % binascii.crc_hqx(body, 0xFFFF)


def polite(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
    answers = {
        "INFO": ["1.4", "KF-B-1", "TPROJ+LEAK"],
        "PING": ["5001234"],
        "VSYNC": ["300", "5000000", "5001234"],
    }
    return [line("A", sequence, verb, *answers.get(verb, fields))]


def saying(verb: str, *fields: object, kind: str = "A") -> Respond:
    """Return a board that answers one verb with these fields, and is polite to the others."""

    def respond(sequence: int, asked: str, polite_fields: list[str]) -> list[bytes]:
        return [line(kind, sequence, verb, *fields)] if asked == verb else polite(sequence, asked, polite_fields)

    return respond


class FarEnd(Terminal):
    """The board's end of the line: answers by a function, says what the test wants, keeps every command."""

    def __init__(self, respond: Respond = polite) -> None:
        self.respond = respond
        self.commands: list[tuple[int, str, list[str]]] = []
        self._pending = b""
        super().__init__(self._exchange)

    def _exchange(self, heard: bytes) -> bytes:
        *lines, self._pending = (self._pending + heard).split(b"\r\n")
        said = []
        for raw in lines:
            body, _, checksum = raw[1:].partition(b"*")
            assert raw[:1] == b"$"
            assert int(checksum, 16) == binascii.crc_hqx(body, 0xFFFF)
            _, sequence, verb, *fields = body.decode().split(",")
            self.commands.append((int(sequence), verb, fields))
            said += self.respond(int(sequence), verb, fields)
        return b"".join(said)


class HandClock(MonotonicClock):
    """A clock that stands until it is moved, and counts who waits; threads wait in real time."""

    def __init__(self) -> None:
        self._now_ns = 1_000_000_000
        self.waits = 0

    def now_ns(self) -> int:
        return self._now_ns

    def advance_s(self, duration_s: float) -> None:
        self._now_ns += round(duration_s * 1e9)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        self.waits += 1
        return super().wait_for(condition, predicate, timeout_s)


@contextmanager
def connected(respond: Respond = polite, clock: MonotonicClock | None = None) -> Iterator[tuple[FarEnd, TriggerBoard]]:
    far = FarEnd(respond)
    try:
        with TriggerBoard.open(BoardSpec(far.url), clock or MonotonicClock()) as board:
            far.commands.clear()
            yield far, board
    finally:
        far.unplug()


def wait_for(board: TriggerBoard, kind: type[Event]) -> Event:
    for _ in range(100):
        event = board.next_event(0.1)
        if isinstance(event, kind):
            return event
    raise AssertionError(f"no {kind}")


def test_opening_asks_who_it_is_and_closing_ends_the_reader() -> None:
    with connected() as (far, board):
        assert (board.info.firmware, board.info.serial) == ("1.4", "KF-B-1")
        assert termios.tcgetattr(far.slave)[5] == termios.B115200, "for a bridge on the bench"
        assert any(thread.name == "kf-board" for thread in threading.enumerate())
        with pytest.raises(DeviceRefused, match=f"another program uses {far.url}"):
            TriggerBoard.open(BoardSpec(far.url), MonotonicClock())
        board.close()
        assert not any(thread.name == "kf-board" for thread in threading.enumerate())
        with TriggerBoard.open(BoardSpec(far.url), MonotonicClock()) as again:
            assert again.info.serial == "KF-B-1"


def test_vertical_sync_and_clock_are_bracketed_by_host_time() -> None:
    with connected() as (far, board):
        before = time.monotonic_ns()
        sync = board.vsync()
        between = time.monotonic_ns()
        clock = board.read_clock()
        after = time.monotonic_ns()
        assert (sync.count, sync.board_time_us, sync.board_now_us) == (300, 5_000_000, 5_001_234)
        assert before <= sync.host_sent_ns < sync.host_received_ns <= between
        assert clock.board_time_us == 5_001_234
        assert between <= clock.host_sent_ns < clock.host_received_ns <= after
        assert [verb for _, verb, _ in far.commands] == ["VSYNC", "PING"]
        far.commands.clear()
        board.arm(24, 90124, 500, 12000)
        assert far.commands[0][1:] == ("ARM", ["24", "90124", "500", "12000"])
        far.respond = saying("LASER", 1, 0)
        assert board.set_lasers(False, False) == LaserState(True, False), "what is read back, not what was asked"


@pytest.mark.parametrize("deaf", [2, 3])
def test_a_lost_answer_is_asked_for_again_with_the_same_number_twice_and_then_the_board_is_gone(deaf: int) -> None:
    asked = 0

    def respond(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
        nonlocal asked
        asked += verb == "STOP"
        return [] if verb == "STOP" and asked <= deaf else polite(sequence, verb, fields)

    with connected(respond) as (far, board):
        if deaf < 3:
            board.stop()
        else:
            with pytest.raises(DeviceGone, match="no answer to STOP in 3 attempts"):
                board.stop()
        assert [verb for _, verb, _ in far.commands] == ["STOP"] * 3
        assert len({sequence for sequence, _, _ in far.commands}) == 1
        assert board.counters.retries == 2


def test_a_program_that_reads_the_port_without_a_lock_is_named_and_not_the_cable() -> None:
    clock = HandClock()
    with connected(clock=clock) as (far, board):
        far.respond = lambda *_: []  # its answers come to the other reader
        with Path(far.url).open("rb", buffering=0) as port, subprocess.Popen(["sleep", "60"], stdin=port) as reader:
            with pytest.raises(DeviceGone) as caught:
                board.stop()
            clock.advance_s(2.0)
            lost = wait_for(board, BoardLost)
            reader.kill()
    said = f"; sleep (process {reader.pid}) has {far.url} open, too"
    assert said in caught.value.message
    assert lost == BoardLost(f"no heartbeat for 1.5 s{said}")
    assert "cable" not in str(caught.value)


def test_a_late_answer_is_not_taken_for_the_next_ones() -> None:
    with connected() as (far, board):
        far.respond = lambda *_: []
        with pytest.raises(DeviceGone):
            board.vsync()
        stale = far.commands[-1][0]
        far.respond = lambda sequence, *rest: [line("A", stale, "VSYNC", 1, 1, 1), *polite(sequence, *rest)]
        assert board.vsync().count == 300
        assert board.counters.late_answers == 1


def test_a_number_the_board_has_seen_before_is_not_used_twice() -> None:
    """A restarted program may hit the number of its predecessor's last command; the board then repeats that answer."""
    first: list[int] = []

    def remembers(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
        first.append(sequence)
        return [line("A", sequence, "LASER", 0, 0)] if sequence == first[0] else polite(sequence, verb, fields)

    with connected(remembers, HandClock()) as (_, board):
        assert board.info.serial == "KF-B-1"
        assert first == [1001, 1002], "the first is the one after the clock's milliseconds"


def test_garbage_and_what_only_a_later_board_reports_cost_no_report() -> None:
    with connected() as (far, board):
        far.say(b"\xff\x00$R,5,PUL" + line("R", 5, "PULSE", 0, 100, 1000) + b"noise\r\n" + b"$" * 7)
        far.say(line("R", 6, "SALINITY", 35) + line("R", 7, "PULSE", 1, 101, 17667))
        assert wait_for(board, Pulse) == Pulse(0, 100, 1000)
        assert wait_for(board, Pulse) == Pulse(1, 101, 17667)
        assert (board.counters.lost_reports, board.counters.damaged_lines) == (0, 8)
        far.say(line("R", 8, "PULSE", 2, 102, 34334)[:-3] + b"!" + line("R", 9, "PULSE", 3, 103, 51001))
        assert wait_for(board, Pulse) == Pulse(3, 103, 51001)
        assert board.counters.lost_reports == 1


SAID = [
    line("R", 5, "PULSE", 0, 100, 1000),
    line("R", 6, "HB", 1, 1, 0, 0, "TPROJ=40.5"),
    line("R", 0, "BOOT", "1.4", "KF-B-1", "power"),
]


@settings(max_examples=10)
@given(st.lists(damaged(SAID), max_size=6))
def test_whatever_was_said_the_next_whole_line_is_heard_and_so_is_the_end(noise: list[bytes]) -> None:
    with connected() as (far, board):
        far.say(b"".join(noise) + b"\r\n" + line("R", 7, "HB", 500000, 30, 0, 0, "TPROJ=41.5"))
        while wait_for(board, Telemetry).temperature_projector_c != 41.5:
            pass
        far.unplug()
        wait_for(board, BoardLost)
        assert board.latest is None, "nothing is known of a board that is gone"
        assert min(asdict(board.counters).values()) >= 0


def test_a_reset_is_told_and_starts_the_numbering_anew() -> None:
    with connected() as (far, board):
        far.say(line("R", 900, "HB", 1, 1, 0, 0) + line("R", 0, "BOOT", "1.4", "KF-B-1", "WATCHDOG"))
        far.say(line("R", 1, "HB", 500000, 30, 0, 0, "TBOARD=31.24"))
        assert wait_for(board, BoardBooted) == BoardBooted("1.4", "KF-B-1", "WATCHDOG")
        assert wait_for(board, Telemetry).temperature_board_c == 31.24
        assert board.health().details["board temperature"] == "31.2 °C"
        far.say(line("R", 0, "BOOT", "1.4", "KF-B-1", "BROWNOUT"))
        wait_for(board, BoardBooted)
        assert board.latest is None, "what it measured before says nothing of now"
        assert "board temperature" not in board.health().details
        assert board.counters.lost_reports == 0


def test_silence_is_told_once_after_three_heartbeats_and_ends_by_itself() -> None:
    clock = HandClock()
    with connected(clock=clock) as (far, board):
        far.say(line("R", 1, "HB", 1, 1, 0, 0))
        wait_for(board, Telemetry)
        clock.advance_s(1.5)
        assert board.next_event(0.2) is None
        clock.advance_s(0.001)
        assert wait_for(board, BoardLost) == BoardLost("no heartbeat for 1.5 s")
        assert board.latest is None
        assert board.next_event(0.2) is None
        far.say(line("R", 2, "HB", 2_000_000, 1, 0, 0))
        wait_for(board, Telemetry)


def test_a_board_that_never_sends_a_whole_heartbeat_is_lost_however_much_it_says_and_answers() -> None:
    clock = HandClock()
    with connected(clock=clock) as (far, board):
        for _ in range(4):
            far.say(line("R", 1, "HB", 1, 1, 0, 0)[:-4] + b"00\r\n" + line("R", 1, "DEPTH", 12))
            board.stop()
            clock.advance_s(0.5)
        assert wait_for(board, BoardLost) == BoardLost("no heartbeat for 1.5 s")
        assert board.counters.damaged_lines == 4


def test_an_order_that_comes_back_otherwise_was_not_understood() -> None:
    def forgetful(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
        return polite(sequence, verb, [*fields[:-1], "999"])

    with connected(forgetful) as (_, board):
        with pytest.raises(DeviceRefused, match=r"ARM 24,90,500,12000 .* 24,90,500,999"):
            board.arm(24, 90, 500, 12000)
        with pytest.raises(DeviceRefused, match=r"LIVE 2,500,12000 .* 2,500,999"):
            board.live(2, 500, 12000)


def test_a_board_without_a_vertical_sync_is_well_and_says_so_and_any_other_refusal_is_no_health() -> None:
    with connected(saying("VSYNC", Refusal.NO_VSYNC, "no", kind="N")) as (far, board):
        assert board.health().ok
        assert board.health().details["vertical sync"] == "none"
        far.respond = saying("VSYNC", Refusal.UNKNOWN_VERB, "no", kind="N")
        assert not board.health().ok
        assert "VSYNC" in board.health().summary
        far.respond = polite
        assert board.health().details["vertical sync"] == "300"


def test_an_unplugged_board_is_told_fails_commands_at_once_and_measures_nothing_any_more() -> None:
    clock = HandClock()
    with connected(clock=clock) as (far, board):
        far.say(line("R", 1, "HB", 500000, 30, 0, 0, "TPROJ=40.5"))
        wait_for(board, Telemetry)
        assert board.latest is not None
        far.unplug()
        assert "vanished" in wait_for(board, BoardLost).reason
        waits = clock.waits
        for command in (board.stop, board.vsync):
            with pytest.raises(DeviceGone, match="port vanished"):
                command()
        assert not board.health().ok
        assert clock.waits == waits, "no answer is waited for"
        assert board.latest is None


@pytest.mark.parametrize(
    ("number", "kind", "said"),
    [
        (errno.EACCES, DeviceRefused, "no permission to open /dev/board. Install the udev rules"),
        (errno.EPERM, DeviceRefused, "no permission to open /dev/board. Install the udev rules"),
        (errno.EBUSY, DeviceRefused, "another program uses /dev/board. Stop it"),
        (errno.EAGAIN, DeviceRefused, "another program uses /dev/board. Stop it"),
        (errno.ENOENT, DeviceGone, "it is not there"),
        (errno.EIO, DeviceGone, "/dev/board cannot be opened"),
        (None, DeviceGone, "/dev/board cannot be opened"),
    ],
)
def test_what_the_system_says_of_a_port_is_told_with_its_remedy(
    number: int | None, kind: type[DeviceGone], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DeviceRefused, match=r"^board: nonsense://x .*\[board\] in the rig file"):
        TriggerBoard.open(BoardSpec("nonsense://x"), MonotonicClock())

    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "as the system says") if number else serial.SerialException("somehow")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(kind, match=re.escape(said)) as caught:
        TriggerBoard.open(BoardSpec("/dev/board"), MonotonicClock())
    assert caught.value.device == "board"


def test_each_refusal_of_the_protocol_has_its_reason_and_remedy_and_nonsense_is_not_believed() -> None:
    with connected() as (far, board):
        for code, reason, remedy in (
            (1, None, "Update the board's firmware"),
            (2, None, "Correct the value"),
            (3, "armed", "Send STOP first"),
            (4, None, "Check that the projector gets a signal"),
            (5, None, "Choose a later vertical sync"),
            (77, None, "Update this software or the board's firmware"),
        ):
            far.respond = saying("ARM", *([code] if reason is None else [code, reason]), kind="N")
            with pytest.raises(BoardRefused) as caught:
                board.arm(24, 90, 500, 12000)
            assert caught.value.code == code
            assert caught.value.message == f"refused ARM: {reason or 'no reason'} (code {code})"
            assert caught.value.remedy.startswith(remedy)
        asks: list[tuple[str, list[object], Callable[[], object]]] = [
            ("VSYNC", [300, 5], board.vsync),
            ("VSYNC", ["many", 5, 6], board.vsync),
            ("VSYNC", [300, -1, 6], board.vsync),
            ("VSYNC", [1 << 32, 1, 2], board.vsync),
            ("LASER", ["on"], lambda: board.set_lasers(True, False)),
            ("PING", ["soon"], board.read_clock),
        ]
        for verb, fields, ask in asks:
            far.respond = saying(verb, *fields)
            with pytest.raises(DeviceRefused, match=f"an invalid answer to {verb}"):
                ask()
