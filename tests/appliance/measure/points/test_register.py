"""A second cloud is laid against the first: the movement between them is found, and nothing is read where there is no surface."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.cloud import CloudSummary
from appliance.measure.points.register import Registration, register_exposures
from appliance.measure.points.surface import surface_of
from appliance.measure.points.table import Cloud

Array = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 160, 120, 320.0
AT_REST = np.eye(3), np.zeros(3)


def height_mm(x: Array, y: Array) -> Array:
    return np.asarray(500.0 + 12.0 * np.sin(x / 25.0) + 9.0 * np.cos(y / 20.0))


def seen(sigma_mm: float = 0.02, moved: tuple[Array, Array] = AT_REST) -> Cloud:
    """The surface as a camera sees it whose points p are at R p + t."""
    R, t_mm = moved
    v, u = np.divmod(np.arange(WIDTH_PX * HEIGHT_PX), WIDTH_PX)
    n, ones = u.size, np.ones(u.size, np.float32)
    ray = np.stack([(u - 79.5) / FOCAL_PX, (v - 59.5) / FOCAL_PX, np.ones(n)], -1)
    depth = np.full(n, 500.0)
    for _ in range(40):
        at = (ray * depth[:, None]) @ R.T + t_mm
        depth += (height_mm(at[:, 0], at[:, 1]) - at[:, 2]) / (ray @ R.T)[:, 2]
    points, pixel = (ray * depth[:, None]).astype(np.float32), np.arange(n, dtype=np.uint32)
    return Cloud(
        points,
        (100 * ones).astype(np.uint8),
        50 * ones,
        ones,
        np.float32(sigma_mm) * ones,
        pixel,
        CloudSummary(n, None, None, None, None),
    )


def laid(first: Cloud, second: Cloud) -> Registration:
    found = register_exposures(surface_of(first, second, (HEIGHT_PX, WIDTH_PX)), second)
    assert found is not None
    return found


def moved(angles_deg: tuple[float, float, float], t_mm: tuple[float, float, float]) -> tuple[Array, Array]:
    """A turn about the surface's middle, and a translation."""
    R = np.asarray(cv2.Rodrigues(np.radians(angles_deg))[0], np.float64)
    middle = np.array([0.0, 0.0, 500.0])
    return R, np.array(t_mm) + middle - R @ middle


@pytest.mark.parametrize(
    ("angles_deg", "t_mm", "turned_deg", "moved_mm"),
    [
        ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), 0.0, 3.0),
        ((0.0, 0.0, 0.0), (0.0, 4.0, 0.0), 0.0, 4.0),
        ((0.0, 0.3, -0.4), (0.0, 0.0, 0.0), 0.5, None),
    ],
)
def test_a_movement_is_told_in_millimetres_pixels_and_degrees(
    angles_deg: tuple[float, float, float], t_mm: tuple[float, float, float], turned_deg: float, moved_mm: float | None
) -> None:
    """3 mm along x at 500 mm and 320 px are 1.92 px; a turn of 0.5 degrees stays one."""
    found = laid(seen(), seen(moved=moved(angles_deg, t_mm)))
    assert found.turned_deg == pytest.approx(turned_deg, abs=0.02)
    if moved_mm is not None:
        assert (found.moved_mm, found.moved_px) == pytest.approx((moved_mm, 0.64 * moved_mm), abs=0.06)


def noisy(cloud: Cloud, noise_mm: float, seed: int) -> Cloud:
    """The same points, moved along their rays by noise."""
    z = cloud.points_mm[:, 2].astype(np.float64)
    off = noise_mm * np.random.default_rng(seed).standard_normal(len(z))
    return replace(cloud, points_mm=(cloud.points_mm * ((z + off) / z)[:, None]).astype(np.float32))


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_the_residual_is_how_much_more_two_clouds_differ_than_they_expect(times: float) -> None:
    """Noise along the ray is less along a sloping normal: of slopes up to 0.5, a tenth in the mean."""
    found = laid(*(noisy(seen(0.05), times * 0.05, seed) for seed in (1, 2)))
    assert found.residual == pytest.approx(0.9 * times, rel=0.12)
    assert found.residual_mm == pytest.approx(found.residual * 0.05 * np.sqrt(2.0), rel=0.02)
    assert found.moved_mm < 0.05


def test_a_part_that_moved_by_itself_is_no_part_of_the_movement_and_is_missing_from_the_shared() -> None:
    """A tenth of the second cloud is 3 mm nearer: the rest still lies where it was."""
    first = seen()
    scale = np.where(first.pixel < len(first.pixel) // 10, 497.0 / 500.0, 1.0)
    found = laid(first, replace(first, points_mm=(first.points_mm * scale[:, None]).astype(np.float32)))
    assert (found.moved_mm, found.turned_deg) == pytest.approx((0.0, 0.0), abs=0.01)
    assert found.shared == pytest.approx(0.9, abs=0.02)


def test_a_plane_that_slides_in_itself_is_left_where_it_is_along_itself() -> None:
    """Of a shift by (3, 2, 1) only what is across the plane can be seen, and nothing is invented for the rest."""
    cloud = seen()
    ray = cloud.points_mm / cloud.points_mm[:, 2:]
    found = laid(*(replace(cloud, points_mm=(ray * z_mm).astype(np.float32)) for z_mm in (500.0, 499.0)))
    np.testing.assert_allclose(found.translation_mm, [0.0, 0.0, 1.0], atol=0.02)
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-4)


def test_four_hundred_shared_points_are_enough_if_they_lie_no_farther_apart_than_a_hand_trembles() -> None:
    first = seen()
    columns = ("points_mm", "intensity", "modulation_dn", "ray_gap_mm", "sigma_mm", "pixel")
    inner = np.flatnonzero(first.pixel % WIDTH_PX > 40)[3000:]
    few = [replace(first, **{name: getattr(first, name)[inner[:n]] for name in columns}) for n in (400, 399)]
    far = [seen(moved=(np.eye(3), np.array([0.0, 0.0, z_mm]))) for z_mm in (5.0, 20.0)]
    surface = surface_of(first, first, (HEIGHT_PX, WIDTH_PX))
    assert [register_exposures(surface, second) is not None for second in (*few, *far)] == [True, False, True, False]
