"""The exposure of scans: exposure time and gain of both cameras, and the steps that may be chosen."""

from __future__ import annotations

import math
from dataclasses import dataclass

STEPS_MS = (2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0, 10.0, 12.0, 14.0, 16.0)
"""Exposure times, about a quarter more light each. 10 ms is a whole period of lamps on 50 Hz mains, which flicker 100
times a second."""
GAIN_STEP_DB = 2.0
"""Step of the gain above the rig's, after the longest exposure: a quarter more light each."""
BRIDGED = 1.14
"""Least ratio of light from a step of gain to the next longer exposure."""
MARGIN_MS = 0.1
"""Time between the end of the longest exposure and the next vsync."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure of both cameras, which share one trigger pulse."""

    time_us: int
    gain_db: float = 0.0

    @property
    def light(self) -> float:
        """Exposure time at 0 dB with the same grey values, µs."""
        # Decibels of amplitude, as cameras state their gain: 20 dB are ten times the grey value.
        return float(self.time_us * 10.0 ** (self.gain_db / 20.0))

    @property
    def label(self) -> str:
        """Label of the exposure, like ``8 ms``, ``6.3 ms``, ``16 ms +4 dB``."""
        gain = f" +{self.gain_db:g} dB" if self.gain_db else ""
        return f"{self.time_us / 1000.0:g} ms{gain}"


NOMINAL = Exposure(12_000)
"""Exposure of an instrument without a rig file."""


@dataclass(frozen=True, slots=True)
class Span:
    """The exposures that may be proposed, before the limit by the projector's period."""

    shortest_ms: float = 2.0
    longest_ms: float = 16.0
    most_gain_db: float = 12.0
    """Largest total gain, including that of the rig file."""
    times_ms: tuple[float, ...] = STEPS_MS
    """Exposure times to choose from, for instance those in which this projector's fringes are sines."""


def ladder(refresh_hz: float, trigger_delay_us: int, gain_db: float, span: Span) -> tuple[Exposure, ...]:
    """Return all exposures from dark to bright that fit a projector's vertical period.

    First longer exposures at the rig's gain; more gain only with the longest, or between exposures that are far apart.
    Raises ValueError if no step fits between trigger and next vsync.
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
    # 1e-9: a difference of whole steps may be a last digit too small.
    count = int((span.most_gain_db - gain_db) / GAIN_STEP_DB + 1e-9)
    steps = []
    for k, time_us in enumerate(times):
        # Up to the next exposure: a step that is hardly darker would only be noisier.
        enough = times[k + 1] / BRIDGED if k + 1 < len(times) else math.inf
        for exposure in (Exposure(time_us, gain_db + GAIN_STEP_DB * n) for n in range(count + 1)):
            if exposure.gain_db == gain_db or exposure.light < enough * 10.0 ** (gain_db / 20.0):
                steps.append(exposure)
    return tuple(steps)
