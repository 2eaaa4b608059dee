"""Errors of clocks, trigger lines and time stamps in the world ``outside``.

The ordinary world's crystals are off by a constant; these wander as well, and every edge has jitter.
"""

# Symbols:
#   x         time by which a clock is ahead of its constant rate, s
#   y         fractional frequency offset, an Ornstein-Uhlenbeck process: dy = −y dt / τ + √(2/τ) · wander · dW
#   white     frequency noise without memory, which makes x a random walk: dx = y dt + walk · dW

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hw_sim.ranges import Range, drawn_strengths

CORRELATION_S = 60.0
"""Correlation time τ of a crystal's frequency: about that of a small case that warms and cools (an estimate)."""
STEP_S = 0.1
"""Step of the wander, which is linear in between."""
AT_ONCE = 3000
"""Number of steps that are drawn at a time."""

RANGES = {
    "board_jitter_us": Range(
        0.5,
        12.0,
        "estimate: other handlers of a busy microcontroller; the core itself needs up to 15 cycles (Cortex-M0+, TI SWCU193)",
    ),
    "camera_jitter_us": Range(
        0.2,
        5.0,
        "estimate: below one row time; makers state a delay of the exposure (Basler: BslExposureStartDelay), not its jitter",
    ),
    "wander_ppm": Range(
        0.05,
        2.0,
        "estimate: a crystal of ±10 to 50 ppm over its temperatures (AT cut, a cubic: J. R. Vig's tutorial on quartz, 2014) in a case that warms by some K",
    ),
    "walk_us": Range(0.01, 0.5, "estimate: white frequency noise of quartz and PLL, µs per √s"),
    "stamps_at_end": Range(
        0.0,
        1.0,
        "both are met: ChunkTimestamp is the frame's start (GenICam SFNC), others stamp when the exposure has ended (so the makers of the depthai library say of theirs); half of the drawn worlds",
    ),
}
"""Ranges of the family ``clocks``; ``stamps_at_end`` is rounded to 0 or 1."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """The errors of clocks and trigger lines; zero is no error. Raises ValueError for impossible numbers."""

    board_jitter_us: float = 0.0
    """Standard deviation of the time of each trigger pulse; its report has the true time."""
    camera_jitter_us: float = 0.0
    """Standard deviation of the moment at which each camera begins an exposure after the pulse's edge."""
    wander_ppm: float = 0.0
    """Standard deviation of each clock's rate about its constant one; it wanders with ``CORRELATION_S``."""
    walk_us: float = 0.0
    """Random walk of each clock, µs after one second; it grows with the root of the time."""
    stamps_at_end: int = 0
    """1: the cameras stamp the end of an exposure; 0: its start."""

    def __post_init__(self) -> None:
        for name in ("board_jitter_us", "camera_jitter_us", "wander_ppm", "walk_us"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1000.0:
                raise ValueError(f"clocks: {name} = {value}; allowed are 0..1000")
        if self.stamps_at_end not in (0, 1):
            raise ValueError(f"clocks: stamps_at_end = {self.stamps_at_end}; allowed are 0 (start of exposure) and 1")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Clocks:
        """Return strengths drawn from ``RANGES``."""
        values = drawn_strengths(RANGES, rng)
        assert set(values) == {f.name for f in fields(cls)}
        return cls(
            values["board_jitter_us"],
            values["camera_jitter_us"],
            values["wander_ppm"],
            values["walk_us"],
            round(values["stamps_at_end"]),
        )


class Wander:
    """The wander of one clock about its constant rate; the same seed gives the same wander."""

    def __init__(self, clocks: Clocks, seed: tuple[int, ...]) -> None:
        self._clocks = clocks
        self._rng = np.random.default_rng(seed)
        self._rate = float(self._rng.standard_normal()) * clocks.wander_ppm * 1e-6
        self._ahead_s: NDArray[np.float64] = np.zeros(1)

    def ahead_ns(self, since_ns: int) -> int:
        """Return the time by which the clock is ahead of its constant rate, ``since_ns`` after time 0 (≥ 0)."""
        steps = max(since_ns, 0) / (STEP_S * 1e9)
        k = int(steps)
        while k + 1 >= self._ahead_s.size:
            self._extend()
        low, high = self._ahead_s[k], self._ahead_s[k + 1]
        return round(1e9 * float(low + (high - low) * (steps - k)))

    def _extend(self) -> None:
        # Exact discretisation of dy = −y dt / τ + …: y' = a y + √(1 − a²) · wander · N, a = exp(−step / τ).
        keep = math.exp(-STEP_S / CORRELATION_S)
        kick = math.sqrt(1.0 - keep * keep) * self._clocks.wander_ppm * 1e-6
        deviates = self._rng.standard_normal((AT_ONCE, 2))
        walk = deviates[:, 1] * (self._clocks.walk_us * 1e-6 * math.sqrt(STEP_S))
        rates = np.empty(AT_ONCE)
        for i in range(AT_ONCE):
            rates[i] = self._rate
            self._rate = keep * self._rate + kick * float(deviates[i, 0])
        self._ahead_s = np.concatenate([self._ahead_s, self._ahead_s[-1] + np.cumsum(rates * STEP_S + walk)])
