"""Owns which delays and exposures are worth trying on a projector, and which of the good ones are offered."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from appliance.bringup.light import SLICE_US, LightTiming, Profile, light_within
from appliance.bringup.response_check import ResponseShape
from appliance.scan.exposure import STEPS_MS

LEAST_US, MOST_US = 500, 16_000
"""Exposures that a scan may have; the longest is the widest pulse of the board."""
USUAL_DELAY_US = 500
MOST_DELAY_US = 15_000
MARGIN_US = 100
"""Time between the end of an exposure and the next picture's light."""
FEWEST = 6
"""Number of combinations that are measured however little the light of single bits promises."""
UNPROMISING = 0.06
"""Worst distance from a straight line, as single bits foretell it, from which a combination is not tried: dim bits are uncertain by some percent."""
NOT_ADDED = 0.1
"""Largest difference of all bits together from white, as a share."""
BRIGHTER = 1.1
"""Least ratio of light from one offered exposure to the next: where the lamp is dark, longer ones bring nothing."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A delay and an exposure, µs."""

    delay_us: int
    exposure_us: int


@dataclass(frozen=True, slots=True)
class Offer:
    """A delay and the exposures that are good with it, for the rig file."""

    delay_us: int
    exposures_us: tuple[int, ...]


def trials(timing: LightTiming, sub_frames: int, period_us: float) -> tuple[Trial, ...]:
    """Return the combinations to be measured."""
    begins = timing.begins_us if timing.overhangs(period_us) else 0.0
    end_us = period_us + max(0.0, begins)
    if sub_frames > 1:
        # At a boundary, or a sub-frame is cut at both ends.
        delays = [max(0, round(timing.begins_us))]
        times = [round(k * period_us / sub_frames) for k in range(1, sub_frames + 1)]
    else:
        before = max(0, SLICE_US // 5 * math.floor((timing.begins_us - SLICE_US) / (SLICE_US // 5)))
        delays = [before] if before <= USUAL_DELAY_US else [before, USUAL_DELAY_US]
        if begins > 0.0:
            delays = [50 * math.ceil(begins / 50.0)]
        times = [round(1000.0 * step) for step in STEPS_MS]
    found = set()
    for delay_us in delays:
        # All of the light, from before its first window until after the last.
        whole = [] if sub_frames > 1 else [100 * math.ceil((timing.ends_us + SLICE_US - delay_us) / 100.0)]
        for exposure_us in (*times, *whole):
            fits = LEAST_US <= exposure_us <= MOST_US and delay_us + exposure_us <= end_us - MARGIN_US
            if fits and delay_us <= MOST_DELAY_US:
                found.add(Trial(delay_us, exposure_us))
    return tuple(sorted(found, key=lambda one: (one.delay_us, one.exposure_us)))


def promising(wanted: Sequence[Trial], profiles: Mapping[int, Profile], first_us: float) -> tuple[Trial, ...]:
    """Return those of ``wanted`` that may be straight by the light of each bit in their window, and at least a few.

    ``profiles`` are those of codes, from the blank of the flip on; delays count from ``first_us``. Where a bit was not measured, or bits do
    not add up to white, nothing can be foretold, and all are returned.
    """
    bits = [2**k for k in range(8)]
    if any(bit not in profiles for bit in bits) or len(wanted) <= FEWEST:
        return tuple(wanted)
    together = sum(float(profiles[bit].sum()) for bit in bits)
    if abs(together - float(profiles[255].sum())) > NOT_ADDED * together:
        return tuple(wanted)
    # A code is the sum of its bits, each as bright as the window lets it through.
    codes = np.arange(256)
    off = {}
    for trial in wanted:
        begins_us = first_us + trial.delay_us
        weights = [light_within(profiles[bit], begins_us, begins_us + trial.exposure_us) for bit in bits]
        light = sum(weight * ((codes >> k) & 1) for k, weight in enumerate(weights))
        line = np.polyval(np.polyfit(codes, light, 1), codes)
        off[trial] = float(np.abs(light - line).max()) / max(sum(weights), 1e-9)
    # Never none: what is refused must have been seen, or its remedy could not say by how much.
    ranked = sorted(off, key=lambda trial: off[trial])
    kept = {trial for k, trial in enumerate(ranked) if k < FEWEST or off[trial] < UNPROMISING}
    return tuple(trial for trial in wanted if trial in kept)


def offered(measured: Mapping[Trial, ResponseShape], light_of: Callable[[Trial], float]) -> Offer | None:
    """Return the delay with the most good exposures, and those of them that differ in light; ``None``: none is good.

    ``light_of`` tells how much of a white picture's light a trial sees, in any unit: images that are partly saturated cannot.
    """
    offers = []
    for delay_us in sorted({trial.delay_us for trial in measured}):
        good = [
            (t.exposure_us, light_of(t)) for t, shape in measured.items() if t.delay_us == delay_us and shape.usable
        ]
        kept = _different(sorted(good))
        if kept:
            # More exposures to choose from first, then more light: a single long one leaves nothing to propose.
            offers.append((len(kept), kept[-1][1], Offer(delay_us, tuple(time for time, _ in kept))))
    return max(offers, key=lambda one: one[:2])[2] if offers else None


def _different(good: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    kept: list[tuple[int, float]] = []
    for time_us, light in good:
        if not kept or light > BRIGHTER * kept[-1][1]:
            kept.append((time_us, light))
    return kept
