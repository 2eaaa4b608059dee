"""Owns how many scans become one object: which pairs are compared, what they say, and where every scan lies, or why it is left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from appliance.base import one_line
from appliance.desk.registration import candidates
from appliance.desk.registration.graph import Edge, Placed, place
from appliance.desk.registration.pair import PairRefusal, ReadyScan, RegisteredPair, register
from appliance.measure import Array, Rigid, in_common, known_before

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
    progress: Callable[[str, float], None],
    with_bow: bool = False,
    stated_mm2: Array | None = None,
) -> Solved:
    """Place ``scans``, in the order in which they were taken. ``progress``: told what is being done, and how much is done (0..1).

    ``with_bow``: the depth error that all scans share is estimated and believed; ``stated_mm2``: what their calibration states of it
    (``Calibration.depth_error_mm2``). Pairs: each scan with the next, with those its features vote for, then with all that the places found so far put beside it.
    """
    wanted: dict[tuple[int, int], Rigid | None] = dict.fromkeys(candidates.by_time(len(scans)))
    wanted |= dict.fromkeys(candidates.by_features([scan.features for scan in scans]))
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
    more = candidates.by_place(scans, placed.poses, tried)
    compare(_thinned(more), 0.5)
    progress("closing loops", 1.0)
    aided = place(len(scans), edges_of(compared), middles, True, known_before(stated_mm2))
    placed = aided if with_bow else place(len(scans), edges_of(compared), middles, False, known_before(stated_mm2))
    return Solved(placed, aided, tuple(compared), _left_out(len(scans), placed, compared))


def _compared(scans: Sequence[ReadyScan], first: int, second: int, near: Rigid | None) -> Compared:
    pair = register(scans[first], scans[second], near)
    if not pair.accepted or pair.fit is None:
        return Compared(first, second, pair)
    common = in_common(scans[first].features, scans[second].features, pair.fit.pose)
    return Compared(first, second, pair, len(common))


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
    """Keep at most ``PLACES`` pairs of each scan with others, those farthest apart in time first: they close the longest loops."""
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
