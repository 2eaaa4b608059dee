"""The simulated key pad beyond its protocol (tests/drivers/keys/firmware): fingers, contacts that bounce, faults."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from operator import xor

import pytest

from hw_sim.devices.keypad import Keypad
from tests.hw_sim.devices.bench import Bench, bench

SCAN, UP = 1, 4
MS = 1_000_000


class Pad:
    def __init__(self, made: Bench, seed: int = 1) -> None:
        self.bench, self.pad = made, Keypad(made.time, made.faults, seed)
        self.reports: list[tuple[int, bytes]] = []
        made.changed.append(self.pad.refresh)
        self.listen()

    def listen(self) -> None:
        self.pad.listen(lambda report: self.reports.append((self.bench.time.now_ns(), report)))

    def edges(self, bit: int) -> list[tuple[int, bool]]:
        """Time and level of each change of a key, as reported."""
        levels = [(time_ns, bool(report[1] & bit)) for time_ns, report in self.reports]
        before = [False, *(level for _, level in levels)]
        return [(time_ns, level) for (time_ns, level), last in zip(levels, before, strict=False) if level != last]


@pytest.fixture
def pad() -> Iterator[Pad]:
    with bench() as made:
        yield Pad(made)


def good(report: bytes) -> bool:
    return len(report) == 8 and report[0] == 1 and reduce(xor, report[:7], 0xA5) == report[7]


@pytest.mark.parametrize("announced_ms", [0, 100])
def test_a_finger_holds_a_key_until_it_goes(pad: Pad, announced_ms: int) -> None:
    begin_ns = pad.bench.time.now_ns() + announced_ms * MS
    pad.pad.touch("up", begin_ns)
    pad.pad.let_go("up", begin_ns + 1300 * MS)
    pad.bench.run_s(2.0)
    edges = pad.edges(UP)
    assert edges[0] == (begin_ns, True)
    assert (begin_ns + 1300 * MS, False) in edges
    assert not edges[-1][1]


@pytest.mark.parametrize(("hold_s", "by_finger"), [(0.0, True), (0.003, False), (0.017, True), (0.2, False)])
def test_contacts_bounce_for_20_ms_at_most_and_end_released(hold_s: float, by_finger: bool) -> None:
    bounced = 0
    for seed in range(20):
        with bench() as made:
            pad = Pad(made, seed)
            begin_ns = made.time.now_ns()
            if by_finger:
                pad.pad.touch("scan", 0)
                made.run_s(hold_s)
                pad.pad.let_go("scan", 0)
            else:
                pad.pad.press("scan", hold_s)
            made.run_s(0.3 + hold_s)
            assert pad.reports[-1][1][1] == 0, f"seed {seed}: held for ever"
            assert all(good(report) for _, report in pad.reports)
            edges = pad.edges(SCAN)
            end_ns = begin_ns + int(hold_s * 1e9)
            assert all(t <= begin_ns + 20 * MS or end_ns <= t <= end_ns + 20 * MS for t, _ in edges)
            bounced += len(edges) > 2
    assert bounced >= 4 or hold_s < 0.01, "contacts that never bounce test no debouncing"


def test_garbage_is_mostly_recognisable_and_an_unplugged_pad_comes_back_as_another_device(pad: Pad) -> None:
    pad.bench.faults.add("keypad garbage for_s=20")
    pad.bench.run_s(19.9)
    wrong = [not good(r) for _, r in pad.reports]
    assert sum(wrong) > 0.95 * len(wrong)
    assert {len(r) == 8 for _, r in pad.reports} == {True, False}, "some are short"
    pad.bench.run_s(0.3)
    assert good(pad.reports[-1][1])
    before, enumeration = len(pad.reports), pad.pad.enumeration
    pad.bench.faults.add("keypad off for_s=1.0")
    assert not pad.pad.plugged
    pad.bench.run_s(3.0)
    assert (pad.pad.plugged, pad.pad.enumeration) == (True, enumeration + 1)
    assert len(pad.reports) == before, "the old handle stays dead"
    pad.listen()
    pad.bench.run_s(0.3)
    assert good(pad.reports[-1][1])
