"""Keys bounce, reports say so, and hidapi's shape is kept."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hw_sim.devices.keypad import Keypad
from hw_sim.faults import FaultBook
from hw_sim.wires.hidraw import HidDevice
from tests.hw_sim.devices.conftest import Bench, HandTime

VENDOR, PRODUCT = 0x1209, 0x4B46


class Pad:
    """A pad on a table, its reports kept with their times."""

    def __init__(self, time: HandTime, seed: int = 3) -> None:
        self.time = time
        self.faults = FaultBook(time.now_ns, time.at, lambda t: self.keypad.refresh(t))
        self.reports: list[tuple[int, bytes]] = []
        with time.condition:
            self.keypad = Keypad(time, self.faults, seed)
            self.keypad.listen(lambda report: self.reports.append((time.now_ns(), report)))

    def press(self, key: str, hold_s: float) -> None:
        with self.time.condition:
            self.keypad.press(key, hold_s)

    def edges(self) -> list[tuple[int, int]]:
        """(time, keys) of each change."""
        found: list[tuple[int, int]] = []
        for time_ns, report in self.reports:
            if not found or found[-1][1] != report[1]:
                found.append((time_ns, report[1]))
        return found


@pytest.fixture
def pad(hand_time: HandTime) -> Pad:
    return Pad(hand_time)


def intact(report: bytes) -> bool:
    check = 0xA5
    for byte in report[:7]:
        check ^= byte
    return len(report) == 8 and report[0] == 1 and report[7] == check


def test_an_idle_pad_reports_four_times_a_second(pad: Pad) -> None:
    start_ns = pad.time.now_ns()
    pad.time.run(2.0)
    assert [t - start_ns for t, _ in pad.reports] == [250_000_000 * (k + 1) for k in range(8)]
    assert all(intact(report) and report[1] == 0 for _, report in pad.reports)
    assert [report[2] for _, report in pad.reports] == list(range(8))


def test_the_counter_and_the_clock_wrap(pad: Pad) -> None:
    pad.time.run(70.0)
    counters = [report[2] for _, report in pad.reports]
    assert counters[255:258] == [255, 0, 1]
    clock_ms = [report[4] | report[5] << 8 for _, report in pad.reports]
    assert max(clock_ms) > 65_000
    assert clock_ms[-1] < 10_000


@pytest.mark.parametrize(("key", "bit"), [("scan", 1), ("back", 2), ("up", 4), ("down", 8)])
def test_a_press_is_seen_and_ends(hand_time: HandTime, key: str, bit: int) -> None:
    pad = Pad(hand_time)
    start_ns = pad.time.now_ns()
    pad.press(key, 0.15)
    pad.time.run(0.4)
    edges = pad.edges()
    assert {keys for _, keys in edges} == {0, bit}
    assert edges[0][1] == bit
    assert edges[-1][1] == 0
    pressed = [t - start_ns for t, keys in edges if keys]
    assert pressed[0] == 0
    assert edges[-1][0] - start_ns >= 150_000_000


def test_keys_bounce_for_less_than_the_manual_allows(hand_time: HandTime) -> None:
    bounced = 0
    pad = Pad(hand_time)
    for _ in range(20):
        start_ns = pad.time.now_ns()
        pad.reports.clear()
        pad.press("scan", 0.1)
        pad.time.run(0.2)
        offsets = [t - start_ns for t, _ in pad.edges()]
        bounced += len(offsets) > 2
        assert all(t <= 20_000_000 or 100_000_000 <= t <= 120_000_000 or t >= 150_000_000 for t in offsets)
    assert bounced > 10


def test_a_stuck_key_stays_down(pad: Pad) -> None:
    with pad.time.condition:
        pad.faults.add("key.up stuck for_s=2")
    pad.time.run(1.9)
    assert {report[1] for _, report in pad.reports} == {4}
    pad.time.run(0.2)
    assert pad.reports[-1][1][1] == 0


def test_garbage_is_never_a_good_report(pad: Pad) -> None:
    with pad.time.condition:
        pad.faults.add("keypad garbage")
    pad.time.run(50.0)
    reports = [report for _, report in pad.reports]
    assert not any(intact(report) for report in reports)
    assert {len(report) for report in reports} >= {1, 4, 8}
    assert any(report[0] != 1 for report in reports)


def test_an_unknown_key_is_refused(pad: Pad) -> None:
    with pad.time.condition, pytest.raises(ValueError, match="key 'left'; allowed are scan, back, up, down"):
        pad.keypad.press("left", 0.1)


def test_the_pad_is_found_read_and_lost_as_hidapi_shows_it(bench: Bench) -> None:
    hid = bench.wires.hidraw
    assert hid.enumerate(VENDOR, 0x0001) == []
    (found,) = hid.enumerate(VENDOR, PRODUCT)
    assert (found["usage_page"], found["usage"]) == (0xFF4B, 1)
    device = hid.device()
    with pytest.raises(ValueError, match="not open"):
        device.read(8, 100)
    device.open_path(found["path"])
    assert intact(bytes(device.read(8, 1000)))
    assert len(device.read(3, 1000)) == 3, "a shorter buffer cuts the report"
    assert device.read(8, 1) == [], "a timeout is no error"
    bench.world.press("back")
    assert device.read(8, 1000)[1] == 2
    bench.world.fault("keypad off")
    with pytest.raises(OSError, match="read error"):
        read_all(device)
    assert hid.enumerate(VENDOR, PRODUCT) == []
    with pytest.raises(OSError, match="open failed"):
        hid.device().open_path(found["path"])
    bench.world.clear_faults()
    (again,) = hid.enumerate(VENDOR, PRODUCT)
    assert again["path"] != found["path"], "the kernel gives a new node"
    with pytest.raises(OSError, match="read error"):
        device.read(8, 100)
    device.close()
    device.close()


def test_a_reader_that_does_not_read_loses_the_newest_reports(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(idle_speed=50.0)
    hid = bench.wires.hidraw
    device = hid.device()
    device.open_path(hid.enumerate()[0]["path"])
    bench.wires.clock.sleep_s(25.0)
    counters = []
    while report := device.read(8, 1):
        counters.append(report[2])
    assert counters[:63] == [(counters[0] + k) % 256 for k in range(63)], "the oldest are kept"
    assert len(counters) <= 66
    device.close()


def read_all(device: HidDevice) -> None:
    """Read what is left and what comes."""
    for _ in range(100):
        device.read(8, 100)
