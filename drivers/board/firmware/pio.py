"""The programs of the PIO: counting syncs, begin and end of pulses, and their time stamps.

Three programs fill one block's 32 words, see ``docs/build/firmware.md``. GATE and PULSE run at the system clock and
share flag 4; STAMP runs twice at 5 MHz, five clocks a turn: on the sync and on the trigger line. Words as in the RP2040
datasheet, section 3.4; RP2350 has the same.
"""

STAMP_HZ = 5_000_000
"""One turn of STAMP is five clocks: 1 us."""
STAMP_AHEAD_US = 1
"""A stamp includes the turn in which the edge is seen: 0.6 to 1.6 us more than have passed."""
FLAG = 4
LARGEST_DELAY_CYCLES = (1 << 24) - 1
GATE_CYCLES = 7
"""Clocks from the sync at the pin's synchroniser to the trigger line, when the gate's loop turns once."""
SYNCHRONISER_CYCLES = 2
"""Flip-flops between the pin and the PIO (section 3.5.6.3)."""
PULSE_CYCLES = 2
"""Clocks by which a pulse is longer than its loop's counter."""

# Conditions of JMP, registers of MOV and OUT.
_ALWAYS, _X_DEC, _Y_DEC, _PIN = 0, 2, 4, 6
_X, _Y, _NULL, _ISR, _OSR = 1, 2, 3, 6, 7


def _jmp(condition: int, target: int, delay: int = 0) -> int:
    return delay << 8 | condition << 5 | target


def _wait_pin(level: int) -> int:
    return 0x2000 | level << 7 | 1 << 5


def _wait_flag(flag: int) -> int:
    return 0x2000 | 1 << 7 | 2 << 5 | flag


def _out(register: int, bits: int) -> int:
    return 0x6000 | register << 5 | bits & 31


def _mov(to: int, source: int, inverted: bool = False) -> int:
    return 0xA000 | to << 5 | (0x08 if inverted else 0) | source


def _set_pin(level: int) -> int:
    return 0xE000 | level


def _raise_flag(flag: int) -> int:
    return 0xC000 | flag


_PULL, _PUSH_IF_ROOM = 0x80A0, 0x8000


LAST_PULSE = 0xE040
"""SET Y, 0: executed from outside during a pulse, it makes PULSE take new numbers when that pulse is over."""


class Program:
    """The words of a program, and where its endless part begins."""

    def __init__(self, instructions: tuple[int, ...], wrap_target: int) -> None:
        self.words = instructions
        self.wrap_target = wrap_target


GATE = Program(
    (
        _PULL,
        _mov(_Y, _OSR),  # syncs to pass over
        _PULL,
        _mov(_ISR, _OSR),  # bits 0..23: clocks of delay; 24..31: syncs between pulses
        _wait_pin(0),
        _wait_pin(1),
        _jmp(_Y_DEC, 4),
        _mov(_OSR, _ISR),
        _out(_X, 24),
        _jmp(_X_DEC, 9),
        _raise_flag(FLAG),
        _out(_Y, 8),
    ),
    4,
)
"""Counts syncs and raises the flag after the delay: armed start, every and delay."""

PULSE = Program(
    (
        _PULL,
        _mov(_Y, _OSR),  # pulses - 1
        _PULL,
        _mov(_ISR, _OSR),  # clocks of width
        _mov(_X, _ISR),
        _wait_flag(FLAG),
        _set_pin(1),
        _jmp(_X_DEC, 7),
        _set_pin(0),
        _jmp(_Y_DEC, 4),
    ),
    0,
)
"""Makes one pulse for each flag, up to its count, and then waits for new numbers: count and width."""

STAMP = Program(
    (
        _mov(_X, _NULL, inverted=True),
        _jmp(_X_DEC, 2),  # low: one turn is five clocks on every way
        _jmp(_PIN, 4),
        _jmp(_ALWAYS, 1, delay=2),
        _mov(_ISR, _X, inverted=True),
        _PUSH_IF_ROOM | 1 << 8,
        _jmp(_X_DEC, 7),  # high
        _jmp(_PIN, 9),
        _jmp(_ALWAYS, 1, delay=2),
        _jmp(_ALWAYS, 6, delay=2),
    ),
    0,
)
"""Counts microseconds downwards in X and hands out the number of those passed at each rising edge."""


def gate_words(skip: int, every: int, delay_us: int, clock_hz: int) -> tuple[int, int]:
    """Return the words that GATE pulls.

    Raises ValueError for a delay above 24 bit of clocks, or every beyond 1..256.
    """
    cycles = max(delay_us * (clock_hz // 1_000_000) - GATE_CYCLES - SYNCHRONISER_CYCLES, 0)
    if cycles > LARGEST_DELAY_CYCLES or not 1 <= every <= 256:
        raise ValueError(f"delay_us={delay_us}, every={every}: they do not fit into the gate's word")
    return skip & 0xFFFFFFFF, every - 1 << 24 | cycles


def pulse_words(pulses: int | None, width_us: int, clock_hz: int) -> tuple[int, int]:
    """Return the words that PULSE pulls; without a number of pulses it is two years of syncs."""
    return (0xFFFFFFFF if pulses is None else pulses - 1), width_us * (clock_hz // 1_000_000) - PULSE_CYCLES


def stamp_us(stamp: int, began_us: int, now_us: int) -> int:
    """Return the time of a 32-bit stamp on the 64-bit clock.

    Its count began at ``began_us`` and wraps each 71 minutes.
    """
    ago_us = now_us - began_us - stamp + STAMP_AHEAD_US & 0xFFFFFFFF
    # A stamp may be slightly later than the clock, which was read before.
    if ago_us & 0x80000000:
        ago_us -= 1 << 32
    return now_us - ago_us
