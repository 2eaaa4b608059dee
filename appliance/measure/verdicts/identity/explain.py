"""Explanations of a camera's frames that contradict the sequence, and the choice of the best one.

Frames may be exchanged, all one late or one early, or one late after a repeated frame. In the corrected order no doubt
is left. The same holds for a mirrored or rotated image if its lines are read backwards. The missing pattern of a late
sequence follows from the others, since four sines add up in pairs. A repeated frame or a still image is detected by
comparing the frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sine import PHASE_STEPS
from appliance.measure.verdicts.identity.evidence import MIN_FRINGE, LineEvidence, Witness
from appliance.measure.verdicts.identity.lines import Lines

SAME = 2.0
"""Largest squared difference of two frames, in units of noise, that show the same image: by noise alone it is 1, by a
step of the faintest fringes that count 4 or more."""
SAME_MEAN = 0.15
SHORTEST_STILL = 3
"""Least number of frames with the same image up to the end of the sequence; two are a repeat."""
ENOUGH_FRINGE = 2000
"""Number of samples with fringes for the first comparison of explanations; the best are compared by all lines."""
FINALISTS = 6
CLEARLY_LESS = 0.7
"""Least decrease of the total of all doubts for accepting a new order: motion leaves some doubt in any order."""


class Disagreement(Enum):
    """The ways in which frames and patterns can disagree."""

    SWAPPED = "swapped"
    LATE = "late"
    """Each frame from ``frame`` on shows the pattern before its own."""
    EARLY = "early"
    """Each frame from ``frame`` on shows the pattern after its own."""
    REPEATED = "repeated"
    """``frame`` shows the same as ``other_frame``."""
    STILL = "still"
    """All frames from ``frame`` on show the same image."""
    MIRRORED = "mirrored left to right"
    """All frames are right if each row is read from its end."""
    UPSIDE_DOWN = "mirrored top to bottom"
    """The same of each column."""
    TURNED = "turned by 180°"
    """Both."""
    UNEXPLAINED = "unexplained"


WAYS_ROUND = {
    Disagreement.MIRRORED: (Direction.X,),
    Disagreement.UPSIDE_DOWN: (Direction.Y,),
    Disagreement.TURNED: (Direction.X, Direction.Y),
}
"""Directions whose lines run backwards in a mirrored or rotated image."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One disagreement and its frames; ``other_frame``: the second one of two frames."""

    kind: Disagreement
    frame: int
    other_frame: int | None = None
    identical: bool = False
    """True if the frames are equal to the last bit: only a camera's memory repeats an image with its noise."""
    moved: float = 0.0
    """Share of the illuminated samples that move under this explanation; see ``moved_share``."""
    relief: float = 0.0
    """Decrease of the total of all doubts by the new order; 0: no new order."""


def explain(witness: Witness, sequence: PatternSequence, noise: CameraNoise, doubts: LineEvidence) -> Explanation:
    """Return the best explanation of frames that contradict the sequence.

    ``doubts``: the evidence against the planned order.
    """
    same = differences(witness, sequence, noise)
    first = still_from(same)
    if first is not None and len(sequence) - first >= SHORTEST_STILL:
        return Explanation(Disagreement.STILL, first, identical=not same[first:, first:].any())
    reordered = _reordered(witness, sequence, noise, doubts)
    if reordered is not None:
        return _at_the_second(reordered, same)
    unordered = _repeated(same, doubts) or Explanation(Disagreement.UNEXPLAINED, _suspect(doubts))
    return replace(unordered, moved=moved_share(witness, sequence, np.arange(len(sequence), dtype=np.int64)))


def still(witness: Witness, sequence: PatternSequence, noise: CameraNoise) -> Explanation | None:
    """Return the explanation that the image stays, for frames without fringes, or ``None``.

    Backscatter alone shows only broad stripes, so that all later frames are alike. So a still image must have begun
    before the second Gray image of the last direction, or fringes of the first direction must be visible.
    """
    same = differences(witness, sequence, noise)
    first = still_from(same)
    if first is None or len(sequence) - first < SHORTEST_STILL:
        return None
    fringed = sum(_fringed(lines, sequence, noise).shape[1] for lines in witness.lines.values())
    if fringed < MIN_FRINGE and first > sequence.axis(Direction.Y).gray[1]:
        return None
    return Explanation(Disagreement.STILL, first, identical=not same[first:, first:].any())


def differences(witness: Witness, sequence: PatternSequence, noise: CameraNoise) -> NDArray[np.float64]:
    """Return the squared differences (n, n) of frames over illuminated samples, in units of noise.

    It is 1 for two images of the same pattern.
    """
    samples = [_fringed(lines, sequence, noise) for lines in witness.lines.values()]
    values = np.concatenate(samples, axis=1).astype(np.float64)
    if values.shape[1] < MIN_FRINGE:
        values = np.concatenate(
            [lines.values[:, lines.illuminated] for lines in witness.lines.values()], axis=1
        ).astype(float)
    variance = noise.variance_dn2(values.mean(axis=0))
    # |a − b|² = |a|² + |b|² − 2 a·b, over the variance of a difference of two frames.
    scaled = (values - values.mean(axis=0)) / np.sqrt(2.0 * variance)
    squares = (scaled**2).sum(axis=1)
    apart = squares[:, None] + squares - 2.0 * scaled @ scaled.T
    result = np.asarray(np.maximum(apart, 0.0) / max(values.shape[1], 1))
    result[result < 1e-9] = 0.0
    return result


def moved_share(witness: Witness, sequence: PatternSequence, order: NDArray[np.int64]) -> float:
    """Return the share of illuminated samples whose means over the sines of X and Y differ.

    Frame ``order[k]`` is taken as pattern k. A single sine in a wrong place changes the mean by an eighth of the swing
    at most.
    """
    moved = illuminated = 0
    for lines in witness.lines.values():
        means = [lines.values[order[list(sequence.axis(d).sine)]][:, lines.illuminated].mean(axis=0) for d in Direction]
        swing = (lines.high - lines.low)[lines.illuminated].astype(np.float64)
        moved += int(np.count_nonzero(abs(means[0] - means[1]) > SAME_MEAN * swing))
        illuminated += swing.size
    return moved / max(illuminated, 1)


def _fringed(lines: Lines, sequence: PatternSequence, noise: CameraNoise) -> NDArray[np.uint8]:
    """Return the samples (n, samples) with visible fringes of X.

    Broad stripes do not count, since they are visible in backscatter as well.
    """
    s0, s1, s2, s3 = (lines.values[k].astype(np.float32) for k in sequence.axis(Direction.X).sine)
    variance = noise.variance_dn2(lines.high.astype(np.float32))
    has_fringes = (s0 - s2) ** 2 + (s3 - s1) ** 2 > 72.0 * variance
    return np.asarray(lines.values[:, lines.illuminated & has_fringes])


def still_from(same: NDArray[np.float64]) -> int | None:
    """Return the first frame from which on all show the same image; ``None``: the last two differ."""
    first = len(same) - 1
    while first > 0 and same[first - 1, -1] < SAME:
        first -= 1
    return None if first == len(same) - 1 else first


def _reordered(
    witness: Witness, sequence: PatternSequence, noise: CameraNoise, doubts: LineEvidence
) -> Explanation | None:
    """Return the order with the smallest total of doubts.

    None of them may have reached its limit, and the total must be clearly less than that of the planned order.
    """
    every = max(1, min(doubts.fringe // ENOUGH_FRINGE, 8))
    # Every order is tried on a part of the lines; only the finalists face all of them.
    thin = {along: _thinned(lines, every) for along, lines in witness.lines.items()}
    scores = [
        (evidence.total, number)
        for number, (_, order, holder) in enumerate(_ordered(Witness(thin, sequence, noise), sequence, noise))
        if (evidence := holder.evidence(order)).judged
    ]
    best: tuple[float, Explanation] | None = None
    chosen = {number for _, number in sorted(scores)[:FINALISTS]}
    for number, (explanation, order, holder) in enumerate(_ordered(witness, sequence, noise)):
        if number not in chosen:
            continue
        evidence = holder.evidence(order)
        clearly = evidence.total <= doubts.total - CLEARLY_LESS
        if evidence.judged and clearly and not evidence.contradicted and (best is None or evidence.total < best[0]):
            relief = doubts.total - evidence.total
            best = evidence.total, replace(explanation, moved=moved_share(holder, sequence, order), relief=relief)
    return None if best is None else best[1]


def _at_the_second(explanation: Explanation, same: NDArray[np.float64]) -> Explanation:
    """Return the explanation, late from the second of two frames of one image on instead of the first."""
    frame = explanation.frame
    if explanation.kind is Disagreement.LATE and same[frame, frame + 1] < SAME:
        return replace(explanation, frame=frame + 1)
    return explanation


def _ordered(
    witness: Witness, sequence: PatternSequence, noise: CameraNoise
) -> Iterator[tuple[Explanation, NDArray[np.int64], Witness]]:
    """Yield explanations by another order, with the frame of each pattern and the witness with these."""
    n = len(sequence)
    straight = np.arange(n, dtype=np.int64)
    for i in range(n):
        for j in range(i + 1, n):
            order = straight.copy()
            order[[i, j]] = j, i
            yield Explanation(Disagreement.SWAPPED, i, j), order, witness
    # Row n is the pattern that was not captured, as computed from the others.
    last = Witness({along: _with_last(lines, sequence) for along, lines in witness.lines.items()}, sequence, noise)
    for first in range(n - 1):
        yield Explanation(Disagreement.LATE, first), np.where(straight < first, straight, straight + 1), last
    bright = Witness({along: _with(lines, lines.high) for along, lines in witness.lines.items()}, sequence, noise)
    yield Explanation(Disagreement.EARLY, 0), np.where(straight == 0, n, straight - 1), bright
    # The planned order with lines read backwards.
    for kind, backwards in WAYS_ROUND.items():
        turned = {along: _backwards(lines) if along in backwards else lines for along, lines in witness.lines.items()}
        yield Explanation(kind, 0), straight, Witness(turned, sequence, noise)


def _backwards(lines: Lines) -> Lines:
    values, low, high = (np.ascontiguousarray(part[..., ::-1]) for part in (lines.values, lines.low, lines.high))
    return Lines(lines.along, values, low, high, np.ascontiguousarray(lines.illuminated[..., ::-1]))


def _thinned(lines: Lines, every: int) -> Lines:
    low, high = (np.ascontiguousarray(part[::every]) for part in (lines.low, lines.high))
    values, illuminated = (
        np.ascontiguousarray(lines.values[:, ::every]),
        np.ascontiguousarray(lines.illuminated[::every]),
    )
    return Lines(lines.along, values, low, high, illuminated)


def _with(lines: Lines, frame: NDArray[np.uint8]) -> Lines:
    return Lines(lines.along, np.concatenate([lines.values, frame[None]]), lines.low, lines.high, lines.illuminated)


def _with_last(lines: Lines, sequence: PatternSequence) -> Lines:
    """Append the last sine step, missing if all is one late: 90° + 270° equals 0° + 180°."""
    steps = sequence.axis(Direction.Y).sine
    place = steps.index(len(sequence) - 1)
    after, opposite, before = (
        lines.values[steps[(place + offset) % PHASE_STEPS] + 1].astype(np.int16) for offset in (1, 2, 3)
    )
    return _with(lines, np.clip(after + before - opposite, 0, 255).astype(np.uint8))


def _repeated(same: NDArray[np.float64], doubts: LineEvidence) -> Explanation | None:
    """Return the explanation by a repeated frame: of equal frames, those with the largest doubt.

    Of equal doubts, that of the nearest frames.
    """
    n = len(same)
    doubt_by_frame = {doubts.suspects[name]: doubt for name, doubt in doubts.doubts.items() if name in doubts.suspects}
    pairs = [(i, j) for j in range(1, n) for i in range(j) if same[i, j] < SAME]
    if not pairs:
        return None
    # The second of two is the repeat: time goes one way.
    i, j = max(
        pairs,
        key=lambda pair: (max(doubt_by_frame.get(pair[0], 0.0), doubt_by_frame.get(pair[1], 0.0)), pair[0] - pair[1]),
    )
    return Explanation(Disagreement.REPEATED, j, i, identical=not same[i, j])


def _suspect(doubts: LineEvidence) -> int:
    doubt_by_name = {name: doubt for name, doubt in doubts.doubts.items() if name in doubts.suspects}
    return doubts.suspects[max(doubt_by_name, key=lambda name: doubt_by_name[name])] if doubt_by_name else 0
