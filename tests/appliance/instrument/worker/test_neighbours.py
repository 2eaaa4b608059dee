"""What the worker does between scans: it compares one with that which was kept before, and live pictures with it, piece by piece."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.worker.memory import reduced
from appliance.instrument.worker.messages import LookAt
from appliance.instrument.worker.neighbours import LiveGuide, Neighbours
from appliance.measure.cloud import CloudSummary
from appliance.measure.guidance import Move, Overlap
from appliance.measure.light.patterns import build_sequence
from appliance.measure.news import LiveGuidance
from appliance.measure.points.table import Cloud
from tests.support import synthetic
from tests.support.views import CALIBRATION, view

STRIDE_PX = 3
SEQUENCE = build_sequence(16)
MOST_PIECES = 12
PLACES_MM = (0.0, 70.0, -330.0)
"""Places along a painted main: the second 70 mm from the first, the third far off."""


@cache
def scan_at(number: int) -> tuple[Cloud, NDArray[np.uint8]]:
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


class Between:
    def __init__(self) -> None:
        self.neighbours = Neighbours(CALIBRATION, synthetic.WATER, SEQUENCE, STRIDE_PX)
        self.onlooker = LiveGuide(CALIBRATION, synthetic.WATER, self.neighbours)

    def take(self, number: int, of: int | None = 1, keep: bool = False) -> None:
        self.neighbours.begin(of)
        cloud, frames = scan_at(number)
        self.neighbours.coarse(cloud)
        in_memory = frames.copy()
        self.neighbours.add_full(in_memory)
        in_memory[:] = 0  # the next scan's come into the same memory
        if keep:
            self.neighbours.keep()

    def compared(self) -> Overlap:
        for _ in range(MOST_PIECES):
            if (found := self.neighbours.go_on()) is not None:
                assert found.cpu_s > 0.0
                assert not self.neighbours.has_work
                return found.overlap
        raise AssertionError(f"no answer after {MOST_PIECES} pieces")

    def look(self, taken_ns: int, picture: NDArray[np.uint8]) -> None:
        self.onlooker.look(LookAt(taken_ns, (picture.shape[0], picture.shape[1]), 1), picture)

    def looked(self) -> LiveGuidance:
        for _ in range(MOST_PIECES):
            if (found := self.onlooker.go_on()) is not None:
                assert not self.onlooker.has_work
                return found
        raise AssertionError(f"no answer after {MOST_PIECES} pieces")


@pytest.fixture
def between() -> Between:
    return Between()


@pytest.fixture(scope="module")
def near() -> NDArray[np.uint8]:
    """A live picture 50 mm along from the first scan."""
    return reduced(view("main", (50.0, 0.0, 560.0, 0.0, 0.0, 0.0), "slight", 9).cloud.grey)


def test_a_scan_is_compared_with_the_one_that_was_kept_and_never_with_one_that_was_rejected(between: Between) -> None:
    between.take(0, keep=True)
    assert not between.neighbours.has_work, "there is none before"
    between.take(2)  # and not kept
    between.take(1)
    share = between.compared().share
    assert share is not None
    assert 0.5 < share < 0.9
    between.neighbours.keep()
    between.take(2)
    assert between.compared().none


@pytest.mark.parametrize(
    ("before", "now", "compared"), [(1, 1, True), (None, None, True), (1, 2, False), (None, 1, False), (1, None, False)]
)
def test_scans_of_two_objects_are_not_compared(
    before: int | None, now: int | None, compared: bool, between: Between
) -> None:
    between.take(0, before, keep=True)
    between.take(1, now)
    assert between.neighbours.has_work == compared


def test_a_new_scan_ends_the_comparison_and_loses_no_neighbour(between: Between) -> None:
    between.take(0, keep=True)
    between.take(2)
    between.neighbours.go_on()
    between.neighbours.begin(1)
    assert (between.neighbours.has_work, between.neighbours.go_on()) == (False, None)
    between.neighbours.keep()  # a scan of which nothing is known yet
    between.take(1)
    assert not between.compared().none


def test_a_picture_is_looked_at_against_the_scan_that_was_kept(between: Between, near: NDArray[np.uint8]) -> None:
    between.look(1, near)
    assert between.looked().guidance is None, "no scan at all"
    between.take(0, 2, keep=True)
    between.look(2, near)
    assert between.looked().guidance is None, "none of the object"
    between.take(0, keep=True)
    between.look(4, near)
    found = between.looked()
    assert (found.taken_ns, found.cpu_s > 0.0) == (4, True)
    assert found.guidance is not None
    assert found.guidance.move is Move.GO_ON


def test_a_scan_that_begins_ends_it_and_a_later_picture_takes_its_place(
    between: Between, near: NDArray[np.uint8]
) -> None:
    between.take(0, keep=True)
    between.look(1, near)
    assert between.onlooker.go_on() is None
    between.onlooker.begin()
    assert (between.onlooker.has_work, between.onlooker.go_on()) == (False, None)
    between.look(2, near)
    between.look(3, near)
    assert between.looked().taken_ns == 3
