"""The verdict ``identity``: whether each frame shows its pattern, by the images, else the cause.

``judge_identity`` is the entry. It is called the fifth witness of a sequence, since the ledger of a capture has four:
flips, pulses, left and right frames. ``evidence.py`` computes doubts; ``explain.py`` finds the explanation that leaves
none: frames exchanged, late, early, repeated or stuck, or a mirrored or rotated image.
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
from appliance.measure.verdicts.identity.explain import WAYS_ROUND, Disagreement, Explanation, explain, still
from appliance.measure.verdicts.identity.lines import Lines, can_follow, take_lines

IDENTITY_NAME = "identity"
LEAST_LIGHT_DN = 0.05
"""Least difference of the means of bright and dark frame, even without backscatter."""
LIGHT_SIGMA = 4.0
LEAST_BACKSCATTER_DN_PER_MS = 0.03
"""Grey values per ms of exposure at 0 dB that the projector's white adds to the mean in the clearest water without an
object: a tenth of that in clear coastal water. At an exposure too short for detecting this, a dark projector cannot be
detected."""
MOST_MOVED = 0.25
"""Largest share of samples whose mean differs between the fringes of both directions; at rest it is below 0.01.

Beyond, doubts that no order of the frames explains are due to motion, which has another judge.
"""
LEAST_MOVED, LARGE_DOUBT = 0.03, 1.5
"""Least share of moved samples with which a doubt below the second value is due to motion as well: a fish before the
object in the first frames."""
DOUBT_PER_MOVED, LARGER_DOUBT = 10.0, 2.5
"""Increase of that limit, beyond 1, with the share that moves, and its maximum: an object that approaches with 60 mm/s.
"""
MOST_TOTAL, RUSHING = 6.0, 0.34
"""Sum of all doubts, each limited to two, from which on motion is the cause only if more than the second value, a share
of the samples, moves.

Motion spoils some of the tests, a wrong frame nearly all of them. With hands of up to 60 mm/s, good frames have 5.4 at
most, 2.9 if a doubt has reached its limit; of 20 wrong orders that had been left to the judge of motion 14 have more.
With hands of 84 to 242 mm/s good frames have up to 20, but then 0.37 of the samples and more move (development scenes).
"""
LARGE_RELIEF = 3.0
"""Decrease of that sum by another order from which on that order is accepted with any motion.

Of 32 good captures that hands of 60 to 250 mm/s spoilt none had such an order.
"""
LEAST_PARALLAX = 0.1
"""Least displacement of the stripes in each camera, to opposite sides, in widths of the field, that means an object far
from the working volume. That alone is no wrong pattern."""
BOTH_ELSEWHERE = 0.5
"""Least doubt ``elsewhere x`` of both cameras that is due to depth, unless another order explains it: from 250 mm to
far behind the volume, stripes are displaced by 0.44 of the field."""
PARALLAX_DOUBTS = frozenset({"place x", "elsewhere x"})
"""Doubts that may be due to the distance."""

MOST_SATURATED = 0.5
"""Largest share of the illuminated samples at which two of the four steps of a direction or more are saturated.

Beyond, only samples at the borders of the image and of stripes are left. Their places, and doubts about them that no
order of the frames explains, are due to saturation and not to a wrong pattern.
"""
MOST_FLOODED = 0.05
"""Largest share of all samples that are saturated even in the darkest frame.

Beyond, equal images prove nothing.
"""


@dataclass(frozen=True, slots=True)
class _Camera:
    """Findings from one camera's frames alone."""

    device: str
    evidence: LineEvidence
    explanation: Explanation | None
    """``None``: the frames do not contradict the sequence."""
    light_dn: float
    """Grey values that the projector's white adds to the mean of the image."""
    sees_light: bool
    """True if this is more than noise."""
    would_see_backscatter: bool
    """True if backscatter alone would be more than noise, so that without light the projector must be dark."""
    ends_dark: bool
    """True if the last frame is about as dark as the darkest."""
    identical: bool
    """True if all frames are equal to the last bit, and not black."""
    flooded: bool
    """True if the image is saturated in every frame over a part too large for a judgement of the patterns."""


def judge_identity(
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    noise: StereoNoise = TYPICAL_PAIR,
    exposure: Exposure = NOMINAL,
    lines: Mapping[str, Mapping[Direction, Lines]] | None = None,
) -> Judgement:
    """Judge whether each frame of ``left`` and ``right`` shows its pattern.

    ``frames``: (n, h, w) uint8, captured with ``exposure``. They are in the order of ``sequence``. ``lines``: those of
    both sides, if they were taken while the frames arrived.

    Passed: every frame shows its pattern. None: too little of the projector's light is seen, or too much moves. Failed,
    with a fault: ``CAMERA_STUCK`` (device), ``PROJECTOR_TIMING`` (shift_frames), ``PATTERN_WRONG`` (frame; device
    projector if both cameras agree), ``PICTURE_MIRRORED`` (device, likewise), ``PROJECTOR_DARK`` (only if backscatter
    would have been detected). Numbers: ``doubt``, the largest of all doubts, which alarm from 1 on; for each camera the
    same, the samples with fringes, and the projector's light; ``parallax_percent``, the displacement of the stripes in
    both cameras, to opposite sides. Raises ValueError for a wrong number of frames.
    """
    for side, side_frames in frames.items():
        if len(side_frames) != len(sequence):
            raise ValueError(
                f"{len(side_frames)} frames of camera {side} for a sequence of {len(sequence)}; judge whole sequences"
            )
    noise_of = {side: of_side(noise, side) for side in SIDES}
    lines = lines or {side: take_lines(side_frames, sequence, noise_of[side]) for side, side_frames in frames.items()}
    findings = [
        _look(side, side_frames, lines[side], sequence, noise_of[side], exposure)
        for side, side_frames in frames.items()
    ]
    cameras = _without_parallax(findings)
    fault = _fault(cameras)
    judged = [camera for camera in cameras if camera.evidence.judged]
    numbers: dict[str, float | None] = {
        "doubt": max((camera.evidence.worst for camera in judged), default=None),
        "frame": None if fault is None else fault.numbers.get("frame"),
        "parallax_percent": _parallax_percent(findings),
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
        text = "not judged: the patterns are too faint, or too much moves in front of them"
        return Judgement(Verdict(IDENTITY_NAME, None, numbers, text))
    devices = " and ".join(camera.device for camera in judged)
    return Judgement(Verdict(IDENTITY_NAME, True, numbers, f"each frame of {devices} shows its pattern"))


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
            weak = explanation.kind is Disagreement.UNEXPLAINED or _decided(evidence) == ["place x"]
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
    """Return the share of illuminated samples with two or more saturated steps of one direction."""
    saturated = illuminated = 0
    for lines in witness.lines.values():
        steps = [lines.values[list(sequence.axis(d).sine)][:, lines.illuminated] == FULL_DN for d in Direction]
        saturated += int(np.count_nonzero(np.max([step.sum(axis=0) for step in steps], axis=0) >= 2))
        illuminated += steps[0].shape[1]
    return saturated / max(illuminated, 1)


def _may_be_motion(explanation: Explanation, evidence: LineEvidence) -> bool:
    """Return True if motion may be the true cause of the doubts: under the true order little moves.

    Equal frames prove a repeat only if nothing else can have raised the doubt; a still image is its own proof.
    """
    if explanation.relief >= LARGE_RELIEF:
        return False
    if explanation.kind is Disagreement.UNEXPLAINED and evidence.total >= MOST_TOTAL and explanation.moved <= RUSHING:
        return False
    if explanation.kind not in (Disagreement.STILL, Disagreement.REPEATED) and explanation.moved > MOST_MOVED:
        return True
    if explanation.moved <= LEAST_MOVED or explanation.kind not in (Disagreement.UNEXPLAINED, Disagreement.REPEATED):
        return False
    doubt_limit = min(LARGER_DOUBT, DECIDED + DOUBT_PER_MOVED * explanation.moved)
    return evidence.worst < (
        max(LARGE_DOUBT, doubt_limit) if explanation.kind is Disagreement.UNEXPLAINED else LARGE_DOUBT
    )


def _without_parallax(cameras: list[_Camera]) -> list[_Camera]:
    """Return the cameras, unjudged if their only doubts are due to the distance of the object.

    Either both see the stripes displaced, to opposite sides: the object is far from the volume. Or both see some of
    them elsewhere: it extends from before the volume to behind it.
    """
    if len(cameras) != 2:
        return cameras
    aside = [camera.evidence.displaced for camera in cameras]
    displaced = aside[0] * aside[1] < 0.0 and min(abs(displacement) for displacement in aside) >= LEAST_PARALLAX
    deep = min(camera.evidence.doubts.get("elsewhere x", 0.0) for camera in cameras) >= BOTH_ELSEWHERE
    if not displaced and not deep:
        return cameras
    return [
        replace(camera, explanation=None, evidence=_nothing(camera)) if _only_displaced(camera) else camera
        for camera in cameras
    ]


def _parallax_percent(cameras: list[_Camera]) -> float | None:
    """Return the parallax of the stripes in percent of the field; ``None``: a camera sees too few.

    It is positive for a near object: displaced to the right in the left camera, and to the left in the right one.
    """
    aside = {camera.device: camera.evidence.displaced for camera in cameras}
    left, right = aside.get("camera.left", 0.0), aside.get("camera.right", 0.0)
    # A stripe that is displaced to the right has a smaller code than the nominal one of that place.
    return None if left == 0.0 or right == 0.0 else 50.0 * (right - left)


def _only_displaced(camera: _Camera) -> bool:
    explanation = camera.explanation
    unexplained = explanation is not None and explanation.kind is Disagreement.UNEXPLAINED
    return unexplained and set(_decided(camera.evidence)) <= PARALLAX_DOUBTS


def _decided(evidence: LineEvidence) -> list[str]:
    return [name for name, doubt in evidence.doubts.items() if doubt >= DECIDED]


def _nothing(camera: _Camera) -> LineEvidence:
    return LineEvidence({}, {}, camera.evidence.illuminated, 0, 0)


def _fault(cameras: list[_Camera]) -> Fault | None:
    """Return the fault by the explanations of all cameras; if both agree, it is one of the projector."""
    wrong = [camera for camera in cameras if camera.explanation is not None]
    if not wrong:
        return _without_patterns(cameras)
    for camera in wrong:
        explanation = camera.explanation
        if explanation is not None and explanation.kind is Disagreement.STILL:
            alone = len(wrong) < len(cameras) or not _alike(wrong)
            if alone or explanation.identical:
                return _stuck(camera, explanation.frame)
    explained = [c for c in wrong if c.explanation is not None and c.explanation.kind is not Disagreement.UNEXPLAINED]
    first = (explained or wrong)[0]
    explanation = first.explanation
    assert explanation is not None
    # If all cameras have an explanation, the projector is the device; for a mirrored image only if they agree.
    all_cameras = len(wrong) == len(cameras) > 1
    if explanation.kind in WAYS_ROUND:
        return _turned(explanation.kind, first.device if not (all_cameras and _alike(wrong)) else "projector")
    return _named(explanation, first, "projector" if all_cameras else first.device)


def _turned(kind: Disagreement, device: str) -> Fault:
    """Return the fault of a mirrored or rotated image, in one camera or in the projector."""
    if device == "projector":
        detail = f"both cameras see the picture {kind.value}: switch rear projection, ceiling projection and flips off in the projector"
    else:
        detail = f"{device} sees the picture {kind.value}: switch its ReverseX and ReverseY off under features, or mount it the right way round"
    return Fault(FaultCode.PICTURE_MIRRORED, detail, device=device)


def _alike(wrong: list[_Camera]) -> bool:
    explanations = [(c.explanation.kind, c.explanation.frame) for c in wrong if c.explanation is not None]
    return len(set(explanations)) == 1


def _stuck(camera: _Camera, frame: int) -> Fault:
    detail = f"{camera.device} shows the same image from frame {frame} on"
    return Fault(FaultCode.CAMERA_STUCK, detail, {"frame": frame}, camera.device)


def _without_patterns(cameras: list[_Camera]) -> Fault | None:
    """Return the fault if no camera sees the patterns, and none contradicts them."""
    if any(camera.flooded for camera in cameras):
        return None  # ambient light saturates it, which the judge of light reports
    for camera in cameras:
        other_cameras = [c for c in cameras if c is not camera]
        blind = camera.evidence.illuminated < MIN_FRINGE and not camera.sees_light
        if camera.identical or (blind and any(c.evidence.judged for c in other_cameras)):
            return _stuck(camera, 0)
    if any(camera.sees_light or camera.evidence.judged for camera in cameras):
        return None
    if not any(camera.would_see_backscatter for camera in cameras):
        return None  # a short exposure or a lamp hides the light, for which the causes are named elsewhere
    light_dn = max(camera.light_dn for camera in cameras)
    return Fault(
        FaultCode.PROJECTOR_DARK,
        f"the bright frame is {light_dn:.2f} DN brighter than the dark one: not even backscatter is visible",
        {"light_dn": light_dn},
        "projector",
    )


def _named(explanation: Explanation, camera: _Camera, device: str) -> Fault:
    frame, other_frame = explanation.frame, explanation.other_frame
    numbers: dict[str, float] = {"frame": frame, "doubt": camera.evidence.worst}
    match explanation.kind:
        case Disagreement.LATE | Disagreement.EARLY:
            shift = 1 if explanation.kind is Disagreement.LATE else -1
            numbers["shift_frames"] = shift
            detail = f"from frame {frame} on, {device} shows each pattern one frame {explanation.kind.value}"
            if frame == 0 and device == "projector":
                return Fault(FaultCode.PROJECTOR_TIMING, detail, numbers, device)
        case Disagreement.STILL:
            if camera.ends_dark:
                return Fault(FaultCode.PROJECTOR_DARK, f"from frame {frame} on, all is dark", numbers, device)
            detail = f"from frame {frame} on, {device} shows one and the same pattern"
        case Disagreement.SWAPPED:
            detail = f"{device} shows the patterns of frames {frame} and {other_frame} in exchanged order"
        case Disagreement.REPEATED:
            detail = f"frame {frame} of {device} repeats frame {other_frame}"
        case _:
            detail = f"{device} does not show the sequence; the first wrong frame is {frame}"
    return Fault(FaultCode.PATTERN_WRONG, detail, numbers, device)
