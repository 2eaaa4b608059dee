"""Scan poses of an object from its scans: choice and comparison of scan pairs, and omitted scans.

``by_time``, ``by_features`` and ``by_place`` choose the scan pairs that are worth comparing, so that forty scans need
not be compared 780 times; ``solve`` does it all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress, one_line
from appliance.desk.registration.bow import Array, prior_covariance
from appliance.desk.registration.graph import Edge, ScanPoses, place
from appliance.measure import PairRefusal, ReadyScan, RegisteredPair, Rigid, register

VOTERS = 400
"""Number of keypoints of a scan that vote, its strongest ones."""
ALIKE = 0.88
"""Least cosine between descriptors of one keypoint."""
LEAST_VOTES = 8
PER_SCAN = 4
"""Largest number of scans with which a scan is compared by keypoints, besides its neighbours in time."""
MAX_SAMPLES = 150
"""Number of patches by which the overlap of two placed scans is estimated."""
LEAST_OVERLAP = 0.2


def by_time(count: int) -> list[tuple[int, int]]:
    """Return each scan with the next one."""
    return [(k, k + 1) for k in range(count - 1)]


def by_features(descriptors: Sequence[NDArray[np.float32]]) -> list[tuple[int, int]]:
    """Return the scan pairs, ascending, whose keypoints vote for each other.

    There are at most ``PER_SCAN`` of each scan. ``descriptors`` are (n, 128) of each scan, the strongest first. Every
    keypoint finds its best match in each other scan; a match counts for the scan in which it is best.
    """
    votes = _votes([descriptors_of_scan[:VOTERS] for descriptors_of_scan in descriptors])
    chosen = set()
    for k, row in enumerate(votes):
        for candidate in np.argsort(-row, kind="stable")[:PER_SCAN]:
            if row[candidate] >= LEAST_VOTES:
                chosen.add((min(k, int(candidate)), max(k, int(candidate))))
    return sorted(chosen)


def _votes(descriptors: Sequence[NDArray[np.float32]]) -> NDArray[np.int64]:
    count = len(descriptors)
    votes = np.zeros((count, count), np.int64)
    for k, own_descriptors in enumerate(descriptors):
        if not len(own_descriptors):
            continue
        best = np.full((count, len(own_descriptors)), -1.0, np.float32)
        for rival, rival_descriptors in enumerate(descriptors):
            if rival != k and len(rival_descriptors):
                best[rival] = (own_descriptors @ rival_descriptors.T).max(axis=1)
        # Several scans may see one keypoint: each that is nearly as good as the best gets the vote.
        top = best.max(axis=0)
        votes[k] = ((best > ALIKE) & (best > top - 0.03)).sum(axis=1)
    return votes


def by_place(
    scans: Sequence[ReadyScan], poses: Mapping[int, Rigid], compared: set[tuple[int, int]]
) -> list[tuple[int, int, Rigid]]:
    """Return untried scan pairs that should overlap, with the pose of the second in the first's frame."""
    overlapping = []
    placed = sorted(poses)
    for number, first in enumerate(placed):
        for second in placed[number + 1 :]:
            if (first, second) in compared:
                continue
            pose = poses[second].then(poses[first].inverse)
            if (
                min(overlap(scans[first], scans[second], pose), overlap(scans[second], scans[first], pose.inverse))
                >= LEAST_OVERLAP
            ):
                overlapping.append((first, second, pose))
    return overlapping


def overlap(a: ReadyScan, b: ReadyScan, pose: Rigid, within_mm: float = 3.0) -> float:
    """Return the share of B's patches that lie on A within ``within_mm``, estimated from some of them."""
    patches = a.coarse.patches
    x = pose.of(_sample(b))
    if not len(x):
        return 0.0
    with np.errstate(invalid="ignore"):
        cell = np.rint(patches.cells(x))
        h, w = patches.sigma_mm.shape
        inside = (cell[:, 0] >= 0) & (cell[:, 1] >= 0) & (cell[:, 0] < w) & (cell[:, 1] < h)
    cells_of_points = (np.where(inside, cell[:, 1], 0).astype(int), np.where(inside, cell[:, 0], 0).astype(int))
    distance_mm = ((x - patches.centre_mm[cells_of_points]) * patches.normal[cells_of_points]).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return float(np.count_nonzero(inside & (np.abs(distance_mm) < within_mm)) / len(x))


def _sample(scan: ReadyScan) -> Array:
    patches = scan.coarse.patches
    points = patches.centre_mm[patches.valid]
    return np.asarray(points[:: max(1, len(points) // MAX_SAMPLES)])


PLACES = 3
"""Largest number of scan pairs per scan that are added because poses predict an overlap."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPair:
    """A scan pair with the result of its registration."""

    first: int
    second: int
    pair: RegisteredPair
    matches: int | None = None
    """Number of keypoints in both scans that the pose maps onto each other; ``None``: it was not accepted."""


@dataclass(frozen=True, slots=True)
class Omission:
    """Reason why a scan has no pose."""

    why: str
    beside: int | None = None
    """The scan with which the comparison failed; ``None``: the reason is not of one scan pair."""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """Scans as one object, by their index in the given order."""

    placed: ScanPoses
    aided: ScanPoses
    """The poses with an estimate of the shared depth error; equal to ``placed`` with ``with_bow``."""
    compared: tuple[ComparedPair, ...]
    left_out: Mapping[int, Omission]
    """Reason of each scan without a pose."""

    __repr__ = one_line


def solve(
    scans: Sequence[ReadyScan],
    progress: Progress,
    with_bow: bool = False,
    stated_mm2: Array | None = None,
) -> Solved:
    """Place ``scans``, in the order in which they were taken.

    ``progress`` gets the step and the finished share (0..1). ``with_bow``: the depth error that all scans share is
    estimated and applied; ``stated_mm2``: its covariance as the calibration states it
    (``Calibration.depth_error_mm2``). Scan pairs: each scan with the next, with those for which its keypoints vote,
    then with those that overlap by the poses found so far.
    """
    first_pairs: dict[tuple[int, int], Rigid | None] = dict.fromkeys(by_time(len(scans)))
    first_pairs |= dict.fromkeys(by_features([scan.features.descriptors for scan in scans]))
    compared: list[ComparedPair] = []
    done_pairs: set[tuple[int, int]] = set()

    def compare(pairs: Mapping[tuple[int, int], Rigid | None], share: float) -> None:
        for number, ((first, second), guess) in enumerate(sorted(pairs.items(), key=lambda item: item[0])):
            progress(f"comparing pair {number + 1} of {len(pairs)}", share + 0.5 * number / len(pairs))
            done_pairs.add((first, second))
            compared.append(_compare_pair(scans, first, second, guess))

    compare(first_pairs, 0.0)
    middles = {k: middle_of(scan) for k, scan in enumerate(scans)}
    placed = place(len(scans), edges_of(compared), middles, with_bow, prior_covariance(stated_mm2))
    predicted = by_place(scans, placed.poses, done_pairs)
    compare(_most_useful(predicted), 0.5)
    progress("closing loops", 1.0)
    aided = place(len(scans), edges_of(compared), middles, True, prior_covariance(stated_mm2))
    placed = aided if with_bow else place(len(scans), edges_of(compared), middles, False, prior_covariance(stated_mm2))
    return Solved(placed, aided, tuple(compared), _omissions(len(scans), placed, compared))


def _compare_pair(scans: Sequence[ReadyScan], first: int, second: int, near: Rigid | None) -> ComparedPair:
    pair = register(scans[first], scans[second], near)
    if not pair.accepted or pair.fit is None:
        return ComparedPair(first, second, pair)
    return ComparedPair(first, second, pair, scans[first].common_keypoints(scans[second], pair.fit.pose))


def middle_of(scan: ReadyScan) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the median (3,) of a scan's patches, mm; zero for a scan without any."""
    patches = scan.fine.patches
    return np.asarray(np.median(patches.centre_mm[patches.valid], axis=0)) if patches.valid.any() else np.zeros(3)


def edges_of(compared: Sequence[ComparedPair]) -> list[Edge]:
    """Return the accepted pairs as edges of a graph."""
    return [
        Edge(result.first, result.second, result.pair.fit)
        for result in compared
        if result.pair.accepted and result.pair.fit is not None
    ]


def _most_useful(pairs: Sequence[tuple[int, int, Rigid]]) -> dict[tuple[int, int], Rigid | None]:
    """Return at most ``PLACES`` pairs of each scan, those farthest apart in time first.

    They close the longest loops.
    """
    count: dict[int, int] = {}
    chosen: dict[tuple[int, int], Rigid | None] = {}
    for first, second, pose in sorted(pairs, key=lambda pair: pair[0] - pair[1]):
        if count.get(first, 0) < PLACES and count.get(second, 0) < PLACES:
            chosen[first, second] = pose
            count[first], count[second] = count.get(first, 0) + 1, count.get(second, 0) + 1
    return chosen


def _omissions(count: int, placed: ScanPoses, compared: Sequence[ComparedPair]) -> dict[int, Omission]:
    reasons: dict[int, Omission] = {}
    wrong = {(edge.first, edge.second) for edge in placed.wrong}
    for scan in range(count):
        if scan in placed.poses:
            continue
        own_results = [result for result in compared if scan in (result.first, result.second)]
        refused = [result for result in own_results if result.pair.refusal not in (None, PairRefusal.NOTHING_IN_COMMON)]
        contradicting = [result for result in own_results if (result.first, result.second) in wrong]
        if contradicting:
            reasons[scan] = Omission("its scan pairs contradict the loops of the others")
        elif any(result.pair.accepted for result in own_results):
            reasons[scan] = Omission("it overlaps only scans without a pose")
        elif refused:
            # The overlap is unknown: scans taken one after the other were meant to overlap.
            best = min(refused, key=lambda result: result.second - result.first)
            reasons[scan] = Omission(best.pair.text, best.second if best.first == scan else best.first)
        else:
            reasons[scan] = Omission("it overlaps no other scan")
    return reasons
