"""The causes of a poor scan, by the share of it that each explains, the largest first.

Each judge looks at one quantity, and causes look alike: motion changes grey values as flickering light does, and
disturbs pixels as specks do. Saturated pixels have weak fringes, as pixels in turbid water have. A dark image is due to
a short exposure or to the water. Here all judgements are weighed against each other, in one unit: the share of the
scan's information that a cause takes. Points count by the inverse of their variance. A pixel without a point has lost
all of its information; noise that grows by a factor f leaves 1/f².

A cause is named if it exceeds its own limit, or if the scan is not usable and no other cause explains more. A scan that
is not usable has at least one cause, if only SCAN_POOR, which says that it is unexplained. See ``docs/causes.md``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from appliance.measure.cloud import CloudSummary
from appliance.measure.decode.decoder import MIN_MODULATION_DN
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import FULL_DN
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import sight_m
from appliance.measure.verdict import USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM, Judgement, Verdict, is_usable
from appliance.measure.verdicts.water.judge import MOST_SIGHT_M, hides_object

CAUSES_NAME = "causes"
MOVED_LIKE_FLICKER = 2.4
"""Largest multiple of the drift over the noise that the judge of light may see by motion alone.

With motion 1.5 to 1.7 times is usual. The excess is light.
"""
LAMP_IN_COMMON = 0.5
"""Share of the squares of the changes that all parts of the image have in common: with a flickering lamp 0.9 and more,
with motion before any texture mostly below 0.3."""
CLEAR_WATER_PERCENT = 12.0
"""If backscatter hides a smaller share of the pixels, lost pixels are not lost to the water."""
LEAST_SHARE = 0.05
"""A cause that explains less is not named unless its judge raised a fault."""
ENOUGH_FRINGE_DN = 8.0
"""Fringes of this modulation give points.

The ninth tenth of the cells must reach it with the longest exposure, or no exposure helps.
"""
MOST_SATURATED = 0.25
"""Share of the illuminated pixels: beyond, weak fringes say nothing about darkness."""
SEEN_FRINGE_DN = 0.5
"""Fringes of this modulation can be distinguished from noise (``sight``)."""
MUCH_ROOM = ENOUGH_FRINGE_DN / SEEN_FRINGE_DN
"""Factor by which the exposure could be longer, from which on it is the cause if no object is seen.

With a smaller factor, an object that gets enough fringes by the longest exposure would already show some.
"""
SWALLOWS_PER_M = 1.6
"""Attenuation from which on the shape of the backscatter says that the water lets no light through; the true
attenuation is two to three times as much."""
MOST_OUTSIDE = 0.5
"""Share of the points outside of the measured depths; beyond, distance is the cause."""
ALL = 1.0

_MISTRACED = frozenset({FaultCode.SIDES_EXCHANGED, FaultCode.NOT_IN_WATER})

Numbers = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Cause:
    """Cause for which points are missing or noisier than they could be."""

    fault: Fault
    share: float
    """Share of the scan's information that it takes, 0..1."""
    certain: bool
    """True if the limit of its judge is exceeded; else it is named only for a scan that is not usable."""


def find_causes(
    judgements: Sequence[Judgement], summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> tuple[Cause, ...]:
    """Return the causes worth reporting, the largest share first.

    ``judgements``: all of the scan; ``summary``: of its best cloud; ``present``: its exposure; ``steps``: the possible
    exposures. Pure: the same verdicts give the same causes, whether they come from the judges or from a manifest.
    """
    wrong = next(
        (judgement.fault for judgement in judgements if judgement.fault and judgement.fault.code in _MISTRACED), None
    )
    if wrong is not None:
        # With exchanged images or rays through another medium, all other faults follow from that.
        return (Cause(wrong, ALL, certain=True),)
    bent = next(
        (
            judgement.fault
            for judgement in judgements
            if judgement.fault and judgement.fault.code is FaultCode.GREY_BENT
        ),
        None,
    )
    if bent is not None:
        # Light, water and noise are judged by grey values, which have no meaning then; the points may be good.
        return (Cause(bent, 0.0, certain=True),)
    by_name = {judgement.verdict.name: judgement for judgement in judgements}
    causes = _once(sorted(_all(by_name, summary, present, steps), key=lambda cause: -cause.share))
    causes += [
        Cause(judgement.fault, 0.01 * judgement.fault.numbers.get("hole_percent", 0.0), certain=True)
        for judgement in judgements
        if judgement.fault is not None and not _is_weighed(judgement)
    ]
    usable = is_usable(summary.coverage_percent, summary.noise_mm)
    named = _once(
        [
            cause
            for k, cause in enumerate(causes)
            if cause.certain or (not usable and (cause.share >= LEAST_SHARE or k == 0) and cause.share > 0.0)
        ]
    )
    # A missing part has a cause; PART_MISSING is reported only if no other cause is known.
    unexplained = {FaultCode.PART_MISSING, FaultCode.COMPENSATED}.issuperset(cause.fault.code for cause in named)
    named = [cause for cause in named if unexplained or cause.fault.code is not FaultCode.PART_MISSING]
    if (named and any(cause.fault.code is not FaultCode.COMPENSATED for cause in named)) or usable:
        return tuple(named)
    return (*named, Cause(_unexplained(summary), 0.0, False))


def with_causes(
    judgements: Sequence[Judgement], summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> tuple[Judgement, ...]:
    """Return ``judgements`` with the faults of ``find_causes`` in that order, and the verdict ``causes``.

    Those faults replace the judgements' faults. A judgement whose fault is explained by another cause is neither passed
    nor failed. Identity is left as it is.
    """
    water = _numbers({judgement.verdict.name: judgement for judgement in judgements}, "water")
    causes = [_with_sight(cause, water) for cause in find_causes(judgements, summary, present, steps)]
    judges = {
        judgement.fault.code: judgement.verdict.name
        for judgement in judgements
        if judgement.fault is not None and not _is_weighed(judgement)
    }
    judges |= _JUDGES
    left = {judgement.verdict.name: judgement for judgement in judgements if judgement.verdict.name != CAUSES_NAME}
    ranked: list[Judgement] = []
    for cause in causes:
        judge = judges.get(cause.fault.code, CAUSES_NAME)
        if judge in left and judge != CAUSES_NAME:
            judgement = left.pop(judge)
            ranked.append(replace(judgement, fault=cause.fault, verdict=_failed(judgement.verdict, cause)))
        else:
            ranked.append(Judgement(Verdict(CAUSES_NAME, None), cause.fault))
    remaining = [_without_fault(judgement) if name != "identity" else judgement for name, judgement in left.items()]
    numbers: dict[str, float | None] = {
        f"{cause.fault.code.value.lower()}_percent": 100.0 * cause.share for cause in causes
    }
    text = (
        ", ".join(f"{cause.fault.code.value} {100.0 * cause.share:.0f} %" for cause in causes)
        or "no cause of poor points"
    )
    verdict = Verdict(CAUSES_NAME, not causes, numbers, text)
    weighed = [
        replace(judgement, verdict=verdict) if judgement.verdict.name == CAUSES_NAME else judgement
        for judgement in ranked
    ]
    if not any(judgement.verdict.name == CAUSES_NAME for judgement in weighed):
        weighed.append(Judgement(verdict))
    identity = [judgement for judgement in remaining if judgement.verdict.name == "identity"]
    return (*identity, *weighed, *(judgement for judgement in remaining if judgement.verdict.name != "identity"))


_JUDGES: Mapping[FaultCode, str] = {
    FaultCode.MOVED: "motion",
    FaultCode.COMPENSATED: "motion",
    FaultCode.TOO_BRIGHT: "light",
    FaultCode.TOO_DARK: "light",
    FaultCode.AMBIENT: "light",
    FaultCode.LIGHT_FLICKERS: "light",
    FaultCode.WATER_DIRTY: "water",
    FaultCode.SCAN_NEAR: "sight",
    FaultCode.SCAN_FAR: "sight",
    FaultCode.NOTHING_SEEN: "sight",
}
"""Names of the verdicts that causes are entered into; a cause without one goes into the verdict ``causes`` itself."""


def _with_sight(cause: Cause, water: Numbers) -> Cause:
    """Return the cause with the visibility, if the cause is the water and the visibility is known."""
    attenuation_per_m = water.get("attenuation_per_m")
    seen_m = None if attenuation_per_m is None else sight_m(attenuation_per_m)
    fault = cause.fault
    if fault.code is not FaultCode.WATER_DIRTY or seen_m is None or seen_m > MOST_SIGHT_M:
        return cause
    detail = f"{fault.detail}; sight {seen_m:.1f} m, attenuation {attenuation_per_m:.1f} /m"
    return replace(cause, fault=replace(fault, detail=detail, numbers={**fault.numbers, "sight_m": seen_m}))


def _is_weighed(judgement: Judgement) -> bool:
    """Return True if a judge's numbers are weighed here.

    The fault of any other judge stands as it is, behind the weighed ones.
    """
    return judgement.verdict.name in {CAUSES_NAME, "identity", *_JUDGES.values()}


def _failed(verdict: Verdict, cause: Cause) -> Verdict:
    """Return the verdict failed by ``cause``; COMPENSATED leaves it as it is."""
    if cause.fault.code is FaultCode.COMPENSATED or verdict.passed is False:
        return verdict
    return replace(verdict, passed=False, text=f"{cause.fault.code.value}: {cause.fault.detail}")


def _without_fault(judgement: Judgement) -> Judgement:
    if judgement.fault is None:
        return judgement
    explained = replace(judgement.verdict, passed=None, text=f"{judgement.verdict.text}; explained by another cause")
    return replace(judgement, fault=None, verdict=explained)


def _once(causes: Sequence[Cause]) -> list[Cause]:
    """Return the first cause of each code, certain if any cause of that code is."""
    certain = {cause.fault.code for cause in causes if cause.certain}
    first: dict[FaultCode, Cause] = {}
    for cause in causes:
        first.setdefault(cause.fault.code, replace(cause, certain=cause.fault.code in certain))
    return list(first.values())


def _all(
    by_name: Mapping[str, Judgement], summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> Iterator[Cause]:
    """Yield the causes that the numbers of the judges make likely, worth reporting or not."""
    light, water, motion, sight = (_numbers(by_name, name) for name in ("light", "water", "motion", "sight"))
    poor = not is_usable(summary.coverage_percent, summary.noise_mm)
    outside = _outside(sight)
    rushing = _rushing(motion, sight, light, water, summary) if poor and outside is None else None
    if rushing is not None:
        yield rushing
    else:
        yield from _motion(by_name, motion, summary, poor)
        yield from _flicker(light, by_name, motion)
    if outside is not None:
        yield outside
    yield from _levels(by_name, light, water, _best_fringe_dn(sight, present, steps))
    still = rushing is None and not _moves(motion)
    yield from _water(by_name, water, _saturated(light, water), still=still)
    faint = _faint(sight, light, water, summary, present, steps) if poor and outside is None else None
    if faint is not None:
        yield faint


def _motion(by_name: Mapping[str, Judgement], motion: Numbers, summary: CloudSummary, poor: bool) -> Iterator[Cause]:
    judged = by_name.get("motion")
    fault = None if judged is None else judged.fault
    added, lost = motion.get("added_noise_percent"), motion.get("lost_percent") or 0.0
    if added is None or not _moves(motion):
        return
    left = (1.0 - 0.01 * min(lost, 100.0)) / (1.0 + 0.01 * max(added, 0.0)) ** 2
    numbers = {"added_noise_percent": added, "shift_px": motion.get("shift_px"), "speed_mm_s": motion.get("speed_mm_s")}
    known_numbers = {name: value for name, value in numbers.items() if value is not None}
    detail = "" if judged is None else judged.verdict.text
    if fault is not None and fault.code is FaultCode.COMPENSATED:
        yield Cause(fault, 0.0, True)
        if poor:
            # Compensation removed the noise; the points that motion cost are missing still.
            yield Cause(Fault(FaultCode.MOVED, detail, known_numbers), 0.01 * min(lost, 100.0), False)
        return
    yield Cause(fault or Fault(FaultCode.MOVED, detail, known_numbers), 1.0 - left, fault is not None)


def _rushing(motion: Numbers, sight: Numbers, light: Numbers, water: Numbers, summary: CloudSummary) -> Cause | None:
    """Return a motion too fast to be judged: too few points, though the fringes are strong.

    The frames contradict each other in good light. A flickering lamp leaves the Gray code readable. Saturation,
    backscatter, faint fringes and a wrong distance are excluded here or by the caller.
    """
    fringe = sight.get("fringe_dn")
    if motion.get("added_noise_percent") is not None or fringe is None or fringe < ENOUGH_FRINGE_DN:
        return None
    turbid = (water.get("veil_percent") or 0.0) >= CLEAR_WATER_PERCENT
    if turbid or _saturated(light, water) > MOST_SATURATED:
        return None
    detail = f"fringes of {fringe:.0f} DN that contradict each other: fast motion"
    return Cause(Fault(FaultCode.MOVED, detail), 1.0 - 0.01 * min(summary.coverage_percent or 0.0, 100.0), True)


def _flicker(light: Numbers, by_name: Mapping[str, Judgement], motion: Numbers) -> Iterator[Cause]:
    """Yield flickering light, less the changes that are due to motion.

    A lamp changes the whole image alike from frame to frame. Motion changes each part by its own albedo, and so does
    sun through waves. If there is motion, the common part and the others are weighed separately.
    """
    judged = by_name.get("light")
    if judged is None or judged.fault is None or judged.fault.code is not FaultCode.LIGHT_FLICKERS:
        return
    ripples = [light.get(f"{side}_flicker_over_noise") for side in SIDES]
    flicker = min((ripple for ripple in ripples if ripple is not None), default=0.0) ** 2
    if _moves(motion):
        lamp = min(_in_common(light, side) for side in SIDES)
        if motion.get("added_noise_percent") is None:
            flicker = flicker if lamp >= LAMP_IN_COMMON else 0.0
        else:
            moved = motion.get("drift_over_noise") or 0.0
            flicker = max(lamp, 1.0 - lamp) * flicker - (MOVED_LIKE_FLICKER * moved) ** 2
    if flicker > 0.0:
        yield Cause(judged.fault, flicker / (1.0 + flicker), True)


def _in_common(light: Numbers, side: str) -> float:
    """Return the share of the squares of the light's changes that the whole image has in common.

    It is 1 if a manifest does not have the numbers.
    """
    common, local = light.get(f"{side}_flicker_percent"), light.get(f"{side}_local_flicker_percent")
    if common is None or local is None:
        return 1.0
    return common**2 / max(common**2 + local**2, 1e-12)


def _moves(motion: Numbers) -> bool:
    """Return True if motion was detected, whether its added noise is known or not."""
    score, limit = motion.get("score"), motion.get("score_limit")
    return score is not None and limit is not None and score >= limit


def _outside(sight: Numbers) -> Cause | None:
    """Return too near or too far: outside of the volume there are no points in any light, at rest or not."""
    distance = sight.get("distance_mm")
    if distance is None:
        return None
    near, far = sight.get("near_percent") or 0.0, sight.get("far_percent") or 0.0
    share = 0.01 * max(near, far)
    if share <= MOST_OUTSIDE:
        return None
    code = FaultCode.SCAN_NEAR if near > far else FaultCode.SCAN_FAR
    word = "nearer" if near > far else "farther"
    what = f"{100.0 * share:.0f} % of the surface lies {word} than the working volume, most at {distance:.0f} mm"
    return Cause(Fault(code, what, {"distance_mm": distance}), ALL, True)


def _levels(
    by_name: Mapping[str, Judgement], light: Numbers, water: Numbers, best_fringe_dn: float | None
) -> Iterator[Cause]:
    """Yield too bright, too dark and too much ambient light, as shares of the illuminated pixels.

    For saturation see ``_saturated``; saturation by another lamp counts as ambient light alone. Ambient light takes no
    more than would be there without it: if the longest exposure makes fringes (``best_fringe_dn``) of less than
    ``ENOUGH_FRINGE_DN``, switching a lamp off does not help.
    """
    judged = by_name.get("light")
    fault = None if judged is None else judged.fault
    saturated = _saturated(light, water, burnt=False)
    if fault is not None and fault.code is FaultCode.TOO_DARK:
        yield Cause(fault, 1.0 - 0.01 * fault.numbers.get("coverage_percent", 0.0), True)
    if fault is not None and fault.code is FaultCode.AMBIENT:
        without_ambient = 1.0 if best_fringe_dn is None else min(1.0, best_fringe_dn / ENOUGH_FRINGE_DN)
        yield Cause(fault, 0.01 * fault.numbers.get("ambient_percent", 0.0) * without_ambient, True)
    if fault is not None and fault.code is FaultCode.TOO_BRIGHT:
        yield Cause(fault, max(0.01 * fault.numbers.get("saturated_percent", 0.0), saturated), True)
    if saturated > 0.0 and (fault is None or fault.code is not FaultCode.TOO_BRIGHT):
        detail = f"{100.0 * saturated:.0f} % of what is seen is saturated"
        yield Cause(Fault(FaultCode.TOO_BRIGHT, detail, {"saturated_percent": 100.0 * saturated}), saturated, False)


def _saturated(light: Numbers, water: Numbers, *, burnt: bool = True) -> float:
    """Return the saturated share of the illuminated pixels of the brighter camera.

    For the left camera it is that of the object's pixels, if larger: illuminated water shows no object, and would
    dilute the share. ``burnt``: include pixels that another lamp saturates, where no exposure helps.
    """
    shares = {side: 0.01 * (light.get(f"{side}_saturated_percent") or 0.0) for side in SIDES}
    if not burnt:
        shares = {side: share - 0.01 * (light.get(f"{side}_burnt_percent") or 0.0) for side, share in shares.items()}
    left, right = (shares[side] for side in SIDES)
    illuminated, clear = light.get("left_lit_percent"), water.get("object_percent")
    if left > 0.0 and illuminated is not None and clear is not None:
        of_picture = left * 0.01 * illuminated
        left = max(left, of_picture / (of_picture + 0.01 * clear))
    return max(left, right)


def _water(by_name: Mapping[str, Judgement], water: Numbers, saturated: float, *, still: bool) -> Iterator[Cause]:
    """Yield the cause water, with the share of the object's unsaturated pixels that it takes.

    ``saturated``: share of all its pixels that are saturated. The judge of water may have failed by specks alone, which
    say nothing unless all is ``still``; backscatter is then named only for a scan that is not usable.
    """
    judged = by_name.get("water")
    if judged is None or judged.fault is None:
        return
    backscatter, hidden, specks = (0.01 * (water.get(f"{name}_percent") or 0.0) for name in ("veil", "hidden", "speck"))
    masked = 0.01 * (water.get("masked_percent") or 0.0)
    turbid = 100.0 * backscatter >= CLEAR_WATER_PERCENT
    shares = [hidden if turbid else 0.0, backscatter if turbid and masked > hidden else 0.0]
    if still:
        shares.append(specks)
    share = (1.0 - saturated) * max(shares)
    if share > 0.0:
        yield Cause(judged.fault, share, still or hides_object(masked, backscatter, hidden))


def _faint(
    sight: Numbers, light: Numbers, water: Numbers, summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> Cause | None:
    """Return the cause for which too little of an object is seen: exposure, water, or no object."""
    room = _room(present, steps)
    fringe = sight.get("fringe_dn")
    lost = 1.0 - 0.01 * min(summary.coverage_percent or 0.0, 100.0)
    if _saturated(light, water) > MOST_SATURATED:
        return None  # saturated pixels show no fringes
    if fringe is None:
        return _unseen(sight, room)
    best = _best_fringe_dn(sight, present, steps) or 0.0
    is_fine = summary.noise_mm is None or summary.noise_mm <= USABLE_NOISE_MM
    if fringe >= ENOUGH_FRINGE_DN and is_fine:
        return None
    numbers = {"fringe_dn": fringe, "coverage_percent": 100.0 * (1.0 - lost)}
    share = lost * min(1.0, ENOUGH_FRINGE_DN / max(fringe, 0.1))
    if best >= ENOUGH_FRINGE_DN:
        if room <= 1.25:
            return None
        detail = f"fringes of {fringe:.1f} DN; a longer exposure gives {best:.0f} DN"
        return Cause(Fault(FaultCode.TOO_DARK, detail, numbers), share, False)
    detail = f"fringes of {fringe:.1f} DN, and no exposure gives more than {best:.1f} DN: the water absorbs the light"
    return Cause(Fault(FaultCode.WATER_DIRTY, detail, numbers), share, False)


def _room(present: Exposure, steps: Sequence[Exposure]) -> float:
    """Return the largest possible light over that of the present exposure."""
    return max((step.light for step in steps), default=present.light) / present.light


def _best_fringe_dn(sight: Numbers, present: Exposure, steps: Sequence[Exposure]) -> float | None:
    """Return the modulation of the fringes with the longest exposure that the projector's light allows.

    ``None``: no fringes are seen. It is scaled so that ``ENOUGH_FRINGE_DN`` give points: gain makes grey values but no
    photons. Noise of light grows with the root of the gain g, so that only 1/√g of the fringes counts against it. Of
    this a pixel needs ``MIN_MODULATION_DN``, as at rest without gain.
    """
    fringe, top = sight.get("fringe_dn"), sight.get("top_dn") or 0.0
    if fringe is None:
        return None
    factor = min(_room(present, steps), FULL_DN / max(top, 1.0))
    longest_us = max((step.time_us for step in steps), default=present.time_us)
    # Time first, since gain adds noise; light is in µs at 0 dB.
    gain = max(1.0, present.light * factor / longest_us)
    return fringe * factor * min(1.0, ENOUGH_FRINGE_DN / MIN_MODULATION_DN / math.sqrt(gain))


def _unseen(sight: Numbers, room: float) -> Cause:
    light, glow = sight.get("light_dn") or 0.0, sight.get("glow_per_m")
    numbers = {"light_dn": light}
    if glow is not None and glow >= SWALLOWS_PER_M:
        detail = f"only backscatter is visible, {light:.1f} DN, and it fades within a short distance"
        return Cause(Fault(FaultCode.WATER_DIRTY, detail, numbers | {"coverage_percent": 0.0}), ALL, False)
    if room >= MUCH_ROOM:
        detail = f"nothing is visible; the exposure could be {room:.0f} times as bright"
        return Cause(Fault(FaultCode.TOO_DARK, detail, numbers), ALL, False)
    return Cause(Fault(FaultCode.NOTHING_SEEN, f"no fringes anywhere; white adds {light:.1f} DN", numbers), ALL, False)


def _unexplained(summary: CloudSummary) -> Fault:
    coverage = summary.coverage_percent
    few = coverage is None or coverage < USABLE_COVERAGE_PERCENT
    detail = (
        "too few points, and no judge finds the cause" if few else "points are too noisy, and no judge finds the cause"
    )
    return Fault(FaultCode.SCAN_POOR, detail, {} if coverage is None else {"coverage_percent": coverage})


def _numbers(by_name: Mapping[str, Judgement], name: str) -> Numbers:
    return by_name[name].verdict.numbers if name in by_name else {}
