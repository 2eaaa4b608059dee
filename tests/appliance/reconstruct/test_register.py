"""A second cloud is laid against the first: the movement between them is found, and nothing is read where there is no surface."""

from __future__ import annotations

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


def test_a_movement_is_found_also_where_part_of_it_leaves_the_picture() -> None:
    R = np.asarray(cv2.Rodrigues(np.radians([0.3, -0.4, 0.5]))[0], np.float64)
    t_mm = np.array([4.0, -1.0, 2.0]) + np.array([0.0, 0.0, 500.0]) - R @ [0.0, 0.0, 500.0]
    first, second = seen(np.eye(3), np.zeros(3), 0.02), seen(R, t_mm, 0.02)
    with np.errstate(invalid="raise", over="raise"):
        found = register(surface_of(first, second, (HEIGHT_PX, WIDTH_PX)), second)
    assert found is not None
    assert np.degrees(np.arccos(0.5 * (np.trace(found.rotation.T @ R) - 1.0))) < 0.02
    assert found.apply(second.points_mm) == pytest.approx(second.points_mm @ R.T + t_mm, abs=0.05)
    assert found.shared > 0.95


def test_too_few_points_are_not_laid_anywhere() -> None:
    first = seen(np.eye(3), np.zeros(3), 0.02)
    assert register(surface_of(first, first, (HEIGHT_PX, WIDTH_PX)), first.thinned(50)) is None
