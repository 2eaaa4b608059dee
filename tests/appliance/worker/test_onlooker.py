"""The worker looks at what the diver aims at: against the scan that was kept of the same object, piece by piece, the latest picture only."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.scan.guidance import Move
from appliance.worker.live_picture import reduced
from appliance.worker.messages import LookAt, LookedAt
from appliance.worker.neighbours import Neighbours
from appliance.worker.onlooker import Onlooker
from tests.appliance.worker.test_neighbours import MOST_PIECES, SEQUENCE, STRIDE_PX, scan_at, take
from tests.support import synthetic
from tests.support.views import CALIBRATION, view


@pytest.fixture(scope="module")
def near() -> NDArray[np.uint8]:
    """A live picture 50 mm along from the first scan."""
    return reduced(view("main", (50.0, 0.0, 560.0, 0.0, 0.0, 0.0), "slight", 9).cloud.grey)


@pytest.fixture
def neighbours() -> Neighbours:
    return Neighbours(CALIBRATION, synthetic.WATER, SEQUENCE, STRIDE_PX)


@pytest.fixture
def onlooker(neighbours: Neighbours) -> Onlooker:
    return Onlooker(CALIBRATION, synthetic.WATER, neighbours)


def order(number: int, picture: NDArray[np.uint8], of: int = 1) -> LookAt:
    return LookAt(number, (picture.shape[0], picture.shape[1]), of)


def answer(onlooker: Onlooker) -> LookedAt:
    for _ in range(MOST_PIECES):
        found = onlooker.go_on() if onlooker.waits else None
        if found is not None:
            return found
    raise AssertionError(f"no answer after {MOST_PIECES} pieces")


def test_a_picture_is_looked_at_against_the_scan_that_was_kept(
    onlooker: Onlooker, neighbours: Neighbours, near: NDArray[np.uint8]
) -> None:
    onlooker.look(order(1, near), near)
    assert answer(onlooker).guidance is None, "no scan at all"
    take(neighbours, scan_at(0), 2)
    neighbours.keep()
    onlooker.look(order(2, near), near)
    assert answer(onlooker).guidance is None, "none of the object"
    take(neighbours, scan_at(0))
    neighbours.keep()
    onlooker.look(order(4, near), near)
    found = answer(onlooker)
    assert not onlooker.waits
    assert found.number == 4
    assert found.cpu_s > 0.0
    assert found.guidance is not None
    assert found.guidance.move is Move.GO_ON


def test_a_scan_that_begins_ends_it_and_a_later_picture_takes_its_place(
    onlooker: Onlooker, neighbours: Neighbours, near: NDArray[np.uint8]
) -> None:
    take(neighbours, scan_at(0))
    neighbours.keep()
    onlooker.look(order(1, near), near)
    assert onlooker.go_on() is None
    onlooker.begin()
    assert not onlooker.waits
    assert onlooker.go_on() is None
    onlooker.look(order(2, near), near)
    onlooker.look(order(3, near), near)
    assert answer(onlooker).number == 3
