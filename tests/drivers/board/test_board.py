"""The conversation with a board at the other end of a pseudo terminal: real bytes through the real pyserial."""

from __future__ import annotations

import binascii
import errno
import os
import re
import select
import subprocess
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.api import BoardBooted, BoardEvent, BoardLost, DeviceGone, DeviceRefused, LaserState, Pulse, Telemetry
from drivers.board import BoardSpec, TriggerBoard
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from drivers.native import MonotonicClock
from tests.support.damage import damaged

Respond = Callable[[int, str, list[str]], list[bytes]]


def line(*parts: object) -> bytes:
    body = ",".join(str(part) for part in parts).encode()
    return b"$" + body + b"*%04X\r\n" % binascii.crc_hqx(body, 0xFFFF)


def polite(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
    answers = {
        "INFO": ["1.4", "KF-B-1", "TPROJ+LEAK"],
        "PING": ["5001234"],
        "VSYNC": ["300", "5000000", "5001234"],
        "LASER": fields,
        "STOP": [],
        "ARM": fields,
        "LIVE": fields,
    }
    return [line("A", sequence, verb, *answers[verb])]


def saying(verb: str, *fields: object, kind: str = "A") -> Respond:
    """Return a board that answers one verb with these fields, and is polite to the others."""

    def respond(sequence: int, asked: str, polite_fields: list[str]) -> list[bytes]:
        return [line(kind, sequence, verb, *fields)] if asked == verb else polite(sequence, asked, polite_fields)

    return respond


class FarEnd:
    """The board's end of the line: answers by a function, says what the test wants, keeps every command."""

    def __init__(self, respond: Respond = polite) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.url = os.ttyname(self._slave)
        self.respond = respond
        self.commands: list[tuple[int, str, list[str]]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        os.write(self._master, data)

    def unplug(self) -> None:
        self._stop.set()
        self._thread.join(2.0)
        os.close(self._slave)
        os.close(self._master)

    def _serve(self) -> None:
        pending = b""
        while not self._stop.is_set():
            if not select.select([self._master], [], [], 0.02)[0]:
                continue
            pending += os.read(self._master, 4096)
            *lines, pending = pending.split(b"\r\n")
            for raw in lines:
                body, _, checksum = raw[1:].partition(b"*")
                assert raw[:1] == b"$"
                assert int(checksum, 16) == binascii.crc_hqx(body, 0xFFFF)
                _, sequence, verb, *fields = body.decode().split(",")
                self.commands.append((int(sequence), verb, fields))
                for answer in self.respond(int(sequence), verb, fields):
                    os.write(self._master, answer)


@contextmanager
def connected(respond: Respond = polite) -> Iterator[tuple[FarEnd, TriggerBoard]]:
    far = FarEnd(respond)
    try:
        with TriggerBoard.open(BoardSpec(far.url), MonotonicClock()) as board:
            far.commands.clear()
            yield far, board
    finally:
        if not far._stop.is_set():
            far.unplug()


def wait_for(board: TriggerBoard, kind: type[BoardEvent], timeout_s: float) -> BoardEvent:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        event = board.next_event(0.1)
        if isinstance(event, kind):
            return event
    raise AssertionError(f"no {kind} within {timeout_s} s")


def test_opening_asks_who_it_is() -> None:
    with connected() as (_, board):
        assert (board.info.firmware, board.info.serial) == ("1.4", "KF-B-1")
        assert board.health().ok
        assert any(thread.name == "kf-board" for thread in threading.enumerate())
    assert not any(thread.name == "kf-board" for thread in threading.enumerate())


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


def test_arming_sends_its_four_numbers() -> None:
    with connected() as (far, board):
        board.arm(24, 90124, 500, 12000)
        assert far.commands[0][1:] == ("ARM", ["24", "90124", "500", "12000"])


def test_the_lasers_read_back_is_told_not_what_was_asked() -> None:
    with connected(saying("LASER", 1, 0)) as (_, board):
        assert board.set_lasers(False, False) == LaserState(True, False)


def test_a_lost_answer_is_asked_for_again_with_the_same_number() -> None:
    asked = 0

    def deaf_twice(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
        nonlocal asked
        asked += verb == "STOP"
        return [] if verb == "STOP" and asked < 3 else polite(sequence, verb, fields)

    with connected(deaf_twice) as (far, board):
        board.stop()
        assert len(far.commands) == 3
        assert len({sequence for sequence, _, _ in far.commands}) == 1
        assert board.counters.retries == 2


def test_a_board_that_never_answers_is_gone_in_bounded_time() -> None:
    with connected() as (far, board):
        far.respond = lambda *_: []
        begin = time.monotonic()
        with pytest.raises(DeviceGone, match="no answer to STOP in 3 attempts"):
            board.stop()
        assert time.monotonic() - begin < 0.6


def test_a_program_that_reads_the_port_without_a_lock_is_named_and_not_the_cable() -> None:
    with connected() as (far, board):
        far.respond = lambda *_: []  # its answers come to the other reader
        with Path(far.url).open("rb", buffering=0) as port, subprocess.Popen(["sleep", "60"], stdin=port) as reader:
            with pytest.raises(DeviceGone) as caught:
                board.stop()
            lost = wait_for(board, BoardLost, 2.5)
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

        def late(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
            return [line("A", stale, "VSYNC", 1, 1, 1), *polite(sequence, verb, fields)]

        far.respond = late
        assert board.vsync().count == 300
        assert board.counters.late_answers == 1


def test_a_number_the_board_has_seen_before_is_not_used_twice() -> None:
    """A restarted program may hit the number of its predecessor's last command; the board then repeats that answer."""
    first: list[int] = []

    def remembers(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
        first.append(sequence)
        if sequence == first[0]:
            return [line("A", sequence, "LASER", 0, 0)]
        return polite(sequence, verb, fields)

    with connected(remembers) as (_, board):
        assert board.info.serial == "KF-B-1"
        assert first[1] == (first[0] + 1) % 65536


def test_garbage_between_lines_costs_no_report() -> None:
    with connected() as (far, board):
        far.say(b"\xff\x00$R,5,PUL" + line("R", 5, "PULSE", 0, 100, 1000) + b"noise\r\n" + b"$" * 7)
        far.say(line("R", 6, "PULSE", 1, 101, 17667)[:-3] + b"!" + line("R", 7, "PULSE", 2, 102, 34334))
        assert wait_for(board, Pulse, 1.0) == Pulse(0, 100, 1000)
        assert wait_for(board, Pulse, 1.0) == Pulse(2, 102, 34334)
        counters = board.counters
        assert counters.lost_reports == 1
        assert counters.damaged_lines >= 2


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
        event = wait_for(board, Telemetry, 5.0)
        while not isinstance(event, Telemetry) or event.temperature_projector_c != 41.5:
            event = wait_for(board, Telemetry, 5.0)
        far.unplug()
        wait_for(board, BoardLost, 5.0)
        assert board.latest is None, "nothing is known of a board that is gone"
        assert min(asdict(board.counters).values()) >= 0


def test_a_reset_is_told_and_starts_the_numbering_anew() -> None:
    with connected() as (far, board):
        far.say(line("R", 900, "HB", 1, 1, 0, 0) + line("R", 0, "BOOT", "1.4", "KF-B-1", "WATCHDOG"))
        far.say(line("R", 1, "HB", 500000, 30, 0, 0, "TPROJ=40.5"))
        assert wait_for(board, BoardBooted, 1.0) == BoardBooted("1.4", "KF-B-1", "WATCHDOG")
        event = wait_for(board, Telemetry, 1.0)
        assert isinstance(event, Telemetry)
        assert event.temperature_projector_c == 40.5
        far.say(line("R", 2, "HB", 1000000, 60, 0, 0, "TBOARD=31.24"))
        wait_for(board, Telemetry, 1.0)
        assert board.health().details["board temperature"] == "31.2 °C"
        far.say(line("R", 0, "BOOT", "1.4", "KF-B-1", "BROWNOUT"))
        wait_for(board, BoardBooted, 1.0)
        assert board.latest is None, "what it measured before says nothing of now"
        assert "board temperature" not in board.health().details
        assert board.counters.lost_reports == 0


def test_silence_is_told_once_after_three_heartbeats_and_ends_by_itself() -> None:
    with connected() as (far, board):
        far.say(line("R", 1, "HB", 1, 1, 0, 0))
        wait_for(board, Telemetry, 1.0)
        begin = time.monotonic()
        assert wait_for(board, BoardLost, 2.5) == BoardLost("no heartbeat for 1.5 s")
        assert 1.4 < time.monotonic() - begin < 1.9
        assert board.latest is None
        assert board.next_event(0.3) is None
        far.say(line("R", 2, "HB", 2_000_000, 1, 0, 0))
        assert isinstance(wait_for(board, Telemetry, 1.0), Telemetry)


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (lambda board: board.arm(24, 90, 500, 12000), "ARM 24,90,500,12000 was answered with 24,90,500,999"),
        (lambda board: board.live(2, 500, 12000), "LIVE 2,500,12000 was answered with 2,500,999"),
    ],
)
def test_an_order_that_comes_back_otherwise_was_not_understood(
    order: Callable[[TriggerBoard], None], said: str
) -> None:
    def forgetful(sequence: int, verb: str, fields: list[str]) -> list[bytes]:
        return polite(sequence, verb, [*fields[:-1], "999"])

    with connected(forgetful) as (_, board), pytest.raises(DeviceRefused, match=said):
        order(board)


def test_a_board_without_a_vertical_sync_is_well_and_says_so_and_any_other_refusal_is_no_health() -> None:
    with connected(saying("VSYNC", Refusal.NO_VSYNC, "no", kind="N")) as (_, board):
        health = board.health()
        assert health.ok
        assert health.details["vertical sync"] == "none"
    with connected(saying("VSYNC", Refusal.UNKNOWN_VERB, "no", kind="N")) as (_, board):
        health = board.health()
        assert not health.ok
        assert "refused VSYNC" in health.summary
    with connected() as (_, board):
        assert board.health().details["vertical sync"] == "300"


def test_a_board_that_never_sends_a_whole_heartbeat_is_lost_however_much_it_says_and_answers() -> None:
    with connected() as (far, board):
        begin = time.monotonic()
        lost: BoardEvent | None = None
        while lost is None and time.monotonic() - begin < 3.0:
            far.say(line("R", 1, "HB", 1, 1, 0, 0)[:-4] + b"00\r\n" + line("R", 1, "DEPTH", 12))
            board.stop()
            lost = board.next_event(0.2)
        assert lost == BoardLost("no heartbeat for 1.5 s")
        assert board.counters.damaged_lines >= 3


def test_an_unplugged_board_is_told_fails_commands_at_once_and_measures_nothing_any_more() -> None:
    with connected() as (far, board):
        far.say(line("R", 1, "HB", 500000, 30, 0, 0, "TPROJ=40.5"))
        wait_for(board, Telemetry, 1.0)
        assert board.latest is not None
        far.unplug()
        lost = wait_for(board, BoardLost, 1.0)
        assert isinstance(lost, BoardLost)
        assert "vanished" in lost.reason
        begin = time.monotonic()
        for command in (board.stop, board.vsync):
            with pytest.raises(DeviceGone, match=r"port (vanished|failed)"):
                command()
        assert time.monotonic() - begin < 0.09
        assert not far.commands
        assert not board.health().ok
        assert board.latest is None


def test_a_loss_that_the_writer_and_then_the_reader_notice_is_told_once_by_its_first_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_way_out(line: bytes) -> int:
        raise OSError(errno.EIO, "Input/output error")

    with connected() as (far, board):
        monkeypatch.setattr(board._port, "write", no_way_out)
        with pytest.raises(DeviceGone):
            board.stop()
        far.unplug()  # the way in is gone now, too
        lost = wait_for(board, BoardLost, 1.0)
        assert isinstance(lost, BoardLost)
        assert lost.reason.startswith("port failed")
        assert board.next_event(0.3) is None
        with pytest.raises(DeviceGone, match="port failed"):
            board.vsync()


def test_what_only_a_later_board_reports_is_passed_over_and_counts_as_received() -> None:
    with connected() as (far, board):
        far.say(
            line("R", 4, "PULSE", 0, 100, 1000) + line("R", 5, "SALINITY", 35) + line("R", 6, "PULSE", 1, 101, 17667)
        )
        assert board.next_event(1.0) == Pulse(0, 100, 1000)
        assert board.next_event(1.0) == Pulse(1, 101, 17667)
        assert board.counters.lost_reports == 0
        assert board.counters.damaged_lines == 0


def test_a_bench_bridge_gets_its_baud_rate_and_a_second_program_is_kept_out() -> None:
    with connected() as (far, _):
        assert termios.tcgetattr(far._slave)[5] == termios.B115200
        with pytest.raises(DeviceRefused, match=f"another program uses {far.url}"):
            TriggerBoard.open(BoardSpec(far.url), MonotonicClock())
    with connected() as (far, board):
        board.close()
        with TriggerBoard.open(BoardSpec(far.url), MonotonicClock()) as again:
            assert again.info.serial == "KF-B-1"


@pytest.mark.parametrize(
    ("number", "kind", "said"),
    [
        (errno.EACCES, DeviceRefused, "no permission to open /dev/board. Install the udev rules"),
        (errno.EPERM, DeviceRefused, "no permission to open /dev/board. Install the udev rules"),
        (errno.EBUSY, DeviceRefused, "another program uses /dev/board. Stop it"),
        (errno.EAGAIN, DeviceRefused, "another program uses /dev/board. Stop it"),
        (errno.EIO, DeviceGone, "/dev/board cannot be opened"),
        (None, DeviceGone, "/dev/board cannot be opened"),
    ],
)
def test_what_the_system_says_of_a_port_is_told_with_its_remedy(
    number: int | None, kind: type[DeviceGone], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "as the system says") if number else serial.SerialException("somehow")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(kind, match=re.escape(said)) as caught:
        TriggerBoard.open(BoardSpec("/dev/board"), MonotonicClock())
    assert caught.value.device == "board"


@pytest.mark.parametrize(
    ("code", "reason", "remedy"),
    [
        (1, None, "Update the board's firmware"),
        (2, None, "Correct the value"),
        (3, "armed", "Send STOP first"),
        (4, None, "Check that the projector gets a signal"),
        (5, None, "Choose a later vertical sync"),
        (77, None, "Update this software or the board's firmware"),
    ],
)
def test_each_refusal_of_the_protocol_has_its_reason_and_remedy(code: int, reason: str | None, remedy: str) -> None:
    told = [code] if reason is None else [code, reason]
    with connected(saying("ARM", *told, kind="N")) as (_, board):
        with pytest.raises(BoardRefused) as caught:
            board.arm(24, 90, 500, 12000)
        assert caught.value.code == code
        assert caught.value.message == f"refused ARM: {reason or 'no reason'} (code {code})"
        assert caught.value.remedy.startswith(remedy)


@pytest.mark.parametrize(
    ("verb", "fields", "ask"),
    [
        ("VSYNC", ["300", "5000000"], TriggerBoard.vsync),
        ("VSYNC", ["many", "5000000", "5001234"], TriggerBoard.vsync),
        ("VSYNC", ["300", "-1", "5001234"], TriggerBoard.vsync),
        ("VSYNC", ["4294967296", "1", "2"], TriggerBoard.vsync),
        ("LASER", ["on"], lambda board: board.set_lasers(True, False)),
        ("PING", ["soon"], TriggerBoard.read_clock),
    ],
)
def test_an_answer_without_meaning_is_refused_not_believed(
    verb: str, fields: list[str], ask: Callable[[TriggerBoard], object]
) -> None:
    nonsense = pytest.raises(DeviceRefused, match=f"answered {verb} with nonsense")
    with connected(saying(verb, *fields)) as (_, board), nonsense:
        ask(board)


def test_commands_are_numbered_by_the_milliseconds_so_that_a_restarted_program_does_not_repeat_a_number() -> None:
    far = FarEnd()
    before_ms = time.monotonic_ns() // 1_000_000
    with TriggerBoard.open(BoardSpec(far.url), MonotonicClock()):
        after_ms = time.monotonic_ns() // 1_000_000
        first = (far.commands[0][0] - 1 - before_ms) % 65536  # the first number is the one after the clock's
        assert first <= after_ms - before_ms
    far.unplug()


def test_a_url_that_is_no_port_is_told_with_the_entry_to_correct() -> None:
    with pytest.raises(DeviceRefused, match=r"^board: nonsense://x is no port .*\[board\] in the rig file") as caught:
        TriggerBoard.open(BoardSpec("nonsense://x"), MonotonicClock())
    assert caught.value.device == "board"


def test_a_path_without_a_board_is_one_clear_error() -> None:
    with pytest.raises(DeviceGone, match="/dev/no-such-board cannot be opened: it is not there") as caught:
        TriggerBoard.open(BoardSpec("/dev/no-such-board"), MonotonicClock())
    assert "url of [board]" in caught.value.remedy
