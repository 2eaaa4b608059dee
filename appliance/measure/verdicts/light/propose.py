"""Owns which exposure the next scan should have, and which second one would show what a single one cannot.

The aim is a share of the scale; the band in which nothing is proposed reaches well beyond one step above and below it, so
that a proposal, once applied, proposes nothing more. Each illuminated pixel's light at other exposures follows from what it is
at this one; what is saturated here is known from the darkest of its sine images. A step of the table loses the pixels that
would be saturated or whose fringes would be too weak.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import MIN_MODULATION_DN
from appliance.measure.light.exposure import Exposure

AIM, TOO_HIGH, TOO_LOW = 0.85, 0.97, 0.55
"""Shares of the scale above black: where the brightest surfaces should be, and the ends of the band that is left
alone."""
MIN_TOP_DN = 4.0
"""Light below which nothing is seen that an exposure could be chosen by."""
MAINS_PERIOD_US = 10_000
"""Lamps on 50 Hz mains flicker at 100 Hz: an exposure of a whole period sees all of them alike."""


def propose(top_dn: float, scale_dn: float, present: Exposure, steps: Sequence[Exposure]) -> Exposure | None:
    """Return the step that brings the brightest surfaces to ``AIM``; ``None``: the present one is right, or the best
    there is.

    ``top_dn``: their level over black at the present exposure; ``scale_dn``: saturation over black; ``steps``: from
    dark to bright.
    """
    share = top_dn / scale_dn
    if top_dn < MIN_TOP_DN or TOO_LOW <= share <= TOO_HIGH:
        return None
    fitting = [step for step in steps if share * step.light / present.light <= AIM]
    best = fitting[-1] if fitting else steps[0]
    brighter = best.light > present.light
    return best if brighter == (share < TOO_LOW) and best.light != present.light else None


def without_flicker(top_dn: float, scale_dn: float, present: Exposure, steps: Sequence[Exposure]) -> Exposure | None:
    """Return the step that does not see lamps on 50 Hz mains flicker, where it is well inside of the band; else
    ``None``."""
    for step in steps:
        share = top_dn / scale_dn * step.light / present.light
        whole = step.time_us == MAINS_PERIOD_US and step.time_us != present.time_us
        if whole and 1.1 * TOO_LOW <= share <= TOO_HIGH / 1.05:
            return step
    return None


LEAST_LOST = 0.05
"""Least share of the illuminated pixels that the best single exposure must lose for a second one to be proposed."""
LEAST_GAINED = 0.05
"""Least share of the illuminated pixels that a pair must show beyond the best single exposure."""
LEAST_COMMON = 0.1
"""Least share of the illuminated pixels that both must show, or nothing tells how they lie to each other."""
ALIKE = 0.01
"""Pairs that differ by so few of the illuminated pixels are as good as each other: the second one that loses least itself is taken."""

Light = tuple[NDArray[np.float32], NDArray[np.float32]]
"""One camera's illuminated pixels: their brightest level over black in any image, which may be above the scale, and
their modulation; both in grey values at the present exposure."""


def propose_second(
    cameras: Sequence[Light], scale_dn: Sequence[float], present: Exposure, steps: Sequence[Exposure]
) -> Exposure | None:
    """Return the step that shows, together with the present exposure, clearly more than any single one; ``None``:
    none does."""
    if any(top.size == 0 for top, _ in cameras):
        return None
    now = _lost(cameras, scale_dn, 1.0)
    if _share(now) < LEAST_LOST:
        return None
    lost = {step: _lost(cameras, scale_dn, step.light / present.light) for step in steps}
    best = min(_share(one) for one in (*lost.values(), now))
    if best < LEAST_LOST:
        return None
    together = {
        step: _share([a & b for a, b in zip(now, one, strict=True)])
        for step, one in lost.items()
        if _share([a | b for a, b in zip(now, one, strict=True)]) <= 1.0 - LEAST_COMMON
    }
    least = min(together.values(), default=1.0)
    if least > best - LEAST_GAINED:
        return None
    return min((step for step, both in together.items() if both <= least + ALIKE), key=lambda step: _share(lost[step]))


def _lost(cameras: Sequence[Light], scale_dn: Sequence[float], factor: float) -> list[NDArray[np.bool_]]:
    return [
        (factor * top >= scale) | (factor * modulation < MIN_MODULATION_DN)
        for (top, modulation), scale in zip(cameras, scale_dn, strict=True)
    ]


def _share(lost: Sequence[NDArray[np.bool_]]) -> float:
    """Return the share that the camera with the greater loss loses."""
    return max(float(np.mean(one)) for one in lost)
