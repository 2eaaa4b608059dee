"""Owns how many scans become one object: which pairs are compared, what they say, and where every scan lies, or why it
is left out.

It also owns which pairs of scans are worth comparing, so that forty scans need not be compared 780 times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress, one_line
from appliance.desk.registration.bow import Array, known_before
from appliance.desk.registration.graph import Edge, Placed, place
from appliance.measure import PairRefusal, ReadyScan, RegisteredPair, Rigid, register

VOTERS = 400
"""Features of a scan that vote, its strongest ones."""
ALIKE = 0.88
"""Least cosine between descriptors that may be the same mark."""
LEAST_VOTES = 8
PER_SCAN = 4
"""Other scans that a scan is compared with for its features, besides its neighbours in time."""
LOOKED_AT = 150
"""Patches that tell how much two placed scans overlap."""
LEAST_OVERLAP = 0.2


def by_time(count: int) -> list[tuple[int, int]]:
    """Return each scan with the one after it."""
    return [(k, k + 1) for k in range(count - 1)]


def by_features(descriptors: Sequence[NDArray[np.float32]]) -> list[tuple[int, int]]:
    """Return the pairs, ascending, of scans whose features (n, 128), the strongest first, vote for each other, at most
    ``PER_SCAN`` of each scan.

    Every voter finds its best match in each other scan at once; a match counts for the scan in which it is best.
    """
    votes = _votes([one[:VOTERS] for one in descriptors])
    chosen = set()
    for k, row in enumerate(votes):
        for other in np.argsort(-row, kind="stable")[:PER_SCAN]:
            if row[other] >= LEAST_VOTES:
                chosen.add((min(k, int(other)), max(k, int(other))))
    return sorted(chosen)


def _votes(descriptors: Sequence[NDArray[np.float32]]) -> NDArray[np.int64]:
    count = len(descriptors)
    votes = np.zeros((count, count), np.int64)
    for k, mine in enumerate(descriptors):
        if not len(mine):
            continue
        best = np.full((count, len(mine)), -1.0, np.float32)
        for other, theirs in enumerate(descriptors):
            if other != k and len(theirs):
                best[other] = (mine @ theirs.T).max(axis=1)
        # The same mark is seen by several scans: every one nearly as good as the best gets the vote.
        top = best.max(axis=0)
        votes[k] = ((best > ALIKE) & (best > top - 0.03)).sum(axis=1)
    return votes


def by_place(
    scans: Sequence[ReadyScan], poses: Mapping[int, Rigid], tried: set[tuple[int, int]]
) -> list[tuple[int, int, Rigid]]:
    """Return untried pairs of placed scans that should overlap, with the pose of the second in the first's frame."""
    found = []
    placed = sorted(poses)
    for number, first in enumerate(placed):
        for second in placed[number + 1 :]:
            if (first, second) in tried:
                continue
            pose = poses[second].then(poses[first].inverse)
            if (
                min(overlap(scans[first], scans[second], pose), overlap(scans[second], scans[first], pose.inverse))
                >= LEAST_OVERLAP
            ):
                found.append((first, second, pose))
    return found


def overlap(a: ReadyScan, b: ReadyScan, pose: Rigid, within_mm: float = 3.0) -> float:
    """Return the share of B's patches that lie on A within ``within_mm``, from a few of them."""
    patches = a.coarse.patches
    x = pose.of(_sample(b))
    if not len(x):
        return 0.0
    with np.errstate(invalid="ignore"):
        cell = np.rint(patches.cells(x))
        h, w = patches.sigma_mm.shape
        inside = (cell[:, 0] >= 0) & (cell[:, 1] >= 0) & (cell[:, 0] < w) & (cell[:, 1] < h)
    at = (np.where(inside, cell[:, 1], 0).astype(int), np.where(inside, cell[:, 0], 0).astype(int))
    off = ((x - patches.centre_mm[at]) * patches.normal[at]).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return float(np.count_nonzero(inside & (np.abs(off) < within_mm)) / len(x))


def _sample(scan: ReadyScan) -> Array:
    patches = scan.coarse.patches
    points = patches.centre_mm[patches.valid]
    return np.asarray(points[:: max(1, len(points) // LOOKED_AT)])


PLACES = 3
"""Largest number of pairs per scan that are added because places predict an overlap."""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A pair that was compared."""

    first: int
    second: int
    pair: RegisteredPair
    matches: int | None = None
    """Features that both show, where the pair's pose lays them on each other; ``None``: it was not accepted."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Reason why a scan has no place."""

    why: str
    beside: int | None = None
    """The scan that it was compared with to no avail; ``None``: the reason is not one pair's."""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Scans as one object, by their number in the order given."""

    placed: Placed
    aided: Placed
    """The same with the shared depth error estimated; where that was wanted, it is ``placed``."""
    compared: tuple[Compared, ...]
    left_out: Mapping[int, LeftOut]
    """Why each scan that has no place has none."""

    __repr__ = one_line


def solve(
    scans: Sequence[ReadyScan],
    progress: Progress,
    with_bow: bool = False,
    stated_mm2: Array | None = None,
) -> Solved:
    """Place ``scans``, in the order in which they were taken. ``progress``: told what is being done, and how much is
    done (0..1).

    ``with_bow``: the depth error that all scans share is estimated and believed; ``stated_mm2``: what their calibration
    states of it (``Calibration.depth_error_mm2``). Pairs: each scan with the next, with those its features vote for,
    then with all that the places found so far put beside it.
    """
    wanted: dict[tuple[int, int], Rigid | None] = dict.fromkeys(by_time(len(scans)))
    wanted |= dict.fromkeys(by_features([scan.features.descriptors for scan in scans]))
    compared: list[Compared] = []
    tried: set[tuple[int, int]] = set()

    def compare(pairs: Mapping[tuple[int, int], Rigid | None], share: float) -> None:
        for number, ((first, second), near) in enumerate(sorted(pairs.items(), key=lambda item: item[0])):
            progress(f"comparing pair {number + 1} of {len(pairs)}", share + 0.5 * number / len(pairs))
            tried.add((first, second))
            compared.append(_compared(scans, first, second, near))

    compare(wanted, 0.0)
    middles = {k: middle_of(scan) for k, scan in enumerate(scans)}
    placed = place(len(scans), edges_of(compared), middles, with_bow, known_before(stated_mm2))
    more = by_place(scans, placed.poses, tried)
    compare(_thinned(more), 0.5)
    progress("closing loops", 1.0)
    aided = place(len(scans), edges_of(compared), middles, True, known_before(stated_mm2))
    placed = aided if with_bow else place(len(scans), edges_of(compared), middles, False, known_before(stated_mm2))
    return Solved(placed, aided, tuple(compared), _left_out(len(scans), placed, compared))


def _compared(scans: Sequence[ReadyScan], first: int, second: int, near: Rigid | None) -> Compared:
    pair = register(scans[first], scans[second], near)
    if not pair.accepted or pair.fit is None:
        return Compared(first, second, pair)
    return Compared(first, second, pair, scans[first].common_keypoints(scans[second], pair.fit.pose))


def middle_of(scan: ReadyScan) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the median (3,) of a scan's patches, its middle, mm; zero for a scan of none."""
    patches = scan.fine.patches
    return np.asarray(np.median(patches.centre_mm[patches.valid], axis=0)) if patches.valid.any() else np.zeros(3)


def edges_of(compared: Sequence[Compared]) -> list[Edge]:
    """Return the accepted pairs as edges of a graph."""
    return [
        Edge(one.first, one.second, one.pair.fit) for one in compared if one.pair.accepted and one.pair.fit is not None
    ]


def _thinned(found: Sequence[tuple[int, int, Rigid]]) -> dict[tuple[int, int], Rigid | None]:
    """Keep at most ``PLACES`` pairs of each scan with others, those farthest apart in time first: they close the
    longest loops."""
    count: dict[int, int] = {}
    kept: dict[tuple[int, int], Rigid | None] = {}
    for first, second, pose in sorted(found, key=lambda one: one[0] - one[1]):
        if count.get(first, 0) < PLACES and count.get(second, 0) < PLACES:
            kept[first, second] = pose
            count[first], count[second] = count.get(first, 0) + 1, count.get(second, 0) + 1
    return kept


def _left_out(count: int, placed: Placed, compared: Sequence[Compared]) -> dict[int, LeftOut]:
    reasons: dict[int, LeftOut] = {}
    wrong = {(edge.first, edge.second) for edge in placed.wrong}
    for scan in range(count):
        if scan in placed.poses:
            continue
        mine = [one for one in compared if scan in (one.first, one.second)]
        refused = [one for one in mine if one.pair.refusal not in (None, PairRefusal.NOTHING_IN_COMMON)]
        contradicting = [one for one in mine if (one.first, one.second) in wrong]
        if contradicting:
            reasons[scan] = LeftOut("its pairs contradict the loops of the others")
        elif any(one.pair.accepted for one in mine):
            reasons[scan] = LeftOut("it fits others that have no place either")
        elif refused:
            # Nothing is known of how much they overlap: those taken one after the other were meant to.
            best = min(refused, key=lambda one: one.second - one.first)
            reasons[scan] = LeftOut(best.pair.text, best.second if best.first == scan else best.first)
        else:
            reasons[scan] = LeftOut("it overlaps no other scan")
    return reasons
