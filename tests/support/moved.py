"""What truly moved in a rendered scan, and clouds judged against the surface at their own time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.noise import TYPICAL_PAIR, StereoNoise
from appliance.measure.light.sides import SIDES
from appliance.measure.motion.prior import LEVER_MM
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.scan_images import ScanImages
from hw_sim.objects.motion import object_pose
from tests.support.rendered import Accuracy, RenderedScan, judge
from tests.support.truth import left_to_rig

FRAME_S = 1.0 / 60.0


def recorded(scan: RenderedScan, pipeline: Pipeline, noise: StereoNoise = TYPICAL_PAIR) -> ScanImages:
    """A scan as judges are given it."""
    decoded = {side: pipeline.decoded(side) for side in SIDES}
    return ScanImages(scan.sequence, scan.frames, decoded, AcquisitionSettings(noise=noise))


def true_motion_mm(
    scan: RenderedScan, times_s: NDArray[np.float64], reference_s: float, centre_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, 6): shift of ``centre_mm`` and turn at the lever, from the reference time on; left camera frame."""
    scene, left = scan.renderer.scene, scan.renderer.truth.left
    R0, t0 = object_pose(scene.start_pose, scene.motion, reference_s)
    centre = left_to_rig(scan.renderer.truth, centre_mm[None])[0]
    found = []
    for time_s in times_s:
        R, t = object_pose(scene.start_pose, scene.motion, float(time_s))
        turn = R @ R0.T
        vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        shift = turn @ (centre - t0) + t - centre
        found.append(np.concatenate([np.array(left.R).T @ shift, np.array(left.R).T @ vector * LEVER_MM]))
    return np.asarray(found)


def judge_at(scan: RenderedScan, cloud: Cloud, time_s: float) -> Accuracy:
    """A cloud against the true surface at ``time_s``."""
    return judge(scan, cloud, time_s)
