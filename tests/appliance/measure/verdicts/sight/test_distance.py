"""What is too dark to be decoded, or too faint behind backscatter, has a distance all the same: it came as TOO DARK or WATER DIRTY, and was too far."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from appliance.measure.light.noise import TYPICAL_PAIR, CameraNoise
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.sight.judge import (
    COLUMNS,
    ROWS,
    _clear_everywhere,
    _likeness,
    _strongest,
    find_depths_mm,
)
from hw_sim.scene import Scene
from hw_sim.water.medium import Water
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

SILT = Water(attenuation_per_m=2.0, backscatter=0.4, blur_px_per_m=1.0)
CLEAR = Water()


@cache
def plane_at(
    depth_mm: float, exposure_s: float, water: Water = CLEAR, ambient: float = 0.01, width_px: int = 200
) -> RenderedScan:
    """A plane, slanting by 12°, with fringes of about 6 px in the image, or of 12 px in a strip of a larger one."""
    scene = Scene("plane", pose=(0.0, 0.0, depth_mm, 4.0, 12.0, 0.0), texture="slight", water=water, ambient=ambient)
    return render_scan(scene, "realistic", 10_600, width_px, 32, exposure_s, height_px=150)


def depths_mm(scan: RenderedScan) -> np.ndarray:
    rig = true_calibration(scan.renderer.truth).rig
    return find_depths_mm(scan.frames, scan.sequence, TYPICAL_PAIR, rig, WATER.index)


@pytest.mark.parametrize(
    ("depth_mm", "water", "exposure_s", "width_px"),
    [(760.0, SILT, 0.012, 200), (330.0, Water(), 0.0001, 200), (760.0, Water(), 0.0006, 800)],
    ids=["far in silt", "dark and near", "dark and far, large images"],
)
def test_what_is_too_faint_for_decoding_has_one(
    depth_mm: float, water: Water, exposure_s: float, width_px: int
) -> None:
    found = depths_mm(plane_at(depth_mm, exposure_s, water, width_px=width_px))
    assert abs(float(np.median(found)) / depth_mm - 1.0) < 0.07
    assert np.mean(abs(found / depth_mm - 1.0) < 0.1) > 0.7, "most windows agree, not one by luck"


def test_where_only_lit_water_is_seen_there_is_no_distance() -> None:
    """What is left in it of long fringes lies at 320 mm, and would be called too near."""
    scene = Scene("plane", pose=(0.0, 0.0, 20_000.0, 0.0, 0.0, 0.0), water=SILT)
    assert len(depths_mm(render_scan(scene, "realistic", 10_601, 200, 32, 0.012))) == 0


def test_what_one_camera_sees_clear_and_the_other_saturated_is_not_far_away() -> None:
    """The window's own place is saturated in the right picture, the likest of the others is a wrong fringe: a plane in silt at
    530 mm, exposed for too long, came as SCAN FAR, 1200 mm."""
    scan = plane_at(530.0, 0.045, SILT)
    saturated = [float(np.mean(scan.frames[side].max(axis=0) == 255)) for side in ("left", "right")]
    assert all(0.3 < share < 0.7 for share in saturated)
    assert len(depths_mm(scan)) == 0


def test_a_few_windows_are_no_distance() -> None:
    """What two or three windows agree on may be chance."""
    scan = plane_at(530.0, 0.0002)
    left = scan.frames["left"].copy()
    left[:, 25:], left[:, :, 28:] = 2, 2
    assert len(depths_mm(replace(scan, frames={"left": left, "right": scan.frames["right"]}))) == 0


# ------------------------------------------------------------------------------------------------- by values

SEQUENCE = build_sequence(8, 32, 32)
SINE = SEQUENCE.axis(Direction.X).sine


@pytest.mark.parametrize(
    ("factor", "fringe_dn", "read_dn", "light_dn", "brightest_dn", "found"),
    [
        # Each image varies by 0.05 · (100 − 20) = 4 for its photons, and by what reading makes: 6² − 4 · (1.6² + 4) = 9.8.
        (1, 6, 1.6, 0, 0, True),
        (1, 6, 2.19, 0, 0, True),  # 0.8² are enough
        (1, 6, 2.21, 0, 0, False),
        (2, 3, 2.20, 0, 0, False),
        (2, 3, 2.00, 0, 0, True),
        (1, 6, 1.6, 31, 0, True),  # a tenth of the light: 3.1² = 9.6
        (1, 6, 1.6, 32, 0, False),
        (1, 6, 1.6, 0, 249, True),
        (1, 6, 1.6, 0, 250, False),
    ],
)
def test_windows_have_fringes_beyond_noise_and_are_nowhere_saturated(
    factor: int, fringe_dn: int, read_dn: float, light_dn: int, brightest_dn: int, found: bool
) -> None:
    shape = 2 * ROWS + 1, 2 * COLUMNS + 1
    frames = np.full((len(SEQUENCE), factor * shape[0] + factor - 1, factor * shape[1]), 100, np.uint8)
    window = np.s_[ROWS * factor : 2 * ROWS * factor, COLUMNS * factor : 2 * COLUMNS * factor]
    frames[SEQUENCE.dark] -= np.uint8(light_dn)
    frames[SINE[1]][window] -= np.uint8(fringe_dn // 2)
    frames[SINE[3]][window] += np.uint8(fringe_dn - fringe_dn // 2)
    frames[SINE[1], ROWS * factor, COLUMNS * factor] = max(brightest_dn, 100)
    frames[SINE[3], ROWS * factor, COLUMNS * factor] = max(brightest_dn, 100)
    changes = np.zeros((2, *shape), np.float32)
    changes[1, ROWS : 2 * ROWS, COLUMNS : 2 * COLUMNS] = fringe_dn
    v, u = _strongest(frames, SEQUENCE, factor, changes, CameraNoise(read_dn, 0.05, 20.0))
    assert (v.tolist(), u.tolist()) == (([ROWS], [COLUMNS]) if found else ([], []))


@pytest.mark.parametrize(
    ("column", "row", "inside"),
    [(0, 0, True), (6, 3, True), (6.4, 3.4, True), (7, 3, False), (6, 4, False), (-1, 0, False), (0, -1, False), (np.nan, np.nan, False)],
)  # fmt: skip
def test_a_window_is_compared_where_the_whole_of_it_is_in_the_picture(column: float, row: float, inside: bool) -> None:
    rng = np.random.default_rng(4)
    right = rng.normal(size=(4, ROWS + 3, COLUMNS + 6)).astype(np.float32)
    v, u = (round(row), round(column)) if inside else (0, 0)
    left = right.copy()
    left[2:] += 7.0  # what Gray images have all over a window is the water's
    at = np.array([[column, row]])
    assert _likeness(left, right, (v, u), at)[0] == pytest.approx(float(inside), abs=1e-5)
    assert abs(_likeness(left, right, (2, 1), np.array([[4.0, 0.0]]))[0]) < 0.5
    for corner in ((v, u), (v + ROWS - 1, u + COLUMNS - 1)):
        bright = np.full(right.shape[1:], 249.0, np.float32)
        bright[corner] = 250.0
        assert _clear_everywhere(bright, at[None]).tolist() == [not inside]
