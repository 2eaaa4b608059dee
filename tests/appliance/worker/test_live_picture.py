"""A live picture comes to the worker as it was seen, small, and beside the points."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.table import POINT_BYTES
from appliance.worker.live_picture import LONGEST_PX, LivePicture, behind_picture

CAPACITY = 5_000


@pytest.mark.parametrize(
    ("shape", "small"), [((1200, 1600), (360, 480)), ((300, 400), (300, 400)), ((960, 600), (480, 300))]
)
def test_what_is_put_is_copied_in_its_own_shape_and_no_point_is_touched(
    shape: tuple[int, int], small: tuple[int, int]
) -> None:
    memory = memoryview(bytearray([7]) * behind_picture(CAPACITY))
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]] / max(shape)
    picture = (100.0 + 60.0 * u + 90.0 * v).astype(np.uint8)
    ours, theirs = LivePicture(memory, CAPACITY), LivePicture(memory, CAPACITY)
    assert ours.put(picture) == small
    copied = theirs.copy(small)
    ours.put(np.zeros(shape, np.uint8))
    v, u = np.mgrid[0 : small[0], 0 : small[1]] / min(max(shape), LONGEST_PX)
    assert np.abs(copied - (100.0 + 60.0 * u + 90.0 * v)).max() < 2.0, "the next one does not change it"
    assert set(memory[: CAPACITY * POINT_BYTES]) == {7}


def test_memory_that_was_closed_is_said_to_be() -> None:
    with pytest.raises(ValueError, match="closed"):
        LivePicture(None, 1)
