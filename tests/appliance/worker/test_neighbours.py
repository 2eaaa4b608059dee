"""The worker compares a scan with the one that was kept before: of the same object, piece by piece, and only while nothing else is wanted."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import Cloud
from appliance.scan.overlap import Overlap
from appliance.worker.neighbours import Neighbours
from tests.support import synthetic
from tests.support.views import CALIBRATION, view

STRIDE_PX = 3
SEQUENCE = build_sequence(16)
MOST_PIECES = 12
PLACES_MM = (0.0, 70.0, -330.0)
"""Places along the main: the second 70 mm from the first, the third far off."""


@cache
def scan_at(number: int) -> tuple[Cloud, NDArray[np.uint8]]:
    """Coarse cloud and left frames of one of the places along a painted main."""
    pose = (PLACES_MM[number], 0.0, 560.0, 0.0, 0.0, float(number))
    first, other = (view("main", pose, "slight", seed).cloud for seed in (number, number + 100))
    mask = np.zeros(first.shape, bool)
    mask[::STRIDE_PX, ::STRIDE_PX] = first.mask[::STRIDE_PX, ::STRIDE_PX]
    pixel = np.flatnonzero(mask)
    nothing = np.zeros(len(pixel), np.float32)
    cloud = Cloud(
        first.points_mm.reshape(-1, 3)[pixel], nothing.astype(np.uint8), nothing, nothing,
        first.sigma_mm.ravel()[pixel], pixel.astype(np.uint32), CloudSummary(len(pixel), None, None, None, None),
    )  # fmt: skip
    frames = np.broadcast_to(other.grey, (len(SEQUENCE), *other.grey.shape)).copy()
    frames[SEQUENCE.bright] = first.grey
    return cloud, frames


@pytest.fixture
def neighbours() -> Neighbours:
    return Neighbours(CALIBRATION, synthetic.WATER, SEQUENCE, STRIDE_PX)


def take(neighbours: Neighbours, scan: tuple[Cloud, NDArray[np.uint8]], of: int | None = 1) -> None:
    neighbours.begin(of)
    neighbours.coarse(scan[0])
    frames = scan[1].copy()
    neighbours.whole(frames)
    frames[:] = 0  # the next scan's come into the same memory


def answer(neighbours: Neighbours) -> Overlap | None:
    for _ in range(MOST_PIECES):
        if not neighbours.waits:
            return None
        found = neighbours.go_on()
        if found is not None:
            assert found.cpu_s > 0.0
            return found.overlap
    raise AssertionError(f"no answer after {MOST_PIECES} pieces")


def test_a_scan_is_compared_with_the_one_that_was_kept(neighbours: Neighbours) -> None:
    take(neighbours, scan_at(0))
    assert answer(neighbours) is None, "there is none before"
    neighbours.keep()
    take(neighbours, scan_at(1))
    found = answer(neighbours)
    assert found is not None
    assert found.share is not None
    assert 0.5 < found.share < 0.9
    neighbours.keep()
    take(neighbours, scan_at(2))
    gone = answer(neighbours)
    assert gone is not None
    assert gone.none


def test_a_scan_that_was_rejected_is_nobodys_neighbour(neighbours: Neighbours) -> None:
    take(neighbours, scan_at(0))
    neighbours.keep()
    take(neighbours, scan_at(2))  # and not kept
    take(neighbours, scan_at(1))
    found = answer(neighbours)
    assert found is not None
    assert found.share is not None
    assert found.share > 0.5


@pytest.mark.parametrize(
    ("before", "now", "compared"), [(1, 1, True), (None, None, True), (1, 2, False), (None, 1, False), (1, None, False)]
)
def test_scans_of_two_objects_are_not_compared(
    before: int | None, now: int | None, compared: bool, neighbours: Neighbours
) -> None:
    take(neighbours, scan_at(0), before)
    neighbours.keep()
    take(neighbours, scan_at(1), now)
    assert neighbours.waits == compared


def test_a_new_scan_ends_the_comparison_and_loses_no_neighbour(neighbours: Neighbours) -> None:
    take(neighbours, scan_at(0))
    neighbours.keep()
    take(neighbours, scan_at(2))
    neighbours.go_on()
    neighbours.begin(1)
    assert not neighbours.waits
    assert neighbours.go_on() is None
    neighbours.keep()  # a scan of which nothing is known yet
    neighbours.coarse(scan_at(1)[0])
    neighbours.whole(scan_at(1)[1])
    found = answer(neighbours)
    assert found is not None
    assert not found.none
