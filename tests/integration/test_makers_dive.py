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

from appliance.instrument.service.app import run
from appliance.instrument.service.checkup import check
from appliance.store.config import Rig
from appliance.store.library import Library
from tests.integration.dived import calibrate_exactly, instrument, off_surface_mm

pytestmark = pytest.mark.devices
KEPT = """
wait state AIM 90
press scan
wait state REVIEW 60
pause 1
press scan
wait state AIM 60
end
"""
LEFT_BEHIND: Mapping[str, dict[str, Any]] = {
    "blackfly": {"ReverseX": True, "Gamma": 0.5, "TriggerMode[AcquisitionStart]": "On"},
    "ace": {"OverlapMode": "Off", "ExposureMode": "TriggerWidth", "TriggerMode[FrameBurstStart]": "On"},
    "alvium": {"OffsetX": 40, "ExposureAuto": "Continuous", "LineMode[Line0]": "Output"},
}
"""What the last owner of these cameras saved in them."""


def instrument_of(folder: Path, left: str, right: str, script: str, features: Mapping[str, Any] | None = None) -> Rig:
    """Return a rig with cameras of these makers, used ones; ``features``: of the left one in the rig file."""
    rig = instrument(folder, script, object_name="pipe", truth="nominal", seed=11)
    makers = {"left": left, "right": right}
    power_on = {side: {"personality": one, "saved": LEFT_BEHIND[one]} for side, one in makers.items()}
    source = {side: "Line1" if one == "ace" else None for side, one in makers.items()}
    cameras = replace(
        rig.camera,
        left=replace(rig.camera.left, trigger_source=source["left"], features=features or {}),
        right=replace(rig.camera.right, trigger_source=source["right"]),
    )
    wires = {**rig.rig.wires_options, "cameras": power_on}
    return replace(rig, camera=cameras, rig=replace(rig.rig, wires_options=wires))


def test_an_instrument_with_used_cameras_is_checked_and_scans(tmp_path: Path) -> None:
    rig = instrument_of(tmp_path, "blackfly", "ace", KEPT)
    calibrate_exactly(rig)
    ashore = {name: value for name, value in rig.rig.wires_options.items() if name != "script"}
    found = {health.device: health for health in check(replace(rig, rig=replace(rig.rig, wires_options=ashore)))}
    assert all(health.ok for health in found.values()), found
    models = [found[f"camera.{side}"].details["model"] for side in ("left", "right")]
    assert ("FLIR Blackfly S" in models[0], "Basler a2A1920" in models[1]) == (True, True)
    assert run(rig) == 0
    off_mm = off_surface_mm(rig, Library(rig.storage.root).ids()[-1])
    assert len(off_mm) > 40_000
    assert np.sqrt(np.mean(off_mm**2)) < 0.06


@pytest.mark.parametrize(
    ("maker", "features", "code", "told"),
    [
        ("blackfly", {"TriggerOverlap": "Off"}, "CAMERA_TOO_SLOW", "one for every 2 pulses"),
        ("blackfly", {"TriggerDelay": 3000.0}, "SYNC_LOST", "ms late"),
        ("alvium", {"ReverseX": True}, "PICTURE_MIRRORED", "sees the picture mirrored left to right"),
        ("blackfly", {"ExposureAuto": "Continuous"}, "CAMERA_REFUSED", "ExposureTime: 12000 refused"),
    ],
)  # fmt: skip
def test_a_wrong_setting_is_named_by_what_it_does(
    tmp_path: Path, maker: str, features: dict[str, Any], code: str, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    scan = "" if code == "CAMERA_REFUSED" else "wait state AIM 90\npress scan\n"
    rig = instrument_of(tmp_path, maker, maker, f"{scan}wait alert {code} 60\nend\n", features)
    assert run(rig) == 0
    lines = [one.getMessage() for one in caplog.records]
    assert any(told in line and "camera.left" in line for line in lines), lines
