"""The key pad's reports, byte by byte, and its fingers."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce
from operator import xor

import pytest

from hw_sim.devices.keypad import REPORT_DESCRIPTOR, Keypad
from tests.hw_sim.devices.bench import Bench, bench

BITS = {"scan": 1, "back": 2, "up": 4, "down": 8}


@dataclass
class Pad:
    bench: Bench
    seed: int = 1
    reports: list[tuple[int, bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pad = Keypad(self.bench.time, self.bench.faults, self.seed)
        self.bench.changed.append(self.pad.refresh)
        self.listen()

    def listen(self) -> None:
        self.pad.listen(lambda report: self.reports.append((self.bench.time.now_ns(), report)))

    def edges(self, bit: int) -> list[tuple[int, bool]]:
        """Time and level of each change of a key, as reported."""
        changes, before = [], False
        for time_ns, report in self.reports:
            level = bool(report[1] & bit)
            if level != before:
                changes.append((time_ns, level))
            before = level
        return changes


@pytest.fixture
def pad() -> Iterator[Pad]:
    with bench() as made:
        yield Pad(made)


def good(report: bytes) -> bool:
    return len(report) == 8 and report[0] == 1 and reduce(xor, report[:7], 0xA5) == report[7]


def test_a_report_every_quarter_second_counts_and_tells_the_time(pad: Pad) -> None:
    pad.bench.run_s(70.01)
    assert len(pad.reports) == 280
    assert all(good(r) and r[1] == 0 and r[3] == 0 for _, r in pad.reports)
    counters = [r[2] for _, r in pad.reports]
    assert {(b - a) % 256 for a, b in itertools.pairwise(counters)} == {1}
    times_ms = [int.from_bytes(r[4:6], "little") for _, r in pad.reports]
    assert {(b - a) % 65536 for a, b in itertools.pairwise(times_ms)} == {250}
    assert min(times_ms) < times_ms[0], "16 bits wrap within this time"


@pytest.mark.parametrize("key", list(BITS))
def test_a_press_is_its_own_bit_and_bounces_no_longer_than_promised(key: str) -> None:
    longest_ns, bounced = 0, 0
    for seed in range(12):
        with bench() as made:
            pad = Pad(made, seed)
            begin_ns = made.time.now_ns()
            pad.pad.press(key, 0.2)
            made.run_s(0.5)
            assert all(good(r) and r[1] & ~BITS[key] == 0 for _, r in pad.reports)
            edges = pad.edges(BITS[key])
            assert edges[0] == (begin_ns, True)
            downs = [t for t, level in edges if t < begin_ns + 200_000_000]
            ups = [t for t, level in edges if t >= begin_ns + 200_000_000]
            assert ups[0] == begin_ns + 200_000_000
            assert not edges[-1][1]
            longest_ns = max(longest_ns, downs[-1] - begin_ns, ups[-1] - ups[0])
            bounced += len(edges) > 2
    assert longest_ns <= 20_000_000
    assert bounced >= 6, "contacts that never bounce test no debouncing"


@pytest.mark.parametrize("hold_s", [0.000_001, 0.003, 0.017])
def test_a_press_shorter_than_its_bounce_ends_released(hold_s: float) -> None:
    for seed in range(40):
        with bench() as made:
            pad = Pad(made, seed)
            pad.pad.press("scan", hold_s)
            made.run_s(0.3)
            assert pad.reports[-1][1][1] == 0, f"seed {seed}: held for ever"
            assert pad.edges(1)[-1][0] <= pad.reports[0][0] + int(hold_s * 1e9) + 20_000_000


def test_a_finger_holds_a_key_until_it_goes(pad: Pad) -> None:
    begin_ns = pad.bench.time.now_ns()
    pad.pad.touch("up", 0)
    pad.bench.run_s(1.3)
    assert pad.reports[-1][1][1] == BITS["up"]
    pad.pad.let_go("up", 0)
    pad.bench.run_s(0.3)
    edges = pad.edges(BITS["up"])
    assert edges[0] == (begin_ns, True)
    assert (begin_ns + 1_300_000_000, False) in edges
    assert not edges[-1][1]


def test_a_finger_may_be_announced(pad: Pad) -> None:
    begin_ns = pad.bench.time.now_ns() + 100_000_000
    pad.pad.touch("down", begin_ns)
    pad.pad.let_go("down", begin_ns + 400_000_000)
    pad.bench.run_s(1.0)
    changes = [time_ns for time_ns, _ in pad.edges(BITS["down"])]
    assert changes[0] == begin_ns
    assert 0 <= changes[-1] - begin_ns - 400_000_000 <= 20_000_000


@pytest.mark.parametrize("gap_s", [0.0, 0.002, 0.012])
def test_a_finger_that_goes_before_the_contact_has_settled_leaves_nothing_pressed(gap_s: float) -> None:
    for seed in range(40):
        with bench() as made:
            pad = Pad(made, seed)
            pad.pad.touch("scan", 0)
            made.run_s(gap_s)
            pad.pad.let_go("scan", 0)
            made.run_s(0.3)
            assert pad.reports[-1][1][1] == 0, f"seed {seed}: held for ever"


def test_two_keys_at_once(pad: Pad) -> None:
    pad.pad.press("scan", 0.3)
    pad.bench.run_s(0.05)
    pad.pad.press("back", 0.1)
    pad.bench.run_s(0.05)
    assert pad.reports[-1][1][1] == 0b0011
    pad.bench.run_s(0.1)
    assert pad.reports[-1][1][1] == 0b0001


@pytest.mark.parametrize(("key", "hold_s"), [("fire", 0.1), ("scan", 0.0), ("scan", -1.0), ("scan", float("nan"))])
def test_a_press_that_cannot_be_is_refused(pad: Pad, key: str, hold_s: float) -> None:
    with pytest.raises(ValueError, match="allowed"):
        pad.pad.press(key, hold_s)
    for change in (pad.pad.touch, pad.pad.let_go):
        with pytest.raises(ValueError, match="key 'fire'; allowed are scan, back, up, down"):
            change("fire", 0)
    pad.bench.run_s(0.3)
    assert pad.edges(0xF) == []


def test_a_stuck_key_is_held_until_repaired(pad: Pad) -> None:
    pad.bench.faults.add("key.up stuck for_s=1.0")
    pad.bench.run_s(0.9)
    assert {r[1] for _, r in pad.reports} == {BITS["up"]}
    pad.bench.run_s(0.5)
    assert pad.reports[-1][1][1] == 0


def test_garbage_is_mostly_recognisable_and_ends(pad: Pad) -> None:
    pad.bench.faults.add("keypad garbage for_s=20")
    pad.bench.run_s(19.9)
    wrong = [not good(r) for _, r in pad.reports]
    assert sum(wrong) > 0.95 * len(wrong)
    assert {len(r) == 8 for _, r in pad.reports} == {True, False}, "some are short"
    pad.bench.run_s(0.3)
    assert good(pad.reports[-1][1])


def test_an_unplugged_pad_is_silent_and_comes_back_as_another_device(pad: Pad) -> None:
    pad.bench.run_s(1.0)
    before, enumeration = len(pad.reports), pad.pad.enumeration
    pad.bench.faults.add("keypad off for_s=1.0")
    plugged = [pad.pad.plugged]
    pad.bench.run_s(3.0)
    plugged.append(pad.pad.plugged)
    assert plugged == [False, True]
    assert len(pad.reports) == before, "the old handle stays dead"
    assert pad.pad.enumeration == enumeration + 1
    pad.listen()
    pad.bench.run_s(0.3)
    assert good(pad.reports[-1][1])


def test_the_descriptor_describes_the_report() -> None:
    """HID 1.11, 6.2.2: items are prefix (tag, type, size) and little-endian data."""
    items: dict[int, int] = {}
    at = 0
    while at < len(REPORT_DESCRIPTOR):
        size = (0, 1, 2, 4)[REPORT_DESCRIPTOR[at] & 3]
        items[REPORT_DESCRIPTOR[at] & 0xFC] = int.from_bytes(REPORT_DESCRIPTOR[at + 1 : at + 1 + size], "little")
        at += 1 + size
    usage_page, report_id, report_size, report_count, application = 0x04, 0x84, 0x74, 0x94, 0xA0
    assert items[usage_page] == 0xFF4B
    assert (items[report_id], items[application]) == (1, 1)
    assert items[report_size] * items[report_count] == 8 * 7, "seven bytes behind the number"
    assert REPORT_DESCRIPTOR[-1] == 0xC0
