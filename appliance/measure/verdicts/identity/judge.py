"""Judges from a camera's images alone whether each frame shows the pattern planned for it, and if not, what happened
instead.

``judge_identity`` is the entry. It is called the fifth witness of a sequence, since the ledger of a capture has four:
flips, pulses, left and right frames. Doubts are counted in ``evidence.py``; ``explain.py`` finds what would leave none:
frames exchanged, late, early, repeated or stuck, or a picture that lies the wrong way round.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import NOMINAL, Exposure
from appliance.measure.light.noise import FULL_DN, TYPICAL_PAIR, CameraNoise, StereoNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.identity.evidence import DECIDED, MIN_FRINGE, LineEvidence, Witness
from appliance.measure.verdicts.identity.explain import WAYS_ROUND, Explanation, What, explain, still
from appliance.measure.verdicts.identity.lines import Lines, can_follow, take_lines

IDENTITY_NAME = "identity"
LEAST_LIGHT_DN = 0.05
"""Mean of the bright frame above that of the dark one, where even the water's backscatter is gone."""
LIGHT_SIGMA = 4.0
LEAST_BACKSCATTER_DN_PER_MS = 0.03
"""Grey values per ms of exposure at 0 dB that the projector's white adds to the mean even where it meets nothing but
the clearest water: a tenth of what clear coastal water adds. An exposure so short that this would not be seen cannot
tell that the projector is dark."""
MOST_MOVED = 0.25
"""Share of samples that are not the same from one direction's fringes to the other's.

At rest it is below 0.01; beyond this, doubts that no order of the frames explains are the motion's, which has a judge
of its own.
"""
LEAST_MOVED, LARGE_DOUBT = 0.03, 1.5
"""Share of moved samples from which on a doubt below the second value is the motion's as well: a fish before what
the first frames saw."""
DOUBT_PER_MOVED, LARGER_DOUBT = 10.0, 2.5
"""Growth of that doubt, beyond 1, with the share that moves, and its most: an object that comes nearer by 60 mm/s."""
MOST_TOTAL, RUSHING = 6.0, 0.34
"""Sum of all doubts, each counted as at most two, from which on movement alone has not made them unless more than the
second value, a share of the samples, moves. What moves spoils some of the tests, a wrong frame nearly all of them: good
views before hands of up to 60 mm/s have 5.4 at most, 2.9 where one is decided; of 20 wrong orders that had been left to
the judge of motion 14 have more. Before hands of 84 to 242 mm/s good views have up to 20, but then 0.37 of the samples
and more move (development scenes)."""
LARGE_RELIEF = 3.0
"""Drop of that sum under another order from which on that order is believed whatever moves.

Of 32 good views that hands of 60 to 250 mm/s spoilt none had such an order.
"""
LEAST_PARALLAX = 0.1
"""Least distance of the stripes from their place in either camera, to opposite sides, in widths of the field: the
object is far from the measuring volume. That alone is no wrong pattern."""
BOTH_ELSEWHERE = 0.5
"""Doubt of both cameras that stripes across the base line are elsewhere from which on that is depth, unless another
order explains it: from 250 mm to far behind the volume they wander by 0.44 of the field."""
PARALLAX_DOUBTS = frozenset({"place x", "elsewhere x"})
"""Doubts that distance raises."""

MOST_SATURATED = 0.5
"""Share of the illuminated samples at which two of the four steps of a direction or more are saturated.

Beyond, what is left are borders of the picture and of stripes. Where these lie, and doubts about them that no order of
the frames explains, is no wrong pattern: the picture is too bright.
"""
MOST_FLOODED = 0.05
"""Share of all samples that are saturated even in the darkest frame.

Beyond, that all images are alike proves nothing.
"""


@dataclass(frozen=True, slots=True)
class _Camera:
    """Findings from one camera's frames alone."""

    device: str
    evidence: LineEvidence
    explanation: Explanation | None
    """``None``: nothing speaks against them."""
    light_dn: float
    """Grey values that the projector's white adds to the mean of the image."""
    sees_light: bool
    """It is more than chance."""
    would_see_backscatter: bool
    """Mere illuminated water would be more than chance as well: seeing no light then means that there is none."""
    ends_dark: bool
    """The last frame is about as dark as the darkest."""
    identical: bool
    """All frames are one image to the last bit, and it is not black."""
    flooded: bool
    """The image is saturated in every frame over so large a part that it says nothing of the patterns."""


def judge_identity(
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    noise: StereoNoise = TYPICAL_PAIR,
    exposure: Exposure = NOMINAL,
    lines: Mapping[str, Mapping[Direction, Lines]] | None = None,
) -> Judgement:
    """Judge ``identity`` by the frames (n, h, w) uint8 of ``left`` and ``right``, in the order of ``sequence``, taken
    with ``exposure``. ``lines`` of both sides, where they were taken while the frames arrived.

    Passed: every frame is its pattern. None: too little of the projector's light is seen to say so, or too much moves.
    Failed, with a fault: ``CAMERA_STUCK`` (device), ``PROJECTOR_TIMING`` (shift_frames), ``PATTERN_WRONG`` (frame;
    device projector if both cameras say it), ``PICTURE_MIRRORED`` (device, likewise), ``PROJECTOR_DARK`` (only where
    the illuminated water would have been seen). Numbers: ``doubt``, the largest of all doubts, which alarm from 1 on;
    of each camera the same, the samples with fringes, and the projector's light; ``parallax_percent``, by which both
    see the stripes beside their place, to opposite sides. Raises ValueError for a number of frames that is not the
    sequence's.
    """
    for side, mine in frames.items():
        if len(mine) != len(sequence):
            raise ValueError(
                f"{len(mine)} frames of camera {side} for a sequence of {len(sequence)}; judge whole sequences"
            )
    of = {side: of_side(noise, side) for side in SIDES}
    lines = lines or {side: take_lines(mine, sequence, of[side]) for side, mine in frames.items()}
    seen_by = [_look(side, mine, lines[side], sequence, of[side], exposure) for side, mine in frames.items()]
    cameras = _without_parallax(seen_by)
    fault = _fault(cameras)
    judged = [camera for camera in cameras if camera.evidence.judged]
    numbers: dict[str, float | None] = {
        "doubt": max((camera.evidence.worst for camera in judged), default=None),
        "frame": None if fault is None else fault.numbers.get("frame"),
        "parallax_percent": _parallax_percent(seen_by),
    }
    for camera in cameras:
        side = camera.device.removeprefix("camera.")
        numbers[f"{side}_doubt"] = camera.evidence.worst if camera.evidence.judged else None
        numbers[f"{side}_samples"] = float(camera.evidence.fringe)
        numbers[f"{side}_light_dn"] = camera.light_dn
    if fault is not None:
        text = f"{fault.code.value}: {fault.detail}"
        return Judgement(Verdict(IDENTITY_NAME, False, numbers, text), fault)
    if not judged:
        text = "too little is seen of the patterns, or too much moves before them"
        return Judgement(Verdict(IDENTITY_NAME, None, numbers, text))
    seen = " and ".join(camera.device for camera in judged)
    return Judgement(Verdict(IDENTITY_NAME, True, numbers, f"each frame of {seen} is its pattern"))


def _look(
    side: str,
    frames: NDArray[np.uint8],
    lines: Mapping[Direction, Lines],
    sequence: PatternSequence,
    noise: CameraNoise,
    exposure: Exposure,
) -> _Camera:
    witness = Witness(lines, sequence, noise)
    evidence = witness.evidence(np.arange(len(sequence), dtype=np.int64))
    if not can_follow(sequence, frames.shape[2]):
        evidence = LineEvidence({}, {}, evidence.illuminated, 0, 0)
    means = np.mean([mine.values.reshape(len(sequence), -1).mean(axis=1) for mine in witness.lines.values()], axis=0)
    sines = [k for direction in Direction for k in sequence.axis(direction).sine]
    light_dn = float(means[sequence.bright] - means[sequence.dark])
    chance_dn = max(LEAST_LIGHT_DN, LIGHT_SIGMA * float(np.std(means[sines])))
    sees_light = abs(light_dn) > chance_dn
    would_see_backscatter = LEAST_BACKSCATTER_DN_PER_MS * 1e-3 * exposure.light > chance_dn
    explanation = None
    flooded = max(float(np.mean(mine.low == FULL_DN)) for mine in witness.lines.values()) > MOST_FLOODED
    if evidence.judged:
        if evidence.contradicted:
            explanation = explain(witness, sequence, noise, evidence)
            weak = explanation.what is What.UNEXPLAINED or _decided(evidence) == ["place x"]
            dazzled = weak and _saturated_share(witness, sequence) > MOST_SATURATED
            if dazzled or _may_be_motion(explanation, evidence):
                explanation, evidence = (
                    None,
                    LineEvidence({}, {}, evidence.illuminated, 0, 0, displaced=evidence.displaced),
                )
    elif evidence.illuminated >= MIN_FRINGE and not flooded:
        explanation = still(witness, sequence, noise)
    ends_dark = bool(means[-1] - means.min() < 0.1 * (means.max() - means.min()))
    identical = all(np.array_equal(mine.low, mine.high) and mine.high.any() for mine in witness.lines.values())
    return _Camera(
        f"camera.{side}",
        evidence,
        explanation,
        light_dn,
        sees_light,
        would_see_backscatter,
        ends_dark,
        identical,
        flooded,
    )


def _saturated_share(witness: Witness, sequence: PatternSequence) -> float:
    """Return the share of the illuminated samples at which two steps of one direction or more are saturated."""
    saturated = illuminated = 0
    for lines in witness.lines.values():
        steps = [lines.values[list(sequence.axis(d).sine)][:, lines.illuminated] == FULL_DN for d in Direction]
        saturated += int(np.count_nonzero(np.max([step.sum(axis=0) for step in steps], axis=0) >= 2))
        illuminated += steps[0].shape[1]
    return saturated / max(illuminated, 1)


def _may_be_motion(explanation: Explanation, evidence: LineEvidence) -> bool:
    """Say whether motion may be what was explained: a good order of the frames leaves nothing that moves much.
    Frames that look alike prove a repeat only where nothing else can have raised the doubt; an image that stays
    proves itself."""
    if explanation.relief >= LARGE_RELIEF:
        return False
    if explanation.what is What.UNEXPLAINED and evidence.total >= MOST_TOTAL and explanation.moved <= RUSHING:
        return False
    if explanation.what not in (What.STILL, What.REPEATED) and explanation.moved > MOST_MOVED:
        return True
    if explanation.moved <= LEAST_MOVED or explanation.what not in (What.UNEXPLAINED, What.REPEATED):
        return False
    most = min(LARGER_DOUBT, DECIDED + DOUBT_PER_MOVED * explanation.moved)
    return evidence.worst < (max(LARGE_DOUBT, most) if explanation.what is What.UNEXPLAINED else LARGE_DOUBT)


def _without_parallax(cameras: list[_Camera]) -> list[_Camera]:
    """Return the cameras, unjudged where their only doubt is where the stripes lie and both see them displaced to
    opposite sides, or both some of them elsewhere: what is seen is far from the volume, or reaches from before it to
    behind it."""
    if len(cameras) != 2:
        return cameras
    aside = [camera.evidence.displaced for camera in cameras]
    displaced = aside[0] * aside[1] < 0.0 and min(abs(one) for one in aside) >= LEAST_PARALLAX
    deep = min(camera.evidence.doubts.get("elsewhere x", 0.0) for camera in cameras) >= BOTH_ELSEWHERE
    if not displaced and not deep:
        return cameras
    return [replace(one, explanation=None, evidence=_nothing(one)) if _only_displaced(one) else one for one in cameras]


def _parallax_percent(cameras: list[_Camera]) -> float | None:
    """Return how far the stripes lie to the right in the left camera and to the left in the right one, in percent of
    the field: positive before an object that is near. ``None``: one of them sees too few."""
    aside = {camera.device: camera.evidence.displaced for camera in cameras}
    left, right = aside.get("camera.left", 0.0), aside.get("camera.right", 0.0)
    # A pattern's stripe that is seen farther to the right has a smaller code there than the design gives that place.
    return None if left == 0.0 or right == 0.0 else 50.0 * (right - left)


def _only_displaced(camera: _Camera) -> bool:
    explanation = camera.explanation
    unexplained = explanation is not None and explanation.what is What.UNEXPLAINED
    return unexplained and set(_decided(camera.evidence)) <= PARALLAX_DOUBTS


def _decided(evidence: LineEvidence) -> list[str]:
    return [name for name, doubt in evidence.doubts.items() if doubt >= DECIDED]


def _nothing(camera: _Camera) -> LineEvidence:
    return LineEvidence({}, {}, camera.evidence.illuminated, 0, 0)


def _fault(cameras: list[_Camera]) -> Fault | None:
    """Return one cause for what the cameras say: what both say alike is the projector's doing."""
    wrong = [camera for camera in cameras if camera.explanation is not None]
    if not wrong:
        return _without_patterns(cameras)
    for camera in wrong:
        explanation = camera.explanation
        if explanation is not None and explanation.what is What.STILL:
            alone = len(wrong) < len(cameras) or not _alike(wrong)
            if alone or explanation.identical:
                return _stuck(camera, explanation.frame)
    explained = [c for c in wrong if c.explanation is not None and c.explanation.what is not What.UNEXPLAINED]
    first = (explained or wrong)[0]
    explanation = first.explanation
    assert explanation is not None
    # What all see alike is the projector's; of a picture that lies wrong only if it lies wrong in the same way.
    everybody = len(wrong) == len(cameras) > 1
    if explanation.what in WAYS_ROUND:
        return _turned(explanation.what, first.device if not (everybody and _alike(wrong)) else "projector")
    return _named(explanation, first, "projector" if everybody else first.device)


def _turned(what: What, device: str) -> Fault:
    """Return the fault of a picture that lies the wrong way round: in one camera, or, where all see it so, in the
    projector."""
    if device == "projector":
        detail = f"both cameras see the picture {what.value}: switch rear projection, ceiling projection and flips off in the projector"
    else:
        detail = f"{device} sees the picture {what.value}: switch its ReverseX and ReverseY off under features, or mount it the right way round"
    return Fault(FaultCode.PICTURE_MIRRORED, detail, device=device)


def _alike(wrong: list[_Camera]) -> bool:
    explanations = [(c.explanation.what, c.explanation.frame) for c in wrong if c.explanation is not None]
    return len(set(explanations)) == 1


def _stuck(camera: _Camera, frame: int) -> Fault:
    detail = f"{camera.device} shows the same image from frame {frame} on"
    return Fault(FaultCode.CAMERA_STUCK, detail, {"frame": frame}, camera.device)


def _without_patterns(cameras: list[_Camera]) -> Fault | None:
    """Return the fault, where nothing contradicts the patterns, of nobody having seen them."""
    if any(camera.flooded for camera in cameras):
        return None  # other light than the projector's blinds it: the judge of light says so
    for camera in cameras:
        others = [c for c in cameras if c is not camera]
        blind = camera.evidence.illuminated < MIN_FRINGE and not camera.sees_light
        if camera.identical or (blind and any(c.evidence.judged for c in others)):
            return _stuck(camera, 0)
    if any(camera.sees_light or camera.evidence.judged for camera in cameras):
        return None
    if not any(camera.would_see_backscatter for camera in cameras):
        return None  # a short exposure or a lamp hides it: the causes say what is known of that
    light_dn = max(camera.light_dn for camera in cameras)
    return Fault(
        FaultCode.PROJECTOR_DARK,
        f"the bright frame is {light_dn:.2f} DN brighter than the dark one: there is not even backscatter",
        {"light_dn": light_dn},
        "projector",
    )


def _named(explanation: Explanation, camera: _Camera, device: str) -> Fault:
    frame, other = explanation.frame, explanation.other
    numbers: dict[str, float] = {"frame": frame, "doubt": camera.evidence.worst}
    match explanation.what:
        case What.LATE | What.EARLY:
            shift = 1 if explanation.what is What.LATE else -1
            numbers["shift_frames"] = shift
            detail = f"from frame {frame} on, {device} shows each pattern one frame {explanation.what.value}"
            if frame == 0 and device == "projector":
                return Fault(FaultCode.PROJECTOR_TIMING, detail, numbers, device)
        case What.STILL:
            if camera.ends_dark:
                return Fault(FaultCode.PROJECTOR_DARK, f"from frame {frame} on, all is dark", numbers, device)
            detail = f"from frame {frame} on, {device} shows one and the same pattern"
        case What.SWAPPED:
            detail = f"{device} shows the patterns of frames {frame} and {other} in each other's place"
        case What.REPEATED:
            detail = f"frame {frame} of {device} repeats frame {other}"
        case _:
            detail = f"{device} does not show the sequence; the first doubt is about frame {frame}"
    return Fault(FaultCode.PATTERN_WRONG, detail, numbers, device)
