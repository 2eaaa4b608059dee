"""The conversation with the trigger board: commands, answers, reports, and the check for its loss."""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import serial

from drivers.api import (
    BoardBooted,
    BoardEvent,
    BoardLost,
    BoardTime,
    Clock,
    DeviceError,
    DeviceGone,
    DeviceRefused,
    Health,
    LaserState,
    Telemetry,
    Vsync,
)
from drivers.board.line import (
    SEQUENCE_MODULUS,
    Kind,
    LineSplitter,
    MalformedLine,
    Sentence,
    format_line,
    parse_line,
    parse_uint,
)
from drivers.board.port_users import other_users
from drivers.board.queue import EventQueue
from drivers.board.reports import (
    MAX_COUNT,
    MAX_TIME_US,
    BoardInfo,
    Refusal,
    parse_info,
    parse_lasers,
    parse_refusal,
    parse_report,
)

THREAD_NAME = "kf-board"
ATTEMPTS = 3
"""One question and two repetitions with the same number."""
ANSWER_TIMEOUT_S = 0.1
"""The board answers within 20 ms; the rest is the host's scheduling."""
SILENCE_S = 1.5
"""Three heartbeats."""
_READ_TIMEOUT_S = 0.05
_WRITE_TIMEOUT_S = 0.5
_JOIN_TIMEOUT_S = 2.0
_READ_SIZE = 4096
_BAUD = 115200  # CDC-ACM ignores it; a USB-UART bridge on the bench does not

_REMEDY = {
    Refusal.UNKNOWN_VERB: "Update the board's firmware",
    Refusal.OUT_OF_RANGE: "Correct the value",
    Refusal.BUSY: "Send STOP first",
    Refusal.NO_VSYNC: "Check that the projector gets a signal",
    Refusal.PAST: "Choose a later vertical sync",
}


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """The board of the rig. ``url`` is a device path or any URL that pyserial resolves."""

    url: str
    name: str = "board"


class BoardRefused(DeviceRefused):
    """The board answered N. ``code`` is one of ``Refusal``, or a number this version does not know."""

    def __init__(self, device: str, message: str, remedy: str, code: int) -> None:
        super().__init__(device, message, remedy)
        self.code = code


@dataclass(frozen=True, slots=True)
class BoardCounters:
    """Errors on the line since the port was opened."""

    damaged_lines: int
    """Lines with a wrong checksum, frame or field, and lines cut off."""
    garbage_bytes: int
    lost_reports: int
    """Reports missing in the board's own numbering."""
    late_answers: int
    """Answers that came after the last attempt of their command."""
    retries: int
    dropped_events: int
    """Events that were dropped from the full queue."""


@dataclass(slots=True)
class _Exchange:
    """The command that is under way and, once it has come, its answer."""

    sequence: int
    verb: str
    answer: Sentence | None = None
    mistaken: bool = False


class TriggerBoard:
    """A ``drivers.api.Board`` behind a serial port.

    One thread (``kf-board``) reads; commands may come from any thread and go one at a time. After BoardLost because of
    a vanished port every command raises DeviceGone: close it and open a new one. After BoardLost because of silence the
    board may come back by itself; its reports then continue.
    """

    def __init__(self, spec: BoardSpec, clock: Clock) -> None:
        """Open the port, start the reader and identify the board. Raises DeviceGone, DeviceRefused."""
        self._name = spec.name
        self._clock = clock
        self._events = EventQueue(clock)
        self._splitter = LineSplitter()
        self._command_lock = threading.Lock()
        self._state = threading.Condition()
        self._exchange: _Exchange | None = None
        self._lost: str | None = None
        self._latest: Telemetry | None = None
        self._next_report: int | None = None
        self._damaged_lines = 0
        self._lost_reports = 0
        self._late_answers = 0
        self._retries = 0
        self._closing = threading.Event()
        self._url = spec.url
        self._port = _open_port(spec)
        # Not 0: the board repeats its answer to a number that it has just seen, perhaps from an earlier program.
        self._sequence = (clock.now_ns() // 1_000_000) % SEQUENCE_MODULUS
        self._thread = threading.Thread(target=self._read_forever, name=THREAD_NAME, daemon=True)
        self._thread.start()
        try:
            self._info = self._ask_info()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(cls, spec: BoardSpec, clock: Clock) -> Self:
        """Open the board like the constructor."""
        return cls(spec, clock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the reader and close the port; idempotent.

        Lasers and triggers stay as they are: stop them first.
        """
        self._closing.set()
        if self._thread is not threading.current_thread():
            self._thread.join(_JOIN_TIMEOUT_S)
        with contextlib.suppress(OSError, serial.SerialException):
            self._port.close()

    @property
    def info(self) -> BoardInfo:
        """Identity of the board when it was opened."""
        return self._info

    @property
    def latest(self) -> Telemetry | None:
        """The latest heartbeat, read or not; ``None`` before the first and while the board is silent."""
        with self._state:
            return self._latest

    @property
    def counters(self) -> BoardCounters:
        """Errors on the line so far."""
        with self._state:
            return BoardCounters(
                damaged_lines=self._damaged_lines + self._splitter.broken_lines,
                garbage_bytes=self._splitter.garbage_bytes,
                lost_reports=self._lost_reports,
                late_answers=self._late_answers,
                retries=self._retries,
                dropped_events=self._events.dropped,
            )

    # ----------------------------------------------------------------------------------------------- commands

    def vsync(self) -> Vsync:
        """Return the latest vertical sync, bracketed by host time. Raises BoardRefused (NO_VSYNC), DeviceGone.

        After a retry the bracket begins with the first attempt: the board repeats an answer as it was, with the times
        of its first execution.
        """
        answer, sent_ns, received_ns = self._ask("VSYNC")
        count, time_us, now_us = self._fields(answer, 3)
        try:
            return Vsync(
                count=parse_uint(count, MAX_COUNT),
                board_time_us=parse_uint(time_us, MAX_TIME_US),
                board_now_us=parse_uint(now_us, MAX_TIME_US),
                host_sent_ns=sent_ns,
                host_received_ns=received_ns,
            )
        except MalformedLine as error:
            raise self._nonsense("VSYNC", error) from error

    def read_clock(self) -> BoardTime:
        """Return the board's clock, bracketed by host time; it needs no vertical sync.

        Raises DeviceGone, DeviceRefused.
        """
        answer, sent_ns, received_ns = self._ask("PING")
        (time_us,) = self._fields(answer, 1)
        try:
            return BoardTime(parse_uint(time_us, MAX_TIME_US), sent_ns, received_ns)
        except MalformedLine as error:
            raise self._nonsense("PING", error) from error

    def arm(self, pulses: int, at_vsync: int, delay_us: int, width_us: int) -> None:
        """Fire ``pulses`` (1..64), one per vertical sync from number ``at_vsync`` on.

        Each is ``delay_us`` (0..15000) after its sync and ``width_us`` (50..16000) wide. Raises BoardRefused (busy,
        past, out of range), DeviceGone.
        """
        self._command_echoed("ARM", pulses, at_vsync, delay_us, width_us)

    def live(self, every: int, delay_us: int, width_us: int) -> None:
        """Fire on every ``every``-th (1..60) vertical sync until ``stop`` or ``arm``. Raises as ``arm``."""
        self._command_echoed("LIVE", every, delay_us, width_us)

    def stop(self) -> None:
        """Fire no more pulses. Raises DeviceGone."""
        self._ask("STOP")

    def set_lasers(self, left_on: bool, right_on: bool) -> LaserState:
        """Switch both lasers; returns the read-back of their currents, which may differ. Raises DeviceGone."""
        answer, _, _ = self._ask("LASER", str(int(left_on)), str(int(right_on)))
        try:
            return parse_lasers(answer)
        except MalformedLine as error:
            raise self._nonsense("LASER", error) from error

    def next_event(self, timeout_s: float) -> BoardEvent | None:
        """Return the oldest unread report; ``None`` after the timeout. Overflow: see ``EventQueue``."""
        return self._events.get(timeout_s)

    def health(self) -> Health:
        """Return the board's entry in ``kingfisher check``. A silent board is reported, not raised."""
        info, counters, latest = self._info, self.counters, self.latest
        details = {
            "firmware": info.firmware,
            "serial": info.serial,
            "sensors": " ".join(sorted(info.capabilities)) or "none",
            "damaged lines": str(counters.damaged_lines),
            "lost reports": str(counters.lost_reports),
        }
        if latest is not None and latest.temperature_board_c is not None:
            details["board temperature"] = f"{latest.temperature_board_c:.1f} °C"
        try:
            vsync = self.vsync()
        except BoardRefused as error:
            if error.code != Refusal.NO_VSYNC:
                return Health(self._name, False, error.message, details)
            details["vertical sync"] = "none"
        except DeviceError as error:
            return Health(self._name, False, error.message, details)
        else:
            details["vertical sync"] = str(vsync.count)
        return Health(self._name, True, "trigger board", details)

    def _command_echoed(self, verb: str, *values: int) -> None:
        fields = tuple(str(value) for value in values)
        answer, _, _ = self._ask(verb, *fields)
        if answer.fields != fields:
            raise DeviceRefused(
                self._name,
                f"{verb} {','.join(fields)} was answered with {','.join(answer.fields)}",
                "Update the board's firmware",
            )

    def _ask_info(self) -> BoardInfo:
        answer, _, _ = self._ask("INFO")
        try:
            return parse_info(answer)
        except MalformedLine as error:
            raise self._nonsense("INFO", error) from error

    def _fields(self, answer: Sentence, count: int) -> tuple[str, ...]:
        if len(answer.fields) < count:
            raise self._nonsense(answer.verb, MalformedLine(f"{len(answer.fields)} fields, expected {count}"))
        return answer.fields[:count]

    def _ask(self, verb: str, *fields: str) -> tuple[Sentence, int, int]:
        """Return the answer, and the host times before the first sending of its number and after its arrival."""
        with self._command_lock:
            sequence = self._advance()
            sent_ns = self._clock.now_ns()
            for attempt in range(ATTEMPTS):
                exchange = _Exchange(sequence, verb)
                with self._state:
                    self._retries += attempt > 0
                    self._exchange = exchange
                self._send(format_line(Sentence(Kind.COMMAND, sequence, verb, fields)))
                answer = self._await(exchange)
                received_ns = self._clock.now_ns()
                if answer is not None:
                    self._raise_refusal(answer)
                    return answer, sent_ns, received_ns
                if exchange.mistaken:
                    # The board took the number for an earlier command's and did not execute it: use another number.
                    sequence = self._advance()
                    sent_ns = self._clock.now_ns()
        silent = f"no answer to {verb} in {ATTEMPTS} attempts of {ANSWER_TIMEOUT_S * 1000:.0f} ms"
        if other_readers := self._other_readers():
            raise DeviceGone(self._name, f"{silent}{other_readers}", "Stop that program: it reads the board's answers")
        raise DeviceGone(
            self._name,
            silent,
            "Check the board's cable, and that no other program reads its port; it is opened again by itself",
        )

    def _other_readers(self) -> str:
        """Return the addition to a message about silence: other programs that have the port open."""
        programs = " and ".join(other_users(self._url))
        return programs and f"; {programs} has {self._url} open, too"

    def _advance(self) -> int:
        self._sequence = (self._sequence + 1) % SEQUENCE_MODULUS
        return self._sequence

    def _send(self, line: bytes) -> None:
        self._raise_if_lost()
        try:
            self._port.write(line)
        except serial.SerialTimeoutException as error:
            raise DeviceGone(self._name, "does not take commands", "Re-plug the board") from error
        except (OSError, serial.SerialException) as error:
            self._lose(f"port failed ({error})")
            self._raise_if_lost()

    def _await(self, exchange: _Exchange) -> Sentence | None:
        def settled() -> bool:
            return exchange.answer is not None or exchange.mistaken or self._lost is not None

        with self._state:
            self._clock.wait_for(self._state, settled, ANSWER_TIMEOUT_S)
            self._exchange = None
        if exchange.answer is None:
            self._raise_if_lost()
        return exchange.answer

    def _raise_refusal(self, answer: Sentence) -> None:
        if answer.kind is not Kind.REFUSAL:
            return
        try:
            code, text = parse_refusal(answer)
        except MalformedLine as error:
            raise self._nonsense(answer.verb, error) from error
        remedy = _REMEDY[Refusal(code)] if code in set(Refusal) else "Update this software or the board's firmware"
        raise BoardRefused(self._name, f"refused {answer.verb}: {text or 'no reason'} (code {code})", remedy, code)

    def _raise_if_lost(self) -> None:
        reason = self._lost
        if reason is not None:
            raise DeviceGone(self._name, reason, "Check the board's cable; it is opened again by itself")

    def _nonsense(self, verb: str, error: MalformedLine) -> DeviceRefused:
        return DeviceRefused(self._name, f"sent an invalid answer to {verb} ({error})", "Update the board's firmware")

    # ------------------------------------------------------------------------------------------------- reader

    def _read_forever(self) -> None:
        heard_ns = self._clock.now_ns()
        silent = False
        while not self._closing.is_set():
            read_start_ns = self._clock.now_ns()
            try:
                data = self._port.read(min(_READ_SIZE, max(1, self._port.in_waiting)))
            except (OSError, TypeError, serial.SerialException) as error:
                # TypeError: pyserial reads from a descriptor that a concurrent close() has set to None.
                if not self._closing.is_set():
                    self._lose(f"port vanished ({error})")
                return
            now_ns = self._clock.now_ns()
            for line in self._splitter.feed(data):
                if self._take(line, now_ns):
                    heard_ns = now_ns
                    silent = False
            # An empty read proves silence until its start: afterwards this thread may have had to wait.
            if not silent and read_start_ns - heard_ns > SILENCE_S * 1e9:
                silent = True
                with self._state:
                    self._latest = None
                self._events.put(BoardLost(f"no heartbeat for {SILENCE_S} s{self._other_readers()}"))

    def _take(self, line: bytes, now_ns: int) -> bool:
        """Deliver one line; return True when it proves that the board is alive (heartbeat or boot banner)."""
        try:
            sentence = parse_line(line)
            if sentence.kind is Kind.REPORT:
                return self._take_report(sentence, now_ns)
        except MalformedLine:
            with self._state:
                self._damaged_lines += 1
            return False
        if sentence.kind is not Kind.COMMAND:
            self._take_answer(sentence)
        return False

    def _take_report(self, sentence: Sentence, now_ns: int) -> bool:
        event = parse_report(sentence, now_ns)
        with self._state:
            if isinstance(event, BoardBooted):
                self._next_report = None  # numbering starts anew
                self._latest = None
            elif isinstance(event, Telemetry):
                self._latest = event
            if self._next_report is not None:
                self._lost_reports += (sentence.sequence - self._next_report) % SEQUENCE_MODULUS
            self._next_report = (sentence.sequence + 1) % SEQUENCE_MODULUS
        if event is not None:
            self._events.put(event)
        return isinstance(event, Telemetry | BoardBooted)

    def _take_answer(self, sentence: Sentence) -> None:
        with self._state:
            exchange = self._exchange
            if exchange is None or exchange.sequence != sentence.sequence or exchange.answer is not None:
                self._late_answers += 1
            elif exchange.verb != sentence.verb:
                exchange.mistaken = True
                self._state.notify_all()
            else:
                exchange.answer = sentence
                self._state.notify_all()

    def _lose(self, reason: str) -> None:
        with self._state:
            if self._lost is not None:
                return
            self._lost = reason
            self._latest = None
            self._state.notify_all()
        self._events.put(BoardLost(reason))


def _open_port(spec: BoardSpec) -> Any:
    try:
        return serial.serial_for_url(
            spec.url, baudrate=_BAUD, timeout=_READ_TIMEOUT_S, write_timeout=_WRITE_TIMEOUT_S, exclusive=True
        )
    except PermissionError as error:
        raise DeviceRefused(spec.name, f"no permission to open {spec.url}", "Install the udev rules") from error
    except (OSError, ValueError, serial.SerialException) as error:
        raise _not_opened(spec, error) from error


def _not_opened(spec: BoardSpec, error: Exception) -> DeviceError:
    number = getattr(error, "errno", None)
    if number in (13, 1):
        return DeviceRefused(spec.name, f"no permission to open {spec.url}", "Install the udev rules")
    if number in (11, 16) or "exclusively lock" in str(error):
        return DeviceRefused(spec.name, f"another program uses {spec.url}", "Stop it, then try again")
    if isinstance(error, ValueError):
        return DeviceRefused(spec.name, f"{spec.url} is no port ({error})", "Correct url of [board] in the rig file")
    if number == 2:
        return DeviceGone(
            spec.name,
            f"{spec.url} cannot be opened: it is not there",
            "Plug the board in, or correct url of [board] in the rig file",
        )
    return DeviceGone(spec.name, f"{spec.url} cannot be opened ({error})", "Check the board's cable")
