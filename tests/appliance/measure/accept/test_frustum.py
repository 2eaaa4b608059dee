"""The frustum of a pyramid out of made-up points whose edges are known exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.accept.frustum import Frustum, find_frustum
from appliance.measure.accept.points import NotFound
from appliance.measure.accept.result import Artefact, evaluate
from tests.appliance.measure.accept.made_points import Array, Points

Kept = Callable[[Array, Array], NDArray[np.bool_]]
TOP_MM, BASE_MM, HEIGHT_MM, PLATE_MM = 40.0, 80.0, 30.0, 150.0
"""Edges of top and base, height, edge of the plate: the sides rise 30 mm over 20 mm, at 56 degrees."""
SLANTED_MM = float(np.sqrt(2 * 20.0**2 + 30.0**2))
TILT = np.radians([8.0, -6.0, 20.0])


def turned() -> Array:
    """A rotation about all three axes."""
    (a, b, c), R = TILT, np.eye(3)
    for angle, (i, j) in ((a, (1, 2)), (b, (0, 2)), (c, (0, 1))):
        step = np.eye(3)
        step[i, i] = step[j, j] = np.cos(angle)
        step[i, j], step[j, i] = -np.sin(angle), np.sin(angle)
        R = step @ R
    return R


def height_mm(x: Array, y: Array) -> Array:
    """Height over the plate."""
    out = np.maximum(np.abs(x), np.abs(y))
    return np.asarray(np.clip((BASE_MM / 2 - out) * HEIGHT_MM / ((BASE_MM - TOP_MM) / 2), 0.0, HEIGHT_MM))


def cloud(noise_mm: float = 0.0, keep: Kept | None = None) -> Points:
    """A frustum 520 mm away, its top towards the instrument; noise is along the surface's own axis."""
    side = np.arange(-PLATE_MM / 2, PLATE_MM / 2, 0.8)
    x, y = (one.ravel() for one in np.meshgrid(side, side))
    z = -height_mm(x, y) + noise_mm * np.random.default_rng(3).standard_normal(x.size)
    points = np.column_stack([x, y, z]) @ turned().T + [12.0, -7.0, 520.0]
    return Points.of(points[np.ones(x.size, bool) if keep is None else keep(x, y)])


def found(source: Points) -> Frustum:
    frustum = find_frustum(source)
    assert isinstance(frustum, Frustum), frustum
    return frustum


def test_edges_and_height_are_those_of_the_body_and_corners_are_where_they_are_in_one_turn_around_the_top() -> None:
    frustum = found(cloud())
    for name, length_mm in (("top", TOP_MM), ("base", BASE_MM), ("slanted", SLANTED_MM), ("height", HEIGHT_MM)):
        lengths_mm = frustum.lengths_mm[name]
        assert lengths_mm == pytest.approx([length_mm] * (1 if name == "height" else 4), abs=0.01)
    for corners, half, z in (
        (frustum.top_corners_mm, TOP_MM / 2, -HEIGHT_MM),
        (frustum.base_corners_mm, BASE_MM / 2, 0.0),
    ):
        local = (corners - [12.0, -7.0, 520.0]) @ turned()
        np.testing.assert_allclose(np.abs(local[:, :2]), half, atol=0.01)
        np.testing.assert_allclose(local[:, 2], z, atol=0.01)
        angles = np.unwrap(np.arctan2(local[:, 1], local[:, 0]))
        np.testing.assert_allclose(np.abs(np.diff(angles)), np.pi / 2, atol=1e-3)
    # Corner k lies on sides k and k + 1, and on top or plate.
    for k in range(4):
        for side in (frustum.sides[k], frustum.sides[(k + 1) % 4]):
            corners = np.stack([frustum.top_corners_mm[k], frustum.base_corners_mm[k]])
            np.testing.assert_allclose(side.plane.distance_mm(corners), 0.0, atol=1e-6)


def test_what_is_missing_is_named_with_what_to_do() -> None:
    rows: tuple[tuple[Kept, str], ...] = (
        (lambda x, y: x < -200.0, "the cloud has only 0 points; bring the frustum into the light"),
        (lambda x, y: (x < -60.0) & (y < 0.0), "top and plate of the frustum were not both found"),
        (lambda x, y: (x < 18.0) | (x > 42.0), "only 3 of the frustum's four sides were found"),
        (lambda x, y: np.maximum(np.abs(x), np.abs(y)) > 25.0, "top and plate of the frustum were not both found"),
    )
    for keep, words in rows:
        said = find_frustum(cloud(keep=keep))
        assert isinstance(said, NotFound)
        assert words in said.reason
    whole = cloud()
    for n, looked_at in ((999, False), (1000, True)):
        said = find_frustum(Points(whole.points_mm[:n], whole.sigma_mm[:n], whole.pixel[:n]))
        assert isinstance(said, NotFound)
        assert ("the cloud has only" not in said.reason) is looked_at


def test_each_measured_edge_stands_beside_the_calibrated_length_of_its_kind() -> None:
    result = evaluate(cloud(), Artefact.FRUSTUM, {"top": 40.0, "height": 30.3})
    assert [one.name for one in result.lengths] == ["top 1", "top 2", "top 3", "top 4", "height"]
    assert [one.calibrated_mm for one in result.lengths] == [40.0] * 4 + [30.3]
    assert result.worst_e_l == pytest.approx(0.3 / 30.3, rel=0.02)
    assert list(result.surfaces) == ["top", "plate", "side 1", "side 2", "side 3", "side 4"]
