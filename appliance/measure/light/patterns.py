"""The patterns and their sequence: Gray code and sine fringes in two directions, bright and dark."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from itertools import zip_longest
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.response import Response
from appliance.measure.light.sine import AMPLITUDE_CODE, MEAN_CODE, PHASE_STEPS, fringe


def bit_count(size_px: int, period_px: int) -> int:
    """Return the number of Gray-code images that number all half periods over ``size_px``.

    It is 7, 6, 5 for 16, 32, 64 px on 1024, and one more of each on 1280.
    """
    # Rounded up: a part of a period at the far edge has a number, too.
    half_periods = -(-2 * size_px // period_px)
    return max(1, (half_periods - 1).bit_length())


def gray_bit(size_px: int, period_px: int, bit: int) -> NDArray[np.bool_]:
    """Return which pixels of ``size_px`` are bright in the image of bit ``bit``: shape (size_px,) bool.

    Bit 0 is the most significant of the reflected binary code.
    """
    # At the pixels' left edges, while `sine.fringe` uses their centres: for even periods both change between the same
    # pixels.
    half_period = 2 * np.arange(size_px, dtype=np.int64) // period_px
    # Reflected binary code: n xor n/2.
    code = half_period ^ (half_period >> 1)
    shift = bit_count(size_px, period_px) - 1 - bit
    return (code >> shift & 1).astype(np.bool_)


def inverse_gray(bits: int) -> NDArray[np.int16]:
    """Return the table from Gray code to half-period number: shape (2**bits,) int16."""
    number = np.arange(1 << bits, dtype=np.int64)
    table = np.empty(1 << bits, dtype=np.int16)
    table[number ^ (number >> 1)] = number.astype(np.int16)
    return table


STEP_DEG = 360 // PHASE_STEPS


def sine_codes(size_px: int, period_px: int, step: int) -> NDArray[np.uint8]:
    """Return the codes of step ``step`` (0..3) of a fringe pattern: shape (size_px,) uint8, rounded to nearest."""
    return np.rint(MEAN_CODE + AMPLITUDE_CODE * fringe(size_px, period_px, step)).astype(np.uint8)


PERIODS_PX = (16, 32, 64)
BRIGHT_CODE = 247
DARK_CODE = 0
REFERENCES = 2
"""Number of frames before those of X: bright and dark."""
STEPS = (0, 1, 3, 2)
"""Order in which the steps of 90° are projected: 0°, 90°, 270°, 180°.

Sine and cosine of the phase follow from the pairs (90°, 270°) and (0°, 180°), which have the same middle in time in
this order: uniform motion shifts both alike, and makes no ripple.
"""
RISING_STEPS = (0, 1, 2, 3)
"""Rising order: 0°, 90°, 180°, 270°. Motion of a px from frame to frame makes a ripple of half a px."""
STEP_ORDERS = (STEPS, RISING_STEPS)
"""Orders in which a sequence may project its steps of 90°: that of the instrument, and the rising one."""


class Direction(Enum):
    """The pattern coordinate along which a pattern varies."""

    X = "x"
    """Varies from column to column: vertical stripes."""
    Y = "y"
    """Varies from row to row: horizontal stripes."""


class Kind(Enum):
    BRIGHT = "bright"
    DARK = "dark"
    GRAY = "gray"
    SINE = "sine"


@dataclass(frozen=True, slots=True)
class Pattern:
    """One frame of the sequence. ``index`` is the Gray bit (0 = most significant) or the sine step (0..3)."""

    kind: Kind
    direction: Direction
    index: int
    period_px: int
    size_px: int
    """Length of the varying axis."""

    @property
    def name(self) -> str:
        """Short name for manifests, reports and pictures: ``bright``, ``gray-x-0``, ``sine-y-270``."""
        match self.kind:
            case Kind.BRIGHT | Kind.DARK:
                return "bright" if self.kind is Kind.BRIGHT else "dark"
            case Kind.GRAY:
                return f"gray-{self.direction.value}-{self.index}"
            case Kind.SINE:
                return f"sine-{self.direction.value}-{STEP_DEG * self.index}"
            case unknown:
                assert_never(unknown)

    def codes(self, response: Response | None = None) -> NDArray[np.uint8]:
        """Return the 8-bit codes along the varying axis: shape (size_px,) uint8.

        Gray stripes use the bright code. With the projector's ``response`` the light of sine fringes is a sine, without
        it their codes are.
        """
        match self.kind:
            case Kind.BRIGHT:
                return np.full(self.size_px, BRIGHT_CODE, np.uint8)
            case Kind.DARK:
                return np.full(self.size_px, DARK_CODE, np.uint8)
            case Kind.GRAY:
                is_bright = gray_bit(self.size_px, self.period_px, self.index)
                return np.where(is_bright, BRIGHT_CODE, DARK_CODE).astype(np.uint8)
            case Kind.SINE:
                draw = sine_codes if response is None else response.sine_codes
                return draw(self.size_px, self.period_px, self.index)
            case unknown:
                assert_never(unknown)


@dataclass(frozen=True, slots=True)
class Axis:
    """Frame numbers of one direction in the sequence."""

    direction: Direction
    size_px: int
    gray: tuple[int, ...]
    """Frame numbers of the Gray-code images, most significant bit first."""
    sine: tuple[int, int, int, int]
    """Frame numbers of the steps 0°, 90°, 180°, 270°, regardless of the order of projection."""

    @property
    def last(self) -> int:
        """Frame number of the last image of this direction."""
        return max(self.sine)

    @property
    def pair_frames(self) -> tuple[int, int]:
        """Frames from the step 0° to that of 180°, which give the cosine, and from 90° to 270°, for the sine."""
        zero, quarter, half, three = self.sine
        return half - zero, three - quarter


@dataclass(frozen=True, slots=True)
class PatternSequence:
    """All patterns of a scan in the order of projection.

    Decoders, judges and compensation may rely on this, and on nothing else
    (``docs/adr/0039-what-a-sequence-promises.md``):

    * the bright and the dark reference are the first two frames, in either order;
    * there are two directions: every frame that varies along X comes before every one that varies along Y, and the last
      frame of Y is the last of all;
    * a direction begins with its Gray-code images, the most significant bit first, as many as number all half periods;
    * they are followed at once by four sine images, 90° apart, in the order ``STEPS`` or ``RISING_STEPS``, the same in
      both directions;
    * all have the same period and each the size of its axis.

    Raises ValueError for another sequence, with the first frame that is wrong.
    """

    period_px: int
    width_px: int
    height_px: int
    patterns: tuple[Pattern, ...]

    def __post_init__(self) -> None:
        bright, dark, *varying = _promised(self.period_px, self.width_px, self.height_px, self.steps)
        # Either order of the references keeps the promise (ADR 0039).
        references = (dark, bright) if self.patterns[:1] == (dark,) else (bright, dark)
        for k, (expected, pattern) in enumerate(zip_longest((*references, *varying), self.patterns)):
            if expected != pattern:
                raise ValueError(
                    f"frame {k} of the sequence: {_named(pattern)}; {_named(expected)} belongs there (class "
                    "PatternSequence)"
                )

    @classmethod
    def of_names(cls, period_px: int, width_px: int, height_px: int, names: tuple[str, ...]) -> PatternSequence:
        """Return the sequence whose patterns have these ``names``, in the order of projection.

        Raises ValueError if no sequence has them.
        """
        for steps in STEP_ORDERS:
            built = build_sequence(period_px, width_px, height_px, steps)
            bright, dark, *varying = built.patterns
            for patterns in (built.patterns, (dark, bright, *varying)):
                if tuple(pattern.name for pattern in patterns) == names:
                    return replace(built, patterns=patterns)
        raise ValueError(
            f"patterns {', '.join(names)}: no sequence of {period_px} px on {width_px} × {height_px}; allowed are "
            f"{', '.join(pattern.name for pattern in built.patterns)}, or the steps of 90° in rising order"
        )

    def __len__(self) -> int:
        return len(self.patterns)

    @property
    def steps(self) -> tuple[int, ...]:
        """Order in which the steps of 90° were projected: ``RISING_STEPS`` or ``STEPS``."""
        first = REFERENCES + bit_count(self.width_px, self.period_px)
        shown = tuple(pattern.index for pattern in self.patterns[first : first + PHASE_STEPS])
        return RISING_STEPS if shown == RISING_STEPS else STEPS

    @property
    def bright(self) -> int:
        """Frame number of the bright reference."""
        return 0 if self.patterns[0].kind is Kind.BRIGHT else 1

    @property
    def dark(self) -> int:
        """Frame number of the dark reference."""
        return 1 - self.bright

    def __hash__(self) -> int:
        # These determine the patterns; hashing two dozen patterns would slow down every cache lookup.
        return hash((self.period_px, self.width_px, self.height_px, self.bright, self.steps))

    def axis(self, direction: Direction) -> Axis:
        """Return the frame numbers that encode ``direction``."""
        # Computed, not searched, since it is called for each frame and by each judge.
        size, first = self.width_px, REFERENCES
        bits = bit_count(size, self.period_px)
        if direction is Direction.Y:
            size, first = self.height_px, first + bits + PHASE_STEPS
            bits = bit_count(size, self.period_px)
        sine, order = first + bits, self.steps
        zero, quarter, half, three = (sine + order.index(step) for step in range(PHASE_STEPS))
        return Axis(direction, size, tuple(range(first, sine)), (zero, quarter, half, three))


def build_sequence(
    period_px: int, width_px: int = 1024, height_px: int = 768, steps: tuple[int, ...] = STEPS
) -> PatternSequence:
    """Return the sequence for a fringe period.

    It has 24, 22 or 20 frames for 16, 32 or 64 px on 1024 × 768, one more on 1280 × 720. Any period ≥ 4 px is accepted
    here (also no power of two); the rig file restricts the choice. Raises ValueError for a period outside 4..size.
    """
    if not 4 <= period_px <= min(width_px, height_px):
        raise ValueError(
            f"fringe period {period_px} px; allowed are 4..{min(width_px, height_px)} px; choose one of {PERIODS_PX}"
        )
    return PatternSequence(period_px, width_px, height_px, tuple(_promised(period_px, width_px, height_px, steps)))


def _promised(period_px: int, width_px: int, height_px: int, steps: tuple[int, ...]) -> list[Pattern]:
    """Return the patterns in the order that ``PatternSequence`` promises."""
    patterns = [
        Pattern(Kind.BRIGHT, Direction.X, 0, period_px, width_px),
        Pattern(Kind.DARK, Direction.X, 0, period_px, width_px),
    ]
    # The references have X as their direction although they do not vary, since a Pattern needs one.
    for direction, size_px in ((Direction.X, width_px), (Direction.Y, height_px)):
        patterns += [
            Pattern(Kind.GRAY, direction, bit, period_px, size_px) for bit in range(bit_count(size_px, period_px))
        ]
        patterns += [Pattern(Kind.SINE, direction, step, period_px, size_px) for step in steps]
    return patterns


def _named(pattern: Pattern | None) -> str:
    return "nothing" if pattern is None else f"{pattern.name} ({pattern.size_px} px, period {pattern.period_px} px)"
