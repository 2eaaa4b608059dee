"""A second cloud is laid against the first: the movement between them is found, and nothing is read where there is no surface."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.register import register
from appliance.reconstruct.surface import surface_of
from appliance.reconstruct.table import Cloud

Array = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX, FOCAL_PX = 160, 120, 320.0


def height_mm(x: Array, y: Array) -> Array:
    return np.asarray(500.0 + 12.0 * np.sin(x / 25.0) + 9.0 * np.cos(y / 20.0))


def seen(R: Array, t_mm: Array, sigma_mm: float) -> Cloud:
    """The surface as a camera sees it whose points p are at R p + t."""
    v, u = np.divmod(np.arange(WIDTH_PX * HEIGHT_PX), WIDTH_PX)
    ray = np.stack([(u - 79.5) / FOCAL_PX, (v - 59.5) / FOCAL_PX, np.ones(u.size)], -1)
    depth = np.full(u.size, 500.0)
    for _ in range(40):
        at = (ray * depth[:, None]) @ R.T + t_mm
        depth += (height_mm(at[:, 0], at[:, 1]) - at[:, 2]) / (ray @ R.T)[:, 2]
    n = u.size
    return Cloud(
        points_mm=(ray * depth[:, None]).astype(np.float32), intensity=np.full(n, 100, np.uint8),
        modulation_dn=np.full(n, 50.0, np.float32), ray_gap_mm=np.zeros(n, np.float32),
        sigma_mm=np.full(n, sigma_mm, np.float32), pixel=np.arange(n, dtype=np.uint32),
        summary=CloudSummary(n, None, None, None, None),
    )  # fmt: skip


def moved(angles_deg: tuple[float, float, float], t_mm: tuple[float, float, float]) -> tuple[Array, Array]:
    """A turn about the surface's middle, and a translation."""
    R = np.asarray(cv2.Rodrigues(np.radians(angles_deg))[0], np.float64)
    middle = np.array([0.0, 0.0, 500.0])
    return R, np.array(t_mm) + middle - R @ middle


def test_a_movement_is_told_in_millimetres_pixels_and_degrees() -> None:
    """3 mm along x at 500 mm and 320 px are 1.92 px; a turn of 0.5 degrees stays one."""
    first = seen(np.eye(3), np.zeros(3), 0.02)
    for angles_deg, t_mm, turned_deg, moved_mm, moved_px in (
        ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), 0.0, 3.0, 1.92),
        ((0.0, 0.0, 0.0), (0.0, 4.0, 0.0), 0.0, 4.0, 2.56),
        ((0.0, 0.3, -0.4), (0.0, 0.0, 0.0), 0.5, None, None),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0),
    ):
        R, t = moved(angles_deg, t_mm)
        found = register(surface_of(first, first, (HEIGHT_PX, WIDTH_PX)), seen(R, t, 0.02))
        assert found is not None
        assert found.turned_deg == pytest.approx(turned_deg, abs=0.02)
        if moved_mm is not None:
            assert found.moved_mm == pytest.approx(moved_mm, abs=0.06)
            assert found.moved_px == pytest.approx(moved_px, abs=0.06)


def noisy(cloud: Cloud, noise_mm: float, seed: int) -> Cloud:
    """The same points, moved along their rays by noise."""
    z = cloud.points_mm[:, 2].astype(np.float64)
    off = noise_mm * np.random.default_rng(seed).standard_normal(len(z))
    return replace(cloud, points_mm=(cloud.points_mm * ((z + off) / z)[:, None]).astype(np.float32))


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_the_residual_is_how_much_more_two_clouds_differ_than_they_expect(times: float) -> None:
    """Noise along the ray is less along a sloping normal: of slopes up to 0.5, a tenth in the mean."""
    first, second = (noisy(seen(np.eye(3), np.zeros(3), 0.05), times * 0.05, seed) for seed in (1, 2))
    found = register(surface_of(first, second, (HEIGHT_PX, WIDTH_PX)), second)
    assert found is not None
    assert found.residual == pytest.approx(0.9 * times, rel=0.12)
    assert found.residual_mm == pytest.approx(found.residual * 0.05 * np.sqrt(2.0), rel=0.02)
    assert found.moved_mm < 0.05


def test_a_part_that_moved_by_itself_is_no_part_of_the_movement_and_is_missing_from_the_shared() -> None:
    """A tenth of the second cloud is 3 mm nearer: the rest still lies where it was."""
    first = second = seen(np.eye(3), np.zeros(3), 0.02)
    scale = np.ones(len(second.pixel))
    scale[: len(scale) // 10] = 497.0 / 500.0
    second = replace(second, points_mm=(second.points_mm * scale[:, None]).astype(np.float32))
    found = register(surface_of(first, first, (HEIGHT_PX, WIDTH_PX)), second)
    assert found is not None
    assert found.moved_mm < 0.01
    assert found.turned_deg < 0.01
    assert found.shared == pytest.approx(0.9, abs=0.02)


def test_a_plane_that_slides_in_itself_is_left_where_it_is_along_itself() -> None:
    """Of a shift by (3, 2, 1) only what is across the plane can be seen, and nothing is invented for the rest."""

    def plane(z_mm: float) -> Cloud:
        cloud = seen(np.eye(3), np.zeros(3), 0.02)
        return replace(cloud, points_mm=(cloud.points_mm * (z_mm / cloud.points_mm[:, 2:])).astype(np.float32))

    first, second = plane(500.0), plane(499.0)
    found = register(surface_of(first, second, (HEIGHT_PX, WIDTH_PX)), second)
    assert found is not None
    np.testing.assert_allclose(found.translation_mm, [0.0, 0.0, 1.0], atol=0.02)
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-4)


@pytest.mark.parametrize(("shared", "laid"), [(400, True), (399, False)])
def test_four_hundred_shared_points_are_enough(shared: int, laid: bool) -> None:
    first = seen(np.eye(3), np.zeros(3), 0.02)
    centre = (np.arange(HEIGHT_PX)[:, None] // 2 * 0 + np.arange(WIDTH_PX)).ravel() > 40
    inner = np.flatnonzero(centre)[3000 : 3000 + shared]
    second = Cloud(
        first.points_mm[inner], first.intensity[inner], first.modulation_dn[inner], first.ray_gap_mm[inner],
        first.sigma_mm[inner], first.pixel[inner], first.summary,
    )  # fmt: skip
    found = register(surface_of(first, first, (HEIGHT_PX, WIDTH_PX)), second)
    assert (found is not None) is laid


def test_surfaces_that_are_farther_apart_than_a_hand_trembles_have_nothing_in_common() -> None:
    first = seen(np.eye(3), np.zeros(3), 0.02)
    for z_mm, laid in ((5.0, True), (20.0, False)):
        second = seen(np.eye(3), np.array([0.0, 0.0, z_mm]), 0.02)
        found = register(surface_of(first, first, (HEIGHT_PX, WIDTH_PX)), second)
        assert (found is not None) is laid, z_mm
