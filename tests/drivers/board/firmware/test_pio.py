"""The PIO programs cycle by cycle in an RP2040 emulator: when pulses begin, how long they last, which syncs they follow.

Two things the emulator does not spend time on, and the chip does: two flip-flops between pin and PIO, and one clock for each
WAIT that ends at once. Both are added where a pulse is compared with its sync; together they are 32 ns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.board.firmware import pio
from drivers.board.firmware.pins import gpio

pytestmark = pytest.mark.devices

CLOCK_HZ = 125_000_000
US = CLOCK_HZ // 1_000_000
VSYNC, TRIGGER = gpio("VSYNC"), gpio("TRIGGER")
GATE, PULSE = 0, 1
WAITS = 2
"""Between a sync and its pulse: that for the pin, and that for the flag."""
PIO0_BASE = 0x50200000
PIO0 = 6
"""Function of a GPIO."""
INPUT_ENABLED = 0x40
CTRL, FSTAT, TXF0, RXF0, IRQ, INSTR_MEM0 = 0x00, 0x04, 0x10, 0x20, 0x30, 0x48
CLKDIV, EXECCTRL, SHIFTCTRL, INSTR, PINCTRL = 0xC8, 0xCC, 0xD0, 0xD8, 0xDC
"""Of state machine 0; the others follow 0x18 apart (RP2040 datasheet, table 366)."""
JOIN_RX, OUT_RIGHT, IN_RIGHT = 1 << 31, 1 << 19, 1 << 18


@dataclass
class Chip:
    """One PIO block with its programs, a sync source and an oscilloscope on the trigger line."""

    scope: list[tuple[int, int]] = field(default_factory=list)
    """(clock, level) of each change of the trigger line."""
    now: int = 0
    enabled: int = 0

    def __post_init__(self) -> None:
        simulator = pytest.importorskip("rp2040py.simulator", reason="./dev installs rp2040py")
        self._simulator: Any = simulator.Simulator()
        self._chip: Any = self._simulator.rp2040
        self._block: Any = self._chip.pio[0]
        self._chip.gpio[VSYNC].pad_value |= INPUT_ENABLED
        self._chip.gpio[TRIGGER].pad_value |= INPUT_ENABLED
        self._chip.gpio[TRIGGER].ctrl = PIO0
        self._chip.gpio[TRIGGER].add_listener(self._seen)
        self.sync(0)
        self._chip.gpio[TRIGGER].set_input_value(False)

    def _seen(self, state: Any, _: Any) -> None:
        level = int(state == 1)
        if level == (self.scope[-1][1] if self.scope else 0):
            return
        self.scope.append((self.now, level))
        # The pad reads back what it drives.
        self._chip.gpio[TRIGGER].set_input_value(bool(level))

    def write(self, offset: int, value: int) -> None:
        self._chip.write_uint32(PIO0_BASE + offset, value)

    def read(self, offset: int) -> int:
        return int(self._chip.read_uint32(PIO0_BASE + offset))

    def control(self, pin: int) -> int:
        return int(self._chip.gpio[pin].ctrl)

    def set_control(self, pin: int, value: int) -> None:
        self._chip.gpio[pin].ctrl = value

    def sync(self, level: int) -> None:
        self._chip.gpio[VSYNC].set_input_value(bool(level))

    def load(self, machine: int, program: pio.Program, at: int, **pins: int) -> None:
        """Put ``program`` to address ``at`` and set a machine up as MicroPython's StateMachine does; not yet running."""
        self.enable(self.enabled & ~(1 << machine))
        for i, word in enumerate(program.words):
            jumps = word >> 13 == 0
            self.write(INSTR_MEM0 + 4 * (at + i), word + (at if jumps else 0))
        base = 0x18 * machine
        last = at + len(program.words) - 1
        self.write(CLKDIV + base, pins.get("divider", 1) << 16)
        self.write(EXECCTRL + base, pins.get("jmp_pin", 0) << 24 | last << 12 | (at + program.wrap_target) << 7)
        self.write(SHIFTCTRL + base, (JOIN_RX if "jmp_pin" in pins else 0) | OUT_RIGHT | IN_RIGHT)
        self.write(PINCTRL + base, 1 << 26 | VSYNC << 15 | TRIGGER << 5)
        self.write(CTRL, self.enabled | 1 << 4 + machine)
        # SET PINDIRS, then a jump to the program's beginning, as instructions from outside.
        self.write(INSTR + base, 0xE081)
        self.write(INSTR + base, at)

    def enable(self, mask: int) -> None:
        self.enabled = mask
        self.write(CTRL, mask)

    def put(self, machine: int, words: Sequence[int]) -> None:
        for word in words:
            self.write(TXF0 + 4 * machine, word)

    def got(self, machine: int) -> list[int]:
        """Return what the machine has pushed."""
        words = []
        while not self.read(FSTAT) >> 8 + machine & 1:
            words.append(self.read(RXF0 + 4 * machine))
        return words

    def run(self, cycles: int) -> None:
        """Clock the block, one cycle at a time wherever a machine has something to do."""
        block, end = self._block, self.now + cycles
        while self.now < end:
            block.advance(1)
            self.now += 1

    def syncs(self, count: int, period_us: int, width_us: int = 20) -> list[int]:
        """Run through so many periods, each beginning with a sync; return the clocks of the rising edges."""
        edges = []
        for _ in range(count):
            edges.append(self.now)
            self.sync(1)
            self.run(width_us * US)
            self.sync(0)
            self.run((period_us - width_us) * US)
        return edges

    def rises(self) -> list[int]:
        return [clock for clock, level in self.scope if level]

    def widths(self) -> list[int]:
        return [b[0] - a[0] for a, b in zip(self.scope[::2], self.scope[1::2], strict=True)]

    def start(self, skip: int, every: int, pulses: int | None, delay_us: int, width_us: int) -> None:
        """Do what the board's ``start`` does."""
        self.load(GATE, pio.GATE, 0)
        self.load(PULSE, pio.PULSE, len(pio.GATE.words))
        self.write(IRQ, 1 << pio.FLAG)
        self.put(GATE, pio.gate_words(skip, every, delay_us, CLOCK_HZ))
        self.put(PULSE, pio.pulse_words(pulses, width_us, CLOCK_HZ))
        self.enable(self.enabled | 1 << GATE | 1 << PULSE)
        self.run(50)


@pytest.fixture
def chip() -> Chip:
    return Chip()


def late(chip: Chip, edges: Sequence[int], delay_us: int) -> list[int]:
    """Return by how many clocks each pulse comes later than ``delay_us`` after its sync."""
    return [
        rise + WAITS + pio.SYNCHRONISER_CYCLES - edge - delay_us * US
        for rise, edge in zip(chip.rises(), edges, strict=True)
    ]


@pytest.mark.parametrize("skip", [0, 1, 5])
@pytest.mark.parametrize(("pulses", "delay_us", "width_us"), [(1, 1, 50), (4, 100, 60), (7, 13, 150)])
def test_pulses_are_as_armed_to_the_clock(chip: Chip, skip: int, pulses: int, delay_us: int, width_us: int) -> None:
    chip.start(skip, 1, pulses, delay_us, width_us)
    edges = chip.syncs(skip + pulses + 3, 200)
    assert late(chip, edges[skip : skip + pulses], delay_us) == [0] * pulses
    assert chip.widths() == [width_us * US] * pulses


def test_the_longest_delay_and_width_at_60_hz_are_exact(chip: Chip) -> None:
    chip.start(0, 1, 2, 15_000, 16_000)
    edges = chip.syncs(4, 16_667, 124)
    assert late(chip, edges[:2], 15_000) == [0, 0]
    assert chip.widths() == [16_000 * US] * 2


def test_no_delay_is_late_by_less_than_a_tenth_of_a_microsecond(chip: Chip) -> None:
    chip.start(0, 1, 3, 0, 50)
    edges = chip.syncs(4, 200)
    assert set(late(chip, edges[:3], 0)) == {pio.GATE_CYCLES + pio.SYNCHRONISER_CYCLES}
    assert (pio.GATE_CYCLES + pio.SYNCHRONISER_CYCLES) / US < 0.1


def test_a_sync_that_is_high_at_the_start_is_not_counted(chip: Chip) -> None:
    chip.sync(1)
    chip.run(10)
    chip.start(0, 1, 1, 10, 50)
    chip.run(100 * US)
    assert not chip.scope
    chip.sync(0)
    chip.run(10 * US)
    edges = chip.syncs(2, 200)
    assert late(chip, edges[:1], 10) == [0]


@pytest.mark.parametrize("every", [1, 2, 7, 60])
def test_live_pulses_come_on_every_so_many_syncs_and_do_not_end(chip: Chip, every: int) -> None:
    chip.start(0, every, None, 5, 50)
    edges = chip.syncs(2 * every + 71, 100)
    assert late(chip, edges[::every], 5) == [0] * len(edges[::every])


def test_a_new_series_replaces_the_old_one_and_knows_nothing_of_it(chip: Chip) -> None:
    chip.start(0, 1, None, 5, 50)
    chip.syncs(3, 200)
    chip.enable(0)
    chip.write(0x34, 1 << pio.FLAG)  # a flag that nobody took
    chip.scope.clear()
    chip.start(2, 1, 2, 30, 70)
    edges = chip.syncs(6, 200)
    assert late(chip, edges[2:4], 30) == [0, 0]
    assert chip.widths() == [70 * US] * 2


def test_stopping_ends_no_pulse_early_and_begins_none(chip: Chip) -> None:
    chip.start(0, 1, 5, 10, 150)
    chip.sync(1)
    chip.run(50 * US)
    assert [level for _, level in chip.scope] == [1]
    chip.enable(1 << PULSE)
    chip.sync(0)
    chip.run(150 * US)
    chip.syncs(4, 200)
    assert chip.widths() == [150 * US]


def test_a_start_within_a_pulse_lets_it_end_and_takes_over_then(chip: Chip) -> None:
    chip.start(0, 1, None, 10, 150)
    chip.sync(1)
    chip.run(20 * US)
    chip.sync(0)
    chip.load(GATE, pio.GATE, 0)
    chip.enable(1 << PULSE)
    chip.write(INSTR + 0x18 * PULSE, pio.LAST_PULSE)
    assert chip.scope[-1][1] == 1
    chip.put(PULSE, pio.pulse_words(2, 70, CLOCK_HZ))
    chip.put(GATE, pio.gate_words(1, 1, 30, CLOCK_HZ))
    chip.enable(1 << PULSE | 1 << GATE)
    chip.run(180 * US)
    assert chip.widths() == [150 * US]
    chip.scope.clear()
    edges = chip.syncs(6, 200)
    assert late(chip, edges[1:3], 30) == [0, 0]
    assert chip.widths() == [70 * US] * 2


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
    chip.start(1, 1, 3, 40, 60)
    edges = chip.syncs(4, 200)
    syncs, pulses = chip.got(2), chip.got(3)
    assert late(chip, edges[1:], 40) == [0, 0, 0]
    assert len(syncs) == 4
    assert all(abs(off_us(stamp, rise - began)) < 0.65 for stamp, rise in zip(pulses, chip.rises(), strict=True))
    assert all(abs(pulse - sync - 40) <= 1 for pulse, sync in zip(pulses, syncs[1:], strict=True))
    assert not chip.syncs(2, 200)[2:]
    assert len(chip.got(2)) == 2
    assert not chip.got(3)


def test_the_programs_fill_one_block() -> None:
    assert len(pio.GATE.words) + len(pio.PULSE.words) + len(pio.STAMP.words) <= 32


def test_numbers_that_do_not_fit_are_refused() -> None:
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
