"""How a surface stands to the rays follows from its points, where they have neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import Cloud
from appliance.verdict.motion_surface import facing, surface_map

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
    found = surface_map(tilted(60.0), coordinate, coordinate, (2, 2))
    known = np.isfinite(found.noise_mm)
    assert known.any()
    assert found.noise_mm[known] == pytest.approx(0.04 * 0.5, rel=0.15)


def test_without_points_nothing_is_said() -> None:
    empty = tilted(0.0, missing=10_000)
    found = surface_map(empty, np.zeros((90, WIDTH_PX), np.float32), np.zeros((90, WIDTH_PX), np.float32), (2, 2))
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
        cosine, inside = facing(line, WIDTH_PX)
        assert (len(cosine), len(inside)) == (0, 0)
