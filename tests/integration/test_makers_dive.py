"""Whole instruments with cameras in the manner of three makers: checked, scanned with, and named where a setting is wrong.

The settings that are wrong on purpose stand in the rig file, since the driver mends whatever a camera was left with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.calibration.file import encode
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import Rig, load_rig
from appliance.instrument import CALIBRATION_FILE
from appliance.service.app import run
from appliance.service.checkup import check
from appliance.storage.library import Library
from hw_sim.options import options_from
from hw_sim.rendering.render import Renderer
from hw_sim.truth import TrueRig, draw_truth
from tests.support.truth import left_to_rig, true_calibration

pytestmark = pytest.mark.devices
WIDTH, HEIGHT = 400, 300
LARGE_PX = (1200, 900)
KEPT = """
wait state AIM 90
press scan
wait state REVIEW 60
pause 1
press scan
wait state AIM 60
end
"""
PATIENT = KEPT.replace("AIM 90", "AIM 600\npause 3", 1).replace(" 60", " 600")
"""The same of large images on a machine that is busy with other things, by a diver who has seen live pictures before he scans."""
REFUSED = """
wait state AIM 90
press scan
wait alert {code} 60
end
"""
NOT_EVEN_OPENED = """
wait alert {code} 60
end
"""
LEFT_BEHIND: Mapping[str, dict[str, Any]] = {
    "blackfly": {"ReverseX": True, "Gamma": 0.5, "TriggerMode[AcquisitionStart]": "On"},
    "ace": {"OverlapMode": "Off", "ExposureMode": "TriggerWidth", "TriggerMode[FrameBurstStart]": "On"},
    "alvium": {"OffsetX": 40, "ExposureAuto": "Continuous", "LineMode[Line0]": "Output"},
}
"""What the last owner of these cameras saved in them."""
NAMES = {"blackfly": "FLIR Blackfly S", "ace": "Basler a2A1920", "alvium": "Allied Vision 1800 U"}
SOURCE = {"usual": None, "blackfly": None, "ace": "Line1", "alvium": None}


def instrument(
    folder: Path,
    maker: str,
    script: str,
    saved: Mapping[str, Any],
    left: Mapping[str, Any],
    size_px: tuple[int, int] = (WIDTH, HEIGHT),
    also: Mapping[str, Any] | None = None,
) -> tuple[Rig, TrueRig]:
    """Return a rig whose two cameras are of that maker, and its truth; ``left``: features of the left one in the rig file; ``also``: what else
    is peculiar about how both cameras power up."""
    path = folder / "dive.script"
    path.write_text(script)
    options = SimOptions(
        root=folder / "root",
        object_name="pipe",
        truth="nominal",
        seed=11,
        size=f"{size_px[0]}x{size_px[1]}",
        script=path,
    )
    rig = simulated(load_rig(default_sim_rig()), options)
    power_on = {side: {"personality": maker, "saved": dict(saved), **(also or {})} for side in ("left", "right")}
    rig = replace(rig, rig=replace(rig.rig, wires_options={**rig.rig.wires_options, "cameras": power_on}))
    cameras = replace(
        rig.camera,
        left=replace(rig.camera.left, trigger_source=SOURCE[maker], features=left),
        right=replace(rig.camera.right, trigger_source=SOURCE[maker]),
    )
    rig = replace(rig, camera=cameras)
    world = options_from(rig.rig.wires_options)
    truth = draw_truth(world.truth, world.seed, world.width_px, world.height_px, world.scene().water.index)
    calibration = rig.storage.root / CALIBRATION_FILE
    calibration.parent.mkdir(parents=True)
    calibration.write_bytes(encode(true_calibration(truth, rig.rig.serial)))
    return rig, truth


@pytest.mark.parametrize("maker", NAMES)
def test_an_instrument_with_used_cameras_of_each_maker_is_checked_and_scans(tmp_path: Path, maker: str) -> None:
    rig, truth = instrument(tmp_path, maker, KEPT, LEFT_BEHIND[maker], {})
    ashore = {name: value for name, value in rig.rig.wires_options.items() if name != "script"}
    found = {health.device: health for health in check(replace(rig, rig=replace(rig.rig, wires_options=ashore)))}
    assert all(health.ok for health in found.values()), found
    assert NAMES[maker] in found["camera.left"].details["model"]

    assert run(rig) == 0
    library = Library(rig.storage.root)
    last = library.last_id()
    assert last is not None
    cloud = library.load(last).cloud()
    assert cloud is not None
    surface = Renderer(truth, options_from(rig.rig.wires_options).scene()).surface(0.0)
    distance = surface.distance_mm(left_to_rig(truth, cloud.points_mm))
    assert len(distance) > 40_000
    assert np.sqrt(np.mean(distance**2)) < 0.06


@pytest.mark.parametrize(
    ("maker", "features", "code", "told"),
    [
        ("blackfly", {"TriggerOverlap": "Off"}, "CAMERA_TOO_SLOW", "one for every 2 pulses"),
        ("ace", {"AcquisitionFrameRateEnable": True, "AcquisitionFrameRate": 20.0}, "CAMERA_TOO_SLOW", "every 3 pulses"),
        ("ace", {"DeviceLinkThroughputLimitMode": "On", "DeviceLinkThroughputLimit": 1_000_000}, "CAMERA_TOO_SLOW", "pulses"),
        ("ace", {"TriggerSelector": "FrameBurstStart", "TriggerMode": "On"}, "CAMERA_SILENT", "trigger_source"),
        ("blackfly", {"TriggerActivation": "FallingEdge"}, "SYNC_LOST", "12.00 ms late"),
        ("blackfly", {"TriggerDelay": 3000.0}, "SYNC_LOST", "3.00 ms late"),
        ("alvium", {"ReverseX": True}, "PICTURE_MIRRORED", "sees the picture mirrored left to right"),
        ("blackfly", {"ReverseX": True, "ReverseY": True}, "PICTURE_MIRRORED", "sees the picture turned by 180°"),
        ("ace", {"Gamma": 0.45}, "GREY_BENT", "bends grey. Under features of camera.left set Gamma = 1.0"),
        ("blackfly", {"GammaEnable": True, "Gamma": 0.8}, "GREY_BENT", "bends grey. Under features of camera.left"),
        ("blackfly", {"LUTEnable": True}, "GREY_BENT", "LUTEnable = false"),
        ("blackfly", {"TestPattern": "GreyHorizontalRamp"}, "CAMERA_STUCK", "shows the same image"),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_named_by_what_it_does(
    tmp_path: Path, maker: str, features: dict[str, Any], code: str, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    rig, _ = instrument(tmp_path, maker, REFUSED.format(code=code), {}, features)
    assert run(rig) == 0
    lines = [one.getMessage() for one in caplog.records if code in one.getMessage()]
    assert any(told in line and "camera.left" in line for line in lines), lines


@pytest.mark.parametrize(
    ("maker", "features", "told"),
    [
        ("blackfly", {"ExposureAuto": "Continuous"}, "ExposureTime: 12000 refused"),
        ("ace", {"OffsetX": 40}, "Use the key offset_x_px"),
        ("alvium", {"TriggerMode": "Off"}, "TriggerMode is Off after it was set to On"),
    ],
)  # fmt: skip
def test_a_setting_that_contradicts_the_order_is_refused_and_nobody_looks_for_a_loose_plug(
    tmp_path: Path, maker: str, features: dict[str, Any], told: str, caplog: pytest.LogCaptureFixture
) -> None:
    rig, _ = instrument(tmp_path, maker, NOT_EVEN_OPENED.format(code="CAMERA_REFUSED"), {}, features)
    assert run(rig) == 0
    assert any(told in one.getMessage() for one in caplog.records), [one.getMessage() for one in caplog.records]


def test_an_instrument_whose_host_refuses_whole_images_scans_in_pieces(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Images of more than a MiB behind a host controller that takes no longer transfer: the diver notices nothing of it."""
    caplog.set_level("INFO")
    rig, truth = instrument(
        tmp_path, "usual", PATIENT, {}, {}, size_px=LARGE_PX, also={"largest_transfer_bytes": 1024 * 1024}
    )
    assert LARGE_PX[0] * LARGE_PX[1] > 1024 * 1024
    assert run(rig) == 0
    library = Library(rig.storage.root)
    last = library.last_id()
    assert last is not None
    entry = library.load(last)
    cloud = entry.cloud()
    assert cloud is not None
    surface = Renderer(truth, options_from(rig.rig.wires_options).scene()).surface(0.0)
    distance = surface.distance_mm(left_to_rig(truth, cloud.points_mm))
    assert len(distance) > 300_000
    assert np.sqrt(np.mean(distance**2)) < 0.06
    lost = [one.getMessage() for one in caplog.records if "CAMERA_LOST" in one.getMessage()]
    assert not lost, lost
