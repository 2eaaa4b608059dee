"""The short cuts of tracing change nothing: blocks of rays and the shadow map give what every ray alone gives, in motion
as at rest."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.objects.motion import Motion, object_pose
from hw_sim.objects.shapes import NAMES, march_all
from hw_sim.optics.geometry import LIT, P, Q
from hw_sim.rendering.stage import Stage
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, project, ray

POSES = {
    "plane": (0.0, 0.0, 522.5, 40.0, 30.0, 0.0),
    "ballbar": (0.0, 0.0, 522.5, 30.0, 65.0, 15.0),
    "frustum": (0.0, 0.0, 545.0, 35.0, -40.0, 12.0),
    "pipe": (0.0, 0.0, 560.0, 20.0, 40.0, 20.0),
    "shell": (0.0, 0.0, 545.0, 45.0, 30.0, 10.0),
    "stones": (0.0, 0.0, 535.0, 50.0, -30.0, 80.0),
    "board": (0.0, 0.0, 560.0, 35.0, 30.0, 20.0),
    "main": (-90.0, 0.0, 590.0, 25.0, 35.0, 15.0),
}
"""Tilted so that there is much shadow."""
SWIM = Motion(velocity_mm_s=(40.0, -25.0, 60.0), tremor_mm=(0.5, 0.5, 0.2), rotation_deg_s=(20.0, -15.0, 30.0))
"""Faster than any scan survives: shadows and silhouettes are elsewhere at the next moment."""


def marched(origin: np.ndarray, direction: np.ndarray, scene: Scene, truth: TrueRig, time_s: float) -> np.ndarray:
    """Every ray on its own, from its window on."""
    R, t = object_pose(POSES[scene.object], scene.motion, time_s)
    far = np.empty(len(origin))
    rays = np.ascontiguousarray(np.hstack([(origin - t) @ R, direction @ R]))
    march_all(NAMES[scene.object], truth.artefacts.sizes(), rays, far)
    return far


@pytest.mark.parametrize("name", list(NAMES))
def test_every_pixel_sees_and_is_lit_as_its_own_rays_say(name: str) -> None:
    scene = Scene(object=name, pose=POSES[name], motion=SWIM)
    truth = draw_truth("realistic", 7, 200, 150, scene.water.index)
    stage = Stage(truth)
    v, u = np.mgrid[0:150, 0:200]
    in_shadow = 0
    for camera, time_s in (("right", 0.11), ("left", 0.4)):
        geometry = stage.geometry(camera, scene, stage.pose(scene, time_s))
        origin, direction = ray(truth, camera, np.stack([u, v], -1).reshape(-1, 2))
        alone = marched(origin, direction, scene, truth, time_s)
        together = geometry.distance_mm.ravel()
        np.testing.assert_array_equal(np.isnan(together), np.isnan(alone))
        hit = np.isfinite(alone)
        assert hit.sum() > 500
        gap = np.abs(together[hit] - alone[hit])
        assert np.quantile(gap, 0.999) < 1e-7, "grazing rays aside"
        assert gap.max() < 0.05

        points = origin[hit] + alone[hit, None] * direction[hit]
        pixels = project(truth, "projector", points)
        inside = ((pixels > -1.0) & (pixels < [1024.0, 768.0])).all(axis=1)
        window, beam = ray(truth, "projector", np.nan_to_num(pixels))
        reach = marched(window, beam, scene, truth, time_s)
        length = np.linalg.norm(points - window, axis=1)
        meets = np.abs(reach - length) < 0.02
        hidden = reach < length - 0.5
        lit = geometry.pixels[..., LIT].ravel()[hit] > 0.0
        in_shadow += int(hidden[inside].sum())
        assert (lit & hidden & inside).sum() <= 5e-4 * hit.sum() + 1, "no light in the shade, but where it grazes"
        assert (~lit & meets & inside).sum() <= 0.004 * hit.sum() + 2, "and no shade in the light"
        found = geometry.pixels.reshape(-1, 5)[hit][lit][:, [P, Q]]
        assert np.abs(found - pixels[lit]).max() < 1e-4, "float32 and table together"
    assert in_shadow > 20 or name in ("plane", "board"), "or nothing was shown"
