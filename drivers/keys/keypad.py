"""The HID device of the keypad: finding it, reading its reports, and noticing its loss."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from drivers.api import Clock, DeviceGone, DeviceRefused, Health, KeyEvent, KeysLost
from drivers.keys.debounce import Debouncer
from drivers.keys.report import REPORT_SIZE, KeyReport, MalformedReport, parse_report

SILENCE_S = 1.0
"""Four missing reports."""
FIRST_REPORT_TIMEOUT_S = 1.0
_WAITED_NS = 2_000_000
"""Duration of a read above which no report was queued before it: its report is new."""
_USAGE_PAGE = 0xFF4B
_WRAP_MS = 1 << 16
"""The pad counts milliseconds in 16 bits (docs/protocols/keys.md)."""
_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class KeysSpec:
    """The keypad of the rig, by USB identity."""

    vendor_id: int
    product_id: int
    name: str = "keys"


class PadTime:
    """Dates reports so that a late host does not change the duration of a key press.

    A report for which the read had to wait is dated to its arrival. One that was queued already is dated by the pad's
    own clock from the report before it, never after its arrival and never before its predecessor.
    """

    def __init__(self) -> None:
        self._last_ms: int | None = None
        self._last_ns = 0

    def date(self, pad_time_ms: int, arrival_ns: int, waited_for: bool) -> int:
        """Return the host time in ns at which the report was made."""
        time_ns = arrival_ns
        if not waited_for and self._last_ms is not None:
            # Modulo the counter's range: reports come far more often than it wraps.
            elapsed_ns = (pad_time_ms - self._last_ms) % _WRAP_MS * _MS
            time_ns = min(arrival_ns, self._last_ns + elapsed_ns)
        self._last_ms = pad_time_ms
        # Never before its predecessor: the debouncer takes times in order for granted.
        self._last_ns = max(time_ns, self._last_ns)
        return self._last_ns


@dataclass(slots=True)
class KeypadCounters:
    """Counts of reports since the pad was opened."""

    reports: int = 0
    garbage_reports: int = 0
    """Reports of another length, number or checksum."""
    lost_reports: int = 0
    """Missing in the pad's own numbering."""


class HidKeypad:
    """A ``drivers.api.Keys`` behind hidapi; for one thread.

    KeysLost comes once. After a silent loss the pad may come back by itself; after a failed read (unplugged) every
    further call raises DeviceGone: close it and open a new one.
    """

    def __init__(self, spec: KeysSpec, hidraw: Any, clock: Clock) -> None:
        """Open the pad and wait for its first report. Raises DeviceGone, DeviceRefused (no permission).

        Keys that are down by then are masked until they are released: a key held while the pad is plugged in again
        starts no scan.
        """
        self._name = spec.name
        self._clock = clock
        self._debouncer = Debouncer()
        self._pad_time = PadTime()
        self._events: deque[KeyEvent] = deque()  # at most a few per report, emptied before the next read
        self._counter: int | None = None
        self._firmware: int | None = None
        self._failure: str | None = None
        self._silent = False
        self.counters = KeypadCounters()
        self._device: Any = _open_device(spec, hidraw)
        self._heard_ns = clock.now_ns()
        try:
            self._await_first_report()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(cls, spec: KeysSpec, hidraw: Any, clock: Clock) -> Self:
        """Open the pad like the constructor.

        ``hidraw`` is hidapi's module of that name or an object of its shape.
        """
        return cls(spec, hidraw, clock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the device; idempotent."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def next_event(self, timeout_s: float) -> KeyEvent | None:
        """Return the next event, or ``None`` after the timeout. Raises DeviceGone after the pad was unplugged."""
        if self._events:
            return self._events.popleft()
        if self._failure is not None or self._device is None:
            raise DeviceGone(self._name, self._failure or "closed", "Check the key pad's cable")
        deadline_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        now_ns = self._clock.now_ns()
        while True:
            # At least one read per call, and time counts only when no report is queued: one that waited for a late
            # host must not turn a short press into a long one, or a busy second into a lost pad.
            if not self._read_one(self._next_look_s(now_ns, deadline_ns)):
                self._look_at_time(asked_ns=now_ns, now_ns=self._clock.now_ns())
            if self._events:
                return self._events.popleft()
            now_ns = self._clock.now_ns()
            if now_ns >= deadline_ns:
                return None

    def health(self) -> Health:
        """Return the keypad's entry in ``kingfisher check``."""
        counters = self.counters
        details = {
            "firmware": "unknown" if self._firmware is None else str(self._firmware),
            "reports": str(counters.reports),
            "garbage reports": str(counters.garbage_reports),
            "lost reports": str(counters.lost_reports),
        }
        if self._failure is not None:
            return Health(self._name, False, self._failure, details)
        if self._silent:
            return Health(self._name, False, f"no report for {SILENCE_S} s", details)
        return Health(self._name, True, f"firmware {details['firmware']}", details)

    def _await_first_report(self) -> None:
        deadline_ns = self._clock.now_ns() + round(FIRST_REPORT_TIMEOUT_S * 1e9)
        while self._counter is None and self._failure is None:
            remaining_s = (deadline_ns - self._clock.now_ns()) * 1e-9
            if remaining_s <= 0:
                self._failure = f"sends no valid report within {FIRST_REPORT_TIMEOUT_S} s"
                break
            self._read_one(remaining_s)
        if self._failure is not None:
            raise DeviceGone(self._name, self._failure, "Re-plug the key pad")

    def _next_look_s(self, now_ns: int, deadline_ns: int) -> float:
        """Return how long a read may block: until the caller's, the debouncer's or the silence's time."""
        times = [deadline_ns]
        due_ns = self._debouncer.due_ns()
        if due_ns is not None:
            times.append(due_ns)
        if not self._silent:
            times.append(self._heard_ns + round(SILENCE_S * 1e9))
        return max(0.0, (min(times) - now_ns) * 1e-9)

    def _look_at_time(self, asked_ns: int, now_ns: int) -> None:
        """Handle a read that began at ``asked_ns`` and found no report.

        It proves silence until ``asked_ns``, not until now: if this thread had to wait afterwards, reports may have
        come.
        """
        if self._silent:
            return
        if asked_ns - self._heard_ns > SILENCE_S * 1e9:
            self._silent = True
            # The state of the keys is unknown now: drop it, so that a key held meanwhile neither presses nor sticks.
            self._debouncer = Debouncer()
            self._pad_time = PadTime()
            self._counter = None
            self._events.append(KeysLost(f"no report for {SILENCE_S} s"))
        else:
            self._events.extend(self._debouncer.advance(now_ns))

    def _read_one(self, timeout_s: float) -> bool:
        """Read and process at most one report; return True if there was one.

        Garbage counts as silence, which it could otherwise hide.
        """
        # A timeout of 0 means "for ever" to some versions of hidapi.
        timeout_ms = max(1, -(-round(timeout_s * 1e6) // 1000))
        before_ns = self._clock.now_ns()
        try:
            data = bytes(self._device.read(REPORT_SIZE, timeout_ms))
        except (OSError, ValueError) as error:
            self._failure = f"unplugged ({error})"
            self._events.append(KeysLost(self._failure))
            return True
        if not data:
            return False
        now_ns = self._clock.now_ns()
        self.counters.reports += 1
        try:
            report = parse_report(data)
        except MalformedReport:
            self.counters.garbage_reports += 1
            return False
        self._digest(report, now_ns, waited_for=now_ns - before_ns > _WAITED_NS)
        return True

    def _digest(self, report: KeyReport, now_ns: int, waited_for: bool) -> None:
        if self._counter is not None:
            self.counters.lost_reports += (report.counter - self._counter - 1) % 256
        self._counter = report.counter
        self._firmware = report.firmware
        self._heard_ns = now_ns
        self._silent = False
        time_ns = self._pad_time.date(report.pad_time_ms, now_ns, waited_for)
        self._events.extend(self._debouncer.contacts(time_ns, report.pressed, report.faulty))


def _open_device(spec: KeysSpec, hidraw: Any) -> Any:
    entries = [
        entry
        for entry in hidraw.enumerate(spec.vendor_id, spec.product_id)
        # Kernels and libraries that do not know the usage page say 0.
        if entry.get("usage_page", 0) in (0, _USAGE_PAGE)
    ]
    if not entries:
        raise DeviceGone(
            spec.name, f"no key pad {spec.vendor_id:04x}:{spec.product_id:04x}", "Check the key pad's cable"
        )
    device = hidraw.device()
    path = entries[0]["path"]
    try:
        device.open_path(path)
    except OSError as error:
        # hidapi reports only "open failed"; the device exists, so the cause is permission or another program.
        raise DeviceRefused(
            spec.name, f"{path!r} cannot be opened ({error})", "Install the udev rules, or stop the other program"
        ) from error
    return device
