"""What is saturated has a distance all the same: an object that was too near came as TOO BRIGHT, and a shorter exposure of it
would have shown that it has no points either."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.reconstruct.quality import CloudSummary, QualityLimits
from appliance.reconstruct.table import Found, PointTable
from appliance.scan.noise import TYPICAL_PAIR
from appliance.verdict.sight.distance import find_depths_mm
from appliance.verdict.sight.judge import look
from appliance.verdict.sight.stripes import find_depths_by_stripes_mm
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from hw_sim.water.medium import Water
from tests.support.rendered import FRAME_S, RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

STILL = Motion()
CLEAR = Water()
SILT = Water(attenuation_per_m=2.0, backscatter=0.4, blur_px_per_m=1.0)


@cache
def plane_at(
    depth_mm: float, exposure_s: float, motion: Motion = STILL, water: Water = CLEAR, ambient: float = 0.01, width_px: int = 200
) -> RenderedScan:  # fmt: skip
    """A plane, slanting by 12°, that saturates nearly all pixels."""
    pose = (0.0, 0.0, depth_mm, 4.0, 12.0, 0.0)
    scene = Scene("plane", pose=pose, texture="slight", water=water, motion=motion, ambient=ambient)
    frame_s = 0.0 if motion.still else FRAME_S
    return render_scan(scene, "realistic", 10_600, width_px, 32, exposure_s, frame_s=frame_s, height_px=150)


def depths_mm(scan: RenderedScan) -> np.ndarray:
    rig = true_calibration(scan.renderer.truth).rig
    return find_depths_by_stripes_mm(scan.frames, scan.sequence, rig, WATER.index)


@pytest.mark.parametrize(
    ("depth_mm", "exposure_s", "motion", "width_px"),
    [
        (330.0, 0.012, STILL, 200),
        (330.0, 0.064, STILL, 200),
        (330.0, 0.012, Motion(velocity_mm_s=(-12.0, 12.0, -12.0)), 200),
        (760.0, 0.120, STILL, 200),
        (330.0, 0.012, STILL, 800),
    ],
    ids=["near", "near and exposed for too long", "near and moving", "far", "near, large images"],
)
def test_what_is_saturated_has_a_distance(depth_mm: float, exposure_s: float, motion: Motion, width_px: int) -> None:
    scan = plane_at(depth_mm, exposure_s, motion, width_px=width_px)
    bright = scan.frames["left"][scan.sequence.bright]
    assert np.mean(bright[bright > 60] == 255) > 0.8
    found = depths_mm(scan)
    assert abs(float(np.median(found)) / depth_mm - 1.0) < 0.07
    assert np.mean(abs(found / depth_mm - 1.0) < 0.1) > 0.8, "most pixels agree, not one by luck"


@pytest.mark.parametrize("what", ["a flood light", "silt"])
def test_where_black_stripes_are_not_black_there_is_no_distance(what: str) -> None:
    """Other light than the projector's saturates the pixels as well, or scattered light fills the black stripes."""
    scan = plane_at(530.0, 0.012, ambient=6.0) if what == "a flood light" else plane_at(530.0, 0.064, water=SILT)
    assert np.mean(scan.frames["left"][scan.sequence.bright] == 255) > 0.5
    assert len(depths_mm(scan)) == 0


def near_with(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    scan = plane_at(330.0, 0.012)
    rig = true_calibration(scan.renderer.truth).rig
    return find_depths_by_stripes_mm({"left": left, "right": right}, scan.sequence, rig, WATER.index)


def test_what_is_not_saturated_is_not_asked_for_its_stripes() -> None:
    frames = plane_at(330.0, 0.012).frames
    assert len(near_with(np.minimum(frames["left"], 254), frames["right"])) == 0


def test_numbers_that_meet_anywhere_are_no_distance() -> None:
    """The right image is mirrored: each number of the left one is somewhere on its line, by chance."""
    frames = plane_at(330.0, 0.012).frames
    assert len(near_with(frames["left"], frames["right"])) > 200
    assert len(near_with(frames["left"], frames["right"][:, :, ::-1])) == 0


def test_a_few_pixels_are_no_distance() -> None:
    frames = plane_at(330.0, 0.012).frames
    covered = frames["left"].copy()
    covered[:, 1:] = 2
    assert len(near_with(covered, frames["right"])) > 40, "a row says it"
    covered[:, :, 40:] = 2
    assert len(near_with(covered, frames["right"])) == 0
    assert len(near_with(frames["left"], np.where(np.arange(200) < 150, 2, frames["right"]).astype(np.uint8))) == 0


def test_a_saturated_plane_that_is_too_near_is_said_to_be_near() -> None:
    """Without a point, and without a window whose fringes are clear."""
    scan = plane_at(330.0, 0.064)
    rig = true_calibration(scan.renderer.truth).rig
    assert len(find_depths_mm(scan.frames, scan.sequence, TYPICAL_PAIR, rig, WATER.index)) == 0
    nothing = PointTable(1).cloud(Found(((0, 0),), CloudSummary(0, 0.0, None, None, None)))
    seen = look(scan.frames, scan.sequence, TYPICAL_PAIR, rig, WATER.index, nothing, QualityLimits())
    assert seen.numbers["near_percent"] == pytest.approx(100.0, abs=5.0)
    assert seen.numbers["distance_mm"] == pytest.approx(330.0, rel=0.07)
