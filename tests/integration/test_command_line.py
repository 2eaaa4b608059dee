"""What `kingfisher check`, `sim` and `calibration` say on the command line, right and wrong words."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from appliance.storage.lock import hold_lock
from tests.support.commands import ROOT, Shell, kingfisher

SMALL_RIG = ROOT / "hw_sim" / "rigs" / "small.toml"


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    """Commands in this process: starting one is most of what they take. A few have a process of their own all the same."""
    monkeypatch.setattr("faulthandler.enable", lambda **_: None)  # a process has one, and here it is the test run's
    return Shell(capsys)


def checked(shell: Shell, folder: Path, *faults: str, change: Callable[[str], str] = str) -> dict[str, dict[str, Any]]:
    """What ``kingfisher check`` says of each device of a rig in which something is wrong; exit code 1 if it says so."""
    rig = folder / "rig.toml"
    text = change(SMALL_RIG.read_text(encoding="utf-8"))
    rig.write_text(text.replace("[rig.wires_options]", f"[rig.wires_options]\nfaults = {json.dumps(faults)}"))
    said = shell("check", "--rig", rig, "--json")
    assert said.code == (0 if all(one["ok"] for one in said.document) else 1)
    return {one["device"]: one for one in said.document}


def test_the_simulated_devices_pass_the_check_and_identify_themselves() -> None:
    said = kingfisher("check", "--rig", SMALL_RIG)
    assert said.code == 0, said.out + said.err
    devices, _, buses = said.out.partition("\n\n")
    header, *lines = devices.splitlines()
    assert header.split()[:4] == ["DEVICE", "SERIAL", "LINK", "FIRMWARE"]
    rows = {line.split()[0]: line.split()[1] for line in lines}
    assert rows == dict.fromkeys(["camera.left", "camera.right", "board", "keys", "projector", "display"], "ok")
    assert lines[0].split()[:6] == ["camera.left", "ok", "KF-CAM-L", "5000", "Mbit/s", "1.0"]
    assert "KF-CAM-L (USB3 Vision, bus" in buses
    assert "KF-CAM-R (USB3 Vision, bus" in buses
    assert "1209:4b46" in buses
    assert "HDMI-A-1 on /dev/dri/card0 (1024×768 60.00 Hz" in buses
    assert "DP-1 on /dev/dri/card0 (800×480 60.00 Hz" in buses


def test_the_check_names_what_is_wrong_with_each_device(shell: Shell, tmp_path: Path) -> None:
    def other(text: str) -> str:
        """The rig wants another left camera than the one that is there, and another firmware of the board."""
        return text.replace('serial = "KF-CAM-L"', 'serial = "KF-CAM-7"').replace(
            "[board]", '[board]\nfirmware = "2.0"'
        )

    said = checked(shell, tmp_path, "camera.right slow", "keypad off", change=other)
    assert [name for name, one in said.items() if not one["ok"]] == ["camera.left", "camera.right", "board", "keys"]
    assert "KF-CAM-7 not found" in said["camera.left"]["summary"]
    assert "KF-CAM-L" in said["camera.left"]["summary"]  # which is there in its place
    assert "480 Mbit/s" in said["camera.right"]["summary"]
    assert said["camera.right"]["details"]["serial"] == "KF-CAM-R"
    assert "KF-CAM-L (USB3 Vision" in said["camera.left"]["details"]["there"], (
        "what could be meant stands beside what is missing"
    )
    assert said["keys"]["details"]["there"] == "nothing"
    assert "firmware 1.4.2; the rig file wants 2.0" in said["board"]["summary"]
    assert all(". " in said[name]["summary"] for name in ("camera.left", "camera.right", "board", "keys"))  # a remedy


def test_a_device_that_does_not_answer_fails_the_check(shell: Shell, tmp_path: Path) -> None:
    said = checked(shell, tmp_path, "camera.right off")
    assert [name for name, one in said.items() if not one["ok"]] == ["camera.right"]
    assert "KF-CAM-R" in said["camera.right"]["summary"]


def test_the_check_leaves_a_running_instrument_alone(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(SMALL_RIG.read_text().replace('root = "/var/tmp/kingfisher-sim"', f'root = "{tmp_path}"'))
    with hold_lock(tmp_path):
        said = kingfisher("check", "--rig", rig)
    assert said.code == 1
    assert f"is running (process {os.getpid()})" in said.error
    assert "systemctl stop kingfisher" in said.error


def test_a_calibration_is_never_replaced(shell: Shell, tmp_path: Path) -> None:
    for run, out in ((kingfisher, ()), (shell, ("--out", tmp_path / "x.json"))):
        first = run("calibration", "nominal", "--rig", SMALL_RIG, "--root", tmp_path, *out, "--json")
        assert first.code == 0, first.err
        path = Path(first.document["file"])
        before = path.read_bytes()
        again = shell("calibration", "nominal", "--rig", SMALL_RIG, "--root", tmp_path, *out)
        assert again.code == 2
        assert str(path) in again.error
        assert path.read_bytes() == before
    said = shell("calibration", "nominal", "--out", tmp_path / "no" / "x.json")
    assert (said.code, "no folder" in said.error) == (2, True)


# --------------------------------------------------------------------------------------------- sim


@pytest.mark.parametrize(
    ("script", "code", "words"),
    [
        ("press fire", 2, ("line 1: press fire", "allowed are scan, back, up, down")),
        ("wait state REVIEW 1", 3, ("line 1: wait state REVIEW 1", "after 1 s the state is")),
    ],
)
def test_a_script_says_at_which_line_it_failed(
    script: str, code: int, words: tuple[str, ...], shell: Shell, tmp_path: Path
) -> None:
    path = tmp_path / "dive.script"
    path.write_text(script + "\n")
    said = shell("sim", "--rig", SMALL_RIG, "--root", tmp_path / "root", "--script", path)
    assert said.code == code
    last = said.err.splitlines()[-1]
    for word in words:
        assert word in last


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--fault", "camera.left explode"), ("camera.left explode", "supported: camera.left|right intermittent")),
        (("--truth", SMALL_RIG), ("truth", "small.toml", "nominal, realistic")),
        (("--rig", ROOT / "appliance" / "rigs" / "kingfisher.toml"), ("drivers.native:open", "kingfisher run")),
    ],
)
def test_an_option_that_the_world_refuses_is_wrong_usage(
    options: tuple[object, ...], words: tuple[str, ...], shell: Shell, tmp_path: Path
) -> None:
    said = shell("sim", "--rig", SMALL_RIG, "--root", tmp_path / "root", *options)
    assert said.code == 2
    for word in words:
        assert word in said.error
