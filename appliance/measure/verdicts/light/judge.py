"""The verdict ``light``, and the exposures to try next.

judge_light        whether a scan has enough light, not too much, and the same in all frames
propose            the exposure of the next scan
without_flicker    an exposure at which lamps on mains do not flicker
propose_second     the second exposure of a bracket, for surfaces that a single exposure does not show

The aim is a share of the scale. There is a band without proposals that extends by more than one step to either side of
it, so that a proposal, once applied, leads to no other one. The light of each illuminated pixel at other exposures
follows from that at this one; for saturated pixels it is estimated from the darkest of their sine images. An exposure
loses the pixels that would be saturated or whose fringes would be too weak.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import MIN_MODULATION_DN
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import FULL_DN
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.light.changes import Changes, EarlyFit, measure_changes
from appliance.measure.verdicts.light.levels import Levels, Sample, light_of, measure_levels, sample

AIM, TOO_HIGH, TOO_LOW = 0.85, 0.97, 0.55
"""Shares of the scale above black: the aim for the brightest surfaces, and the ends of the band without proposals."""
MIN_TOP_DN = 4.0
"""Level below which no exposure can be chosen."""
MAINS_PERIOD_US = 10_000
"""Lamps on 50 Hz mains flicker at 100 Hz: an exposure of a whole period gets the same light from them in each frame."""


def propose(top_dn: float, scale_dn: float, present: Exposure, steps: Sequence[Exposure]) -> Exposure | None:
    """Return the step that brings the brightest surfaces to ``AIM``; ``None``: keep the present exposure.

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
    """Return the step at which lamps on 50 Hz mains do not flicker; ``None``: it is outside of the band."""
    for step in steps:
        share = top_dn / scale_dn * step.light / present.light
        is_whole_period = step.time_us == MAINS_PERIOD_US and step.time_us != present.time_us
        if is_whole_period and 1.1 * TOO_LOW <= share <= TOO_HIGH / 1.05:
            return step
    return None


LEAST_LOST = 0.05
"""Least share of the illuminated pixels that the best single exposure must lose for a second one to be proposed."""
LEAST_GAINED = 0.05
"""Least share of the illuminated pixels that a bracket must show beyond the best single exposure."""
LEAST_COMMON = 0.1
"""Least share of the illuminated pixels that both exposures must show, as registration needs."""
ALIKE = 0.01
"""Brackets that differ by less than this share of the illuminated pixels are equally good: the second exposure that
loses least is taken."""

Light = tuple[NDArray[np.float32], NDArray[np.float32]]
"""One camera's illuminated pixels: their brightest level over black in any image, which may be above the scale, and
their modulation; both in grey values at the present exposure."""


def propose_second(
    cameras: Sequence[Light], scale_dn: Sequence[float], present: Exposure, steps: Sequence[Exposure]
) -> Exposure | None:
    """Return the step that shows clearly more, together with the present one, than any single one.

    ``None``: no step does.
    """
    if any(top.size == 0 for top, _ in cameras):
        return None
    now = _lost(cameras, scale_dn, 1.0)
    if _share(now) < LEAST_LOST:
        return None
    lost = {step: _lost(cameras, scale_dn, step.light / present.light) for step in steps}
    best = min(_share(lost_pixels) for lost_pixels in (*lost.values(), now))
    if best < LEAST_LOST:
        return None
    together = {
        step: _share([a & b for a, b in zip(now, lost_pixels, strict=True)])
        for step, lost_pixels in lost.items()
        if _share([a | b for a, b in zip(now, lost_pixels, strict=True)]) <= 1.0 - LEAST_COMMON
    }
    least_lost = min(together.values(), default=1.0)
    if least_lost > best - LEAST_GAINED:
        return None
    return min(
        (step for step, share in together.items() if share <= least_lost + ALIKE), key=lambda step: _share(lost[step])
    )


def _lost(cameras: Sequence[Light], scale_dn: Sequence[float], factor: float) -> list[NDArray[np.bool_]]:
    return [
        (factor * top >= scale) | (factor * modulation < MIN_MODULATION_DN)
        for (top, modulation), scale in zip(cameras, scale_dn, strict=True)
    ]


def _share(lost: Sequence[NDArray[np.bool_]]) -> float:
    """Return the lost share of the camera that loses more."""
    return max(float(np.mean(camera_lost)) for camera_lost in lost)


MAX_SATURATED = 0.05
"""Largest share of one camera's illuminated pixels that may be saturated without a fault."""
MAX_WEAK = 0.25
MAX_HARMED = 0.10
"""Largest share of the illuminated pixels that may have phase errors of more than half of their noise by changing
light."""
MAX_AMBIENT_BEYOND = 0.25
"""Largest share of the illuminated pixels that may get more ambient light than light of the projector. There ambient
light takes half of the scale, and so half of the modulation, at any exposure."""
BEND_AS_LIGHT = 0.5
"""Largest ripple over the phase error of the response that is due to that error and not to light.

It was up to 0.37 in the sixteen of 30 scans that looked like changing light, with six projectors of bit planes at
exposure times of 2 to 8 ms (development seeds 10001 to 10010).
"""


def judge_light(
    images: ScanImages,
    present: Exposure,
    steps: Sequence[Exposure],
    bend_px: float = 0.0,
    samples: Mapping[str, Sample] | None = None,
    early: Mapping[str, EarlyFit] | None = None,
) -> Judgement:
    """Return the verdict ``light`` with its numbers, at most one fault, and the proposed exposures.

    From the frames alone. ``present``: their exposure; ``steps``: exposures that may be proposed, from dark to bright
    (``appliance.measure.light.exposure.ladder``). ``bend_px``: RMS of the phase error of non-sinusoidal fringes, which
    look like light that changes by a part of that. ``samples`` and ``early``: those of both sides and their
    ``fit_early``, if taken while the frames arrived.
    """
    noise = {side: of_side(images.noise, side) for side in SIDES}
    samples = samples or {side: sample(images.frames[side], images.sequence) for side in SIDES}
    levels = {side: measure_levels(samples[side], images.sequence, noise[side]) for side in SIDES}
    changes = {
        side: measure_changes(samples[side], images.sequence, noise[side], early[side] if early else None)
        for side in SIDES
    }
    fault = _flickers(changes, bend_px) or _worst_level(levels)
    numbers: dict[str, float | None] = {}
    for side in SIDES:
        numbers |= _numbers(side, levels[side], changes[side])
    numbers["exposure_ms"], numbers["gain_db"] = present.time_us / 1000.0, present.gain_db
    burnt = (
        fault is not None
        and fault.code is FaultCode.AMBIENT
        and any((levels[side].burnt or 0.0) > MAX_SATURATED for side in SIDES)
    )
    # No exposure shows surfaces in the light of a torch, and a shorter one darkens the others.
    proposal = None if burnt else _propose(images, levels, present, steps)
    if proposal is None and fault is not None and fault.code is FaultCode.LIGHT_FLICKERS:
        top_dn, scale_dn = _top(images, levels)
        proposal = without_flicker(top_dn, scale_dn, present, steps)
    second = (
        None
        if burnt
        else propose_second(
            [light_of(samples[side], images.sequence, noise[side]) for side in SIDES],
            [FULL_DN - noise[side].black_dn for side in SIDES],
            present,
            steps,
        )
    )
    if second is not None:
        numbers["second_ms"], numbers["second_gain_db"] = second.time_us / 1000.0, second.gain_db
    if proposal is not None:
        numbers["proposed_ms"], numbers["proposed_gain_db"] = proposal.time_us / 1000.0, proposal.gain_db
    judged = any(levels[side].illuminated_share > 0.0 for side in SIDES)
    passed = fault is None if judged else None
    text = "light is sufficient, not saturated, and steady" if fault is None else f"{fault.code.value}: {fault.detail}"
    verdict = Verdict("light", passed, numbers, text if judged else "the projector illuminates nothing")
    return Judgement(verdict, fault, proposal, second)


def _top(images: ScanImages, levels: dict[str, Levels]) -> tuple[float, float]:
    black = {side: of_side(images.noise, side).black_dn for side in SIDES}
    brightest = max(SIDES, key=lambda side: levels[side].top_dn / (FULL_DN - black[side]))
    return levels[brightest].top_dn, FULL_DN - black[brightest]


def _propose(
    images: ScanImages, levels: dict[str, Levels], present: Exposure, steps: Sequence[Exposure]
) -> Exposure | None:
    top_dn, scale_dn = _top(images, levels)
    return propose(top_dn, scale_dn, present, steps)


def _flickers(changes: dict[str, Changes], bend_px: float) -> Fault | None:
    """Return the fault of flickering light, if both cameras see it, as they must."""
    measured = [c for c in changes.values() if c.harmed is not None and c.ripple is not None]
    smaller = min(measured, key=lambda c: c.harmed or 0.0, default=None)
    if smaller is None or smaller.harmed is None or smaller.harmed <= MAX_HARMED:
        return None
    if max(c.ripple_px or 0.0 for c in measured) <= BEND_AS_LIGHT * bend_px:
        return None
    harmed = 100.0 * smaller.harmed
    what = f"ambient light changed during the scan and biases {harmed:.0f} % of the points"
    return Fault(FaultCode.LIGHT_FLICKERS, what, {"harmed_percent": harmed, "ripple": smaller.ripple or 0.0})


def _worst_level(levels: dict[str, Levels]) -> Fault | None:
    """Return the fault that loses most points, in multiples of its limit."""
    cases: list[tuple[float, Fault]] = []
    for side, level in levels.items():
        if level.saturated is None or level.burnt is None or level.weak is None or level.ambient_beyond is None:
            continue
        # Saturation by a torch counts for the torch, since a shorter exposure does not help.
        exposed = level.saturated - level.burnt
        saturated, weak, beyond = 100.0 * exposed, 100.0 * level.weak, 100.0 * level.ambient_beyond
        cases += [
            (
                max(level.ambient_beyond / MAX_AMBIENT_BEYOND, level.burnt / MAX_SATURATED),
                Fault(
                    FaultCode.AMBIENT,
                    f"{beyond:.0f} % of the illuminated pixels have more ambient light than projector light ({side} "
                    "camera)",
                    {"ambient_percent": beyond},
                ),
            ),
            (
                exposed / MAX_SATURATED,
                Fault(
                    FaultCode.TOO_BRIGHT,
                    f"{saturated:.0f} % of the illuminated pixels are saturated ({side} camera, {level.where})",
                    {"saturated_percent": saturated},
                ),
            ),
            (
                level.weak / MAX_WEAK,
                Fault(
                    FaultCode.TOO_DARK,
                    f"{weak:.0f} % of the illuminated pixels have fringes too weak to measure ({side} camera)",
                    {"coverage_percent": 100.0 - weak},
                ),
            ),
        ]
    worst = max(cases, key=lambda case: case[0], default=None)
    return worst[1] if worst is not None and worst[0] > 1.0 else None


def _numbers(side: str, level: Levels, change: Changes) -> dict[str, float | None]:
    def percent(share: float | None) -> float | None:
        return None if share is None else 100.0 * share

    return {
        f"{side}_lit_percent": percent(level.illuminated_share),
        f"{side}_saturated_percent": percent(level.saturated),
        f"{side}_burnt_percent": percent(level.burnt),
        f"{side}_weak_percent": percent(level.weak),
        f"{side}_modulation_dn": level.modulation_dn,
        f"{side}_modulation_tenth_dn": level.modulation_tenth_dn,
        f"{side}_top_dn": level.top_dn,
        f"{side}_ambient_dn": level.ambient_dn,
        f"{side}_ambient_percent": percent(level.ambient_ratio),
        f"{side}_torch_percent": percent(level.ambient_peak),
        f"{side}_flicker_percent": percent(change.common),
        f"{side}_ambient_flicker_percent": percent(change.ambient_flicker),
        f"{side}_local_flicker_percent": percent(change.local),
        f"{side}_flicker_harmed_percent": percent(change.harmed),
        f"{side}_flicker_over_noise": change.ripple,
        f"{side}_flicker_ripple_px": change.ripple_px,
    }
