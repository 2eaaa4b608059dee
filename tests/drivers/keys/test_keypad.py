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
SCAN, UP, NONE = 0x01, 0x04, 0x00


def report(mask: int, counter: int, time_ms: int, faulty: int = 0) -> bytes:
    body = bytes([1, mask, counter % 256, faulty, time_ms & 0xFF, time_ms >> 8 & 0xFF, 3])
    check = 0xA5
    for byte in body:
        check ^= byte
    return body + bytes([check])


class Pad:
    """Reports that become readable at their times (ms since the clock's beginning), as the kernel queues them; hidapi's shape."""

    def __init__(self, clock: SteppedClock) -> None:
        self._clock = clock
        self._begin_ns = clock.now_ns()
        self._queue: list[tuple[float, bytes | None]] = []
        self.present = self.openable = True
        self.closed = False
        self.late_s = 0.0
        """How long the host's thread waits for the processor after a read that found nothing."""
        self.reads = 0

    def queue(self, time_ms: float, data: bytes | None) -> None:
        self._queue.append((time_ms, data))

    def now_ms(self) -> float:
        return (self._clock.now_ns() - self._begin_ns) * 1e-6

    def enumerate(self, vendor: int, product: int) -> list[dict[str, Any]]:
        assert (vendor, product) == (0x1209, 0x4B46)
        return [{"path": b"/dev/hidraw0", "usage_page": 0xFF4B, "usage": 1}] if self.present else []

    def device(self) -> Pad:
        return self

    def open_path(self, path: bytes) -> None:
        if not self.openable:
            raise OSError("open failed")

    def read(self, size: int, timeout_ms: int) -> list[int]:
        assert timeout_ms >= 1, "0 blocks for ever in some versions"
        assert size == 8
        self.reads += 1
        if self._queue and self._queue[0][0] <= self.now_ms() + timeout_ms:
            time_ms, data = self._queue.pop(0)
            self._clock.advance_s(max(0.0, time_ms - self.now_ms()) * 1e-3)
            if data is None:
                raise OSError("read error")
            return list(data)
        self._clock.advance_s(timeout_ms * 1e-3 + self.late_s)
        return []

    def close(self) -> None:
        self.closed = True


class Bench:
    """A pad whose first report comes at once, unless ``begins`` says otherwise, and then ``reports``."""

    def __init__(self, *reports: tuple[float, bytes | None], begins: bytes | None = report(NONE, 0, 0)) -> None:
        self.clock = SteppedClock()
        self.pad = Pad(self.clock)
        if begins is not None:
            self.pad.queue(0, begins)
        for time_ms, data in reports:
            self.pad.queue(time_ms, data)

    def open(self) -> HidKeypad:
        return HidKeypad.open(SPEC, self.pad, self.clock)

    def all_until(self, keys: HidKeypad, time_ms: float) -> list[KeyEvent]:
        said: list[KeyEvent] = []
        while self.pad.now_ms() < time_ms:
            event = keys.next_event(min(0.1, (time_ms - self.pad.now_ms()) * 1e-3))
            if event is not None:
                said.append(event)
        return said


def held(mask: int, from_ms: int, to_ms: int, counter: int) -> list[tuple[float, bytes]]:
    """A report at once and every 250 ms."""
    return [(ms, report(mask, counter + k, ms)) for k, ms in enumerate(range(from_ms, to_ms, 250))]


def at_ns(time_ms: float) -> int:
    return 1_000_000_000 + round(time_ms * 1e6)


GOOD = report(NONE, 1, 300)
BAD = (GOOD[:7], GOOD + b"\0", b"\x02" + GOOD[1:], GOOD[:7] + b"\0", bytes(8))
LOST = KeysLost("no report for 1.0 s")


@pytest.mark.parametrize(
    ("reports", "until_ms", "said"),
    [
        (
            [(ms, report(mask, n, ms)) for n, (ms, mask) in enumerate([(200, SCAN), (206, NONE), (215, SCAN), (400, NONE), (600, NONE)], 1)],
            700,
            [KeyPress(Key.SCAN, at_ns(215)), KeyRelease(Key.SCAN, at_ns(400), 0.185)],
        ),
        (held(SCAN, 100, 1200, 1), 1000, [KeyPress(Key.SCAN, at_ns(100)), KeyLongPress(Key.SCAN, at_ns(900))]),
        ([*((100 + n, bad) for n, bad in enumerate(BAD)), (300, GOOD)], 400, []),
        ([(ms, bytes(8)) for ms in range(50, 2000)], 1900, [LOST]),
        # The key that was down when the pad came back presses nothing; the next press does.
        ([(3000, report(SCAN, 1, 3000)), *held(NONE, 3100, 3500, 2), (3600, report(SCAN, 9, 3600))], 3800, [LOST, KeyPress(Key.SCAN, at_ns(3600))]),
    ],
    ids=["bounce", "long press", "garbage", "nothing but garbage", "silence and another beginning"],
)  # fmt: skip
def test_reports_become_events_at_their_times(
    reports: list[tuple[float, bytes | None]], until_ms: float, said: list[KeyEvent]
) -> None:
    bench = Bench(*reports)
    with bench.open() as keys:
        assert bench.all_until(keys, until_ms) == said
        assert keys.health().ok is (not said or said[-1] != LOST)
    assert bench.pad.closed


def test_events_come_when_they_are_known_and_nothing_is_nothing_for_exactly_the_timeout() -> None:
    bench = Bench((1000, report(NONE, 1, 1000, faulty=SCAN)), (1400, report(UP, 2, 1400, faulty=SCAN)), (1500, None))
    with bench.open() as keys:
        begin_ms, bench.pad.reads = bench.pad.now_ms(), 0
        assert keys.next_event(0.1) is None
        assert bench.pad.now_ms() - begin_ms == pytest.approx(100, abs=2)
        assert bench.pad.reads == 1, "it sleeps meanwhile"
        assert keys.next_event(0.85) is None
        assert bench.pad.reads == 2
        assert keys.next_event(0.1) == KeyStuck(Key.SCAN), "a faulty coil"
        assert isinstance(keys.next_event(0.9), KeyPress)
        assert bench.pad.now_ms() == pytest.approx(1430, abs=2), "without another report"
        assert keys.next_event(0.5) == KeysLost("unplugged (read error)")
        with pytest.raises(DeviceGone, match="keys: unplugged"):
            keys.next_event(0.1)
    bench = Bench()
    with bench.open() as keys:
        assert keys.next_event(5.0) == LOST, "whoever waits long hears of it after a second"
        assert bench.pad.now_ms() == pytest.approx(1000, abs=60)


def test_a_pad_that_starts_anew_dates_its_reports_anew() -> None:
    """Its clock stood at 65.3 s; the first report after the silence lies unread, and says 10 ms."""
    bench = Bench(
        *((200, report(NONE, 1, 65_300)), (3000, report(NONE, 0, 10)), (3200, report(SCAN, 1, 210))),
        *held(SCAN, 3400, 4300, 2),
    )
    with bench.open() as keys:
        assert bench.all_until(keys, 2000) == [LOST]
        bench.clock.advance_s(1.3)
        (press,) = bench.all_until(keys, 3800)
    assert isinstance(press, KeyPress)
    assert press.time_ns == pytest.approx(at_ns(3300), abs=110e6), "not in the silence before"


def test_a_host_that_reads_late_still_sees_a_short_press_as_short_and_has_not_lost_the_pad() -> None:
    """A press of 150 ms and a whole second of reports lie in the kernel's queue when the thread gets the processor."""
    bench = Bench((100, report(SCAN, 1, 100)), (250, report(NONE, 2, 250)), *held(NONE, 500, 12_000, 3))
    with bench.open() as keys:
        bench.clock.advance_s(1.1)
        press, release = bench.all_until(keys, 1400)
        assert isinstance(press, KeyPress)
        assert isinstance(release, KeyRelease)
        assert release.held_s == pytest.approx(0.15)
        bench.pad.late_s = 1.2
        assert bench.all_until(keys, 10_000) == []
        assert keys.health().ok


def test_reports_garbage_and_what_is_missing_across_the_wrap_are_counted() -> None:
    counted = ((n * 10, report(NONE, counter, n * 10)) for n, counter in enumerate((255, 0, 3), 1))
    bench = Bench(*counted, *((50 + n, bad) for n, bad in enumerate(BAD)), begins=report(NONE, 254, 0))
    with bench.open() as keys:
        bench.all_until(keys, 100)
        details = {"firmware": "3", "reports": "9", "garbage reports": "5", "lost reports": "2"}
        assert keys.health().details == details


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


def test_no_pad_no_permission_and_a_mute_pad_are_three_errors() -> None:
    bench = Bench(begins=None)
    bench.pad.present = False
    with pytest.raises(DeviceGone, match="1209:4b46"):
        bench.open()
    bench.pad.present, bench.pad.openable = True, False
    with pytest.raises(DeviceRefused, match="udev"):
        bench.open()
    bench.pad.openable = True
    with pytest.raises(DeviceGone, match=r"no valid report within 1\.0 s"):
        bench.open()
    assert bench.pad.now_ms() == pytest.approx(1000, abs=3)
    assert bench.pad.reads <= 2, "it waits, and does not poll"
    assert bench.pad.closed
