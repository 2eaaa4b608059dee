"""The short cuts of tracing change nothing: blocks of rays and the shadow map give what every ray alone gives."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.geometry import LIT, P, Pose, Q
from hw_sim.motion import pose_matrix
from hw_sim.objects.shapes import NAMES, march_all
from hw_sim.optics.points import project, ray
from hw_sim.scene import Scene
from hw_sim.stage import Stage
from hw_sim.truth import draw_truth

POSES = {
    "plane": (0.0, 0.0, 522.5, 40.0, 30.0, 0.0),
    "ballbar": (0.0, 0.0, 522.5, 30.0, 65.0, 15.0),
    "frustum": (0.0, 0.0, 545.0, 35.0, -40.0, 12.0),
    "pipe": (0.0, 0.0, 560.0, 20.0, 40.0, 20.0),
    "shell": (0.0, 0.0, 545.0, 45.0, 30.0, 10.0),
    "stones": (0.0, 0.0, 535.0, 50.0, -30.0, 80.0),
}
"""Tilted so that there is much shadow."""


@pytest.mark.parametrize("name", list(NAMES))
def test_every_pixel_sees_and_is_lit_as_its_own_rays_say(name: str) -> None:
    scene = Scene(object=name, pose=POSES[name])
    truth = draw_truth("realistic", 7, 200, 150, scene.water.index)
    R, t = pose_matrix(POSES[name])
    pose = Pose(NAMES[name], truth.artefacts.sizes(), R, t)
    geometry = Stage(truth).geometry("left", scene, pose)

    v, u = np.mgrid[0:150, 0:200]
    origin, direction = ray(truth, "left", np.stack([u, v], -1).reshape(-1, 2))
    alone = np.empty(len(origin))
    march_all(pose.kind, pose.sizes, np.ascontiguousarray(np.hstack([(origin - t) @ R, direction @ R])), alone)
    together = geometry.distance_mm.ravel()
    np.testing.assert_array_equal(np.isnan(together), np.isnan(alone))
    hit = np.isfinite(alone)
    assert hit.sum() > 500
    gap = np.abs(together[hit] - alone[hit])
    assert np.quantile(gap, 0.999) < 1e-5, "grazing rays aside"
    assert gap.max() < 0.05

    points = origin[hit] + alone[hit, None] * direction[hit]
    pixels = project(truth, "projector", points)
    inside = ((pixels > -1.0) & (pixels < [1024.0, 768.0])).all(axis=1)
    window, beam = ray(truth, "projector", np.nan_to_num(pixels))
    reach = np.empty(len(points))
    march_all(pose.kind, pose.sizes, np.ascontiguousarray(np.hstack([(window - t) @ R, beam @ R])), reach)
    length = np.linalg.norm(points - window, axis=1)
    meets = np.abs(reach - length) < 0.02
    hidden = reach < length - 0.5
    lit = geometry.pixels[..., LIT].ravel()[hit] > 0.0
    assert hidden[inside].sum() > 30 or name == "plane"
    assert (lit & hidden & inside).sum() <= 5e-4 * hit.sum() + 1, "no light in the shade, but where it grazes"
    dark_though_met = (~lit & meets & inside).sum()
    assert dark_though_met <= 0.004 * hit.sum() + 2, "and no shade in the light"
    found = geometry.pixels.reshape(-1, 5)[hit][lit][:, [P, Q]]
    assert np.abs(found - pixels[lit]).max() < 2e-4, "float32 and table together"
