"""Owns what speaks against a camera's frames showing the patterns of the sequence: doubts, each 1 where it is decided.

No doubt is taken from coordinates: a wrong sequence decodes to wrong ones that look right. What is counted is whether
neighbours follow each other as they were drawn, which a surface, its colour and moderate motion leave as it is:

forward    from sample to sample the fringes' phase grows, because cameras and projector are the same way up
order      where one Gray image changes, the code goes on by one: for all images of a direction together, and for each by
           itself, since the coarsest have an edge or two in the whole field, but each of the lines crosses it
in phase   these edges lie at the fringes' 0° and 180°, alternately. This holds Gray code and sines together, and each Gray
           image against all others: exchange it for anything but another of its direction, and the code's parity is wrong
opposite   the sines of 0° and 180°, and of 90° and 270°, are each other's negative
ends       nothing is brighter than the bright frame, nothing darker than the dark one
place      the middle of what is seen lies about where the design puts it: nothing else tells Gray images apart of which no
           edge is seen
elsewhere  all of it lies about as far from there: where two such images are exchanged, quarters of the field change places and
           their middle stays

Steps that cross an outline, a printed edge or a place that something moved over are left out by what the fringes themselves do
there: phase that bends, swings that differ, a bright frame that is not bright.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.sequence import Direction, PatternSequence
from appliance.measure.verdicts.identity.counts import COUNTS, OFF_REFERENCE, PLACES, Count, follow
from appliance.measure.verdicts.identity.lines import Lines, thresholds

DECIDED = 1.0
"""A doubt of this size is an alarm. The limits below are half way, in its own measure, between what good scans of moving,
dark and turbid scenes show at most and what a wrong frame shows (docs/identity.md has both)."""
LEAST_FORWARD = 0.7
MOST_DISPLACED = {Direction.X: 0.2, Direction.Y: 0.15}
"""Largest distance, in widths of the field, between where the stripes are in the image, on average, and where the
design puts them. Along the base line they wander with distance: by 0.08 in the measuring volume, 0.15 well before
it."""
APART = {Direction.X: 0.2, Direction.Y: 0.1}
"""Distance, in widths of the field, from where most of the stripes are, beyond which one is elsewhere. Along the base line, the near
and the far end of the measuring volume are 0.16 apart; down it distance shifts nothing."""
MOST_ELSEWHERE = {Direction.X: 0.2, Direction.Y: 0.3}
"""Largest share of the steps that may be elsewhere. Before printed squares that move 0.04 have a wrong code across the base line, 0.16
along it; of two exchanged images of which no edge is seen, a quarter to a half."""
LEAST_IN_PHASE = 0.6
"""Mean cosine; a fifth of the edges half a period off, where only a part of the surface shows a frame to be wrong."""
MOST_OUT_OF_ORDER = 0.3
MOST_OF_ONE_OUT_OF_ORDER = 0.6
"""Largest share of the edges of one Gray image that may be out of order: the coarsest have few, and an outline may
cross them."""
LEAST_EDGES_OF_ONE = 5
MOST_CORRELATION = -0.4
"""Largest correlation of sines of opposite steps; it is −1 where nothing but the pattern changes."""
MOST_BEHIND_BEST = 0.5
"""Largest amount by which a pair's correlation may be worse than that of the best pair: colour that moves spoils all
of them."""
MOST_OFF_REFERENCE = 0.8
LEAST_BESIDE_REFERENCE, MOST_BESIDE_REFERENCE = 0.05, 0.08
MOST_OF_OFF, NEARLY_ALL_OF_OFF = 0.5, 0.75
"""Share of samples, or of those off the reference, by which another frame may be the better bright (or dark) one: over what
moves, a frame from the middle of the sequence halves them. Fewer samples, down to the least that show a wrong order, speak where the
other frame is right at nearly all of these: nothing that moves leaves one that is."""
MIN_FRINGE = 60
"""Samples with fringes in both directions, or there is nothing to judge by."""
MIN_EDGES = 12
MIN_SINE = 100
_FRINGE_SIGMA = 6.0


@dataclass(frozen=True, slots=True)
class LineEvidence:
    """Doubts that the lines of one camera raise about one explanation, by name, e.g. ``order gray-x-3``."""

    doubts: Mapping[str, float]
    suspects: Mapping[str, int]
    """The frame a doubt is about, where it is about one."""
    illuminated: int
    fringe: int
    """Samples with fringes; below ``MIN_FRINGE`` no doubt means anything."""
    edges: int
    steps: int = 0
    """Steps along the lines of the direction with fewer: where a camera reads the stripes of one direction only, nothing is said
    of the frames of the other."""
    displaced: float = 0.0
    """Distance of the stripes across the base line from the design's place, in widths of the field: with opposite
    signs in both cameras where the object is near or far, with the same sign where a Gray image is wrong."""

    @property
    def judged(self) -> bool:
        """Is there enough to judge by?"""
        enough = self.edges >= MIN_EDGES and self.steps >= MIN_FRINGE
        return self.fringe >= MIN_FRINGE and (enough or self.contradicted)

    @property
    def worst(self) -> float:
        """The largest doubt; 0 without any."""
        return max(self.doubts.values(), default=0.0)

    @property
    def contradicted(self) -> bool:
        """Is one of the doubts decided?"""
        return self.worst >= DECIDED

    @property
    def total(self) -> float:
        """All doubts together: what explanations are compared by."""
        return float(sum(min(doubt, 2.0) for doubt in self.doubts.values()))


def _elsewhere(places: NDArray[np.float64], apart: float) -> float:
    """Return the share of the steps that lie farther than ``apart`` widths of the field from where the middle one of them lies.

    ``places``: (PLACES,) steps by how far beside their place they lie, −1 to 1.
    """
    middle = int(np.searchsorted(np.cumsum(places), 0.5 * places.sum()))
    far = np.abs(np.arange(PLACES) - middle) > 0.5 * PLACES * apart
    return float(places[far].sum() / places.sum())


class Witness:
    """One camera's lines, which can be asked about any order of its frames."""

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
        """Collect the doubts about frame ``order[k]`` showing pattern k."""
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
            doubts, suspects, int(total[Count.ILLUMINATED]), int(total[Count.FRINGE]), int(total[Count.EDGES]),
            min(int(sums[Count.STEPS]) for sums in all_sums.values()),
            self._displaced(all_sums),
        )  # fmt: skip

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
            # Mean place by the half periods' numbers, as a share of the field, against the mean place along the line.
            coded = (sums[Count.NUMBER] / steps + 0.5) * self._half_period(along)
            doubts[f"place {name}"] = abs(coded - sums[Count.PLACE] / steps) / MOST_DISPLACED[along]
            doubts[f"forward {name}"] = (1.0 - sums[Count.FORWARD] / steps) / (1.0 - LEAST_FORWARD)
        count = sums[Count.EDGES]
        if count >= MIN_EDGES:
            doubts[f"phase {name}"] = (1.0 - sums[Count.IN_PHASE] / count) / (1.0 - LEAST_IN_PHASE)
            doubts[f"order {name}"] = (1.0 - sums[Count.IN_ORDER] / count) / MOST_OUT_OF_ORDER
        for k, (seen, wrong) in zip(axis.gray, edges, strict=True):
            if wrong >= LEAST_EDGES_OF_ONE:
                key = f"order {self._sequence.patterns[k].name}"
                doubts[key] = wrong / seen / MOST_OF_ONE_OUT_OF_ORDER
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
        """Doubt pairs of steps that are not each other's opposite."""
        found: dict[int, float] = {}
        for along, mine in sums.items():
            n = mine[Count.SINES]
            if n < MIN_SINE:
                continue
            for first, place in ((0, Count.PRODUCT_02), (1, Count.PRODUCT_13)):
                # Correlation of two opposite steps by their sums: (E[ab] − E[a] E[b]) / (σa σb).
                means = mine[[Count.SINE_0 + first, Count.SINE_0 + first + 2]] / n
                squares = mine[[Count.SQUARE_0 + first, Count.SQUARE_0 + first + 2]] / n
                spread = float(np.sqrt(np.maximum(squares - means**2, 1e-6)).prod())
                found[self._axes[along].sine[first]] = float(mine[place] / n - means.prod()) / spread
        best = min(found.values(), default=0.0)
        for k, correlation in found.items():
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
        """Doubt the references where another frame is the better bright, or the better dark. At outlines of what
        moves, none is."""
        if total[Count.ILLUMINATED] < MIN_FRINGE:
            return
        share = {"bright": total[Count.NOT_BRIGHT], "dark": total[Count.NOT_DARK]}
        for name, off in share.items():
            off /= total[Count.ILLUMINATED]
            excess = 0.0
            if off > LEAST_BESIDE_REFERENCE:
                least = float(self._off_reference()[int(name == "bright")][order].min())
                nearly_all = min(MOST_BESIDE_REFERENCE, NEARLY_ALL_OF_OFF * off)
                excess = (off - least) / max(LEAST_BESIDE_REFERENCE, nearly_all, MOST_OF_OFF * off)
            doubts[name] = max(off / MOST_OFF_REFERENCE, excess)
            suspects[name] = self._sequence.bright if name == "bright" else self._sequence.dark

    def _off_reference(self) -> NDArray[np.float64]:
        """Return (2, frames) the share of illuminated samples at which each frame is not dark, and not bright;
        computed once."""
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
