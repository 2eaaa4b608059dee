"""Points go into the table and come out as they were, in one block of memory that two processes may share."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import POINT_BYTES, Cloud, Found, PointTable

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


def assert_same(one: Cloud, other: Cloud) -> None:
    for name in ("points_mm", "intensity", "modulation_dn", "ray_gap_mm", "sigma_mm", "pixel"):
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.parametrize(("n", "capacity"), [(7, 7), (5, 7), (1, 1), (0, 3)])
def test_a_cloud_comes_out_as_it_went_in(n: int, capacity: int) -> None:
    table, wanted = PointTable(capacity), cloud(n)
    found = table.put(wanted)
    assert found.pieces == ((0, n),)
    got = table.cloud(found)
    assert_same(got, wanted)
    assert got.summary is SUMMARY
    assert got.gaps is None


def test_modulation_is_kept_to_half_a_grey_value() -> None:
    table, wanted = PointTable(4), cloud(4)
    wanted.modulation_dn[:] = [0.24, 0.26, 33.3, 127.5]
    assert table.cloud(table.put(wanted)).modulation_dn.tolist() == [0.0, 0.5, 33.5, 127.5]


def test_two_tables_on_the_same_memory_hold_the_same_points_and_26_bytes_are_enough_for_one() -> None:
    """Three coordinates, gap, sigma and pixel of four bytes, modulation and grey value of one."""
    assert POINT_BYTES == 6 * 4 + 2
    memory = bytearray(9 * POINT_BYTES)
    here, there = PointTable(9, memoryview(memory)), PointTable(9, memoryview(memory))
    assert (here.capacity, len(here.points.pixel), here.points.xyz_mm.shape) == (9, 9, (9, 3))
    wanted = cloud(9)
    assert_same(there.cloud(here.put(wanted)), wanted)
    with pytest.raises(ValueError, match=r"array|size|split|shape|multiple"):
        PointTable(10, memoryview(memory))


def test_memory_with_room_to_spare_holds_a_table_at_its_beginning() -> None:
    memory = bytearray(9 * POINT_BYTES + 100)
    wanted = cloud(9)
    table = PointTable(9, memoryview(memory))
    assert_same(table.cloud(table.put(wanted)), wanted)
    assert bytes(memory[9 * POINT_BYTES :]) == bytes(100)


def test_the_pieces_of_several_threads_are_joined_without_what_lies_between() -> None:
    table, whole = PointTable(12), cloud(12)
    table.put(whole)
    got = table.cloud(Found(((1, 4), (6, 6), (9, 12)), SUMMARY))
    kept = [1, 2, 3, 9, 10, 11]
    np.testing.assert_array_equal(got.points_mm, whole.points_mm[kept])
    np.testing.assert_array_equal(got.pixel, whole.pixel[kept])
    np.testing.assert_array_equal(got.modulation_dn, whole.modulation_dn[kept])
    table.put(cloud(3))
    np.testing.assert_array_equal(got.points_mm, whole.points_mm[kept], "a copy")


@pytest.mark.parametrize(
    ("most", "kept"), [(10, range(10)), (11, range(10)), (9, range(0, 10, 2)), (3, (0, 4, 8)), (1, (0,))]
)
def test_a_thinned_cloud_has_no_more_points_than_wanted_evenly_and_the_numbers_of_all(
    most: int, kept: tuple[int, ...]
) -> None:
    whole = cloud(10)
    thin = whole.thinned(most)
    np.testing.assert_array_equal(thin.pixel, whole.pixel[list(kept)])
    np.testing.assert_array_equal(thin.points_mm, whole.points_mm[list(kept)])
    np.testing.assert_array_equal(thin.sigma_mm, whole.sigma_mm[list(kept)])
    np.testing.assert_array_equal(thin.ray_gap_mm, whole.ray_gap_mm[list(kept)])
    np.testing.assert_array_equal(thin.modulation_dn, whole.modulation_dn[list(kept)])
    np.testing.assert_array_equal(thin.intensity, whole.intensity[list(kept)])
    assert thin.summary is SUMMARY


def test_a_cloud_of_no_points_can_be_thinned() -> None:
    assert len(cloud(0).thinned(5).pixel) == 0
