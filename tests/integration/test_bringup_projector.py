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

pytestmark = [pytest.mark.devices, pytest.mark.timeout(900)]
SMALL = Path(__file__).parents[2] / "hw_sim" / "rigs" / "small.toml"
WIDTH_PX, HEIGHT_PX = 96, 72


def rig_file(folder: Path, world: str, size_px: tuple[int, int] = (WIDTH_PX, HEIGHT_PX)) -> Path:
    """A rig in air before a plane, with small cameras; ``world`` are further options of the world."""
    text = SMALL.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(folder / "root"))
    width_px, height_px = size_px
    text = text.replace("width_px = 400", f"width_px = {width_px}").replace(
        "height_px = 300", f"height_px = {height_px}"
    )
    text = text.replace("pixel_um = 18.0", f"pixel_um = {4.5 * 1600 / width_px}")
    plane = 'object = "plane"\nobject_pose = [0, 0, 540, 0, 0, 0]\nmedium = "air"\nstills = true\nidle_speed = 4.0\n'
    path = folder / "rig.toml"
    path.write_text(text.replace("[rig.wires_options]", f"[rig.wires_options]\n{plane}{world}", 1), encoding="utf-8")
    return path


def test_a_late_projector_of_bit_planes_is_measured_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = rig_file(tmp_path, 'faults = ["projector wrong"]\noutside = { seed = 3, families = ["projector"] }\n')
    before = rig.read_text(encoding="utf-8")
    assert main(["bringup", "projector", "--rig", str(rig), "--out", str(tmp_path / "page"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["good"]
    now = load_rig(rig)
    assert now.projector.latency_blanks == 1
    # The lamp is dark for a part of the frame's end; only an exposure that holds all of the light sees every bit.
    assert now.scan.exposures_ms == (16.0,)
    assert now.board.trigger_delay_us == 0
    assert now.camera.left.exposure_ms == 16.0
    assert (tmp_path / "rig.toml.before-1").read_text(encoding="utf-8") == before
    page = (tmp_path / "page" / "projector.html").read_text(encoding="utf-8")
    assert "latency" in page
    assert (tmp_path / "page" / "light.png").read_bytes().startswith(b"\x89PNG")


def test_a_dark_lamp_is_named_and_nothing_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = rig_file(tmp_path, 'faults = ["projector off"]\n')
    before = rig.read_text(encoding="utf-8")
    assert main(["bringup", "projector", "--rig", str(rig)]) == 1
    assert "one white picture among black ones changed the images by" in capsys.readouterr().err
    assert rig.read_text(encoding="utf-8") == before
    assert not list(tmp_path.glob("rig.toml.*"))


def test_the_packaged_rig_file_is_never_changed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bringup", "projector"]) == 2
    assert (
        "the packaged rig file is never changed; give the instrument's, or measure with --dry-run"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("kind", "channels", "sub_frames"),
    [('"repeats"', "green", 2), ('"video"', "green", None), ('"pattern"', "all", 3)],
)
def test_each_kind_of_projector_is_measured_as_it_is_built(
    kind: str, channels: str, sub_frames: int | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = rig_file(tmp_path, f"projector = {kind}\n")
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


@pytest.mark.parametrize(
    ("world", "named", "said", "remedy"),
    [
        ('{ kind = "ideal", gamma = 2.2 }', "grey", "like a power of 2.2", "switch gamma off in the projector"),
        ('{ kind = "ideal", mirrored = true }', "orientation", "both cameras see the picture mirrored left to right", "rear projection off"),
    ],
)  # fmt: skip
def test_a_projector_that_was_set_up_wrong_is_refused_and_named_and_nothing_that_is_right(
    world: str, named: str, said: str, remedy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = rig_file(tmp_path, f"projector = {world}\n")
    before = rig.read_text(encoding="utf-8")
    assert main(["bringup", "projector", "--rig", str(rig), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    wrong = {one["name"]: one for one in report["findings"] if not one["ok"]}
    assert set(wrong) == {named}
    assert said in wrong[named]["said"]
    assert remedy in wrong[named]["remedy"]
    assert report["keys"] == {}
    assert rig.read_text(encoding="utf-8") == before


@pytest.mark.parametrize(("scaled", "beats"), [("[912, 1140]", True), (None, False)])
def test_a_picture_that_is_scaled_to_another_panel_is_told_by_cameras_that_resolve_it(
    scaled: str | None, beats: bool, tmp_path: Path
) -> None:
    """The two measurements that are concerned, on their own: a whole one with cameras of this size takes minutes."""
    rig = rig_file(
        tmp_path, f'projector = {{ kind = "ideal"{f", scaled = {scaled}" if scaled else ""} }}\n', (800, 600)
    )
    best = Trial(500, 8_000)
    with light_bench(load_rig(rig)) as bench:
        seen, _ = measure_orientation(bench, 0, best, "green")
        lines, _ = measure_lines(bench, 0, best, "green")
    raster = raster_finding(lines, seen)
    assert raster.ok is not beats, raster
    if beats:
        assert "the projector scales its picture" in raster.said
        assert "raster of its panel" in raster.remedy
    else:
        assert raster.said.startswith("single lines are equally bright"), raster
