"""The behaviour of the trigger board: verbs, refusals, reports, heartbeat, and the numbers of pulses.

It knows no pin: all electronics are behind ``hardware.BoardHardware``, and pulses are not timed here. Source:
``docs/protocols/board.md``.
"""

from drivers.board.firmware.hardware import BoardHardware
from drivers.board.firmware.line import Command, CommandFinder, decimal, sentence

FIRMWARE = "2.0.0"
HEARTBEAT_US = 500_000
MEASURE_EVERY_US = 40_000
"""Interval of measurements, one sensor at a time: none may delay an answer by more than its own few milliseconds."""
SYNC_LOST_US = 50_000
"""Three periods of 60 Hz."""
PERIOD_US = 16_667
SYNC_GUARD_US = 1500
"""Time before an expected sync in which no start is allowed: a start at the edge itself might count it or not."""
STARTS = 3
LONGEST_NAME = 16
"""Characters of an unknown verb that a refusal repeats."""

UNKNOWN, OUT_OF_RANGE, BUSY, NO_SYNC, PAST = 1, 2, 3, 4, 5
TEXTS = ("", "unknown verb", "argument out of range", "busy", "no vertical sync", "at_vsync is past")
COUNT = (0, 0xFFFFFFFF)
DELAY_US = (0, 15_000)
WIDTH_US = (50, 16_000)


class Refused(Exception):
    """Exception of a command that is refused; ``code`` is that of the protocol."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Series:
    """Requested pulses: ``pulses`` of them from sync ``start`` on, or without end (``None``)."""

    def __init__(self, pulses: int | None, start: int, width_us: int) -> None:
        self.pulses = pulses
        self.start = start
        self.width_us = width_us
        self.fired = 0
        self.ends_us = 0


class BoardCore:
    """The board's logic: call ``step`` as often as possible, at least every 20 ms."""

    def __init__(self, hardware: BoardHardware, serial: str, cause: str) -> None:
        """Begin after a reset by ``cause`` (``POWER WATCHDOG BROWNOUT HOST``).

        Lasers are off, no pulses are armed, and BOOT is reported.
        """
        self._hardware = hardware
        self._serial = serial
        self._finder = CommandFinder()
        self._answered: Command | None = None
        self._answer = b""
        self._reports = 0
        self._count = 0
        self._synced_us: int | None = None
        self._period_us = PERIOD_US
        self._series: Series | None = None
        hardware.stop()
        hardware.set_lasers(False, False)
        self._names = hardware.fitted()
        self._values = [hardware.measure(name) for name in self._names]
        self._turn = 0
        now_us = hardware.now_us()
        self._measure_us = now_us + MEASURE_EVERY_US
        self._beat_us = now_us + HEARTBEAT_US
        self._report("BOOT", [FIRMWARE, serial, cause])

    def step(self) -> None:
        """Handle all events since the last call, and send the reports. Needs about 1 ms on the chip."""
        self._hardware.feed()
        self._hardware.beat()
        self._look_at_syncs()
        self._look_at_pulses()
        self._look_at_time()
        for command in self._finder.feed(self._hardware.read()):
            # A host that lost an answer sends the command again: the answer is repeated, the command is not.
            if not command.same_as(self._answered):
                self._answer = self._obey(command)
                self._answered = command
            self._hardware.write(self._answer)

    # ------------------------------------------------------------------------------------------ events without a command

    def _look_at_syncs(self) -> bool:
        """Count the new syncs; return True if there were any."""
        came = False
        while True:
            time_us = self._hardware.next_sync()
            if time_us is None:
                return came
            if self._synced_us is not None and 5000 < time_us - self._synced_us < SYNC_LOST_US:
                self._period_us = time_us - self._synced_us
            self._count = self._count + 1 & 0xFFFFFFFF
            self._synced_us = time_us
            came = True

    def _look_at_pulses(self) -> None:
        while True:
            time_us = self._hardware.next_pulse()
            if time_us is None:
                return
            series = self._series
            if series is None or series.pulses is None or series.fired == series.pulses:
                continue
            number = series.start + series.fired & 0xFFFFFFFF
            self._report("PULSE", [str(series.fired), str(number), str(time_us)])
            series.fired += 1
            series.ends_us = time_us + series.width_us

    def _look_at_time(self) -> None:
        now_us = self._hardware.now_us()
        series = self._series
        if series is not None and series.fired == series.pulses and now_us >= series.ends_us:
            self._series = None
            self._report("DONE", [str(series.pulses)])
        # Lost stamps make the count wrong: the host must be told, as of lost syncs.
        lost = self._hardware.syncs_lost()
        if self._series is not None and (lost or not self._synced(now_us)):
            self._hardware.stop()
            self._series = None
            self._report("NOSYNC", [])
        if now_us >= self._measure_us:
            self._measure_us = now_us + MEASURE_EVERY_US
            self._measure_one()
        if now_us >= self._beat_us:
            # From the last heartbeat, not from now, so that delays do not add up.
            self._beat_us += HEARTBEAT_US
            self._report("HB", [str(now_us), str(self._count)] + self._lasers() + self._sensors())

    def _measure_one(self) -> None:
        if self._names:
            self._turn = (self._turn + 1) % len(self._names)
            self._values[self._turn] = self._hardware.measure(self._names[self._turn])

    def _synced(self, now_us: int) -> bool:
        return self._synced_us is not None and now_us - self._synced_us < SYNC_LOST_US

    def _lasers(self) -> list[str]:
        left, right = self._hardware.lasers()
        return [str(int(left)), str(int(right))]

    def _sensors(self) -> list[str]:
        return [name + "=" + value for name, value in zip(self._names, self._values)]

    def _report(self, verb: str, fields: list[str]) -> None:
        self._hardware.write(sentence("R", self._reports, [verb] + fields))
        self._reports = self._reports + 1 & 0xFFFF

    # ------------------------------------------------------------------------------------------ commands

    def _obey(self, command: Command) -> bytes:
        verb = command.verb
        try:
            fields = self._execute(verb, command.arguments)
        except Refused as refused:
            cut = verb[:LONGEST_NAME]
            return sentence("N", command.number, [cut, str(refused.code), TEXTS[refused.code]])
        return sentence("A", command.number, [verb] + fields)

    def _execute(self, verb: str, arguments: list[str]) -> list[str]:
        if verb == "ARM":
            return self._arm(arguments)
        if verb == "LIVE":
            return self._live(arguments)
        if verb == "LASER":
            left, right = numbers(arguments, ((0, 1), (0, 1)))
            self._hardware.set_lasers(left == 1, right == 1)
            return self._lasers()
        if verb not in ("PING", "INFO", "VSYNC", "STOP", "SENSE"):
            raise Refused(UNKNOWN)
        numbers(arguments, ())
        if verb == "PING":
            return [str(self._hardware.now_us())]
        if verb == "INFO":
            return [FIRMWARE, self._serial, "+".join(self._names)]
        if verb == "SENSE":
            return self._sensors()
        if verb == "STOP":
            self._hardware.stop()
            self._series = None
            return []
        return self._vsync()

    def _vsync(self) -> list[str]:
        self._look_at_syncs()
        now_us = self._hardware.now_us()
        if not self._synced(now_us):
            raise Refused(NO_SYNC)
        return [str(self._count), str(self._synced_us), str(now_us)]

    def _arm(self, arguments: list[str]) -> list[str]:
        pulses, start, delay_us, width_us = numbers(arguments, ((1, 64), COUNT, DELAY_US, WIDTH_US))
        self._may_fire()
        for _ in range(STARTS):
            self._keep_clear_of_the_sync()
            # The count wraps: a difference in the upper half of its range is negative.
            ahead = start - self._count & 0xFFFFFFFF
            if ahead == 0 or ahead & 0x80000000:
                break
            self._hardware.start(ahead - 1, 1, pulses, delay_us, width_us)
            if not self._look_at_syncs():
                self._forget_pulses()
                self._series = Series(pulses, start, width_us)
                return [str(pulses), str(start), str(delay_us), str(width_us)]
            # A sync came between counting and starting: it is unknown whether it was counted.
            self._hardware.stop()
            self._series = None
        raise Refused(PAST)

    def _live(self, arguments: list[str]) -> list[str]:
        every, delay_us, width_us = numbers(arguments, ((1, 60), DELAY_US, WIDTH_US))
        self._may_fire()
        self._hardware.start(0, every, None, delay_us, width_us)
        self._series = Series(None, 0, width_us)
        return [str(every), str(delay_us), str(width_us)]

    def _may_fire(self) -> None:
        self._look_at_syncs()
        if self._series is not None and self._series.pulses is not None:
            raise Refused(BUSY)
        if not self._synced(self._hardware.now_us()):
            raise Refused(NO_SYNC)

    def _keep_clear_of_the_sync(self) -> None:
        """Wait, if a sync is due within 1.5 ms, until it has come: less than 2 ms."""
        self._look_at_syncs()
        if self._synced_us is None:
            return
        due_us = self._synced_us + self._period_us - self._hardware.now_us()
        if -100 < due_us < SYNC_GUARD_US:
            self._hardware.wait_us(max(due_us, 0) + 200)
            self._look_at_syncs()

    def _forget_pulses(self) -> None:
        """Drop the unread stamps of an earlier series."""
        while self._hardware.next_pulse() is not None:
            pass


def numbers(arguments: list[str], ranges: tuple[tuple[int, int], ...]) -> list[int]:
    """Return the arguments as numbers, each within its range. Raises Refused."""
    if len(arguments) != len(ranges):
        raise Refused(OUT_OF_RANGE)
    values: list[int] = []
    for i in range(len(ranges)):
        value = decimal(arguments[i], ranges[i][1])
        if value is None or value < ranges[i][0]:
            raise Refused(OUT_OF_RANGE)
        values.append(value)
    return values
