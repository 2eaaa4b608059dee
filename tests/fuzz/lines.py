"""What the board and the key pad may send: lines and reports, with anything between them."""

from __future__ import annotations

import functools
import operator
import threading
from dataclasses import asdict
from pathlib import Path
from random import Random

import serial

from drivers.api import (
    BoardEvent,
    BoardLost,
    DeviceGone,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    KeysLost,
    KeyStuck,
    Telemetry,
)
from drivers.board import BoardSpec, TriggerBoard
from drivers.board.board import THREAD_NAME
from drivers.board.line import MAX_LINE, Kind, LineSplitter, MalformedLine, Sentence, crc16, format_line, parse_line
from drivers.board.reports import parse_info, parse_lasers, parse_refusal, parse_report
from drivers.keys.keypad import HidKeypad
from drivers.keys.report import MalformedReport
from drivers.keys.report import parse_report as parse_key_report
from drivers.native import MonotonicClock
from tests.drivers.clock import SteppedClock
from tests.drivers.keys.test_keypad import SPEC, Pad
from tests.drivers.keys.test_keypad import report as key_report
from tests.fuzz.damage import damaged, reworded
from tests.fuzz.target import Target

SENTENCES = (
    Sentence(Kind.REPORT, 311, "PULSE", ("0", "90124", "1502733412")),
    Sentence(Kind.REPORT, 312, "DONE", ("24",)),
    Sentence(Kind.REPORT, 313, "NOSYNC"),
    Sentence(
        Kind.REPORT, 314, "HB", ("1502733412", "90124", "0", "1", "TPROJ=41.5", "TCASE=-", "LEAK=0", "SUPPLY=12.1")
    ),
    Sentence(Kind.REPORT, 0, "BOOT", ("1.2.0", "KB-0007", "power")),
    Sentence(Kind.ACKNOWLEDGE, 7, "INFO", ("1.2.0", "KB-0007", "TPROJ+TCASE+LEAK")),
    Sentence(Kind.ACKNOWLEDGE, 8, "LASER", ("1", "0")),
    Sentence(Kind.ACKNOWLEDGE, 9, "VSYNC", ("90124", "1502733412", "1502740000")),
    Sentence(Kind.REFUSAL, 10, "ARM", ("3", "busy")),
)
HEARTBEAT = format_line(SENTENCES[3])
LINES = tuple(format_line(sentence) for sentence in SENTENCES)
BODIES = tuple(line[1:-7].decode() for line in LINES)
FIELDS = tuple(sorted({field for body in BODIES for field in body.split(",")}))


def _line(chance: Random) -> bytes:
    """A line whose checksum mostly fits its damaged content."""
    body = chance.choice(BODIES)
    if chance.random() < 0.6:
        body = reworded(chance, body.replace(",", " "), FIELDS).replace(" ", ",")
    raw = body.encode("utf-8", "surrogatepass")
    if chance.random() < 0.4:
        raw = damaged(chance, raw, LINES)
    line = b"$" + raw + b"*%04X\r\n" % crc16(raw)
    return line if chance.random() < 0.8 else damaged(chance, line, LINES)


def _read_line(line: bytes, _: Path) -> None:
    sentence = parse_line(line)
    assert format_line(sentence), "what was understood can be said"
    match sentence.kind, sentence.verb:
        case Kind.REPORT, _:
            parse_report(sentence, 0)
        case Kind.REFUSAL, _:
            parse_refusal(sentence)
        case Kind.ACKNOWLEDGE, "LASER":
            parse_lasers(sentence)
        case _:
            parse_info(sentence)


def _bytes(chance: Random) -> list[bytes]:
    """What one read after the other gets of a line full of noise."""
    stream = b"".join(
        chance.choice((_line(chance), chance.choice(LINES), chance.randbytes(chance.choice((1, 5, 300)))))
        for _ in range(chance.randrange(1, 6))
    )
    pieces = []
    while stream:
        size = chance.choice((1, 3, 40, 500))
        pieces.append(stream[:size])
        stream = stream[size:]
    return pieces


def _split(pieces: list[bytes], _: Path) -> None:
    splitter = LineSplitter()
    out = 0
    for piece in pieces:
        for line in splitter.feed(piece):
            assert len(line) <= MAX_LINE
            out += len(line)
            try:
                _read_line(line, _)
            except MalformedLine:
                continue
    assert out + splitter.garbage_bytes <= sum(map(len, pieces)), "bytes are counted once"
    assert splitter.feed(LINES[0])[-1] == LINES[0], "the next whole line is found, whatever was before"


def _hear(pieces: list[bytes], _: Path) -> None:
    """The driver with its reader thread, on a port that says this and is then pulled out."""
    packages: list[str] = serial.protocol_handler_packages
    packages.append("tests.fuzz")
    try:
        url = "fuzz://" + ".".join(piece.hex() for piece in (*pieces, b"\r\n", HEARTBEAT))
        with TriggerBoard.open(BoardSpec(url), MonotonicClock()) as board:
            heard: list[BoardEvent] = []
            while not heard or not isinstance(heard[-1], BoardLost):
                event = board.next_event(5.0)
                assert event is not None, "it hangs"
                heard.append(event)
            counters = board.counters
            assert board.latest is None, "nothing is known of a board that is gone"
    finally:
        packages.remove("tests.fuzz")
    assert isinstance(heard[-2], Telemetry), "the next whole line is heard, whatever was before"
    assert heard[-2].temperature_projector_c == 41.5
    assert min(asdict(counters).values()) >= 0
    assert not any(thread.name == THREAD_NAME for thread in threading.enumerate())


# ---------------------------------------------------------------------------------------------------- key pad

REPORTS = (key_report(0, 0, 0), key_report(1, 3, 250), key_report(0x0F, 255, 65535), key_report(2, 9, 500, 8))


def _checked(data: bytes) -> bytes:
    return data[:7] + bytes([functools.reduce(operator.xor, data[:7], 0xA5)]) + data[8:] if len(data) >= 8 else data


def _report(chance: Random) -> bytes:
    data = damaged(chance, chance.choice(REPORTS), REPORTS)
    return _checked(data) if chance.random() < 0.7 else data


def _presses(chance: Random) -> list[tuple[int, bytes | None]]:
    """Reports with the milliseconds between them; ``None``: the pad is pulled out."""
    said: list[tuple[int, bytes | None]] = []
    for _ in range(chance.randrange(1, 15)):
        data = chance.choice(
            (_report(chance), key_report(chance.randrange(16), chance.randrange(256), chance.randrange(65536)))
        )
        said.append((chance.choice((0, 1, 5, 40, 250, 900, 3000)), None if chance.random() < 0.03 else data))
    return said


def _press(said: list[tuple[int, bytes | None]], _: Path) -> None:
    clock = SteppedClock()
    pad = Pad(clock)
    pad.queue(0, key_report(0, 0, 0))
    time_ms = 0
    for gap_ms, data in said:
        time_ms += gap_ms
        pad.queue(time_ms, data)
    down: set[object] = set()
    with HidKeypad.open(SPEC, pad, clock) as keys:
        for _step in range(10 * len(said) + 20):
            event = keys.next_event(0.5)
            match event:
                case KeyPress(key=key):
                    assert key not in down, "pressed twice without a release"
                    down.add(key)
                case KeyRelease(key=key) | KeyStuck(key=key):  # a stuck one is masked until it was released
                    down.discard(key)
                case KeyLongPress(key=key):
                    assert key in down, "long without a press"
                case KeysLost():
                    down.clear()
                case None if pad.now_ms() > time_ms + 2000:
                    return
        raise AssertionError("events without end")


TARGETS = (
    Target("board-line", "a line of the board", _line, _read_line, (MalformedLine,)),
    Target("board-bytes", "the board's serial line with noise between and within lines", _bytes, _split, cost=3.0),
    Target("board-thread", "the board's driver: reader thread, events, until the port is pulled out", _bytes, _hear, cost=20.0),
    Target("key-report", "a report of the key pad", _report, lambda data, _: parse_key_report(data), (MalformedReport,)),
    Target("key-pad", "reports of a key pad at any times, until it is pulled out", _presses, _press, (DeviceGone,), cost=5.0),
)  # fmt: skip
