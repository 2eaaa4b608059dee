"""The PIO programs cycle by cycle in an RP2040 emulator: when pulses begin, how long they last, which syncs they follow.

Two things the emulator does not spend time on, and the chip does: two flip-flops between pin and PIO, and one clock for each
WAIT that ends at once. Both are added where a pulse is compared with its sync; together they are 32 ns.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from drivers.board.firmware import pio
from tests.drivers.board.firmware.emulated import CLOCK_HZ, GATE, IRQ, PULSE, TRIGGER, US, VSYNC, Chip

pytestmark = pytest.mark.devices

WAITS = 2
"""Between a sync and its pulse: that for the pin, and that for the flag."""


def start(chip: Chip, skip: int, every: int, pulses: int | None, delay_us: int, width_us: int) -> None:
    """Do what the board's ``start`` does."""
    chip.load(GATE, pio.GATE, 0)
    chip.load(PULSE, pio.PULSE, len(pio.GATE.words))
    chip.write(IRQ, 1 << pio.FLAG)
    chip.put(GATE, pio.gate_words(skip, every, delay_us, CLOCK_HZ))
    chip.put(PULSE, pio.pulse_words(pulses, width_us, CLOCK_HZ))
    chip.enable(chip.enabled | 1 << GATE | 1 << PULSE)
    chip.run(50)


@pytest.fixture
def chip() -> Chip:
    return Chip()


def late(chip: Chip, edges: Sequence[int], delay_us: int) -> list[int]:
    """Return by how many clocks each pulse comes later than ``delay_us`` after its sync."""
    return [
        rise + WAITS + pio.SYNCHRONISER_CYCLES - edge - delay_us * US
        for rise, edge in zip(chip.rises(), edges, strict=True)
    ]


@pytest.mark.parametrize(("skip", "pulses", "delay_us", "width_us"), [(0, 1, 1, 50), (1, 4, 100, 60), (5, 7, 13, 150)])
def test_pulses_are_as_armed_to_the_clock(chip: Chip, skip: int, pulses: int, delay_us: int, width_us: int) -> None:
    start(chip, skip, 1, pulses, delay_us, width_us)
    edges = chip.syncs(skip + pulses + 3, 200)
    assert late(chip, edges[skip : skip + pulses], delay_us) == [0] * pulses
    assert chip.widths() == [width_us * US] * pulses


def test_the_longest_delay_and_width_at_60_hz_are_exact_and_no_delay_is_late_by_less_than_a_tenth_of_a_us(
    chip: Chip,
) -> None:
    start(chip, 0, 1, 1, 15_000, 16_000)
    edges = chip.syncs(2, 16_667, 124)
    assert late(chip, edges[:1], 15_000) == [0]
    assert chip.widths() == [16_000 * US]
    chip.scope.clear()
    start(chip, 0, 1, 3, 0, 50)
    edges = chip.syncs(4, 200)
    assert set(late(chip, edges[:3], 0)) == {pio.GATE_CYCLES + pio.SYNCHRONISER_CYCLES}
    assert (pio.GATE_CYCLES + pio.SYNCHRONISER_CYCLES) / US < 0.1


def test_a_sync_that_is_high_at_the_start_is_not_counted(chip: Chip) -> None:
    chip.sync(1)
    chip.run(10)
    start(chip, 0, 1, 1, 10, 50)
    chip.run(100 * US)
    assert not chip.scope
    chip.sync(0)
    chip.run(10 * US)
    edges = chip.syncs(2, 200)
    assert late(chip, edges[:1], 10) == [0]


@pytest.mark.parametrize("every", [1, 60])
def test_live_pulses_come_on_every_so_many_syncs_and_do_not_end(chip: Chip, every: int) -> None:
    start(chip, 0, every, None, 5, 50)
    edges = chip.syncs(2 * every + 11, 100)
    assert late(chip, edges[::every], 5) == [0] * len(edges[::every])


STAMP_DIVIDER = CLOCK_HZ // pio.STAMP_HZ


def stamping(chip: Chip, machine: int = 2, pin: int = VSYNC, at: int = 0) -> int:
    """Start a stamper; return the clock at which its count begins."""
    chip.load(machine, pio.STAMP, at, divider=STAMP_DIVIDER, jmp_pin=pin)
    chip.enable(chip.enabled | 1 << machine)
    return chip.now


def off_us(stamp: int, cycles: int) -> float:
    return stamp - pio.STAMP_AHEAD_US - cycles / US


def test_stamps_are_right_to_a_microsecond_for_ever(chip: Chip) -> None:
    began = stamping(chip)
    stamps, edges = [], []
    for gap_us, width_us in [(37, 1), (100, 3), (911, 124), (5, 2), (13, 7), (2000, 1000), (3, 2), (59, 31)] * 6:
        chip.run(gap_us * US + 17)
        edges.append(chip.now)
        chip.sync(1)
        chip.run(width_us * US + 40)
        chip.sync(0)
        stamps += chip.got(2)
    assert len(stamps) == len(edges)
    errors_us = [off_us(stamp, edge - began) for stamp, edge in zip(stamps, edges, strict=True)]
    assert min(errors_us) > -0.45
    assert max(errors_us) < 0.65


def test_stamps_that_nobody_reads_are_dropped_and_the_clock_goes_on(chip: Chip) -> None:
    began = stamping(chip)
    chip.syncs(12, 100)
    assert len(chip.got(2)) == 4, "the emulator does not join FIFOs; the chip's has eight"
    assert chip.read(0x08) >> 2 & 1, "FDEBUG tells it"
    (edge,) = chip.syncs(1, 100)
    (stamp,) = chip.got(2)
    assert abs(off_us(stamp, edge - began)) < 0.65


def test_all_programs_run_at_once_and_the_trigger_line_is_stamped_too(chip: Chip) -> None:
    at = len(pio.GATE.words) + len(pio.PULSE.words)
    stamping(chip, 2, VSYNC, at)
    began = stamping(chip, 3, TRIGGER, at)
    start(chip, 1, 1, 3, 40, 60)
    edges = chip.syncs(4, 200)
    syncs, pulses = chip.got(2), chip.got(3)
    assert late(chip, edges[1:], 40) == [0, 0, 0]
    assert len(syncs) == 4
    assert all(abs(off_us(stamp, rise - began)) < 0.65 for stamp, rise in zip(pulses, chip.rises(), strict=True))
    assert all(abs(pulse - sync - 40) <= 1 for pulse, sync in zip(pulses, syncs[1:], strict=True))
    assert not chip.syncs(2, 200)[2:]
    assert len(chip.got(2)) == 2
    assert not chip.got(3)


def test_the_programs_fit_one_block_and_numbers_that_do_not_are_refused() -> None:
    assert len(pio.GATE.words) + len(pio.PULSE.words) + len(pio.STAMP.words) <= 32
    with pytest.raises(ValueError, match="delay_us=200000, every=1"):
        pio.gate_words(0, 1, 200_000, CLOCK_HZ)
    with pytest.raises(ValueError, match="every=257"):
        pio.gate_words(0, 257, 0, CLOCK_HZ)
    assert pio.gate_words(0, 60, 15_000, 150_000_000)[1] >> 24 == 59, "RP2350 at 150 MHz"


@pytest.mark.parametrize(
    ("stamp", "now_us", "time_us"),
    [
        (11, 1015, 1010),
        (0xFFFF_FFFF, 1000 + (1 << 32), 1000 + (1 << 32) - 2),
        (4, 1000 + (5 << 32) + 40, 1003 + (5 << 32)),
        (0, 1000 + (5 << 32) + 40, 999 + (5 << 32)),
        (13, 1011, 1012),
    ],
    ids=["young", "last before the wrap", "sixth turn", "behind the wrap", "ahead of the clock"],
)
def test_a_stamp_is_extended_to_the_boards_clock(stamp: int, now_us: int, time_us: int) -> None:
    assert pio.stamp_us(stamp, 1000, now_us) == time_us
