"""``kingfisher setup measure trigger`` through the shipped drivers: triggers that are wrong on purpose are named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from appliance.cli import main
from tests.integration.dived import at_the_bench

pytestmark = [pytest.mark.devices, pytest.mark.timeout(120)]
BLACKFLIES = 'cameras = { left = { personality = "blackfly" }, right = { personality = "blackfly" } }'


def found(rig: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, Any]]:
    """Return the findings by name; the exit code says whether all are good."""
    code = main(["setup", "measure", "trigger", "--rig", str(rig), "--json"])
    said = {one["name"]: one for one in json.loads(capsys.readouterr().out)}
    assert code == (0 if all(one["ok"] for one in said.values()) else 1)
    return said


def test_a_pulse_that_is_not_fired_is_the_boards(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = found(at_the_bench(tmp_path, (192, 128), 'faults = ["board intermittent frame=9"]'), capsys)
    assert (said["pulses"]["ok"], said["pulses"]["said"]) == (False, "the board fired 63 of 64 pulses")


def test_no_overlap_halves_the_frames_of_one_camera_and_the_other_does_not_see_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = at_the_bench(tmp_path, (192, 128), BLACKFLIES)
    text = rig.read_text(encoding="utf-8").replace("[camera.right]", '[camera.right]\ntrigger_source = "Line3"', 1)
    rig.write_text(f'{text}\n[camera.left.features]\nTriggerOverlap = "Off"\n', encoding="utf-8")
    said = found(rig, capsys)
    assert said["pulses"]["said"] == "the board fired 64 of 64 pulses"
    assert "every second trigger is ignored" in said["camera.left"]["said"]
    assert "TriggerOverlap ReadOut" in said["camera.left"]["remedy"]
    assert "does not see its line" in said["camera.right"]["said"]
