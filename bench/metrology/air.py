"""Owns what is known of a hidden rig before it was in the water: its calibration in air, and the drawing of its ports.

Boards are seen point by point: exact optics, and the noise of finding corners.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from appliance.calibration.air import AirCalibration, BoardView, calibrate_air
from appliance.calibration.design import design_calibration
from appliance.calibration.file import Calibration
from appliance.calibration.start import start_from_air
from hw_sim.optics.points import project
from hw_sim.truth import TrueRig, in_air
from tests.support.calibrating import CORNER_NOISE_PX, DESIGN, WIDTH_PX, Pose, inside
from tests.support.truth import WATER

BOARDS_IN_AIR, BOARDS_IN_WATER = 20, 15


def air_of(truth: TrueRig) -> AirCalibration:
    """From twenty boards, on the day before the housing was closed."""
    views = _boards(in_air(truth), BOARDS_IN_AIR, (470.0, 640.0), 1)
    return calibrate_air(views, truth.left.width_px, truth.left.height_px)


def start_of(air: AirCalibration) -> Calibration:
    """Lenses and pose from air, ports from the drawing."""
    width_px, height_px = air.rig.left.width_px, air.rig.left.height_px
    drawing = replace(DESIGN, pixel_um=DESIGN.pixel_um * WIDTH_PX / width_px)
    return start_from_air(air, design_calibration(drawing, "KF-SIM", width_px, height_px, WATER))


def boards_in_water(truth: TrueRig) -> list[BoardView]:
    """Fifteen boards in the measuring volume."""
    return _boards(truth, BOARDS_IN_WATER, (470.0, 580.0), 2)


def _boards(truth: TrueRig, count: int, distance_mm: tuple[float, float], seed: int) -> list[BoardView]:
    """A board of 14 × 11 corners, 18 mm apart."""
    rng = np.random.default_rng([seed, truth.seed])
    x, y = np.meshgrid((np.arange(14) - 6.5) * 18.0, (np.arange(11) - 5.0) * 18.0)
    corners = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    views = []
    for k in range(count):
        pose = Pose(
            (float(rng.uniform(-40, 40)), float(rng.uniform(-30, 30)), float(rng.uniform(*distance_mm))),
            (float(rng.uniform(-30, 30)), float(rng.uniform(-30, 30)), float(rng.uniform(-180, 180))),
        )
        points = corners @ pose.rotation.T + pose.at_mm
        seen = {side: project(truth, side, points) for side in ("left", "right")}
        keep = inside(seen["left"], truth.left.width_px) & inside(seen["right"], truth.right.width_px)
        noisy = {side: uv[keep] + rng.normal(0, CORNER_NOISE_PX, (keep.sum(), 2)) for side, uv in seen.items()}
        views.append(BoardView(f"board {k}", corners[keep], noisy["left"], noisy["right"]))
    return views
