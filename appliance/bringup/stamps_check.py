"""Owns the comparison of a camera's time stamps with the board's: one constant offset, little jitter, two clocks' drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from appliance.bringup.finding import Finding

MOST_JITTER_US = 20.0
"""Largest distance of a stamp from the straight line: an opto-coupler rises within some µs, and light is skewed by this much at most."""
MOST_DRIFT_PPM = 200.0
"""Largest difference of rate of two clocks of 100 ppm each."""
FEWEST = 8


def judge_stamps(pulses_us: Sequence[int], cameras: Mapping[str, Sequence[int | None]]) -> tuple[Finding, ...]:
    """Compare the board's times of pulses with the cameras' of the frames that they made, ns by each camera's clock; by side.

    Where there are not as many of both nothing can be compared: counting says so.
    """
    return tuple(_stamps(f"stamps.{side}", pulses_us, times_ns) for side, times_ns in cameras.items())


def _stamps(name: str, pulses_us: Sequence[int], times_ns: Sequence[int | None]) -> Finding:
    limits = f"jitter up to {MOST_JITTER_US:g} µs, drift up to {MOST_DRIFT_PPM:g} ppm"
    known = [time_ns for time_ns in times_ns if time_ns is not None]
    if len(known) < len(times_ns):
        return Finding(name, True, "the camera has no clock: its frames are told by their count alone", limits)
    if len(known) != len(pulses_us) or len(known) < FEWEST:
        said = f"{len(known)} stamps of frames and {len(pulses_us)} of pulses cannot be compared"
        return Finding(name, False, said, limits, "first see that each pulse makes a frame: the findings above say how")
    # From the first one on: a clock begins anywhere, and digits would be lost.
    pulses = np.array([time_us - pulses_us[0] for time_us in pulses_us], np.float64)
    frames = np.array([(time_ns - known[0]) / 1000.0 for time_ns in known], np.float64)
    rate, _ = line = np.polyfit(pulses, frames, 1)
    away_us = np.abs(frames - np.polyval(line, pulses))
    jitter_us, drift_ppm = float(away_us.max()), (float(rate) - 1.0) * 1e6
    numbers: dict[str, float | None] = {
        "jitter_us": jitter_us,
        "jitter_rms_us": float(np.sqrt((away_us**2).mean())),
        "drift_ppm": drift_ppm,
    }
    said = f"exposures follow pulses to {jitter_us:.1f} µs; the clocks run {drift_ppm:+.0f} ppm apart"
    # Jitter first: a stamp that jumps bends the line that the drift is read from.
    if jitter_us > MOST_JITTER_US:
        worst = int(away_us.argmax())
        remedy = (
            "drive the opto-coupler with 3.5 to 7 mA and pulses of 200 µs; no LineDebouncer; a ground wire beside the trigger's; "
            f"frame {worst} is the worst"
        )
        return Finding(name, False, said, limits, remedy, numbers)
    if abs(drift_ppm) > MOST_DRIFT_PPM:
        remedy = "one of the clocks is none: check the unit of the camera's time stamps (GevTimestampTickFrequency), and the board's crystal"
        return Finding(name, False, said, limits, remedy, numbers)
    return Finding(name, True, said, limits, "", numbers)
