"""What is too dark to be decoded, or too faint behind backscatter, has a distance all the same: it came as TOO DARK or WATER DIRTY, and was too far."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.quality import CloudSummary, QualityLimits
from appliance.reconstruct.table import Found, PointTable
from appliance.scan.noise import TYPICAL_PAIR
from appliance.verdict.sight.distance import find_depths_mm
from appliance.verdict.sight.judge import look
from hw_sim.scene import Scene
from hw_sim.water.medium import Water
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

SILT = Water(attenuation_per_m=2.0, backscatter=0.4, blur_px_per_m=1.0)


def plane_at(depth_mm: float, water: Water, exposure_s: float, width_px: int = 200) -> RenderedScan:
    """A plane, slanting by 12°, with fringes of about 6 px in the image, or of 12 px in a strip of a larger one."""
    scene = Scene("plane", pose=(0.0, 0.0, depth_mm, 4.0, 12.0, 0.0), texture="slight", water=water)
    return render_scan(scene, "realistic", 10_600, width_px, 32, exposure_s, height_px=150)


def depths_mm(scan: RenderedScan) -> np.ndarray:
    rig = true_calibration(scan.renderer.truth).rig
    return find_depths_mm(scan.frames, scan.sequence, TYPICAL_PAIR, rig, WATER.index)


@pytest.mark.parametrize(
    ("depth_mm", "water", "exposure_s", "width_px"),
    [(530.0, Water(), 0.0002, 200), (760.0, Water(), 0.0006, 200), (760.0, SILT, 0.012, 200), (330.0, Water(), 0.0001, 200), (760.0, Water(), 0.0006, 800)],
    ids=["dark", "dark and far", "far in silt", "dark and near", "dark and far, large images"],
)  # fmt: skip
def test_what_is_too_faint_to_be_decoded_has_a_distance(
    depth_mm: float, water: Water, exposure_s: float, width_px: int
) -> None:
    found = depths_mm(plane_at(depth_mm, water, exposure_s, width_px))
    assert abs(float(np.median(found)) / depth_mm - 1.0) < 0.07
    assert np.mean(abs(found / depth_mm - 1.0) < 0.1) > 0.7, "most windows agree, not one by luck"


@pytest.mark.parametrize("what", ["noise", "water"])
def test_where_nothing_is_seen_there_is_no_distance(what: str) -> None:
    """Neither noise nor the illuminated water has one: what is left in it of long fringes lies at 320 mm, and would be called too near."""
    scene = Scene("plane", pose=(0.0, 0.0, 20_000.0, 0.0, 0.0, 0.0), water=SILT if what == "water" else Water())
    scan = render_scan(scene, "realistic", 10_601, 200, 32, 0.012 if what == "water" else 0.000_01)
    assert len(depths_mm(scan)) == 0


def test_what_one_camera_sees_clear_and_the_other_saturated_is_not_far_away() -> None:
    """The window's own place is saturated in the right picture, the likest of the others is a wrong fringe: a plane in silt at
    530 mm, exposed for too long, came as SCAN FAR, 1200 mm."""
    scan = plane_at(530.0, SILT, 0.045)
    saturated = [float(np.mean(scan.frames[side].max(axis=0) == 255)) for side in ("left", "right")]
    assert all(0.3 < share < 0.7 for share in saturated)
    assert len(depths_mm(scan)) == 0


def test_a_few_windows_are_no_distance() -> None:
    """What two or three windows agree on may be chance."""
    scan = plane_at(530.0, Water(), 0.0002)
    rig = true_calibration(scan.renderer.truth).rig
    covered = {side: frames.copy() for side, frames in scan.frames.items()}
    covered["left"][:, 25:] = 2
    covered["left"][:, :, 28:] = 2
    assert len(find_depths_mm(covered, scan.sequence, TYPICAL_PAIR, rig, WATER.index)) == 0


def test_a_far_plane_in_silt_without_a_point_is_said_to_be_far() -> None:
    scan = plane_at(760.0, SILT, 0.012)
    rig = true_calibration(scan.renderer.truth).rig
    nothing = PointTable(1).cloud(Found(((0, 0),), CloudSummary(0, 0.0, None, None, None)))
    seen = look(scan.frames, scan.sequence, TYPICAL_PAIR, rig, WATER.index, nothing, QualityLimits())
    assert (seen.numbers["far_percent"] or 0.0) > 70.0
    assert seen.numbers["distance_mm"] == pytest.approx(760.0, rel=0.07)
