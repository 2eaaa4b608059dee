"""``kingfisher bringup guide`` through the shipped drivers: a good instrument comes through, what is wrong stops it and is named."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from appliance.bringup.guide import NAMES
from appliance.config import load_rig
from appliance.storage.lock import hold_lock
from hw_sim.options import options_from
from hw_sim.world import World
from tests.support.builder import Builder, guided

pytestmark = [pytest.mark.devices, pytest.mark.timeout(900)]
SMALL = Path(__file__).parents[2] / "hw_sim" / "rigs" / "small.toml"
WIDTH_PX, HEIGHT_PX = 192, 128
BLACKFLY = 'cameras = { left = { personality = "blackfly" }, right = { personality = "blackfly" } }\n'


def rig_file(folder: Path, world: str = "", left: str = "") -> Path:
    """A rig in air before a plane, with small cameras; ``world`` are further options of the world, ``left`` keys of the left camera."""
    text = SMALL.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(folder / "root"))
    text = text.replace("width_px = 400", f"width_px = {WIDTH_PX}").replace(
        "height_px = 300", f"height_px = {HEIGHT_PX}"
    )
    text = text.replace("pixel_um = 18.0", f"pixel_um = {4.5 * 1600 / WIDTH_PX}")
    plane = 'object = "plane"\nobject_pose = [0, 0, 540, 0, 0, 0]\nmedium = "air"\nstills = true\nidle_speed = 20.0\n'
    text = text.replace("[rig.wires_options]", f"[rig.wires_options]\n{plane}{world}", 1)
    path = folder / "rig.toml"
    path.write_text(text.replace("[camera.left]", f"[camera.left]\n{left}", 1), encoding="utf-8")
    return path


@contextmanager
def bench(rig: Path) -> Iterator[Builder]:
    with World(options_from(load_rig(rig).rig.wires_options)) as world:
        yield Builder(world)


def said(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(capsys.readouterr().out)
    return content


def wrong(content: dict[str, Any], step: str) -> dict[str, dict[str, Any]]:
    """The findings of a step that are not good, by name."""
    findings = next(one["findings"] for one in content["steps"] if one["name"] == step)
    return {one["name"]: one for one in findings if not one["ok"]}


def test_a_good_instrument_comes_from_the_box_to_the_first_plane_and_on_after_an_interruption(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, out = rig_file(tmp_path, 'imaging = { response = "linear" }\n'), tmp_path / "out"
    usual = ("--rig", str(rig), "--out", str(out), "--endurance-minutes", "0.1", "--json")
    with bench(rig) as builder:
        # Called away before the wall: what was done is kept.
        builder.hands["white and flat"] = lambda: False
        with pytest.MonkeyPatch.context() as hour:
            hour.setattr("appliance.cli.bringup_guide.ANSWERED_WITHIN_S", 0.2)
            assert guided(builder, monkeypatch, *usual) == 1
        first = said(capsys)
        assert first["done"] == ["board", "pad", "vsync", "cameras", "trigger"]
        assert "call again to go on here" in first["stopped"]
        del builder.hands["white and flat"]
        asked = len(builder.asked)
        code = guided(builder, monkeypatch, *usual)
        second = said(capsys)
        assert (code, second["stopped"]) == (0, None), second
        # Nothing that was good is asked for again.
        assert not any("press SCAN" in line or "caps on both" in line for line in builder.asked[asked:])
    assert second["good"]
    assert [one["name"] for one in second["steps"]] == list(NAMES)
    assert second["done"] == list(NAMES[5:])
    now = load_rig(rig)
    assert now.projector.latency_blanks == 0
    assert now.scan.exposures_ms
    assert (tmp_path / "rig.toml.before-1").exists()
    page = (out / "bringup.html").read_text(encoding="utf-8")
    for text in ("All twelve steps are good", "KF-CAM-L", "HDMI-A-1", "latency_blanks = 0", "data:image/png"):
        assert text in page, text
    # The first plane is a scan like any other.
    assert len(list((tmp_path / "root" / "scans").iterdir())) == 1

    # A third call has nothing to do; another pad makes its step be done again, and no other.
    with bench(rig) as builder:
        assert guided(builder, monkeypatch, *usual) == 0
        assert said(capsys)["done"] == []
        rig.write_text(rig.read_text(encoding="utf-8").replace("product_id = 0x4B46", "product_id = 0x4B47"))
        assert guided(builder, monkeypatch, *usual) == 1
        third = said(capsys)
    assert third["done"] == ["pad"]
    assert "no key pad 1209:4b47" in wrong(third, "pad")["keys"]["said"]


@pytest.mark.parametrize(
    ("fault", "step", "finding", "remedy"),
    [
        ("laser.left stuck", "board", "laser.left", "conducts while it is off"),
        ("laser.right off", "board", "laser.right", "shunt amplifier"),
        ("sensor.HUM off", "board", "sensor.HUM", "does not answer"),
        ("board off", "board", "board", "cable"),
        ("keypad off", "pad", "keys", "cable"),
        ("key.up stuck", "pad", "coils", "shorted"),
        ("camera.left off", "cameras", "camera.left", ""),
    ],
)
def test_what_is_broken_stops_at_its_step_by_its_name(
    fault: str,
    step: str,
    finding: str,
    remedy: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = rig_file(tmp_path, f'faults = ["{fault}"]\n')
    before = rig.read_text(encoding="utf-8")
    # By itself, where the steps before would take long.
    only = () if step in ("board", "pad") else ("--only", step)
    with bench(rig) as builder:
        if only:
            builder.world.clear_faults()
            for name in ("board", "vsync"):
                assert (
                    guided(builder, monkeypatch, "--rig", str(rig), "--out", str(tmp_path / "out"), "--only", name) == 0
                )
            builder.world.fault(fault)
            capsys.readouterr()
        assert guided(builder, monkeypatch, "--rig", str(rig), "--out", str(tmp_path / "out"), "--json", *only) == 1
    content = said(capsys)
    assert content["done"][-1] == step
    found = wrong(content, step)[finding]
    assert remedy in found["said"] + found["remedy"]
    assert found["remedy"]
    assert rig.read_text(encoding="utf-8") == before
    assert (tmp_path / "out" / "bringup.html").exists()


def test_a_gamma_is_named_before_any_picture_and_a_wrong_line_as_the_trigger_step_would(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_file(tmp_path, BLACKFLY, 'trigger_source = "Line3"\n')
    arguments = ("--rig", str(rig), "--out", str(tmp_path / "out"), "--json")
    with bench(rig) as builder:
        for name in ("board", "vsync"):
            assert guided(builder, monkeypatch, *arguments, "--only", name) == 0
        capsys.readouterr()
        assert guided(builder, monkeypatch, *arguments, "--only", "cameras") == 1
        line = said(capsys)
        rig.write_text(
            rig.read_text(encoding="utf-8").replace('trigger_source = "Line3"\n', "")
            + "\n[camera.left.features]\nGammaEnable = true\n",
            encoding="utf-8",
        )
        assert guided(builder, monkeypatch, *arguments, "--only", "cameras") == 1
        gamma = said(capsys)
    assert "does not see its line" in wrong(line, "cameras")["camera.left"]["said"]
    assert wrong(gamma, "cameras").keys() == {"camera.left tone"}
    assert "GammaEnable = false" in wrong(gamma, "cameras")["camera.left tone"]["remedy"]


def test_a_step_that_needs_another_says_which_and_a_running_instrument_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_file(tmp_path)
    arguments = ("--rig", str(rig), "--out", str(tmp_path / "out"), "--only", "trigger")
    with bench(rig) as builder:
        assert guided(builder, monkeypatch, *arguments) == 1
        assert "step trigger needs board, vsync, cameras, which are not good" in builder.stderr
        with hold_lock(tmp_path / "root"):
            assert guided(builder, monkeypatch, *arguments) == 1
        assert "another instance" in builder.stderr
        assert not builder.asked
    capsys.readouterr()
