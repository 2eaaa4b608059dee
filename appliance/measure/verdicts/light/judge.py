"""Owns the judgement of a scan's light: enough, not too much, and the same in all frames; and the exposure to try next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import FULL_DN
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.points.images import ScanImages
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.light.changes import Changes, EarlyFit, find_frequency_hz, measure_changes
from appliance.measure.verdicts.light.levels import Levels, Sample, light_of, measure_levels, sample
from appliance.measure.verdicts.light.propose import propose, propose_second, without_flicker

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
"""Largest ripple that fringes which are no sines are taken for, over their bend: up to 0.37 in the sixteen of 30 scans that
looked like it, of six projectors of bit planes seen for 2 to 8 ms (development seeds 10001 to 10010)."""
FLICKER_ALIAS_HZ = (18.5, 21.5)
"""Frequencies at which lamps on 50 Hz mains show up at 60 frames per second."""


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
    bright (``scan.exposure.ladder``). ``bend_px``: RMS by which fringes that are no sines bend coordinates; they look like light that
    changes by a part of that. ``samples`` of both sides, and what ``fit_early`` says of them, where they were taken while the frames arrived.
    """
    noise = {side: of_side(images.noise, side) for side in SIDES}
    samples = samples or {side: sample(images.frames[side], images.sequence) for side in SIDES}
    levels = {side: measure_levels(samples[side], images.sequence, noise[side]) for side in SIDES}
    changes = {
        side: measure_changes(samples[side], images.sequence, noise[side], early[side] if early else None)
        for side in SIDES
    }
    frequency = find_frequency_hz((*changes["left"].levels, *changes["right"].levels), images.frame_s)
    fault = _flickers(changes, frequency, bend_px) or _worst_level(levels)
    numbers: dict[str, float | None] = {}
    for side in SIDES:
        numbers |= _numbers(side, levels[side], changes[side])
    numbers["flicker_alias_hz"] = frequency[0] if frequency is not None else None
    numbers["exposure_ms"], numbers["gain_db"] = present.time_us / 1000.0, present.gain_db
    burnt = (
        fault is not None
        and fault.code is FaultCode.AMBIENT
        and any((levels[side].burnt or 0.0) > MAX_SATURATED for side in SIDES)
    )
    # No exposure shows what a torch shines on, and a shorter one takes the light from the rest.
    proposal = None if burnt else _propose(images, levels, present, steps)
    mains = frequency is not None and FLICKER_ALIAS_HZ[0] <= frequency[0] <= FLICKER_ALIAS_HZ[1]
    if proposal is None and mains and fault is not None and fault.code is FaultCode.LIGHT_FLICKERS:
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


def _flickers(changes: dict[str, Changes], frequency: tuple[float, float] | None, bend_px: float) -> Fault | None:
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
    often = "" if frequency is None else f"; it shows at {frequency[0]:.1f} Hz"
    return Fault(FaultCode.LIGHT_FLICKERS, what + often, {"harmed_percent": harmed, "ripple": least.ripple or 0.0})


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
                    f"{beyond:.0f} % of the lit pixels get more light from elsewhere than from the projector ({side} camera)",
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
