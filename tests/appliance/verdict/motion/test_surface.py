"""How a surface stands to the rays follows from its points, where they have neighbours."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import Cloud
from appliance.verdict.motion.harm import facing, surface_map

WIDTH_PX, STRIDE = 120, 4


def tilted(angle_deg: float, missing: int = 0) -> Cloud:
    """A plane 500 mm away, turned about the image's rows, seen by every fourth pixel."""
    v, u = np.mgrid[0:90:STRIDE, 0:WIDTH_PX:STRIDE]
    x, y = 0.5 * (u - 60.0) / 500.0, 0.5 * (v - 45.0) / 500.0
    z = 500.0 / (1.0 - x * np.tan(np.radians(angle_deg)))
    points = np.stack([x * z, y * z, z], -1).reshape(-1, 3)[missing:]
    pixel = (v * WIDTH_PX + u).ravel()[missing:]
    n = len(pixel)
    ones = np.ones(n, np.float32)
    return Cloud(
        points.astype(np.float32), ones.astype(np.uint8), ones, ones, np.full(n, 0.04, np.float32),
        pixel.astype(np.uint32), CloudSummary(n, None, None, None, None),
    )  # fmt: skip


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 65.0])
def test_a_tilted_plane_has_the_cosine_of_its_tilt(angle_deg: float) -> None:
    cosine, inside = facing(tilted(angle_deg), WIDTH_PX)
    assert len(cosine) == len(inside) > 500
    assert np.median(cosine) == pytest.approx(np.cos(np.radians(angle_deg)), abs=0.01)


def test_points_at_a_border_have_no_say() -> None:
    whole, _ = facing(tilted(10.0), WIDTH_PX)
    torn, inside = facing(tilted(10.0, missing=200), WIDTH_PX)
    assert len(torn) < len(whole)
    assert inside.min() > 0


def test_the_order_of_the_points_does_not_matter() -> None:
    whole = tilted(20.0)
    turned = np.roll(np.arange(len(whole.pixel)), 300)
    other = Cloud(
        whole.points_mm[turned], whole.intensity[turned], whole.modulation_dn[turned], whole.ray_gap_mm[turned],
        whole.sigma_mm[turned], whole.pixel[turned], whole.summary,
    )  # fmt: skip
    (cosine, inside), (again, there) = facing(whole, WIDTH_PX), facing(other, WIDTH_PX)
    np.testing.assert_array_equal(np.sort(whole.pixel[inside]), np.sort(other.pixel[there]))
    np.testing.assert_array_equal(np.sort(cosine), np.sort(again))


def test_noise_counts_across_the_surface() -> None:
    coordinate = np.tile(np.linspace(0.0, 127.0, WIDTH_PX, dtype=np.float32), (90, 1))
    cloud = tilted(60.0)
    found = surface_map(cloud, coordinate, coordinate, np.full(len(cloud.pixel), 0.04**2, np.float32), (2, 2))
    known = np.isfinite(found.noise_px)
    assert known.any()
    assert found.noise_px[known] == pytest.approx(0.04 * 0.5, rel=0.15)


def test_without_points_nothing_is_said() -> None:
    empty = tilted(0.0, missing=10_000)
    nothing = np.zeros((90, WIDTH_PX), np.float32)
    found = surface_map(empty, nothing, nothing, np.empty(0, np.float32), (2, 2))
    assert np.isnan(found.across).all()
    cosine, inside = facing(empty, WIDTH_PX)
    assert (len(cosine), len(inside)) == (0, 0)


def test_points_in_one_row_or_one_column_face_nowhere() -> None:
    for kept in (slice(0, 30), slice(0, None, 30)):
        whole = tilted(20.0)
        line = Cloud(
            whole.points_mm[kept], whole.intensity[kept], whole.modulation_dn[kept], whole.ray_gap_mm[kept],
            whole.sigma_mm[kept], whole.pixel[kept], whole.summary,
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            cosine, inside = facing(line, WIDTH_PX)
        assert (len(cosine), len(inside)) == (0, 0)


def rough() -> Cloud:
    """Points of every third column and second row, some of them missing, of a surface that stands differently everywhere."""
    rng = np.random.default_rng(4)
    v, u = np.mgrid[5:90:2, 7:WIDTH_PX:3]
    z = 500.0 + rng.normal(0.0, 0.3, u.shape)
    points = np.stack([0.5 * (u - 60.0), 0.5 * (v - 45.0), z], -1).reshape(-1, 3)
    kept = rng.permutation(np.flatnonzero(rng.random(len(points)) < 0.97))
    n = len(kept)
    ones = np.ones(n, np.float32)
    sigma = rng.uniform(0.01, 0.05, n).astype(np.float32)
    pixel = (v * WIDTH_PX + u).ravel()[kept].astype(np.uint32)
    return Cloud(
        points[kept].astype(np.float32), ones.astype(np.uint8), ones, ones, sigma, pixel,
        CloudSummary(n, None, None, None, None),
    )  # fmt: skip


def faces(cloud: Cloud) -> dict[int, float]:
    """Point → |cos θ| of those that have all four neighbours, one by one."""
    where = {int(pixel): k for k, pixel in enumerate(cloud.pixel)}
    out = {}
    for pixel, k in where.items():
        around = [where.get(pixel + step) for step in (-3, 3, -2 * WIDTH_PX, 2 * WIDTH_PX)]
        if None in around:
            continue
        left, right, above, below = (cloud.points_mm[one].astype(float) for one in around)
        normal, ray = np.cross(right - left, below - above), cloud.points_mm[k].astype(float)
        out[k] = abs(normal @ ray) / (np.linalg.norm(normal) * np.linalg.norm(ray))
    return out


def test_every_point_faces_as_its_four_neighbours_stand() -> None:
    cloud = rough()
    cosine, inside = facing(cloud, WIDTH_PX)
    wanted = faces(cloud)
    assert set(inside.tolist()) == set(wanted)
    assert cosine == pytest.approx([wanted[int(k)] for k in inside], rel=1e-4)


def test_cells_are_the_means_of_the_points_whose_coordinates_they_hold() -> None:
    rng = np.random.default_rng(6)
    p, q = (rng.uniform(-20.0, end, (90, WIDTH_PX)).astype(np.float32) for end in (220.0, 150.0))
    for coordinate, end in ((p, 192.0), (q, 128.0)):
        coordinate[rng.random(coordinate.shape) < 0.05] = np.nan
        coordinate[rng.random(coordinate.shape) < 0.05] = 0.0
        coordinate[rng.random(coordinate.shape) < 0.05] = end
    cloud = rough()
    # Of the last two cells three points are left, and four.
    wanted = faces(cloud)
    flat_p, flat_q = p.ravel(), q.ravel()
    for column, kept in ((1, 3), (2, 4)):
        cell = [k for k in wanted if 64.0 <= flat_q[cloud.pixel[k]] < 128.0 and flat_p[cloud.pixel[k]] // 64 == column]
        flat_p[cloud.pixel[cell[kept:]]] = np.nan
    variance = rng.uniform(1e-4, 4e-4, len(cloud.pixel)).astype(np.float32)
    found = surface_map(cloud, p, q, variance, (2, 3))
    for row in range(2):
        for column in range(3):
            cell = [
                k for k in wanted
                if flat_q[cloud.pixel[k]] // 64 == row and flat_p[cloud.pixel[k]] // 64 == column
            ]  # fmt: skip
            assert found.points[row, column] == len(cell)
            if len(cell) < 4:
                assert np.isnan(found.across[row, column])
                assert np.isnan(found.noise_px[row, column])
                continue
            cosines = np.array([wanted[k] for k in cell])
            assert found.across[row, column] == pytest.approx(np.sqrt(np.mean(cosines**2)), rel=1e-4)
            noise = np.sqrt(np.mean(cosines**2 * variance[cell]))
            assert found.noise_px[row, column] == pytest.approx(noise, rel=1e-4)
    assert np.isnan(found.across).tolist() == [[False, False, False], [False, True, False]]


def test_points_that_all_lie_at_one_place_stand_in_no_way() -> None:
    cloud = rough()
    cloud.points_mm[:] = (1.0, 2.0, 500.0)
    coordinate = np.full((90, WIDTH_PX), 1.0, np.float32)
    found = surface_map(cloud, coordinate, coordinate, np.full(len(cloud.pixel), 1e-4, np.float32), (1, 1))
    assert found.points.tolist() == [[0.0]]
    assert np.isnan(found.across).all()
