"""Owns the judgement of a scan's light: enough, not too much, and the same in all frames; and the exposure to try next.

It also owns which exposure the next scan should have, and which second one would show what a single one cannot.

The aim is a share of the scale; the band in which nothing is proposed reaches well beyond one step above and below it,
so that a proposal, once applied, proposes nothing more. Each illuminated pixel's light at other exposures follows from
what it is at this one; what is saturated here is known from the darkest of its sine images. A step of the table loses
the pixels that would be saturated or whose fringes would be too weak.
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
    """Return the step that does not see lamps on 50 Hz mains flicker, which are the usual ones, where it is well inside
    of the band; else ``None``."""
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
"""Pairs that differ by so few of the illuminated pixels are as good as each other: the second one that loses least
itself is taken."""

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


MAX_SATURATED = 0.05
"""Largest share of one camera's illuminated pixels that may be saturated before the diver is told."""
MAX_WEAK = 0.25
MAX_HARMED = 0.10
"""Largest share of the illuminated pixels that may have phases that changing light has biased by more than half of
their noise."""
MAX_AMBIENT_BEYOND = 0.25
"""Largest share of the illuminated pixels that may get more light from elsewhere than from the projector. It takes
half of the scale, and with it half of the fringes' amplitude, at any exposure."""
BEND_AS_LIGHT = 0.5
"""Largest ripple that fringes which are no sines are taken for, over their bend: up to 0.37 in the sixteen of 30 scans
that looked like it, of six projectors of bit planes seen for 2 to 8 ms (development seeds 10001 to 10010)."""


def judge_light(
    images: ScanImages,
    present: Exposure,
    steps: Sequence[Exposure],
    bend_px: float = 0.0,
    samples: Mapping[str, Sample] | None = None,
    early: Mapping[str, EarlyFit] | None = None,
) -> Judgement:
    """Return the verdict ``light`` with its numbers, at most one fault, and what to expose the next scan with.

    From the frames alone. ``present``: what they were exposed with; ``steps``: what may be proposed, from dark to
    bright (``scan.exposure.ladder``). ``bend_px``: RMS by which fringes that are no sines bend coordinates; they look
    like light that changes by a part of that. ``samples`` of both sides, and what ``fit_early`` says of them, where
    they were taken while the frames arrived.
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
    # No exposure shows what a torch shines on, and a shorter one takes the light from the rest.
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
    text = "enough light, not too much, and steady" if fault is None else f"{fault.code.value}: {fault.detail}"
    verdict = Verdict("light", passed, numbers, text if judged else "nothing is lit by the projector")
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
    """Return the fault of flickering light. Both cameras see the same light at the same time: what only one of them
    has is no change of light."""
    known = [c for c in changes.values() if c.harmed is not None and c.ripple is not None]
    least = min(known, key=lambda c: c.harmed or 0.0, default=None)
    if least is None or least.harmed is None or least.harmed <= MAX_HARMED:
        return None
    if max(c.ripple_px or 0.0 for c in known) <= BEND_AS_LIGHT * bend_px:
        return None
    harmed = 100.0 * least.harmed
    what = f"light that is not the projector's changed during the scan and biases {harmed:.0f} % of the points"
    return Fault(FaultCode.LIGHT_FLICKERS, what, {"harmed_percent": harmed, "ripple": least.ripple or 0.0})


def _worst_level(levels: dict[str, Levels]) -> Fault | None:
    """Return the fault that loses most points, in multiples of what may be lost."""
    cases: list[tuple[float, Fault]] = []
    for side, at in levels.items():
        if at.saturated is None or at.burnt is None or at.weak is None or at.ambient_beyond is None:
            continue
        # What a torch saturates is the torch's, and a shorter exposure brings none of it back.
        exposed = at.saturated - at.burnt
        saturated, weak, beyond = 100.0 * exposed, 100.0 * at.weak, 100.0 * at.ambient_beyond
        cases += [
            (
                max(at.ambient_beyond / MAX_AMBIENT_BEYOND, at.burnt / MAX_SATURATED),
                Fault(
                    FaultCode.AMBIENT,
                    f"{beyond:.0f} % of the lit pixels get more light from elsewhere than from the projector ({side} "
                    "camera)",
                    {"ambient_percent": beyond},
                ),
            ),
            (
                exposed / MAX_SATURATED,
                Fault(
                    FaultCode.TOO_BRIGHT,
                    f"{saturated:.0f} % of the lit pixels are saturated ({side} camera, {at.where})",
                    {"saturated_percent": saturated},
                ),
            ),
            (
                at.weak / MAX_WEAK,
                Fault(
                    FaultCode.TOO_DARK,
                    f"{weak:.0f} % of the lit pixels see fringes too weak to measure by ({side} camera)",
                    {"coverage_percent": 100.0 - weak},
                ),
            ),
        ]
    worst = max(cases, key=lambda case: case[0], default=None)
    return worst[1] if worst is not None and worst[0] > 1.0 else None


def _numbers(side: str, at: Levels, c: Changes) -> dict[str, float | None]:
    def percent(share: float | None) -> float | None:
        return None if share is None else 100.0 * share

    return {
        f"{side}_lit_percent": percent(at.illuminated_share),
        f"{side}_saturated_percent": percent(at.saturated),
        f"{side}_burnt_percent": percent(at.burnt),
        f"{side}_weak_percent": percent(at.weak),
        f"{side}_modulation_dn": at.modulation_dn,
        f"{side}_modulation_tenth_dn": at.modulation_tenth_dn,
        f"{side}_top_dn": at.top_dn,
        f"{side}_ambient_dn": at.ambient_dn,
        f"{side}_ambient_percent": percent(at.ambient_ratio),
        f"{side}_torch_percent": percent(at.ambient_peak),
        f"{side}_flicker_percent": percent(c.common),
        f"{side}_ambient_flicker_percent": percent(c.ambient_flicker),
        f"{side}_local_flicker_percent": percent(c.local),
        f"{side}_flicker_harmed_percent": percent(c.harmed),
        f"{side}_flicker_over_noise": c.ripple,
        f"{side}_flicker_ripple_px": c.ripple_px,
    }
