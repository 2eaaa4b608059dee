"""``kingfisher bringup trigger`` through the shipped drivers: triggers that are wrong on purpose are named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.cli import main

pytestmark = [pytest.mark.devices, pytest.mark.timeout(120)]
SMALL = Path(__file__).parents[2] / "hw_sim" / "rigs" / "small.toml"


def said(
    folder: Path, capsys: pytest.CaptureFixture[str], *, left: str = "", line: str = "", world: str = ""
) -> dict[str, dict[str, object]]:
    """What is said, by name; ``left`` are features of the left camera, ``line`` a key of it, ``world`` options of the world."""
    text = SMALL.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(folder / "root"))
    text = (
        text.replace("width_px = 400", "width_px = 192")
        .replace("height_px = 300", "height_px = 128")
        .replace("pixel_um = 18.0", "pixel_um = 37.5")
    )
    text = text.replace("[rig.wires_options]", f"[rig.wires_options]\nstills = true\n{world}", 1)
    text = text.replace("[camera.left]", f"[camera.left]\n{line}", 1)
    rig = folder / "rig.toml"
    rig.write_text(f"{text}\n[camera.left.features]\n{left}\n", encoding="utf-8")
    code = main(["bringup", "trigger", "--rig", str(rig), "--json"])
    spoken = capsys.readouterr()
    assert not spoken.err
    found = {one["name"]: one for one in json.loads(spoken.out)}
    assert code == (0 if all(one["ok"] for one in found.values()) else 1)
    return found


BLACKFLY = 'cameras = { left = { personality = "blackfly" }, right = { personality = "blackfly" } }\n'


def test_a_frame_comes_for_each_pulse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = said(tmp_path, capsys)
    assert all(one["ok"] for one in found.values())
    assert [found[name]["said"] for name in ("pulses", "camera.left", "camera.right")] == [
        "the board fired 64 of 64 pulses",
        "64 frames of 64 pulses, one a period",
        "64 frames of 64 pulses, one a period",
    ]


def test_no_overlap_of_exposure_and_readout_halves_the_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = said(tmp_path, capsys, left='TriggerOverlap = "Off"', world=BLACKFLY)
    assert "every second trigger is ignored" in str(found["camera.left"]["said"])
    assert "TriggerOverlap ReadOut" in str(found["camera.left"]["remedy"])
    assert found["camera.right"]["ok"]


def test_a_wrong_line_gives_no_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = said(tmp_path, capsys, line='trigger_source = "Line3"', world=BLACKFLY)
    assert "does not see its line" in str(found["camera.left"]["said"])
    assert found["camera.right"]["ok"]


def test_a_pulse_that_is_not_fired_is_the_boards(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = said(tmp_path, capsys, world='faults = ["board intermittent frame=9"]\n')
    assert not found["pulses"]["ok"]
    assert found["pulses"]["said"] == "the board fired 63 of 64 pulses"
