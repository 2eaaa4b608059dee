"""``kingfisher bringup projector`` through the shipped drivers: what a simulated projector does is found, written, and kept apart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.bringup.conclusions import raster_finding
from appliance.bringup.exposures import Trial
from appliance.bringup.projector import measure_lines, measure_orientation
from appliance.cli import main
from appliance.config import load_rig
from appliance.service.light_bench import light_bench
from hw_sim.options import options_from
from hw_sim.world import World
from tests.integration.dived import at_the_bench

pytestmark = [pytest.mark.devices, pytest.mark.timeout(900)]
SIZE_PX = (96, 72)
QUICK = "idle_speed = 4.0\n"


def test_a_late_projector_of_bit_planes_is_measured_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = 'faults = ["projector wrong"]\noutside = { seed = 3, families = ["projector"] }'
    rig = at_the_bench(tmp_path, SIZE_PX, QUICK + world)
    before = rig.read_text(encoding="utf-8")
    assert main(["bringup", "projector", "--rig", str(rig), "--out", str(tmp_path / "page"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["good"]
    now = load_rig(rig)
    assert now.projector.latency_blanks == 1
    # The lamp is dark for a part of the frame's end; only an exposure that holds all of the light sees every bit.
    assert now.scan.exposures_ms == (16.0,)
    assert (now.board.trigger_delay_us, now.camera.left.exposure_ms) == (0, 16.0)
    assert (tmp_path / "rig.toml.before-1").read_text(encoding="utf-8") == before
    assert "latency" in (tmp_path / "page" / "projector.html").read_text(encoding="utf-8")
    assert (tmp_path / "page" / "light.png").read_bytes().startswith(b"\x89PNG")


def test_the_packaged_rig_file_is_never_changed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bringup", "projector"]) == 2
    assert "--dry-run" in capsys.readouterr().err


@pytest.mark.parametrize(("kind", "channels", "sub_frames"), [("video", "green", None), ("pattern", "all", 3)])
def test_each_kind_of_projector_is_measured_as_it_is_built(
    kind: str, channels: str, sub_frames: int | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A projector that repeats is among ``test_box_of_parts``."""
    rig = at_the_bench(tmp_path, SIZE_PX, f'{QUICK}projector = "{kind}"')
    with World(options_from(load_rig(rig).rig.wires_options)) as world:
        assert main(["bringup", "projector", "--rig", str(rig), "--json"]) == 0
        truth = world.projector_truth
    said = json.loads(capsys.readouterr().out)
    now = load_rig(rig)
    assert now.projector.latency_blanks == truth.latency_blanks == 1
    assert now.projector.channels == channels
    assert sub_frames is None or now.projector.sub_frames == sub_frames
    # No exposure that is offered is false: each sees light that is linear in the code, of its own picture.
    drawn = "RGB" if channels == "all" else "G"
    assert now.scan.exposures_ms
    for time_ms in now.scan.exposures_ms:
        assert truth.linear(now.board.trigger_delay_us, 1000.0 * time_ms, drawn), time_ms
    lit = [one for one in truth.windows_us if one.channel in drawn]
    assert said["light"]["begins_us"] == pytest.approx(lit[0].begin_us, abs=250.0)
    assert said["light"]["ends_us"] == pytest.approx(lit[-1].end_us, abs=250.0)


def test_a_picture_that_is_scaled_to_another_panel_is_told_by_cameras_that_resolve_it(tmp_path: Path) -> None:
    """The two measurements that are concerned, on their own: a whole one with cameras of this size takes minutes."""
    rig = at_the_bench(tmp_path, (800, 600), f'{QUICK}projector = {{ kind = "ideal", scaled = [912, 1140] }}')
    best = Trial(500, 8_000)
    with light_bench(load_rig(rig)) as bench:
        seen, _ = measure_orientation(bench, 0, best, "green")
        lines, _ = measure_lines(bench, 0, best, "green")
    raster = raster_finding(lines, seen)
    assert raster.ok is False, raster
    assert "the projector scales its picture" in raster.said
    assert "raster of its panel" in raster.remedy
