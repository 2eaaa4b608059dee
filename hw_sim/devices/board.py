"""The trigger board: it counts vsyncs, fires the cameras' trigger lines, switches lasers, reads sensors.

Bytes in by ``receive``, bytes out by ``take``; see ``docs/protocols/board.md``. All calls with the world's lock held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hw_sim.clocks import Clocks, Wander
from hw_sim.devices.board_line import Command, CommandReader, line
from hw_sim.faults import FaultBook
from hw_sim.timing.world_time import BLANK_NS, WorldTime

FIRMWARE = "1.4.2"
SERIAL = "KF-BRD-0001"
SENSORS = ("TPROJ", "TCASE", "TBOARD", "LEAK", "HUM", "SUPPLY")
HEARTBEAT_US = 500_000
SLOW_ANSWER_NS = 500_000_000
SYNC_LOST_PERIODS = 3
OUTPUT_BYTES = 65_536
"""Capacity of the host's serial buffer; lines that do not fit are lost completely."""

BAD_VERB, BAD_ARGUMENT, BUSY, NO_SYNC, PAST = 1, 2, 3, 4, 5
REFUSALS = {
    BAD_VERB: "unknown verb",
    BAD_ARGUMENT: "argument out of range",
    BUSY: "busy",
    NO_SYNC: "no vertical sync",
    PAST: "at_vsync is past",
}


@dataclass(frozen=True, slots=True)
class Shot:
    """The number of a pulse and of its sequence, for faults that name a frame."""

    series: int
    """Number of the ARM, from 1; 0 for live pulses."""
    index: int
    count: int | None
    """Pulses of the ARM; ``None`` for live pulses."""

    @property
    def frame(self) -> int | None:
        """Index in the armed sequence; ``None`` for live pulses."""
        return self.index if self.count is not None else None


@dataclass(frozen=True, slots=True)
class _Job:
    """A series of pulses that the board has to fire."""

    start: int
    every: int
    delay_us: int
    width_us: int
    pulses: int | None
    series: int


class _RequestError(Exception):
    def __init__(self, code: int) -> None:
        self.code = code


class Board:
    """The board's firmware.

    ``fire(time_ns, width_ns, shot)`` pulls both trigger lines; ``sensor(name)`` reads a sensor.
    """

    def __init__(
        self,
        time: WorldTime,
        faults: FaultBook,
        fire: Callable[[int, int, Shot], None],
        sensor: Callable[[str], str],
        seed: int,
        *,
        period_ns: int = BLANK_NS,
        clocks: Clocks | None = None,
    ) -> None:
        """``period_ns``: the firmware's value for the projector's vsync period. ``clocks``: errors of pulses and clock
        beyond a constant; ``None``: no errors."""
        self._sync_lost_ns = SYNC_LOST_PERIODS * period_ns
        self._glitch_ns = period_ns // 2
        self._time, self._faults, self._fire, self._sensor = time, faults, fire, sensor
        self._rng = np.random.default_rng([seed, 0xB0A2D])
        self._ppm = float(self._rng.uniform(-45.0, 45.0))
        self._jitter_ns = 0.0 if clocks is None else 1000.0 * clocks.board_jitter_us
        self._jitter = np.random.default_rng([seed, 0xB0A2D, 1])
        self._wander = None if clocks is None else Wander(clocks, (seed, 0xB0A2D, 2))
        self.series = 0
        self.open = False
        """True while a host has the port open; what is sent while it is closed is lost."""
        self._out = bytearray()
        self._life = 0
        """Counts resets, so that what was planned before one does not happen after it."""
        self._powered = True
        self._reset_ns = 0
        self._count = 0
        self._synced_ns: int | None = None
        self._job: _Job | None = None
        self._lasers = (False, False)
        self._reports = 0
        self._beats = 0
        self._reader = CommandReader()
        self._answered: tuple[Command, bytes] | None = None
        self._boot("POWER", time.blank_ns)

    # ------------------------------------------------------------------------------------------ what others see

    @property
    def armed(self) -> int | None:
        """Number of the ARM that has pulses left."""
        return self._job.series if self._job is not None and self._job.pulses is not None else None

    @property
    def lasers_on(self) -> tuple[bool, bool]:
        """The lasers (left, right) that really shine."""
        left, right = (
            conducts or self._faults.active(f"laser.{side}", "wrong") is not None
            for side, conducts in zip(("left", "right"), self._conducting, strict=True)
        )
        return left, right

    @property
    def _conducting(self) -> tuple[bool, bool]:
        """The lasers (left, right) through which the drivers' current sense measures a current."""
        left, right = (
            self._faults.active(f"laser.{side}", "stuck") is not None
            or (switched_on and self._powered and self._faults.active(f"laser.{side}", "off") is None)
            for side, switched_on in zip(("left", "right"), self._lasers, strict=True)
        )
        return left, right

    def upcoming_frame(self) -> int | None:
        """Index of the pulse at the next vsync, if it is one of an ARM."""
        return self._frame_at(self._count + 1)

    # ------------------------------------------------------------------------------------------ vertical sync

    def vsync(self, time_ns: int) -> None:
        """Count a vsync of the projector's video input, and fire the pulse that is due."""
        if not self._powered:
            return
        self._count = (self._count + 1) & 0xFFFFFFFF
        self._synced_ns = time_ns
        job = self._job
        if job is None:
            return
        # A glitch on the sync line half a period before its frame's vsync: the board cannot distinguish it.
        if self._faults.strike("board", "wrong", "glitch", self._frame_at(self._count + 1)):
            self._at(time_ns + self._glitch_ns, self.vsync)
        # The counter has 32 bits and wraps: a difference in its upper half is negative, the start is still to come.
        since = (self._count - job.start) & 0xFFFFFFFF
        if since & 0x80000000 or since % job.every:
            return
        index = since // job.every
        frame = self._frame_at(self._count)
        if frame is not None and self._faults.strike("board", "wrong", "reset", frame):
            self._boot("WATCHDOG", time_ns)
        if self._job is job:  # the fault may have reset the board
            late = self._faults.strike("board", "delayed", frame=frame)
            late_ns = 0 if late is None else int(late.amount * 1e6)
            # An edge deviates from the timer by its jitter, but never precedes the vsync that causes it.
            if self._jitter_ns:
                late_ns += max(round(self._jitter_ns * self._jitter.standard_normal()), -job.delay_us * 1000)
            self._at(time_ns + job.delay_us * 1000 + late_ns, lambda t: self._pulse(job, index, t))

    def no_vsync(self, time_ns: int) -> None:
        """Note that the projector's video input has no signal at this blank."""
        if self._job is not None and not self._synced(time_ns):
            self._job = None
            self._report("NOSYNC")

    def _synced(self, time_ns: int) -> bool:
        return self._synced_ns is not None and time_ns - self._synced_ns < self._sync_lost_ns

    def _frame_at(self, count: int) -> int | None:
        job = self._job
        if job is None or job.pulses is None:
            return None
        index = (count - job.start) & 0xFFFFFFFF
        return index if index < job.pulses else None

    def _pulse(self, job: _Job, index: int, time_ns: int) -> None:
        if self._job is not job:
            return
        shot = Shot(job.series, index, job.pulses)
        if self._faults.strike("board", "intermittent", frame=shot.frame) is None:
            if job.pulses is not None:
                miscounted = int(self._faults.strike("board", "wrong", "vsync", shot.frame) is not None)
                self._report("PULSE", index, (job.start + index + miscounted) & 0xFFFFFFFF, self._us(time_ns))
            self._fire(time_ns, job.width_us * 1000, shot)
        if job.pulses is not None and index == job.pulses - 1:
            self._job = None
            self._report("DONE", job.pulses)

    # ------------------------------------------------------------------------------------------ power and resets

    def refresh(self, time_ns: int) -> None:
        """Check the faults again: one may have begun or ended."""
        powered = self._faults.active("board", "off") is None
        if powered and not self._powered:
            self._powered = True
            self._boot("POWER", time_ns)
        elif not powered and self._powered:
            self._powered = False
            self._job = None
            self._life += 1
        elif powered and self._faults.strike("board", "wrong", "reset"):
            self._boot("WATCHDOG", time_ns)

    def _boot(self, cause: str, time_ns: int) -> None:
        self._life += 1
        self._reset_ns = time_ns
        self._count = 0
        self._synced_ns = None
        self._job = None
        self._lasers = (False, False)
        self._reports = 0
        self._beats = 0
        self._reader = CommandReader()
        self._answered = None
        self._report("BOOT", FIRMWARE, SERIAL, cause)
        self._schedule_heartbeat()

    def _us(self, time_ns: int) -> int:
        passed_ns = int((time_ns - self._reset_ns) * (1.0 + self._ppm * 1e-6))
        if self._wander is not None:
            passed_ns += self._wander.ahead_ns(time_ns) - self._wander.ahead_ns(self._reset_ns)
        return max(passed_ns, 0) // 1000

    def _at(self, time_ns: int, action: Callable[[int], None]) -> None:
        """Put ``action`` on the world's agenda; a reset of the board cancels it."""
        life = self._life

        def alive(t: int) -> None:
            if self._life == life and self._powered:
                action(t)

        self._time.at(time_ns, alive)

    def _schedule_heartbeat(self) -> None:
        self._beats += 1
        # The board's crystal is off by _ppm, so that its half seconds differ from the world's.
        self._at(self._reset_ns + int(self._beats * HEARTBEAT_US * 1000 / (1.0 + self._ppm * 1e-6)), self._heartbeat)

    def _heartbeat(self, time_ns: int) -> None:
        left, right = self._conducting
        self._report("HB", self._us(time_ns), self._count, int(left), int(right), *self._sensors())
        self._schedule_heartbeat()

    def _sensors(self) -> list[str]:
        return [f"{name}={self._sensor(name)}" for name in SENSORS]

    # ------------------------------------------------------------------------------------------ commands

    def receive(self, data: bytes) -> None:
        """Execute the commands in bytes from the host."""
        if not self._powered:
            return
        for command in self._reader.feed(data):
            # A host that lost an answer repeats the number: it gets the answer again, without another execution.
            if self._answered is not None and self._answered[0] == command:
                answer = self._answered[1]
            else:
                answer = self._execute(command)
                self._answered = (command, answer)
            if self._faults.active("board", "slow"):
                self._at(self._time.now_ns() + SLOW_ANSWER_NS, lambda _, late=answer: self._send(late))  # type: ignore[misc]
            else:
                self._send(answer)

    def _execute(self, command: Command) -> bytes:
        verb = command.verb
        try:
            fields = self._obey(verb, command.arguments)
        except _RequestError as error:
            return line("N", command.number, verb[:16], error.code, REFUSALS[error.code])
        return line("A", command.number, verb, *fields)

    def _obey(self, verb: str, arguments: tuple[str, ...]) -> list[object]:
        now_ns = self._time.now_ns()
        match verb:
            case "PING":
                _numbers(arguments)
                return [self._us(now_ns)]
            case "INFO":
                _numbers(arguments)
                return [FIRMWARE, SERIAL, "+".join(SENSORS)]
            case "VSYNC":
                _numbers(arguments)
                if self._synced_ns is None or not self._synced(now_ns):
                    raise _RequestError(NO_SYNC)
                miscounted = int(self._faults.strike("board", "wrong", "query") is not None)
                return [(self._count + miscounted) & 0xFFFFFFFF, self._us(self._synced_ns), self._us(now_ns)]
            case "ARM":
                return self._arm(arguments, now_ns)
            case "LIVE":
                every, delay_us, width_us = _numbers(arguments, (1, 60), (0, 15_000), (50, 16_000))
                self._may_fire(now_ns)
                self._job = _Job((self._count + 1) & 0xFFFFFFFF, every, delay_us, width_us, None, 0)
                return [every, delay_us, width_us]
            case "STOP":
                _numbers(arguments)
                self._job = None
                return []
            case "LASER":
                left, right = _numbers(arguments, (0, 1), (0, 1))
                self._lasers = (bool(left), bool(right))
                return [int(on) for on in self._conducting]
            case "SENSE":
                _numbers(arguments)
                return list(self._sensors())
            case _:
                raise _RequestError(BAD_VERB)

    def _arm(self, arguments: tuple[str, ...], now_ns: int) -> list[object]:
        pulses, at_vsync, delay_us, width_us = _numbers(arguments, (1, 64), (0, 0xFFFFFFFF), (0, 15_000), (50, 16_000))
        self._may_fire(now_ns)
        ahead = (at_vsync - self._count) & 0xFFFFFFFF
        if ahead == 0 or ahead & 0x80000000:
            raise _RequestError(PAST)
        self.series += 1
        self._job = _Job(at_vsync, 1, delay_us, width_us, pulses, self.series)
        return [pulses, at_vsync, delay_us, width_us]

    def _may_fire(self, now_ns: int) -> None:
        if self.armed is not None:
            raise _RequestError(BUSY)
        if not self._synced(now_ns):
            raise _RequestError(NO_SYNC)

    # ------------------------------------------------------------------------------------------ towards the host

    def _report(self, *fields: object) -> None:
        self._send(line("R", self._reports, *fields))
        self._reports = (self._reports + 1) & 0xFFFF

    def _send(self, data: bytes) -> None:
        if self._faults.active("board", "garbage"):
            data = self._rng.integers(0, 256, int(self._rng.integers(1, 40)), np.uint8).tobytes() + data
        if self.open and len(self._out) + len(data) <= OUTPUT_BYTES:
            self._out += data
            self._time.condition.notify_all()

    @property
    def waiting(self) -> int:
        """Number of bytes that the host has not read."""
        return len(self._out)

    def take(self, size: int) -> bytes:
        """Return and remove up to ``size`` unread bytes."""
        data = bytes(self._out[:size])
        del self._out[:size]
        return data


def _numbers(arguments: tuple[str, ...], *ranges: tuple[int, int]) -> list[int]:
    if len(arguments) != len(ranges) or not all(a.isdecimal() and len(a) <= 10 for a in arguments):
        raise _RequestError(BAD_ARGUMENT)
    numbers = [int(a) for a in arguments]
    if not all(low <= n <= high for n, (low, high) in zip(numbers, ranges, strict=True)):
        raise _RequestError(BAD_ARGUMENT)
    return numbers
