"""Air calibration and nominal ports of a hidden rig, as known before any scan.

Boards are found in pictures by the simulated cameras, as by ``kingfisher calibration air``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from appliance.calibrate.air.board import find_board
from appliance.calibrate.air.calibrate import AirCalibration, calibrate_air
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.water.start import start_from_air
from appliance.measure.calibration.design import design_calibration
from appliance.measure.calibration.file import Calibration
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, in_air
from hw_sim.water.medium import AIR, Water
from tests.support.board_pictures import BOARD, Pose, picture, poses_in_air, poses_in_water
from tests.support.calibrating import DESIGN, WIDTH_PX
from tests.support.truth import WATER

BOARDS_IN_WATER = 15


def air_of(truth: TrueRig, boards: int) -> AirCalibration:
    """Calibrate in air with ``boards`` boards, before the housing is closed. Raises AirCalibrationError."""
    views = _views(in_air(truth), poses_in_air(boards, truth.seed), AIR)
    return calibrate_air(views, truth.left.width_px, truth.left.height_px)


def start_of(air: AirCalibration) -> Calibration:
    """Return the start calibration: lenses and extrinsics from air, nominal ports."""
    width_px, height_px = air.rig.left.width_px, air.rig.left.height_px
    drawing = replace(DESIGN, pixel_um=DESIGN.pixel_um * WIDTH_PX / width_px)
    return start_from_air(air, design_calibration(drawing, "KF-SIM", width_px, height_px, WATER))


def boards_in_water(truth: TrueRig) -> list[BoardView]:
    """Return fifteen boards in the measuring volume."""
    return _views(truth, poses_in_water(BOARDS_IN_WATER, truth.seed), Water())


def _views(rig: TrueRig, poses: Sequence[Pose], water: Water) -> list[BoardView]:
    """Return the boards that were found; a picture with too little of one is left out, as with a real board."""
    renderer = Renderer(rig, Scene(object="board"))
    views = []
    for k, pose in enumerate(poses):
        pictures = picture(renderer, pose, water, 1000 * rig.seed + k)
        view, reasons = find_board(f"board {k}", {"left": pictures.left, "right": pictures.right}, BOARD, strict=True)
        if not reasons:
            views.append(view.without(~(view.has("left") & view.has("right"))))
    return views
