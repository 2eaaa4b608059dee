"""What worker and parent have in memory: clouds that nobody's part of changes, and a live picture beside the points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.instrument.worker.memory import LONGEST_PX, CloudMemory, LivePicture, behind_picture
from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.points.table import POINT_BYTES, Cloud, PointTable

CAPACITY = 50
PIECES = ((3, 20), (25, 40))
SUMMARY = CloudSummary(32, 100.0, 500.0, 1.0, 1.0)


def table_of(number: int) -> PointTable:
    """A table in which each value tells which table, column and row it is of."""
    table, row = PointTable(CAPACITY), np.arange(CAPACITY)
    points = table.points
    points.xyz_mm[:] = number + np.stack([row, row + 0.25, row + 0.5], 1)
    points.gap_mm[:], points.sigma_mm[:] = number + row / 8.0, number + row / 16.0
    points.modulation_half_dn[:], points.intensity[:] = row + number, row + number + 1
    points.pixel[:] = 1000 * number + row
    return table


def values(cloud: Cloud) -> list[list[float]]:
    columns = (cloud.points_mm, cloud.intensity, cloud.modulation_dn, cloud.ray_gap_mm, cloud.sigma_mm, cloud.pixel)
    return [np.asarray(column, float).ravel().tolist() for column in columns]


def test_a_copy_is_the_same_to_the_last_bit_wherever_it_lies() -> None:
    found = CloudLocation(PIECES, SUMMARY)
    kept = CloudMemory(CAPACITY).copied(table_of(3), found)
    assert values(kept) == values(table_of(3).cloud(found))
    assert [kept.modulation_dn.dtype, kept.pixel.dtype, kept.points_mm.shape] == [np.float32, np.uint32, (32, 3)]
    assert kept.modulation_dn[0] == 0.5 * (3 + 3)


@pytest.mark.parametrize("part", ["cloud", "column", "thinned"])
def test_a_cloud_that_somebody_has_a_part_of_does_not_change(part: str) -> None:
    memory = CloudMemory(CAPACITY)
    whole = memory.copied(table_of(1), CloudLocation(PIECES, SUMMARY))
    parts: dict[str, Cloud] = {
        "cloud": whole,
        "column": replace(table_of(7).cloud(CloudLocation(PIECES, SUMMARY)), sigma_mm=whole.sigma_mm[2:5]),
        "thinned": whole.thinned(5),
    }
    held = parts[part]
    del whole, parts
    before = values(held)
    later = [memory.copied(table_of(number), CloudLocation(PIECES, SUMMARY)) for number in (10, 20, 30)]
    assert values(held) == before
    assert [values(one) for one in later] == [
        values(table_of(k).cloud(CloudLocation(PIECES, SUMMARY))) for k in (10, 20, 30)
    ]


def test_scan_after_scan_takes_no_new_memory() -> None:
    memory = CloudMemory(CAPACITY)

    def places() -> set[int]:
        return {memory.copied(table_of(k), CloudLocation(PIECES, SUMMARY)).points_mm.ctypes.data for k in range(6)}

    first = places()
    assert len(first) == 1
    held = memory.copied(table_of(0), CloudLocation(PIECES, SUMMARY))
    assert len(places() | first) == 2, "a scan that is still being published has the other one"
    assert held.points_mm.ctypes.data in first


PLACES = 5_000


@pytest.mark.parametrize(
    ("shape", "small"), [((1200, 1600), (360, 480)), ((300, 400), (300, 400)), ((960, 600), (480, 300))]
)
def test_what_is_put_is_copied_in_its_own_shape_and_no_point_is_touched(
    shape: tuple[int, int], small: tuple[int, int]
) -> None:
    memory = memoryview(bytearray([7]) * behind_picture(PLACES))
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]] / max(shape)
    picture = (100.0 + 60.0 * u + 90.0 * v).astype(np.uint8)
    ours, theirs = LivePicture(memory, PLACES), LivePicture(memory, PLACES)
    assert ours.put(picture) == small
    copied = theirs.copy(small)
    ours.put(np.zeros(shape, np.uint8))
    v, u = np.mgrid[0 : small[0], 0 : small[1]] / min(max(shape), LONGEST_PX)
    assert np.abs(copied - (100.0 + 60.0 * u + 90.0 * v)).max() < 2.0, "the next one does not change it"
    assert set(memory[: PLACES * POINT_BYTES]) == {7}
    with pytest.raises(ValueError, match="closed"):
        LivePicture(None, 1)
