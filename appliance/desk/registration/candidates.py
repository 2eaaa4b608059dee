"""Owns which pairs of scans are worth comparing, so that forty scans need not be compared 780 times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.desk.registration.pair import ReadyScan
from appliance.measure import Array, Features, Rigid

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


def by_features(features: Sequence[Features]) -> list[tuple[int, int]]:
    """Return the pairs, ascending, whose features vote for each other, at most ``PER_SCAN`` of each scan.

    Every voter finds its best match in each other scan at once; a match counts for the scan in which it is best.
    """
    votes = _votes([one.descriptors[:VOTERS] for one in features])
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
