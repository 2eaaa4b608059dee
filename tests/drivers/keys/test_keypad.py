"""The key pad's device over a hidapi-shaped object whose time is the test's."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import DeviceGone, DeviceRefused, Key, KeyEvent, KeyLongPress, KeyPress, KeyRelease, KeysLost, KeyStuck
from drivers.keys import HidKeypad, KeysSpec
from tests.drivers.clock import SteppedClock
from tests.support.damage import damaged

SPEC = KeysSpec(0x1209, 0x4B46)
SCAN, NONE = 0x01, 0x00


def report(mask: int, counter: int, time_ms: int, faulty: int = 0) -> bytes:
    body = bytes([1, mask, counter % 256, faulty, time_ms & 0xFF, time_ms >> 8 & 0xFF, 3])
    check = 0xA5
    for byte in body:
        check ^= byte
    return body + bytes([check])


class Pad:
    """Reports that become readable at their times (ms since the clock's beginning), as the kernel queues them."""

    def __init__(self, clock: SteppedClock) -> None:
        self._clock = clock
        self._begin_ns = clock.now_ns()
        self._queue: list[tuple[float, bytes | None]] = []
        self.present = True
        self.openable = True
        self.closed = False
        self.late_s = 0.0
        """How long the host's thread waits for the processor after a read that found nothing."""
        self.read_sizes: set[int] = set()
        self.reads = 0

    def queue(self, time_ms: float, data: bytes | None) -> None:
        self._queue.append((time_ms, data))

    def hold(self, mask: int, from_ms: int, to_ms: int, counter: int) -> int:
        """A report at once and every 250 ms."""
        for time_ms in range(from_ms, to_ms, 250):
            self.queue(time_ms, report(mask, counter, time_ms))
            counter += 1
        return counter

    def now_ms(self) -> float:
        return (self._clock.now_ns() - self._begin_ns) * 1e-6

    # ---- the shape of hidapi

    def enumerate(self, vendor: int, product: int) -> list[dict[str, Any]]:
        assert (vendor, product) == (0x1209, 0x4B46)
        return [{"path": b"/dev/hidraw0", "usage_page": 0xFF4B, "usage": 1}] if self.present else []

    def device(self) -> Pad:
        return self

    def open_path(self, path: bytes) -> None:
        if not self.openable:
            raise OSError("open failed")

    def read(self, size: int, timeout_ms: int) -> list[int]:
        found = self._read(size, timeout_ms)
        if not found:
            self._clock.advance_s(self.late_s)
        return found

    def _read(self, size: int, timeout_ms: int) -> list[int]:
        assert timeout_ms >= 1, "0 blocks for ever in some versions"
        self.reads += 1
        self.read_sizes.add(size)
        if self._queue and self._queue[0][0] <= self.now_ms() + timeout_ms:
            time_ms, data = self._queue.pop(0)
            self._clock.advance_s(max(0.0, time_ms - self.now_ms()) * 1e-3)
            if data is None:
                raise OSError("read error")
            return list(data)
        self._clock.advance_s(timeout_ms * 1e-3)
        return []

    def close(self) -> None:
        self.closed = True


class Bench:
    def __init__(self) -> None:
        self.clock = SteppedClock()
        self.pad = Pad(self.clock)
        self.pad.queue(0, report(NONE, 0, 0))

    def open(self) -> HidKeypad:
        return HidKeypad.open(SPEC, self.pad, self.clock)

    def at_ms(self, event: KeyEvent) -> float:
        assert isinstance(event, KeyPress | KeyLongPress | KeyRelease)
        return (event.time_ns - 1_000_000_000) * 1e-6

    def all_until(self, keys: HidKeypad, time_ms: float) -> list[KeyEvent]:
        said: list[KeyEvent] = []
        while self.pad.now_ms() < time_ms:
            event = keys.next_event(min(0.1, (time_ms - self.pad.now_ms()) * 1e-3))
            if event is not None:
                said.append(event)
        return said


def test_a_press_with_bounce_becomes_press_and_release_at_their_times() -> None:
    bench = Bench()
    for n, (time_ms, mask) in enumerate(((200, SCAN), (206, NONE), (215, SCAN), (400, NONE), (600, NONE)), start=1):
        bench.pad.queue(time_ms, report(mask, n, time_ms))
    with bench.open() as keys:
        said = bench.all_until(keys, 700)
    assert [type(event) for event in said] == [KeyPress, KeyRelease]
    assert [bench.at_ms(event) for event in said] == [215, 400]
    assert bench.pad.read_sizes == {8}
    assert bench.pad.closed


def test_a_press_is_told_30_ms_after_it_without_another_report() -> None:
    bench = Bench()
    bench.pad.queue(200, report(SCAN, 1, 200))
    with bench.open() as keys:
        assert isinstance(keys.next_event(0.9), KeyPress)
        assert bench.pad.now_ms() == pytest.approx(230, abs=2)


def test_a_long_press_is_told_while_the_key_is_held() -> None:
    bench = Bench()
    bench.pad.hold(SCAN, 100, 1200, 1)
    with bench.open() as keys:
        said = bench.all_until(keys, 1000)
    assert [type(event) for event in said] == [KeyPress, KeyLongPress]


def test_nothing_is_nothing_for_exactly_the_timeout() -> None:
    bench = Bench()
    with bench.open() as keys:
        begin_ms, bench.pad.reads = bench.pad.now_ms(), 0
        assert keys.next_event(0.1) is None
        assert bench.pad.now_ms() - begin_ms == pytest.approx(100, abs=2)
        assert bench.pad.reads == 1, "it sleeps meanwhile"
        assert keys.next_event(0.85) is None
        assert bench.pad.reads == 2
        assert keys.health().details["firmware"] == "3"


def test_a_pad_that_starts_anew_dates_its_reports_anew() -> None:
    """Its clock stood at 65.3 s; the first report after the silence lies unread, and says 10 ms."""
    bench = Bench()
    bench.pad.queue(200, report(NONE, 1, 65_300))
    bench.pad.queue(3000, report(NONE, 0, 10))
    bench.pad.queue(3200, report(SCAN, 1, 210))
    bench.pad.hold(SCAN, 3400, 4300, 2)
    with bench.open() as keys:
        assert bench.all_until(keys, 2000) == [KeysLost("no report for 1.0 s")]
        bench.clock.advance_s(1.3)
        said = bench.all_until(keys, 3800)
    assert [type(event) for event in said] == [KeyPress]
    assert bench.at_ms(said[0]) == pytest.approx(3300, abs=110), "not in the silence before"


def test_a_coil_that_is_faulty_when_the_pad_is_opened_is_told() -> None:
    bench = Bench()
    bench.pad._queue.clear()
    bench.pad.queue(0, report(NONE, 0, 0, faulty=SCAN))
    with bench.open() as keys:
        assert keys.next_event(0.1) == KeyStuck(Key.SCAN)


def test_whoever_waits_long_hears_of_a_lost_pad_after_a_second() -> None:
    bench = Bench()
    with bench.open() as keys:
        assert keys.next_event(5.0) == KeysLost("no report for 1.0 s")
        assert bench.pad.now_ms() == pytest.approx(1000, abs=60)


def test_a_mute_pad_is_given_up_after_a_second_of_waiting_not_of_polling() -> None:
    bench = Bench()
    bench.pad._queue.clear()
    begin_ms = bench.pad.now_ms()
    with pytest.raises(DeviceGone, match="no valid report"):
        bench.open()
    assert bench.pad.now_ms() - begin_ms == pytest.approx(1000, abs=3)
    assert bench.pad.reads <= 2


def test_a_host_that_reads_late_still_sees_a_short_press_as_short() -> None:
    """A press of 150 ms and a whole second of reports lie in the kernel's queue when the thread gets the processor."""
    bench = Bench()
    bench.pad.queue(100, report(SCAN, 1, 100))
    bench.pad.queue(250, report(NONE, 2, 250))
    bench.pad.hold(NONE, 500, 1300, 3)
    with bench.open() as keys:
        bench.clock.advance_s(1.1)
        said = bench.all_until(keys, 1400)
    assert [type(event) for event in said] == [KeyPress, KeyRelease]
    release = said[1]
    assert isinstance(release, KeyRelease)
    assert release.held_s == pytest.approx(0.15)


def test_garbage_is_ignored_and_counted() -> None:
    bench = Bench()
    good = report(NONE, 1, 300)
    for n, bad in enumerate((good[:7], good + b"\0", b"\x02" + good[1:], good[:7] + b"\0", bytes(8))):
        bench.pad.queue(100 + n, bad)
    bench.pad.queue(300, good)
    with bench.open() as keys:
        assert bench.all_until(keys, 400) == []
        assert keys.counters.garbage_reports == 5
        assert keys.counters.lost_reports == 0


def test_every_report_is_counted_and_health_tells_how_many() -> None:
    bench = Bench()
    bench.pad.queue(100, report(NONE, 1, 100))
    bench.pad.queue(200, b"\x02" + report(NONE, 2, 200)[1:])  # garbage is a report as well
    with bench.open() as keys:
        before = keys.counters.reports
        bench.all_until(keys, 150)
        assert keys.counters.reports == before + 1
        bench.all_until(keys, 300)
        assert keys.counters.reports == before + 2
        assert keys.health().details["reports"] == str(before + 2)


def test_missing_reports_are_counted_across_the_wrap() -> None:
    bench = Bench()
    bench.pad._queue.clear()
    for n, counter in enumerate((254, 255, 0, 3)):
        bench.pad.queue(n * 10, report(NONE, counter, n * 10))
    with bench.open() as keys:
        bench.all_until(keys, 100)
        assert keys.counters.lost_reports == 2


def test_four_missing_reports_are_a_lost_pad_told_once_and_it_may_come_back() -> None:
    bench = Bench()
    bench.pad.queue(3000, report(SCAN, 1, 3000))
    bench.pad.hold(NONE, 3100, 3500, 2)
    bench.pad.queue(3600, report(SCAN, 9, 3600))
    with bench.open() as keys:
        assert bench.all_until(keys, 2500) == [KeysLost("no report for 1.0 s")]
        assert not keys.health().ok
        said = bench.all_until(keys, 3800)
        assert keys.health().ok
    # The key that was down when the pad came back presses nothing; the next press does.
    assert [type(event) for event in said] == [KeyPress]
    assert bench.at_ms(said[0]) == 3600


def test_a_host_that_comes_late_to_its_reports_has_not_lost_the_pad() -> None:
    bench = Bench()
    bench.pad.hold(NONE, 250, 12_000, 1)
    with bench.open() as keys:
        bench.pad.late_s = 1.2
        assert bench.all_until(keys, 10_000) == []
        assert keys.health().ok


REPORTS = st.one_of(
    damaged([report(0x0F, 255, 65535), report(2, 9, 500, 8)]),
    st.tuples(st.integers(0, 15), st.integers(0, 255), st.integers(0, 65535)).map(lambda drawn: report(*drawn)),
    st.none(),
)


@given(st.lists(st.tuples(st.sampled_from((0, 1, 5, 40, 250, 900, 3000)), REPORTS), min_size=1, max_size=15))
def test_whatever_a_pad_reports_each_key_is_pressed_once_before_it_is_released(
    said: list[tuple[int, bytes | None]],
) -> None:
    bench, time_ms = Bench(), 0
    for gap_ms, data in said:
        time_ms += gap_ms
        bench.pad.queue(time_ms, data)
    down: set[Key] = set()
    with contextlib.suppress(DeviceGone), bench.open() as keys:
        for event in bench.all_until(keys, time_ms + 2000):
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


def test_a_pad_full_of_garbage_is_lost_too() -> None:
    bench = Bench()
    for time_ms in range(50, 2000, 1):
        bench.pad.queue(time_ms, bytes(8))
    with bench.open() as keys:
        said = bench.all_until(keys, 1900)
    assert said == [KeysLost("no report for 1.0 s")]


def test_unplugging_is_an_event_then_an_error() -> None:
    bench = Bench()
    bench.pad.queue(300, None)
    with bench.open() as keys:
        assert [keys.next_event(0.5)] == [KeysLost("unplugged (read error)")]
        with pytest.raises(DeviceGone, match="keys: unplugged"):
            keys.next_event(0.1)


def test_no_pad_no_permission_and_a_mute_pad_are_three_errors() -> None:
    bench = Bench()
    bench.pad.present = False
    with pytest.raises(DeviceGone, match="no key pad 1209:4b46"):
        bench.open()
    bench.pad.present, bench.pad.openable = True, False
    with pytest.raises(DeviceRefused, match="udev"):
        bench.open()
    bench.pad.openable = True
    bench.pad._queue.clear()
    with pytest.raises(DeviceGone, match=r"no valid report within 1\.0 s"):
        bench.open()
    assert bench.pad.closed
