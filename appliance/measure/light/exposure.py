"""Owns how bright scans are taken: exposure and gain of both cameras, and the steps a diver may choose from."""

from __future__ import annotations

import math
from dataclasses import dataclass

STEPS_MS = (2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0, 10.0, 12.0, 14.0, 16.0)
"""Exposure times, about a quarter more light each. 10 ms is a whole period of lamps on 50 Hz mains, which flicker 100
times a second."""
GAIN_STEP_DB = 2.0
"""Step of the gain above the rig's own, once no longer exposure is left: a quarter more light each."""
BRIDGED = 1.14
"""Least ratio of light from a step of gain to the next longer exposure."""
MARGIN_MS = 0.1
"""Time between the end of the longest exposure and the next vertical sync."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure of both cameras, which share one trigger pulse."""

    time_us: int
    gain_db: float = 0.0

    @property
    def light(self) -> float:
        """Grey values per light are proportional to this: µs at 0 dB."""
        # Decibels of amplitude, as cameras state their gain: 20 dB are ten times the grey value.
        return float(self.time_us * 10.0 ** (self.gain_db / 20.0))

    @property
    def label(self) -> str:
        """Label of the exposure, like ``8 ms``, ``6.3 ms``, ``16 ms +4 dB``."""
        gain = f" +{self.gain_db:g} dB" if self.gain_db else ""
        return f"{self.time_us / 1000.0:g} ms{gain}"


NOMINAL = Exposure(12_000)
"""Exposure of an instrument whose rig file nobody has read."""


@dataclass(frozen=True, slots=True)
class Span:
    """Exposures that may be proposed, whatever the projector's period allows."""

    shortest_ms: float = 2.0
    longest_ms: float = 16.0
    most_gain_db: float = 12.0
    """Largest gain of all, that of the rig file included."""
    times_ms: tuple[float, ...] = STEPS_MS
    """Exposure times to choose from, for instance those that leave this projector's fringes straight."""


def ladder(refresh_hz: float, trigger_delay_us: int, gain_db: float, span: Span) -> tuple[Exposure, ...]:
    """Return all steps from dark to bright for a projector's vertical period: first longer exposures at the rig's own
    gain, and more gain only on the longest, or to bridge exposures that are far apart.

    Raises ValueError where no step fits between trigger and next vertical sync.
    """
    # Longer exposure before more gain: gain amplifies noise with the light.
    room_ms = 1000.0 / refresh_hz - trigger_delay_us / 1000.0 - MARGIN_MS
    longest_ms = min(room_ms, span.longest_ms)
    times = [round(1000.0 * step) for step in sorted(span.times_ms) if span.shortest_ms <= step <= longest_ms]
    if not times:
        raise ValueError(
            f"no exposure step lies within {span.shortest_ms:g}..{longest_ms:.2f} ms ({refresh_hz:g} Hz less trigger "
            f"delay {trigger_delay_us} us); steps are {', '.join(f'{step:g}' for step in span.times_ms)} ms: "
            "shorten the delay, or scan.shortest_exposure_ms"
        )
    # 1e-9: a difference of whole steps may come out a last digit below them.
    count = int((span.most_gain_db - gain_db) / GAIN_STEP_DB + 1e-9)
    steps = []
    for k, time_us in enumerate(times):
        # To the next exposure, if there is one: a step that is hardly darker than it would only be noisier.
        enough = times[k + 1] / BRIDGED if k + 1 < len(times) else math.inf
        for one in (Exposure(time_us, gain_db + GAIN_STEP_DB * n) for n in range(count + 1)):
            if one.gain_db == gain_db or one.light < enough * 10.0 ** (gain_db / 20.0):
                steps.append(one)
    return tuple(steps)
