"""Owns which exposure the next scan should have, and when the present one is left alone.

The aim is a share of the scale; the band in which nothing is proposed reaches well beyond one step above and below it, so
that a proposal, once applied, proposes nothing more.
"""

from __future__ import annotations

from collections.abc import Sequence

from appliance.scan.exposure import Exposure

AIM, TOO_HIGH, TOO_LOW = 0.85, 0.97, 0.55
"""Of the scale above black: where the brightest surfaces should be, and the ends of the band that is left alone."""
MIN_TOP_DN = 4.0
"""Below, nothing is seen that an exposure could be chosen by."""
MAINS_PERIOD_US = 10_000
"""Lamps on 50 Hz mains flicker at 100 Hz: an exposure of a whole period sees all of them alike."""


def propose(top_dn: float, scale_dn: float, present: Exposure, steps: Sequence[Exposure]) -> Exposure | None:
    """The step that brings the brightest surfaces to ``AIM``; ``None``: the present one is right, or the best there is.

    ``top_dn``: their level over black at the present exposure; ``scale_dn``: saturation over black; ``steps``: from dark
    to bright.
    """
    share = top_dn / scale_dn
    if top_dn < MIN_TOP_DN or TOO_LOW <= share <= TOO_HIGH:
        return None
    fitting = [step for step in steps if share * step.light / present.light <= AIM]
    best = fitting[-1] if fitting else steps[0]
    brighter = best.light > present.light
    return best if brighter == (share < TOO_LOW) and best.light != present.light else None


def without_flicker(top_dn: float, scale_dn: float, present: Exposure, steps: Sequence[Exposure]) -> Exposure | None:
    """The step that does not see lamps on 50 Hz mains flicker, where it is well inside of the band; else ``None``."""
    for step in steps:
        share = top_dn / scale_dn * step.light / present.light
        whole = step.time_us == MAINS_PERIOD_US and step.time_us != present.time_us
        if whole and 1.1 * TOO_LOW <= share <= TOO_HIGH / 1.05:
            return step
    return None
