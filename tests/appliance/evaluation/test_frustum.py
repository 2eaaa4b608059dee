"""The frustum of a pyramid out of made-up points whose edges are known exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.evaluation.frustum import Frustum, _patches, find_frustum
from appliance.evaluation.points import NotFound
from appliance.evaluation.result import Artefact, evaluate

Array = NDArray[np.float64]
Kept = Callable[[Array, Array], NDArray[np.bool_]]
TOP_MM, BASE_MM, HEIGHT_MM, PLATE_MM = 40.0, 80.0, 30.0, 150.0
"""Edges of top and base, height, edge of the plate: the sides rise 30 mm over 20 mm, at 56 degrees."""
SLANTED_MM = float(np.sqrt(2 * 20.0**2 + 30.0**2))
TILT = np.radians([8.0, -6.0, 20.0])


@dataclass(frozen=True)
class Points:
    points_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    pixel: NDArray[np.uint32]


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


def cloud(noise_mm: float = 0.0, keep: Kept | None = None, outliers: int = 0, step_mm: float = 0.8) -> Points:
    """A frustum 520 mm away, its top towards the instrument; noise is along the surface's own axis."""
    side = np.arange(-PLATE_MM / 2, PLATE_MM / 2, step_mm)
    x, y = (one.ravel() for one in np.meshgrid(side, side))
    rng = np.random.default_rng(3)
    z = -height_mm(x, y) + noise_mm * rng.standard_normal(x.size)
    if outliers:
        top = np.flatnonzero(np.maximum(np.abs(x), np.abs(y)) < TOP_MM / 2 - 6.0)
        z[top[:outliers]] += 1.2
    points = np.column_stack([x, y, z]) @ turned().T + [12.0, -7.0, 520.0]
    here = np.ones(x.size, bool) if keep is None else keep(x, y)
    n = np.arange(x.size)[here]
    return Points(points[here].astype(np.float32), np.full(n.size, 0.03, np.float32), n.astype(np.uint32) + 5)


def found(source: Points) -> Frustum:
    frustum = find_frustum(source)
    assert isinstance(frustum, Frustum), frustum
    return frustum


def test_every_edge_and_the_height_are_those_of_the_body() -> None:
    lengths = found(cloud()).lengths_mm
    assert lengths["top"] == pytest.approx([TOP_MM] * 4, abs=0.01)
    assert lengths["base"] == pytest.approx([BASE_MM] * 4, abs=0.01)
    assert lengths["slanted"] == pytest.approx([SLANTED_MM] * 4, abs=0.01)
    assert lengths["height"] == pytest.approx([HEIGHT_MM], abs=0.005)


def test_every_patch_has_a_unit_normal_away_from_the_instrument_and_none_is_flat_over_an_edge() -> None:
    points = cloud(step_mm=1.6).points_mm.astype(np.float64)
    normals, flat = _patches(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    assert (np.sum(normals * points, axis=1) > 0.0).all()
    local, out = normals @ turned(), (points - [12.0, -7.0, 520.0]) @ turned()
    edge = np.maximum(np.abs(out[:, 0]), np.abs(out[:, 1]))
    for half in (TOP_MM / 2, BASE_MM / 2):
        assert not flat[np.abs(edge - half) < 1.0].any()
    top, plate = edge < TOP_MM / 2 - 5.5, (edge > BASE_MM / 2 + 5.5) & (edge < PLATE_MM / 2 - 6.0)
    assert flat[top | plate].all()
    np.testing.assert_allclose(local[top | plate], [[0.0, 0.0, 1.0]] * int((top | plate).sum()), atol=1e-3)


def test_corners_are_where_they_are_in_one_turn_around_the_top() -> None:
    frustum = found(cloud())
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


def test_each_face_rests_on_its_own_points_away_from_the_edges() -> None:
    source = cloud(0.02)
    frustum = found(source)
    taken: set[int] = set()
    for name, face in (
        ("top", frustum.top),
        ("plate", frustum.plate),
        *((f"side {k}", f) for k, f in enumerate(frustum.sides)),
    ):
        used = face.used
        np.testing.assert_array_equal(used.pixel, source.pixel[used.indices])
        local = (source.points_mm[used.indices].astype(np.float64) - [12.0, -7.0, 520.0]) @ turned()
        out = np.maximum(np.abs(local[:, 0]), np.abs(local[:, 1]))
        height = height_mm(local[:, 0], local[:, 1])
        assert np.abs(face.plane.distance_mm(source.points_mm[used.indices].astype(np.float64))).max() < 0.2, name
        if name == "top":
            # 3 mm from a face that falls away at 56 degrees are 3.6 mm along the top.
            assert TOP_MM / 2 - 5.0 < out.max() < TOP_MM / 2 - 3.4
        elif name == "plate":
            assert BASE_MM / 2 + 3.4 < out.min() < BASE_MM / 2 + 5.0
        else:
            assert 2.9 < height.min() < 4.5
            assert HEIGHT_MM - 4.5 < height.max() < HEIGHT_MM - 2.9
        assert used.rms_mm < 0.021
        assert used.rejected_count == int(0.003 * (used.count + used.rejected_count))
        mine = set(used.indices.tolist()) | set(used.rejected.tolist())
        assert not mine & taken
        taken |= mine
    assert len(taken) > 0.7 * len(source.pixel)


def test_noise_moves_no_corner_by_more_than_a_plane_of_many_points_allows() -> None:
    lengths = found(cloud(0.1)).lengths_mm
    assert lengths["top"] == pytest.approx([TOP_MM] * 4, abs=0.08)
    assert lengths["base"] == pytest.approx([BASE_MM] * 4, abs=0.08)
    assert lengths["height"] == pytest.approx([HEIGHT_MM], abs=0.02)


def test_of_outliers_no_more_are_removed_than_the_guideline_allows() -> None:
    """The top has about 1700 points of its own: five may go, of forty."""
    used = found(cloud(outliers=40)).top.used
    assert used.rejected_count == int(0.003 * (used.count + used.rejected_count)) > 2
    assert used.range_mm > 1.0, "the others are left in and show"


@pytest.mark.parametrize(
    ("keep", "words"),
    [
        (
            lambda x, y: x < -200.0,
            "the cloud has only 0 points; bring the frustum into the light, at the working distance",
        ),
        (lambda x, y: (x < -60.0) & (y < 0.0), "top and plate of the frustum were not both found"),
        (lambda x, y: (x < 18.0) | (x > 42.0), "only 3 of the frustum's four sides were found"),
        (lambda x, y: np.maximum(np.abs(x), np.abs(y)) > 25.0, "top and plate of the frustum were not both found"),
    ],
)
def test_what_is_missing_is_named_with_what_to_do(keep: Kept, words: str) -> None:
    said = find_frustum(cloud(keep=keep))
    assert isinstance(said, NotFound)
    assert words in said.reason


def test_the_least_cloud_that_is_looked_at_has_a_thousand_points() -> None:
    whole = cloud()
    for n, looked_at in ((999, False), (1000, True)):
        few = Points(whole.points_mm[:n], whole.sigma_mm[:n], whole.pixel[:n])
        said = find_frustum(few)
        assert isinstance(said, NotFound)
        assert ("the cloud has only" not in said.reason) is looked_at
    broken = Points(whole.points_mm.copy(), whole.sigma_mm, whole.pixel)
    broken.points_mm[::7, 2] = np.nan
    used = found(broken).plate.used
    assert not (used.indices % 7 == 0).any()
    np.testing.assert_array_equal(used.pixel, broken.pixel[used.indices])


def test_each_measured_edge_stands_beside_the_calibrated_length_of_its_kind() -> None:
    result = evaluate(cloud(), Artefact.FRUSTUM, {"top": 40.0, "height": 30.3})
    assert [one.name for one in result.lengths] == ["top 1", "top 2", "top 3", "top 4", "height"]
    assert [one.calibrated_mm for one in result.lengths] == [40.0] * 4 + [30.3]
    assert result.worst_e_l == pytest.approx(0.3 / 30.3, rel=0.02)
    assert list(result.surfaces) == ["top", "plate", "side 1", "side 2", "side 3", "side 4"]
