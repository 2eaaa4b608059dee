"""``kingfisher setup measure projector`` through the shipped drivers: what a simulated projector does is found, written, and kept apart.

Colours in turn; ``test_box_of_parts`` has one that repeats, and is mirrored and bent; ``tests/appliance/workshop`` has every kind.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.store.config import load_rig
from hw_sim.options import options_from
from hw_sim.world import World
from tests.integration.dived import at_the_bench

pytestmark = [pytest.mark.devices, pytest.mark.timeout(900)]


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
