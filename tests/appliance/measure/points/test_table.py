"""Points go into the table and come out as they were, in one block of memory that two processes may share."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.points.table import POINT_BYTES, Cloud, PointTable

SUMMARY = CloudSummary(5, 50.0, 500.0, 0.02, 0.01)


def cloud(n: int) -> Cloud:
    rng = np.random.default_rng(n)
    return Cloud(
        points_mm=rng.normal(0.0, 100.0, (n, 3)).astype(np.float32),
        intensity=rng.integers(0, 256, n).astype(np.uint8),
        modulation_dn=(rng.integers(0, 256, n) / 2.0).astype(np.float32),
        ray_gap_mm=rng.random(n).astype(np.float32),
        sigma_mm=rng.random(n).astype(np.float32),
        pixel=np.sort(rng.integers(0, 2**32, n)).astype(np.uint32),
        summary=SUMMARY,
    )


def test_two_tables_on_the_same_memory_hold_the_same_points_and_26_bytes_are_enough_for_one() -> None:
    """Three coordinates, gap, sigma and pixel of four bytes, modulation and grey value of one."""
    assert POINT_BYTES == 6 * 4 + 2
    memory = bytearray(9 * POINT_BYTES)
    here, there = PointTable(9, memoryview(memory)), PointTable(9, memoryview(memory))
    for n in (9, 5, 0):
        wanted = cloud(n)
        found = here.put(wanted)
        assert found.pieces == ((0, n),)
        got = there.cloud(found)
        for name in ("points_mm", "intensity", "modulation_dn", "ray_gap_mm", "sigma_mm", "pixel"):
            np.testing.assert_array_equal(getattr(got, name), getattr(wanted, name), strict=True, err_msg=name)
        assert (got.summary, got.gaps) == (SUMMARY, None)
    with pytest.raises(ValueError, match=r"array|size|split|shape|multiple"):
        PointTable(10, memoryview(memory))


def test_the_pieces_of_several_threads_are_joined_without_what_lies_between() -> None:
    table, whole = PointTable(12), cloud(12)
    table.put(whole)
    got = table.cloud(CloudLocation(((1, 4), (6, 6), (9, 12)), SUMMARY))
    kept = [1, 2, 3, 9, 10, 11]
    np.testing.assert_array_equal(got.points_mm, whole.points_mm[kept])
    np.testing.assert_array_equal(got.pixel, whole.pixel[kept])
    np.testing.assert_array_equal(got.modulation_dn, whole.modulation_dn[kept])
    table.put(cloud(3))
    np.testing.assert_array_equal(got.points_mm, whole.points_mm[kept], "a copy")
