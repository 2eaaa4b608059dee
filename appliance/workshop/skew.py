"""The step ``skew``: both cameras must expose at once, and so see the same light begin at once."""

from __future__ import annotations

from appliance.workshop.finding import finding_of
from appliance.workshop.step import StepOutcome

MOST_SKEW_US = 20.0


def judge(skew_us: float) -> StepOutcome:
    """Judge the time by which the light begins later in the right camera's images than in the left one's."""
    ok, later = abs(skew_us) <= MOST_SKEW_US, "right" if skew_us < 0.0 else "left"
    statement = f"the cameras begin their exposures {abs(skew_us):.0f} µs apart" + (
        "" if ok else f", the {later} one later"
    )
    remedy = "give both cameras the same line and filter (LineDebouncer, TriggerDelay 0), and pulses of 200 µs and more"
    return StepOutcome((finding_of("skew", ok, statement, f"up to {MOST_SKEW_US:g} µs", remedy, skew_us=skew_us),))
