"""What ``docs/protocols/keys.md`` promises, asked of the simulator's pad and of the firmware's under two interpreters.

The suite has its own reading of a report and shares no number with what it judges.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol

import pytest

from drivers.api import Key, KeyEvent, KeyLongPress, KeyPress, KeyRelease
from drivers.keys.debounce import Debouncer
from drivers.keys.firmware import report as firmware_report
from drivers.keys.report import parse_report
from hw_sim.devices.keypad import REPORT_DESCRIPTOR, Keypad
from tests.drivers.keys.firmware.desk import PadDesk
from tests.hw_sim.devices.bench import Bench, bench
from tests.support.micropython import ROOT, desk_inside

pytestmark = pytest.mark.devices

FILES = [
    *(
        ROOT / "drivers" / "keys" / "firmware" / f"{name}.py"
        for name in ("pins", "hardware", "coils", "report", "core")
    ),
    ROOT / "tests" / "drivers" / "keys" / "firmware" / "desk.py",
]
KEYS = ["scan", "back", "up", "down"]
Reports = list[tuple[int, bytes]]


class Target(Protocol):
    """A pad as its host and a finger have it."""

    def run(self, time_ms: int) -> Reports:
        """Let time pass; return the reports with the time in ms at which each came."""

    def finger(self, key: int, down: bool) -> None:
        """Put a finger on key 0..3 or take it off."""


class _Simulated:
    def __init__(self, made: Bench) -> None:
        self._bench = made
        self._pad = Keypad(made.time, made.faults, 1)
        self._reports: Reports = []
        self._pad.listen(lambda report: self._reports.append((made.time.now_ns() // 1_000_000, report)))

    def run(self, time_ms: int) -> Reports:
        self._bench.run_s(time_ms / 1000)
        said, self._reports = list(self._reports), []
        return said

    def finger(self, key: int, down: bool) -> None:
        (self._pad.touch if down else self._pad.let_go)(KEYS[key], 0)


@contextmanager
def simulated() -> Iterator[Target]:
    with bench() as made:
        yield _Simulated(made)


TARGETS: dict[str, Callable[[], AbstractContextManager[Target]]] = {
    "simulator": simulated,
    "firmware in CPython": lambda: nullcontext(PadDesk()),
    "firmware in MicroPython": lambda: desk_inside(FILES, "tests.drivers.keys.firmware.desk", "PadDesk"),
}


@pytest.fixture(params=TARGETS)
def pad(request: pytest.FixtureRequest) -> Iterator[Target]:
    with TARGETS[str(request.param)]() as target:
        yield target


def checked(reports: Reports) -> Reports:
    for _, report in reports:
        assert len(report) == 8
        assert report[0] == 1
        assert report[1] & 0xF0 == 0
        assert report[3] & 0xF0 == 0
        check = 0xA5
        for byte in report[:7]:
            check ^= byte
        assert report[7] == check
    return reports


def test_a_report_comes_four_times_a_second_counts_and_tells_the_time(pad: Target) -> None:
    reports = checked(pad.run(70_010))
    assert abs(len(reports) - 280) <= 1
    assert all(report[1] == report[3] == 0 for _, report in reports)
    assert {(b[2] - a[2]) % 256 for (_, a), (_, b) in itertools.pairwise(reports)} == {1}
    assert {0, 255} <= {report[2] for _, report in reports}
    told_ms = [int.from_bytes(report[4:6], "little") for _, report in reports]
    assert all(abs((b - a) % 65536 - 250) <= 4 for a, b in itertools.pairwise(told_ms))
    assert min(told_ms) < told_ms[0], "16 bits wrap within this time"
    assert len({report[6] for _, report in reports}) == 1


def test_a_press_is_its_own_bit_told_at_once_and_bounces_for_20_ms_at_most(pad: Target) -> None:
    pad.run(3000)
    for key, down in itertools.product(range(4), (True, False)):
        pad.finger(key, down)
        reports = checked(pad.run(600))
        levels = [(time_ms, bool(report[1] & 1 << key)) for time_ms, report in reports]
        assert all(report[1] & ~(1 << key) == 0 for _, report in reports)
        changes = [a for a, b in zip(levels, [(0, not down), *levels], strict=False) if a[1] != b[1]]
        assert changes[-1][1] is down
        assert changes[-1][0] - changes[0][0] <= 20
        assert reports[-1][0] - changes[0][0] >= 300, "and the heartbeat goes on"
    for key in range(4):
        pad.finger(key, True)
    assert checked(pad.run(600))[-1][1][1] == 0x0F
    pad.finger(1, False)
    assert checked(pad.run(600))[-1][1][1] == 0x0D


def test_the_shipped_driver_hears_press_long_press_and_release(pad: Target) -> None:
    reports = pad.run(3000)
    pad.finger(0, True)
    reports += pad.run(1500)
    pad.finger(0, False)
    reports += pad.run(500)
    debouncer, events = Debouncer(), list[KeyEvent]()
    for time_ms, raw in reports:
        report = parse_report(raw)
        events += debouncer.contacts(time_ms * 1_000_000, report.pressed, report.faulty)
    assert [type(event) for event in events] == [KeyPress, KeyLongPress, KeyRelease]
    assert {event.key for event in events if isinstance(event, KeyPress | KeyLongPress | KeyRelease)} == {Key.SCAN}


def test_the_descriptor_says_the_same_as_the_simulators() -> None:
    def items(descriptor: bytes) -> list[tuple[int, int]]:
        """Return tag and value of each short item (HID 1.11, section 6.2.2.2)."""
        found, at = [], 0
        while at < len(descriptor):
            size = (0, 1, 2, 4)[descriptor[at] & 3]
            found.append((descriptor[at] & ~3, int.from_bytes(descriptor[at + 1 : at + 1 + size], "little")))
            at += 1 + size
        return found

    ours = items(firmware_report.DESCRIPTOR)
    assert (0x04, 0xFF4B) in ours
    assert (0x84, 1) in ours
    assert (0x94, 7) in ours
    tags = {0x04, 0x84, 0x74, 0x94, 0x80, 0xA0, 0xC0}
    assert [i for i in ours if i[0] in tags] == [i for i in items(REPORT_DESCRIPTOR) if i[0] in tags]
