"""Clouds are copied into memory that was there before the dive, and none changes while anybody has a part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import Cloud, Found, PointTable
from appliance.worker.cloud_memory import CloudMemory

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
    own, kept = (
        table_of(3).cloud(Found(PIECES, SUMMARY)),
        CloudMemory(CAPACITY).copied(table_of(3), Found(PIECES, SUMMARY)),
    )
    assert values(kept) == values(own)
    assert [kept.modulation_dn.dtype, kept.pixel.dtype, kept.points_mm.shape] == [np.float32, np.uint32, (32, 3)]
    assert kept.modulation_dn[0] == 0.5 * (3 + 3)


@pytest.mark.parametrize("part", ["cloud", "column", "thinned"])
def test_a_cloud_that_somebody_has_a_part_of_does_not_change(part: str) -> None:
    memory = CloudMemory(CAPACITY)
    whole = memory.copied(table_of(1), Found(PIECES, SUMMARY))
    parts: dict[str, Cloud] = {
        "cloud": whole,
        "column": replace(table_of(7).cloud(Found(PIECES, SUMMARY)), sigma_mm=whole.sigma_mm[2:5]),
        "thinned": whole.thinned(5),
    }
    held = parts[part]
    del whole, parts
    before = values(held)
    later = [memory.copied(table_of(number), Found(PIECES, SUMMARY)) for number in (10, 20, 30)]
    assert values(held) == before
    assert [values(one) for one in later] == [values(table_of(k).cloud(Found(PIECES, SUMMARY))) for k in (10, 20, 30)]


def test_scan_after_scan_takes_no_new_memory() -> None:
    memory = CloudMemory(CAPACITY)
    places = set()
    for number in range(6):
        cloud = memory.copied(table_of(number), Found(PIECES, SUMMARY))
        places.add(cloud.points_mm.ctypes.data)
        del cloud
    assert len(places) == 1
    held = memory.copied(table_of(0), Found(PIECES, SUMMARY))
    for number in range(6):
        cloud = memory.copied(table_of(number), Found(PIECES, SUMMARY))
        places.add(cloud.points_mm.ctypes.data)
        del cloud
    assert len(places) == 2, "a scan that is still being published has the other one"
    assert held.points_mm.ctypes.data in places
