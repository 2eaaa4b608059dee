"""What points are off is told along their rays, and no more than the surface is away where the object slides along itself."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.cloud import CloudSummary
from appliance.measure.points.table import Cloud
from bench.outside.scan import errors_mm
from hw_sim.objects.motion import Motion
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, ray
from tests.support.truth import WATER, rig_to_left

TILT_DEG = 35.0
NOISE_MM = 0.05
AT_S = 0.1


def cloud_of(renderer: Renderer, slide_mm: float) -> Cloud:
    """Return every fourth true point, off by ``NOISE_MM`` to and fro along its ray, and then slid along the tilted plane."""
    view = renderer.view("left", AT_S)
    v, u = (index[::4] for index in np.nonzero(view.seen_by_all))
    _, direction = ray(renderer.truth, "left", np.stack([u, v], -1))
    sign = np.where((u + v) % 2, 1.0, -1.0)[:, None]
    angle = np.radians(TILT_DEG)
    down_mm = slide_mm * np.array([0.0, np.cos(angle), np.sin(angle)])
    points = rig_to_left(renderer.truth, view.points_rig_mm[v, u] + NOISE_MM * sign * direction + down_mm).astype(
        np.float32
    )
    n = len(points)
    ones = np.ones(n, np.float32)
    pixel = (v * renderer.truth.left.width_px + u).astype(np.uint32)
    return Cloud(points, np.zeros(n, np.uint8), ones, ones, ones, pixel, CloudSummary(n, None, None, None, None))


@pytest.mark.parametrize("speed_mm_s", [0.0, 5.0])
def test_points_are_off_by_what_they_are_off_along_their_rays(speed_mm_s: float) -> None:
    """A plane that slid along itself by a millimetre was counted as points that were off by half of one."""
    scene = Scene(
        object="plane", pose=(0.0, 0.0, 520.0, TILT_DEG, 0.0, 0.0), motion=Motion(velocity_mm_s=(0.0, 0.0, speed_mm_s))
    )
    renderer = Renderer(draw_truth("realistic", 10_001, 200, 150, WATER.index), scene)
    along, away = errors_mm(renderer, cloud_of(renderer, 1.0 if speed_mm_s else 0.0), AT_S)
    assert np.sqrt(np.mean(along**2)) == pytest.approx(NOISE_MM, rel=0.03)
    # Across the surface it is less by the cosine between both.
    assert np.sqrt(np.mean(away**2)) < 0.95 * NOISE_MM
