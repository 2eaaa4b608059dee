"""``kingfisher bringup projector`` through the shipped drivers: what a simulated projector does is found, written, and kept apart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.config import load_rig

pytestmark = [pytest.mark.hardware, pytest.mark.timeout(300)]
SMALL = Path(__file__).parents[2] / "hw_sim" / "rigs" / "small.toml"
WIDTH_PX, HEIGHT_PX = 192, 128


def rig_file(folder: Path, world: str) -> Path:
    """A rig in air before a plane, with small cameras; ``world`` are further options of the world."""
    text = SMALL.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(folder / "root"))
    text = text.replace("width_px = 400", f"width_px = {WIDTH_PX}").replace(
        "height_px = 300", f"height_px = {HEIGHT_PX}"
    )
    text = text.replace("pixel_um = 18.0", f"pixel_um = {4.5 * 1600 / WIDTH_PX}")
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
