"""A cloud laid on the grid of its image."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.organised import organised
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.table import Cloud


def _cloud(pixel: list[int]) -> Cloud:
    n = len(pixel)
    column = np.arange(n, dtype=np.float32)
    return Cloud(
        points_mm=np.stack([column, column + 100, column + 500], axis=1),
        intensity=np.zeros(n, np.uint8),
        modulation_dn=column + 10,
        ray_gap_mm=column / np.float32(100),
        sigma_mm=column / np.float32(50) + np.float32(0.01),
        pixel=np.array(pixel, np.uint32),
        summary=CloudSummary(n, None, None, None, None),
    )


def test_each_point_lies_at_its_pixel_and_nothing_lies_elsewhere() -> None:
    bright = np.arange(12, dtype=np.uint8).reshape(3, 4)
    view = organised(_cloud([1, 6, 11]), bright)
    assert view.shape == (3, 4)
    assert np.flatnonzero(view.mask).tolist() == [1, 6, 11]
    assert view.points_mm[1, 2].tolist() == [1.0, 101.0, 501.0]
    assert view.sigma_mm[2, 3] == pytest.approx(0.05)
    assert view.modulation_dn[0, 1] == 10.0
    assert view.ray_gap_mm[2, 3] == pytest.approx(0.02)
    assert np.isnan(view.points_mm[0, 0]).all()
    assert np.isnan(view.sigma_mm[0, 0])
    assert view.grey[0, 3] == 3, "the image goes on where there are no points"


def test_a_cloud_of_a_larger_image_is_refused() -> None:
    with pytest.raises(ValueError, match="pixel 12; the image has 12"):
        organised(_cloud([12]), np.zeros((3, 4), np.uint8))
