"""Owns whether one exposure can serve a scene, and which second one would show what it cannot.

Each lit pixel's light at other exposures follows from what it is at this one; what is saturated here is known from the
darkest of its sine images. A step loses the pixels that would be saturated or whose fringes would be too weak.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.decode.decoder import MIN_MODULATION_DN
from appliance.scan.exposure import Exposure

LEAST_LOST = 0.05
"""Of the lit pixels are lost by the best single exposure, or one serves."""
LEAST_GAINED = 0.05
"""Of the lit pixels must a pair have more than the best single exposure."""
LEAST_COMMON = 0.1
"""Of the lit pixels must both show, or nothing tells how they lie to each other."""
ALIKE = 0.01
"""Pairs that differ by so few of the lit pixels are as good as each other: the second one that loses least itself is taken."""

Light = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Of one camera's lit pixels: their brightest level over black in any image, which may be above the scale, and their
modulation; both in grey values at the present exposure."""


def propose_second(
    cameras: Sequence[Light], scale_dn: Sequence[float], present: Exposure, steps: Sequence[Exposure]
) -> Exposure | None:
    """The step that shows, together with the present exposure, clearly more than any single one; ``None``: none does."""
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
    """Of the camera that loses more."""
    return max(float(np.mean(one)) for one in lost)
