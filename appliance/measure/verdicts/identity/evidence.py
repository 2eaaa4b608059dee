"""Doubts about a camera's frames showing the patterns of the sequence; each is 1 at its limit.

No doubt is taken from coordinates, since a wrong sequence decodes to wrong ones that look right. Instead, fringes and
stripes are followed along lines of the image. A surface, its colour and moderate motion do not change their sequence:

forward    from sample to sample the phase increases, because cameras and projector are the same way up
order      where one Gray image changes, the code increases by one: for all images of a direction together, and for each
           image alone, since the coarsest have an edge or two in the complete field, but each line crosses it
in phase   these edges lie at 0° and 180° of the fringes, alternately. This relates Gray code and sines, and each Gray
           image to all others: if it is exchanged for any but another of its direction, the parity of the code is wrong
opposite   the sines of 0° and 180°, and of 90° and 270°, are each other's negative
ends       no frame is brighter than the bright frame, none darker than the dark one
place      the middle of the stripes lies near its nominal place: only this distinguishes Gray images without a visible
           edge
elsewhere  all stripes are displaced alike: if two such images are exchanged, quarters of the field change places, but
           their middle stays

Steps across a contour, an edge of the texture or a moving object are left out by the fringes themselves: phase that
changes unevenly, swings that differ, a bright frame that is not bright.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.gray_code import periods, plain_number
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.identity.lines import Lines, thresholds


class Count(IntEnum):
    """Indices of the table of sums."""

    ILLUMINATED = 0
    """Illuminated samples."""
    FRINGE = 1
    """… with enough modulation in both directions."""
    NOT_BRIGHT = 2
    """Illuminated samples that are not bright in the bright frame."""
    NOT_DARK = 3
    """Illuminated samples that are not dark in the dark frame."""
    STEPS = 4
    """Steps from one sample to the next on the same surface."""
    FORWARD = 5
    """… with increasing phase, as it must be if camera and projector are the same way up."""
    EDGES = 6
    """Steps in which one Gray image changes."""
    IN_ORDER = 7
    """… to the next half period."""
    IN_PHASE = 8
    """Sum of cosines: +1 for each edge at its true phase, −1 half a period away."""
    SINES = 9
    """Samples with fringes and both references, over which the following are sums."""
    SINE_0 = 10
    """Share of the swing in the first step; the following rows: in the other steps."""
    SQUARE_0 = 14
    """First of the rows with the sums of those shares' squares."""
    PRODUCT_02 = 18
    PRODUCT_13 = 19
    NUMBER = 20
    """Sum of the half-period orders over the steps, by the Gray code alone."""
    PLACE = 21
    """Sum of the positions along the line over the steps, 0 … 1."""


COUNTS = 22
PLACES = 128
"""Number of bins, over twice the field, for the displacements of the steps from their nominal places."""
OFF_REFERENCE = np.float32(0.3)
"""Largest distance of bright and dark from the ends of a sample's swing, as a share of the swing."""
_MIN_SWING_SHARE = np.float32(0.15)
"""Least difference of a fringe's opposite steps, as a share of the swing over all frames: less is backscatter, in which
only broad stripes are visible."""
_MAX_STEP_COS = np.float32(-0.74)
"""Cosine of the largest phase step from sample to sample, 138°: a larger one is ambiguous."""
_MAX_OTHER_COS = np.float32(0.5)
"""Cosine of the largest change of the phase of the other direction from sample to sample, 60°: a larger one is a depth
discontinuity."""
_LEAST_RATIO, _MOST_RATIO = np.float32(0.6), np.float32(1.67)
"""Limits of the ratio of neighbours' swings, and of the modulations of the two directions."""
_AT_AN_EDGE = np.float32(0.7)
"""Least |cos φ| at an edge of a Gray image, 45° from 0° or 180°, at the right place or a wrong one. Contours meet the
fringes at any phase."""
_BEND = np.float32(0.25)
"""Largest difference of a step from its neighbours (rad), besides a third of itself."""


# Symbols of the kernel. Along a line with samples x: (re, im) is 2 B (cos φ, sin φ) of the fringes along the line, with
# the phase φ and the modulation B; (other_re, other_im) the same of the fringes across it. mine and other_length are
# their lengths, the differences of opposite steps. g is the Gray code of the bits at a sample, h its half-period order,
# soft the bits that are too near to their threshold to be certain.


@numba.njit(nogil=True, cache=True, error_model="numpy")
def follow(
    values: NDArray[np.uint8],
    low: NDArray[np.uint8],
    high: NDArray[np.uint8],
    illuminated: NDArray[np.bool_],
    middle: NDArray[np.float32],
    doubt_dn: NDArray[np.float32],
    least_dn: NDArray[np.float32],
    order: NDArray[np.int64],
    references: tuple[int, int],
    gray: NDArray[np.int64],
    sine: NDArray[np.int64],
    other_sine: NDArray[np.int64],
    half_period: float,
    sums: NDArray[np.float64],
    edges: NDArray[np.float64],
    places: NDArray[np.float64],
) -> None:
    """Add the lines ``values`` (n, lines, samples) to ``sums``, ``edges`` and ``places``.

    ``sums`` (COUNTS,), ``edges`` (len(gray), 2): tables to which the counts are added. ``order[k]`` is the row of
    ``values`` that is taken for pattern k; ``references``: bright and dark; ``gray`` and ``sine``: the patterns along
    the lines; ``middle`` (1 or len(gray), lines, samples): thresholds of the Gray images, NaN: none; ``doubt_dn``
    (lines, samples): distance from them below which a bit is uncertain; ``least_dn`` (256,): least difference of a
    fringe at a grey value; ``half_period``: its width as a share of the field. ``places`` (PLACES,): number of steps by
    their displacement, −1 to 1 fields. ``edges``: of each Gray image, the number of its edges (where it changes, or
    another one in its place), and of those out of order that are edges of some pattern.
    """
    samples = values.shape[2]
    bits = gray.size
    re, im = np.empty(samples, np.float32), np.empty(samples, np.float32)
    other_re, other_im = np.empty(samples, np.float32), np.empty(samples, np.float32)
    good = np.empty(samples, np.bool_)
    code, number = np.empty(samples, np.int64), np.empty(samples, np.int64)
    smooth, step = np.empty(samples, np.bool_), np.empty(samples, np.float32)
    share = np.empty(4, np.float32)
    a0, a1, a2, a3 = order[sine[0]], order[sine[1]], order[sine[2]], order[sine[3]]
    b0, b1, b2, b3 = order[other_sine[0]], order[other_sine[1]], order[other_sine[2]], order[other_sine[3]]
    bright, dark = order[references[0]], order[references[1]]
    for line in range(values.shape[1]):
        # First pass along a line: each sample alone, and whether it can be compared with its neighbours.
        for x in range(samples):
            good[x] = False
            if not illuminated[line, x]:
                continue
            lower_dn, upper_dn = np.float32(low[line, x]), np.float32(high[line, x])
            swing = upper_dn - lower_dn
            sums[0] += 1.0
            not_bright = np.float32(values[bright, line, x]) < upper_dn - OFF_REFERENCE * swing
            not_dark = np.float32(values[dark, line, x]) > lower_dn + OFF_REFERENCE * swing
            sums[2] += 1.0 if not_bright else 0.0
            sums[3] += 1.0 if not_dark else 0.0
            # Four steps I0..I3 of 90° give (I0 − I2, I3 − I1) = 2 B (cos φ, sin φ).
            re[x] = np.float32(values[a0, line, x]) - np.float32(values[a2, line, x])
            im[x] = np.float32(values[a3, line, x]) - np.float32(values[a1, line, x])
            other_re[x] = np.float32(values[b0, line, x]) - np.float32(values[b2, line, x])
            other_im[x] = np.float32(values[b3, line, x]) - np.float32(values[b1, line, x])
            mine = np.sqrt(re[x] * re[x] + im[x] * im[x])
            other_length = np.sqrt(other_re[x] * other_re[x] + other_im[x] * other_im[x])
            # Fringes count if they are stronger than noise and backscatter.
            needed = max(_MIN_SWING_SHARE * swing, least_dn[high[line, x]])
            judged = not (not_bright or not_dark)  # at the contour of a moving object, the surface has changed
            for k in range(4):
                share[k] = (np.float32(values[order[sine[k]], line, x]) - lower_dn) / swing
            # Not the fringes' difference, which depends on the order of the sines, but the range of all eight, which
            # does not. Weak fringes selected by the former, with an x-sine in the place of a y-sine, would be just the
            # samples at which it is the opposite of its partner.
            across_most = max(
                max(values[b0, line, x], values[b1, line, x]), max(values[b2, line, x], values[b3, line, x])
            )
            across_least = min(
                min(values[b0, line, x], values[b1, line, x]), min(values[b2, line, x], values[b3, line, x])
            )
            along_most = max(max(share[0], share[1]), max(share[2], share[3])) * swing
            along_least = min(min(share[0], share[1]), min(share[2], share[3])) * swing
            spread = max(along_most, np.float32(across_most) - lower_dn) - min(
                along_least, np.float32(across_least) - lower_dn
            )
            # Sums for the correlation of opposite steps: I0 with I2, I1 with I3. Subtracted is the backscatter, which
            # differs from place to place and is the same in all of them: the median of the three other pairs' means.
            # Not the mean of their six, in which a coarse stripe in the place of a sine would be the same large step
            # for all pairs.
            if judged and spread >= needed:
                sums[9] += 1.0
                half, scale = np.float32(0.5), np.float32(0.5) / swing
                of_02, of_13 = half * (share[0] + share[2]), half * (share[1] + share[3])
                across_02 = scale * (
                    np.float32(values[b0, line, x]) + np.float32(values[b2, line, x]) - lower_dn - lower_dn
                )
                across_13 = scale * (
                    np.float32(values[b1, line, x]) + np.float32(values[b3, line, x]) - lower_dn - lower_dn
                )
                lower, upper = min(across_02, across_13), max(across_02, across_13)
                beside_02, beside_13 = max(lower, min(upper, of_13)), max(lower, min(upper, of_02))
                for k in range(4):
                    share[k] -= beside_02 if k % 2 == 0 else beside_13
                    sums[10 + k] += share[k]
                    sums[14 + k] += share[k] * share[k]
                sums[18] += share[0] * share[2]
                sums[19] += share[1] * share[3]
            if mine < needed or other_length < needed:
                continue
            sums[1] += 1.0
            if not judged:
                continue
            # From Gray code to number: each bit of the number is that of the code xor the bit before.
            g, h, bit, soft, decided = 0, 0, 0, 0, True
            for j in range(bits):
                threshold = middle[min(j, middle.shape[0] - 1), line, x]
                off = np.float32(values[order[gray[j]], line, x]) - threshold
                now = 1 if off > np.float32(0.0) else 0
                # A threshold that is NaN decides no bit.
                decided = decided & (off == off)
                soft = 2 * soft + (1 if abs(off) < doubt_dn[line, x] else 0)
                g = 2 * g + now
                bit ^= now
                h = 2 * h + bit
            code[x], number[x] = g, h
            if soft != 0:  # at an edge of its stripe the phase decides; elsewhere the bit is unknown
                turns = np.float32(0.5 / np.pi) * np.arctan2(im[x], re[x])
                decided = decided and periods(h, turns) == periods(plain_number(g ^ soft), turns)
            # Both directions have the same modulation on one surface; not at a contour.
            good[x] = decided and _LEAST_RATIO * other_length < mine < _MOST_RATIO * other_length
            re[x], im[x] = re[x] / mine, im[x] / mine
            other_re[x], other_im[x] = other_re[x] / other_length, other_im[x] / other_length
        # Second pass: the phase steps between neighbours that lie on one surface.
        for x in range(samples - 1):
            smooth[x] = False
            if not (good[x] and good[x + 1]):
                continue
            mine = np.float32(high[line, x]) - np.float32(low[line, x])
            next_ = np.float32(high[line, x + 1]) - np.float32(low[line, x + 1])
            if not _LEAST_RATIO * mine < next_ < _MOST_RATIO * mine:
                continue
            # The cosine and sine of the phase step, as the product of one unit phasor with the conjugate of the other.
            cosine = re[x] * re[x + 1] + im[x] * im[x + 1]
            other_cosine = other_re[x] * other_re[x + 1] + other_im[x] * other_im[x + 1]
            if cosine < _MAX_STEP_COS or other_cosine < _MAX_OTHER_COS:
                continue
            smooth[x] = True
            step[x] = np.arctan2(re[x] * im[x + 1] - im[x] * re[x + 1], cosine)
        # Third pass: count the steps that are like their neighbours, and whether code and phase agree there.
        for x in range(1, samples - 2):
            if not (smooth[x - 1] and smooth[x] and smooth[x + 1]):
                continue
            before = abs(step[x] - step[x - 1]) - np.float32(0.35) * max(abs(step[x]), abs(step[x - 1]))
            after = abs(step[x] - step[x + 1]) - np.float32(0.35) * max(abs(step[x]), abs(step[x + 1]))
            if before > _BEND or after > _BEND:
                continue
            # The position on the line by the code and by the sample: their means are compared with the nominal ones.
            place = (x + 0.5) / samples
            sums[20] += number[x]
            sums[21] += place
            beside = (number[x] + 0.5) * half_period - place
            places[min(max(int(0.5 * PLACES * (beside + 1.0)), 0), PLACES - 1)] += 1.0
            sums[4] += 1.0
            sums[5] += 1.0 if step[x] > 0.0 else 0.0
            changed = code[x] ^ code[x + 1]
            # An edge of a Gray code changes exactly one bit.
            if changed == 0 or changed & (changed - 1) != 0:
                continue
            in_order = number[x + 1] == number[x] + 1
            # The phase in the middle of the step; odd half periods begin at 180°.
            x_, y_ = re[x] + re[x + 1], im[x] + im[x + 1]
            cosine = x_ / np.sqrt(x_ * x_ + y_ * y_)
            if number[x + 1] & 1:
                cosine = -cosine
            sums[6] += 1.0
            sums[7] += 1.0 if in_order else 0.0
            sums[8] += cosine
            # The bit that changes where the number increases by one. A wrong image counts with its edges and with
            # missing ones.
            expected = (number[x] ^ (number[x] >> 1)) ^ ((number[x] + 1) ^ ((number[x] + 1) >> 1))
            for k in range(bits):
                mask = 1 << (bits - 1 - k)
                if changed == mask or expected == mask:
                    edges[k, 0] += 1.0
                    edges[k, 1] += 0.0 if in_order or abs(cosine) < _AT_AN_EDGE else 1.0


DECIDED = 1.0
"""Value of a doubt from which on it is an alarm.

The limits below are half way between the largest values of good scans of moving, dark and turbid scenes and those of a
wrong frame (docs/identity.md has both).
"""
LEAST_FORWARD = 0.7
MOST_DISPLACED = {Direction.X: 0.2, Direction.Y: 0.15}
"""Largest mean displacement of the stripes from their nominal place, in widths of the field. Along the baseline it
depends on the distance: 0.08 in the working volume, 0.15 well before it."""
APART = {Direction.X: 0.2, Direction.Y: 0.1}
"""Distance from the median displacement, in widths of the field, beyond which a step is elsewhere.

Along the baseline, the near and the far end of the working volume are 0.16 apart; across it distance has no effect.
"""
MOST_ELSEWHERE = {Direction.X: 0.2, Direction.Y: 0.3}
"""Largest share of the steps that may be elsewhere.

Before moving printed squares 0.04 have a wrong code across the baseline, 0.16 along it; if two images without visible
edges are exchanged, a quarter to a half.
"""
LEAST_IN_PHASE = 0.6
"""Least mean cosine. It is that of a fifth of the edges half a period off: a wrong frame may be visible on a part of
the surface only."""
MOST_OUT_OF_ORDER = 0.3
MOST_OF_ONE_OUT_OF_ORDER = 0.6
"""Largest share of the edges of one Gray image that may be out of order: the coarsest have few, and a contour may cross
them."""
LEAST_EDGES_OF_ONE = 5
MOST_CORRELATION = -0.4
"""Largest correlation of sines of opposite steps; it is −1 if only the pattern changes."""
MOST_BEHIND_BEST = 0.5
"""Largest difference of a pair's correlation from that of the best pair: moving colours spoil all of them."""
MOST_OFF_REFERENCE = 0.8
LEAST_BESIDE_REFERENCE, MOST_BESIDE_REFERENCE = 0.05, 0.08
MOST_OF_OFF, NEARLY_ALL_OF_OFF = 0.5, 0.75
"""Limits of the share of samples, or of those off the reference, at which another frame is the better reference. With
motion, a frame from the middle of the sequence halves the samples off the reference. Fewer samples count if the other
frame is right at nearly all of these, which it never is with motion."""
MIN_FRINGE = 60
"""Least number of samples with fringes in both directions."""
MIN_EDGES = 12
MIN_SINE = 100
_FRINGE_SIGMA = 6.0


@dataclass(frozen=True, slots=True)
class LineEvidence:
    """Evidence of one camera's lines against one explanation: doubts by name, e.g. ``order gray-x-3``."""

    doubts: Mapping[str, float]
    suspects: Mapping[str, int]
    """The frame that a doubt is about, for doubts about a single frame."""
    illuminated: int
    fringe: int
    """Number of samples with fringes; below ``MIN_FRINGE`` doubts have no meaning."""
    edges: int
    steps: int = 0
    """Number of steps along the lines, of the direction with fewer: stripes of one direction say nothing about the
    frames of the other."""
    displaced: float = 0.0
    """Displacement of the stripes along the baseline from their nominal place, in widths of the field: with opposite
    signs in both cameras if the object is near or far, with the same sign if a Gray image is wrong."""

    @property
    def judged(self) -> bool:
        """True if there are enough samples for a judgement."""
        enough = self.edges >= MIN_EDGES and self.steps >= MIN_FRINGE
        return self.fringe >= MIN_FRINGE and (enough or self.contradicted)

    @property
    def worst(self) -> float:
        """The largest doubt; 0 without any."""
        return max(self.doubts.values(), default=0.0)

    @property
    def contradicted(self) -> bool:
        """True if one of the doubts has reached its limit."""
        return self.worst >= DECIDED

    @property
    def total(self) -> float:
        """Sum of all doubts, each limited to 2, by which explanations are compared."""
        return float(sum(min(doubt, 2.0) for doubt in self.doubts.values()))


def _elsewhere(places: NDArray[np.float64], apart: float) -> float:
    """Return the share of the steps that lie farther than ``apart`` widths of the field from their median.

    ``places`` (PLACES,): number of steps by their displacement, −1 to 1.
    """
    middle = int(np.searchsorted(np.cumsum(places), 0.5 * places.sum()))
    far = np.abs(np.arange(PLACES) - middle) > 0.5 * PLACES * apart
    return float(places[far].sum() / places.sum())


class Witness:
    """One camera's lines, which give evidence about any order of its frames."""

    def __init__(self, lines: Mapping[Direction, Lines], sequence: PatternSequence, noise: CameraNoise) -> None:
        self.lines = lines
        self._sequence = sequence
        self._noise = noise
        self._off: NDArray[np.float64] | None = None
        sigma = np.sqrt(noise.variance_dn2(np.arange(256.0)))
        self._least_dn = np.asarray(_FRINGE_SIGMA * sigma, np.float32)
        self._axes = {d: sequence.axis(d) for d in Direction}
        self._gray = {d: np.array(axis.gray, np.int64) for d, axis in self._axes.items()}
        self._sine = {d: np.array(axis.sine, np.int64) for d, axis in self._axes.items()}

    def evidence(self, order: NDArray[np.int64]) -> LineEvidence:
        """Return the evidence against frame ``order[k]`` showing pattern k, for all k."""
        doubts: dict[str, float] = {}
        suspects: dict[str, int] = {}
        all_sums: dict[Direction, NDArray[np.float64]] = {}
        bright, dark = self._sequence.bright, self._sequence.dark
        for along, mine in self.lines.items():
            across = Direction.Y if along is Direction.X else Direction.X
            sums, edges, places = np.zeros(COUNTS), np.zeros((len(self._gray[along]), 2)), np.zeros(PLACES)
            middle, doubt_dn = thresholds(mine, self._sequence, self._noise, order)
            follow(
                mine.values, mine.low, mine.high, mine.illuminated, middle, doubt_dn, self._least_dn, order, (bright, dark),
                self._gray[along], self._sine[along], self._sine[across], self._half_period(along), sums, edges, places,
            )  # fmt: skip
            all_sums[along] = sums
            self._follow_doubts(along, sums, edges, doubts, suspects)
            if sums[Count.STEPS] >= MIN_FRINGE:
                doubts[f"elsewhere {along.value}"] = _elsewhere(places, APART[along]) / MOST_ELSEWHERE[along]
        self._sine_doubts(all_sums, doubts, suspects)
        total = np.asarray(sum(all_sums.values()))
        self._reference_doubts(order, total, doubts, suspects)
        doubts = {name: float(doubt) for name, doubt in doubts.items()}
        return LineEvidence(
            doubts,
            suspects,
            int(total[Count.ILLUMINATED]),
            int(total[Count.FRINGE]),
            int(total[Count.EDGES]),
            min(int(sums[Count.STEPS]) for sums in all_sums.values()),
            self._displaced(all_sums),
        )

    def _half_period(self, along: Direction) -> float:
        """Return the width of half a period as a share of the field."""
        return 0.5 * self._sequence.period_px / self._axes[along].size_px

    def _follow_doubts(
        self,
        along: Direction,
        sums: NDArray[np.float64],
        edges: NDArray[np.float64],
        doubts: dict[str, float],
        suspects: dict[str, int],
    ) -> None:
        name, axis = along.value, self._axes[along]
        steps = sums[Count.STEPS]
        if steps >= MIN_FRINGE:
            # Mean position by the half-period orders, as a share of the field, against the mean position on the line.
            coded = (sums[Count.NUMBER] / steps + 0.5) * self._half_period(along)
            doubts[f"place {name}"] = abs(coded - sums[Count.PLACE] / steps) / MOST_DISPLACED[along]
            doubts[f"forward {name}"] = (1.0 - sums[Count.FORWARD] / steps) / (1.0 - LEAST_FORWARD)
        count = sums[Count.EDGES]
        if count >= MIN_EDGES:
            doubts[f"phase {name}"] = (1.0 - sums[Count.IN_PHASE] / count) / (1.0 - LEAST_IN_PHASE)
            doubts[f"order {name}"] = (1.0 - sums[Count.IN_ORDER] / count) / MOST_OUT_OF_ORDER
        for k, (count_of_image, wrong) in zip(axis.gray, edges, strict=True):
            if wrong >= LEAST_EDGES_OF_ONE:
                key = f"order {self._sequence.patterns[k].name}"
                doubts[key] = wrong / count_of_image / MOST_OF_ONE_OUT_OF_ORDER
                suspects[key] = k

    def _displaced(self, sums: Mapping[Direction, NDArray[np.float64]]) -> float:
        mine = sums[Direction.X]
        steps = mine[Count.STEPS]
        if steps < MIN_FRINGE:
            return 0.0
        coded = (mine[Count.NUMBER] / steps + 0.5) * self._half_period(Direction.X)
        return float(coded - mine[Count.PLACE] / steps)

    def _sine_doubts(
        self, sums: Mapping[Direction, NDArray[np.float64]], doubts: dict[str, float], suspects: dict[str, int]
    ) -> None:
        """Add the doubts about pairs of steps that are not each other's opposite."""
        correlations: dict[int, float] = {}
        for along, mine in sums.items():
            n = mine[Count.SINES]
            if n < MIN_SINE:
                continue
            for first, place in ((0, Count.PRODUCT_02), (1, Count.PRODUCT_13)):
                # Correlation of two opposite steps by their sums: (E[ab] − E[a] E[b]) / (σa σb).
                means = mine[[Count.SINE_0 + first, Count.SINE_0 + first + 2]] / n
                squares = mine[[Count.SQUARE_0 + first, Count.SQUARE_0 + first + 2]] / n
                spread = float(np.sqrt(np.maximum(squares - means**2, 1e-6)).prod())
                correlations[self._axes[along].sine[first]] = float(mine[place] / n - means.prod()) / spread
        best = min(correlations.values(), default=0.0)
        for k, correlation in correlations.items():
            key = f"opposite {self._sequence.patterns[k].name}"
            behind = (correlation - best) / MOST_BEHIND_BEST
            doubts[key] = max(min((1.0 + correlation) / (1.0 + MOST_CORRELATION), behind), 0.0)
            suspects[key] = k

    def _reference_doubts(
        self,
        order: NDArray[np.int64],
        total: NDArray[np.float64],
        doubts: dict[str, float],
        suspects: dict[str, int],
    ) -> None:
        """Add the doubts about the references, if another frame is the better bright or the better dark one.

        At contours of moving objects no frame is.
        """
        if total[Count.ILLUMINATED] < MIN_FRINGE:
            return
        share = {"bright": total[Count.NOT_BRIGHT], "dark": total[Count.NOT_DARK]}
        for name, off in share.items():
            off /= total[Count.ILLUMINATED]
            excess = 0.0
            if off > LEAST_BESIDE_REFERENCE:
                best_off = float(self._off_reference()[int(name == "bright")][order].min())
                nearly_all = min(MOST_BESIDE_REFERENCE, NEARLY_ALL_OF_OFF * off)
                excess = (off - best_off) / max(LEAST_BESIDE_REFERENCE, nearly_all, MOST_OF_OFF * off)
            doubts[name] = max(off / MOST_OFF_REFERENCE, excess)
            suspects[name] = self._sequence.bright if name == "bright" else self._sequence.dark

    def _off_reference(self) -> NDArray[np.float64]:
        """Return the share (2, frames) of illuminated samples at which each frame is not dark, and not bright.

        It is computed once.
        """
        if self._off is None:
            frames = len(next(iter(self.lines.values())).values)
            off, illuminated = np.zeros((2, frames)), 0
            for mine in self.lines.values():
                values = mine.values[:, mine.illuminated].astype(np.float32)
                low, high = (
                    mine.low[mine.illuminated].astype(np.float32),
                    mine.high[mine.illuminated].astype(np.float32),
                )
                margin = OFF_REFERENCE * (high - low)
                off += np.count_nonzero(values > low + margin, axis=1), np.count_nonzero(values < high - margin, axis=1)
                illuminated += values.shape[1]
            self._off = off / max(illuminated, 1)
        return self._off
