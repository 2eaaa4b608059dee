"""Owns the naming of causes: why a scan is poor, the cause that explains most of it first.

Judges look at one thing each, and one thing looks like another: what moves changes grey values as flickering light
does, and disturbs pixels as specks do; what is saturated has weak fringes as in milk; darkness is a short exposure's
doing or the water's. Here all judgements are weighed against each other, in one currency: the share of the scan's
information that a cause takes. Points count by the inverse of their variance; a pixel that gives no point has lost all
of it, and noise that grows by a factor f leaves 1/f².

A cause is named where it exceeds its own limit, or where the scan is not usable and nothing explains more. A scan that
is not usable has at least one cause: what remains unexplained is said to be so. See ``docs/causes.md``.
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
"""Largest multiple of the drift over the noise that the judge of light may see and that is still motion: 1.5 to 1.7 times is usual where
something moves. What exceeds it is light."""
LAMP_IN_COMMON = 0.5
"""Share of the squares of the changes that all parts of the picture have in common: before a lamp 0.9 and more, where
something moves before paint of any kind mostly below 0.3."""
CLEAR_WATER_PERCENT = 12.0
"""Pixels that are lost where a smaller share is hidden by backscatter are not lost to the water."""
LEAST_SHARE = 0.05
"""A cause that explains less is not named where its judge would not have raised it."""
ENOUGH_FRINGE_DN = 8.0
"""Fringes of this amplitude give points.

The ninth tenth of the cells must reach it with the longest exposure, or no exposure helps.
"""
MOST_SATURATED = 0.25
"""Share of the illuminated pixels: beyond, weak fringes say nothing about darkness."""
SEEN_FRINGE_DN = 0.5
"""Fringes of this amplitude are told from noise (``sight``)."""
MUCH_ROOM = ENOUGH_FRINGE_DN / SEEN_FRINGE_DN
"""Factor of light that can still be exposed for: where nothing is seen, an exposure is to blame that leaves this
unused. With less left, an object of which the longest exposure makes enough fringes would show some already."""
SWALLOWS_PER_M = 1.6
"""Attenuation from which on the shape of the glow says that the water lets no light through; the true attenuation is
two to three times as much."""
MOST_OUTSIDE = 0.5
"""Share of the points that lie outside of the depths measured; beyond, distance is what ails the scan."""
ALL = 1.0

_MISTRACED = frozenset({FaultCode.SIDES_EXCHANGED, FaultCode.NOT_IN_WATER})

Numbers = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Cause:
    """Why points are missing or worse than they could be."""

    fault: Fault
    share: float
    """Share of the scan's information that it takes, 0..1."""
    certain: bool
    """Its judge's own limit is exceeded; else it is named only for a scan that is not usable."""


def find_causes(
    judgements: Sequence[Judgement], summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> tuple[Cause, ...]:
    """Return every cause worth telling, the one that takes most first.

    ``judgements``: all of the scan; ``summary``: of its best cloud; ``present``: how it was exposed; ``steps``: how it
    could be. Pure: the same verdicts give the same causes, whether they come from the judges or from a manifest.
    """
    wrong = next((one.fault for one in judgements if one.fault and one.fault.code in _MISTRACED), None)
    if wrong is not None:
        # Whatever else is said of points of exchanged pictures, or of rays through another medium, follows from that.
        return (Cause(wrong, ALL, certain=True),)
    bent = next((one.fault for one in judgements if one.fault and one.fault.code is FaultCode.GREY_BENT), None)
    if bent is not None:
        # Light, water and noise are told from grey values, which mean nothing then; the points themselves may be good.
        return (Cause(bent, 0.0, certain=True),)
    of = {one.verdict.name: one for one in judgements}
    found = _once(sorted(_all(of, summary, present, steps), key=lambda cause: -cause.share))
    found += [
        Cause(one.fault, 0.01 * one.fault.numbers.get("hole_percent", 0.0), certain=True)
        for one in judgements
        if one.fault is not None and not _is_weighed(one)
    ]
    usable = is_usable(summary.coverage_percent, summary.noise_mm)
    named = _once(
        [
            cause
            for k, cause in enumerate(found)
            if cause.certain or (not usable and (cause.share >= LEAST_SHARE or k == 0) and cause.share > 0.0)
        ]
    )
    # A part is missing for a reason; that it is missing is told where no other is known.
    unexplained = {FaultCode.PART_MISSING, FaultCode.COMPENSATED}.issuperset(cause.fault.code for cause in named)
    named = [cause for cause in named if unexplained or cause.fault.code is not FaultCode.PART_MISSING]
    if (named and any(cause.fault.code is not FaultCode.COMPENSATED for cause in named)) or usable:
        return tuple(named)
    return (*named, Cause(_unexplained(summary), 0.0, False))


def with_causes(
    judgements: Sequence[Judgement], summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> tuple[Judgement, ...]:
    """Return ``judgements`` with the faults of ``find_causes`` in place of their own, in that order, and a verdict
    ``causes``.

    A judgement whose fault something else explains passes nothing and fails nothing. Identity is left as it is.
    """
    water = _numbers({one.verdict.name: one for one in judgements}, "water")
    causes = [_with_sight(cause, water) for cause in find_causes(judgements, summary, present, steps)]
    judges = {one.fault.code: one.verdict.name for one in judgements if one.fault is not None and not _is_weighed(one)}
    judges |= _JUDGES
    left = {one.verdict.name: one for one in judgements if one.verdict.name != CAUSES_NAME}
    ranked: list[Judgement] = []
    for cause in causes:
        judge = judges.get(cause.fault.code, CAUSES_NAME)
        if judge in left and judge != CAUSES_NAME:
            one = left.pop(judge)
            ranked.append(replace(one, fault=cause.fault, verdict=_failed(one.verdict, cause)))
        else:
            ranked.append(Judgement(Verdict(CAUSES_NAME, None), cause.fault))
    others = [_without_fault(one) if name != "identity" else one for name, one in left.items()]
    numbers: dict[str, float | None] = {
        f"{cause.fault.code.value.lower()}_percent": 100.0 * cause.share for cause in causes
    }
    text = ", ".join(f"{cause.fault.code.value} {100.0 * cause.share:.0f} %" for cause in causes) or "nothing ails it"
    verdict = Verdict(CAUSES_NAME, not causes, numbers, text)
    whole = [replace(one, verdict=verdict) if one.verdict.name == CAUSES_NAME else one for one in ranked]
    if not any(one.verdict.name == CAUSES_NAME for one in whole):
        whole.append(Judgement(verdict))
    identity = [one for one in others if one.verdict.name == "identity"]
    return (*identity, *whole, *(one for one in others if one.verdict.name != "identity"))


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
    """Return the cause with how far one sees in this water, where the water is to blame and it is known."""
    attenuation_per_m = water.get("attenuation_per_m")
    seen_m = None if attenuation_per_m is None else sight_m(attenuation_per_m)
    fault = cause.fault
    if fault.code is not FaultCode.WATER_DIRTY or seen_m is None or seen_m > MOST_SIGHT_M:
        return cause
    detail = f"{fault.detail}; sight {seen_m:.1f} m, attenuation {attenuation_per_m:.1f} /m"
    return replace(cause, fault=replace(fault, detail=detail, numbers={**fault.numbers, "sight_m": seen_m}))


def _is_weighed(one: Judgement) -> bool:
    """Say whether a judge's numbers are weighed here; the fault of any other judge stands as it says, behind the
    weighed ones."""
    return one.verdict.name in {CAUSES_NAME, "identity", *_JUDGES.values()}


def _failed(verdict: Verdict, cause: Cause) -> Verdict:
    """COMPENSATED leaves the verdict on motion as it is."""
    if cause.fault.code is FaultCode.COMPENSATED or verdict.passed is False:
        return verdict
    return replace(verdict, passed=False, text=f"{cause.fault.code.value}: {cause.fault.detail}")


def _without_fault(one: Judgement) -> Judgement:
    if one.fault is None:
        return one
    explained = replace(one.verdict, passed=None, text=f"{one.verdict.text}; explained by something else")
    return replace(one, fault=None, verdict=explained)


def _once(found: Sequence[Cause]) -> list[Cause]:
    """Return the first cause of each code, certain if any of them is."""
    certain = {cause.fault.code for cause in found if cause.certain}
    first: dict[FaultCode, Cause] = {}
    for cause in found:
        first.setdefault(cause.fault.code, replace(cause, certain=cause.fault.code in certain))
    return list(first.values())


def _all(
    of: Mapping[str, Judgement], summary: CloudSummary, present: Exposure, steps: Sequence[Exposure]
) -> Iterator[Cause]:
    """Yield what every judge's numbers make likely, whether or not it is worth telling."""
    light, water, motion, sight = (_numbers(of, name) for name in ("light", "water", "motion", "sight"))
    poor = not is_usable(summary.coverage_percent, summary.noise_mm)
    outside = _outside(sight)
    rushing = _rushing(motion, sight, light, water, summary) if poor and outside is None else None
    if rushing is not None:
        yield rushing
    else:
        yield from _motion(of, motion, summary, poor)
        yield from _flicker(light, of, motion)
    if outside is not None:
        yield outside
    yield from _levels(of, light, water, _best_fringe_dn(sight, present, steps))
    still = rushing is None and not _moves(motion)
    yield from _water(of, water, _saturated(light, water), still=still)
    faint = _faint(sight, light, water, summary, present, steps) if poor and outside is None else None
    if faint is not None:
        yield faint


def _motion(of: Mapping[str, Judgement], motion: Numbers, summary: CloudSummary, poor: bool) -> Iterator[Cause]:
    judged = of.get("motion")
    fault = None if judged is None else judged.fault
    added, lost = motion.get("added_noise_percent"), motion.get("lost_percent") or 0.0
    if added is None or not _moves(motion):
        return
    left = (1.0 - 0.01 * min(lost, 100.0)) / (1.0 + 0.01 * max(added, 0.0)) ** 2
    numbers = {"added_noise_percent": added, "shift_px": motion.get("shift_px"), "speed_mm_s": motion.get("speed_mm_s")}
    known = {name: value for name, value in numbers.items() if value is not None}
    detail = "" if judged is None else judged.verdict.text
    if fault is not None and fault.code is FaultCode.COMPENSATED:
        yield Cause(fault, 0.0, True)
        if poor:
            # Undone, and yet too few points are left: the noise is gone, what was lost while it moved is lost.
            yield Cause(Fault(FaultCode.MOVED, detail, known), 0.01 * min(lost, 100.0), False)
        return
    yield Cause(fault or Fault(FaultCode.MOVED, detail, known), 1.0 - left, fault is not None)


def _rushing(motion: Numbers, sight: Numbers, light: Numbers, water: Numbers, summary: CloudSummary) -> Cause | None:
    """Return a motion so fast that too few points are left to judge it by: strong fringes in good light that contradict
    each other.

    A lamp that flickers leaves the Gray code readable, and what is saturated, behind backscatter, faint or outside is
    distinguished from this.
    """
    fringe = sight.get("fringe_dn")
    if motion.get("added_noise_percent") is not None or fringe is None or fringe < ENOUGH_FRINGE_DN:
        return None
    turbid = (water.get("veil_percent") or 0.0) >= CLEAR_WATER_PERCENT
    if turbid or _saturated(light, water) > MOST_SATURATED:
        return None
    detail = f"fringes of {fringe:.0f} DN that contradict each other: something moves fast"
    return Cause(Fault(FaultCode.MOVED, detail), 1.0 - 0.01 * min(summary.coverage_percent or 0.0, 100.0), True)


def _flicker(light: Numbers, of: Mapping[str, Judgement], motion: Numbers) -> Iterator[Cause]:
    """A lamp changes the whole picture alike, from frame to frame; what moves changes each part by its own paint, and
    so does sun through waves. So where anything moves, the two are weighed apart."""
    judged = of.get("light")
    if judged is None or judged.fault is None or judged.fault.code is not FaultCode.LIGHT_FLICKERS:
        return
    ripples = [light.get(f"{side}_flicker_over_noise") for side in SIDES]
    own = min((one for one in ripples if one is not None), default=0.0) ** 2
    if _moves(motion):
        lamp = min(_in_common(light, side) for side in SIDES)
        if motion.get("added_noise_percent") is None:
            own = own if lamp >= LAMP_IN_COMMON else 0.0
        else:
            moved = motion.get("drift_over_noise") or 0.0
            own = max(lamp, 1.0 - lamp) * own - (MOVED_LIKE_FLICKER * moved) ** 2
    if own > 0.0:
        yield Cause(judged.fault, own / (1.0 + own), True)


def _in_common(light: Numbers, side: str) -> float:
    """Return the share of the squares of the light's changes that the whole picture has in common; 1 where a
    manifest does not say."""
    common, local = light.get(f"{side}_flicker_percent"), light.get(f"{side}_local_flicker_percent")
    if common is None or local is None:
        return 1.0
    return common**2 / max(common**2 + local**2, 1e-12)


def _moves(motion: Numbers) -> bool:
    """Say whether anything was found to move, be its harm known or not."""
    score, least = motion.get("score"), motion.get("score_limit")
    return score is not None and least is not None and score >= least


def _outside(sight: Numbers) -> Cause | None:
    """Return too near or too far: all else outside gives no points, however bright or still it is."""
    distance = sight.get("distance_mm")
    if distance is None:
        return None
    near, far = sight.get("near_percent") or 0.0, sight.get("far_percent") or 0.0
    share = 0.01 * max(near, far)
    if share <= MOST_OUTSIDE:
        return None
    code = FaultCode.SCAN_NEAR if near > far else FaultCode.SCAN_FAR
    word = "nearer" if near > far else "farther"
    what = f"{100.0 * share:.0f} % of what is seen lies {word} than is measured, most at {distance:.0f} mm"
    return Cause(Fault(code, what, {"distance_mm": distance}), ALL, True)


def _levels(
    of: Mapping[str, Judgement], light: Numbers, water: Numbers, best_fringe_dn: float | None
) -> Iterator[Cause]:
    """Yield too bright, too dark, too much ambient light, as shares of the illuminated pixels; of what is saturated
    see ``_saturated``. What another lamp saturates is ambient light alone.

    Ambient light takes no more than what would be there without it: where the longest exposure makes less than
    ``ENOUGH_FRINGE_DN`` of the fringes (``best_fringe_dn``), putting a lamp out mends nothing.
    """
    judged = of.get("light")
    fault = None if judged is None else judged.fault
    saturated = _saturated(light, water, burnt=False)
    if fault is not None and fault.code is FaultCode.TOO_DARK:
        yield Cause(fault, 1.0 - 0.01 * fault.numbers.get("coverage_percent", 0.0), True)
    if fault is not None and fault.code is FaultCode.AMBIENT:
        without = 1.0 if best_fringe_dn is None else min(1.0, best_fringe_dn / ENOUGH_FRINGE_DN)
        yield Cause(fault, 0.01 * fault.numbers.get("ambient_percent", 0.0) * without, True)
    if fault is not None and fault.code is FaultCode.TOO_BRIGHT:
        yield Cause(fault, max(0.01 * fault.numbers.get("saturated_percent", 0.0), saturated), True)
    if saturated > 0.0 and (fault is None or fault.code is not FaultCode.TOO_BRIGHT):
        detail = f"{100.0 * saturated:.0f} % of what is seen is saturated"
        yield Cause(Fault(FaultCode.TOO_BRIGHT, detail, {"saturated_percent": 100.0 * saturated}), saturated, False)


def _saturated(light: Numbers, water: Numbers, *, burnt: bool = True) -> float:
    """Return the saturated share of the illuminated pixels of the brighter camera; or of the object's, where the left
    camera sees more of these saturated. ``burnt``: with what another lamp saturates, where no exposure helps.

    Illuminated water shows no object, and would dilute the share that is lost of one.
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


def _water(of: Mapping[str, Judgement], water: Numbers, saturated: float, *, still: bool) -> Iterator[Cause]:
    """Yield what the water takes, as shares of the object's pixels that are not saturated: ``saturated`` of them all
    are.

    Its judge may have been moved by specks alone, which say nothing unless all is ``still``: what backscatter there is
    besides is then named only for a scan that is not usable.
    """
    judged = of.get("water")
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
    """Return why too little of an object is seen to measure it: exposure, water, or that there is none."""
    room = _room(present, steps)
    fringe = sight.get("fringe_dn")
    lost = 1.0 - 0.01 * min(summary.coverage_percent or 0.0, 100.0)
    if _saturated(light, water) > MOST_SATURATED:
        return None  # what is saturated shows no fringes
    if fringe is None:
        return _unseen(sight, room)
    best = _best_fringe_dn(sight, present, steps) or 0.0
    fine = summary.noise_mm is None or summary.noise_mm <= USABLE_NOISE_MM
    if fringe >= ENOUGH_FRINGE_DN and fine:
        return None
    numbers = {"fringe_dn": fringe, "coverage_percent": 100.0 * (1.0 - lost)}
    share = lost * min(1.0, ENOUGH_FRINGE_DN / max(fringe, 0.1))
    if best >= ENOUGH_FRINGE_DN:
        if room <= 1.25:
            return None
        detail = f"fringes of {fringe:.1f} DN; a longer exposure makes {best:.0f} DN of them"
        return Cause(Fault(FaultCode.TOO_DARK, detail, numbers), share, False)
    detail = f"fringes of {fringe:.1f} DN, and no exposure makes more than {best:.1f} DN of them: the water swallows the light"
    return Cause(Fault(FaultCode.WATER_DIRTY, detail, numbers), share, False)


def _room(present: Exposure, steps: Sequence[Exposure]) -> float:
    """Return the factor of light that can still be exposed for."""
    return max((step.light for step in steps), default=present.light) / present.light


def _best_fringe_dn(sight: Numbers, present: Exposure, steps: Sequence[Exposure]) -> float | None:
    """Return the amplitude of the fringes with the longest exposure that the projector's own light allows, ``None``: no
    fringes are seen; less where they are not worth as much, so that ``ENOUGH_FRINGE_DN`` of it give points.

    Gain makes grey values but no photons: the noise of light grows with its root, and of fringes at a gain of g only
    1/√g counts against it, of which a pixel needs ``MIN_MODULATION_DN`` as at rest without gain.
    """
    fringe, top = sight.get("fringe_dn"), sight.get("top_dn") or 0.0
    if fringe is None:
        return None
    factor = min(_room(present, steps), FULL_DN / max(top, 1.0))
    longest_us = max((step.time_us for step in steps), default=present.time_us)
    # Time before gain, for it costs no noise; light is counted in µs at 0 dB.
    gain = max(1.0, present.light * factor / longest_us)
    return fringe * factor * min(1.0, ENOUGH_FRINGE_DN / MIN_MODULATION_DN / math.sqrt(gain))


def _unseen(sight: Numbers, room: float) -> Cause:
    light, glow = sight.get("light_dn") or 0.0, sight.get("glow_per_m")
    numbers = {"light_dn": light}
    if glow is not None and glow >= SWALLOWS_PER_M:
        detail = f"nothing but lit water, {light:.1f} DN, and its glow fades within a hand's breadth"
        return Cause(Fault(FaultCode.WATER_DIRTY, detail, numbers | {"coverage_percent": 0.0}), ALL, False)
    if room >= MUCH_ROOM:
        detail = f"nothing is seen; the exposure could be {room:.0f} times as bright"
        return Cause(Fault(FaultCode.TOO_DARK, detail, numbers), ALL, False)
    return Cause(Fault(FaultCode.NOTHING_SEEN, f"no fringes anywhere; white adds {light:.1f} DN", numbers), ALL, False)


def _unexplained(summary: CloudSummary) -> Fault:
    coverage = summary.coverage_percent
    few = coverage is None or coverage < USABLE_COVERAGE_PERCENT
    detail = (
        "too few points, and nothing that was judged explains it"
        if few
        else "points are too noisy, and nothing explains it"
    )
    return Fault(FaultCode.SCAN_POOR, detail, {} if coverage is None else {"coverage_percent": coverage})


def _numbers(of: Mapping[str, Judgement], name: str) -> Numbers:
    return of[name].verdict.numbers if name in of else {}
