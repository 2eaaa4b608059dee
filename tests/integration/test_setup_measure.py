"""``kingfisher setup measure`` through the shipped drivers: what a simulated projector does is found, written, and kept apart; triggers that are
wrong on purpose are named.

Colours in turn; ``test_box_of_parts`` has one that repeats, and is mirrored and bent; ``tests/appliance/workshop`` has every kind.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from appliance.cli import main
from appliance.store.config import load_rig
from hw_sim.options import options_from
from hw_sim.world import World
from tests.integration.dived import at_the_bench

pytestmark = [pytest.mark.devices, pytest.mark.timeout(900)]
BLACKFLIES = 'cameras = { left = { personality = "blackfly" }, right = { personality = "blackfly" } }'


def test_a_video_projector_is_measured_as_it_is_built_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = at_the_bench(tmp_path, (96, 72), 'idle_speed = 2.0\nprojector = "video"')
    before = rig.read_text(encoding="utf-8")
    out = ("--out", str(tmp_path / "page"), "--json")
    with World(options_from(load_rig(rig).rig.wires_options)) as world:
        assert main(["setup", "measure", "projector", "--rig", str(rig), "--install", *out]) == 0
        truth = world.projector_truth
    said = json.loads(capsys.readouterr().out)
    now = load_rig(rig)
    assert now.projector.latency_blanks == truth.latency_blanks == 1
    assert now.projector.channels == "green"
    # No exposure that is offered is false: each sees light that is linear in the code, of its own picture.
    assert now.scan.exposures_ms
    for time_ms in now.scan.exposures_ms:
        assert truth.linear(now.board.trigger_delay_us, 1000.0 * time_ms, "G"), time_ms
    lit = [one for one in truth.windows_us if one.channel == "G"]
    assert said["light"]["begins_us"] == pytest.approx(lit[0].begin_us, abs=250.0)
    assert said["light"]["ends_us"] == pytest.approx(lit[-1].end_us, abs=250.0)
    assert (tmp_path / "rig.toml.before-1").read_text(encoding="utf-8") == before
    assert "latency" in (tmp_path / "page" / "projector.html").read_text(encoding="utf-8")
    assert (tmp_path / "page" / "light.png").read_bytes().startswith(b"\x89PNG")


def test_the_packaged_rig_file_is_never_changed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["setup", "measure", "projector", "--install"]) == 2
    assert "is never changed" in capsys.readouterr().err


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
    assert "does not get its trigger" in said["camera.right"]["said"]
