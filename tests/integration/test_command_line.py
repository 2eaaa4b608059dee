"""`kingfisher check`, `sim`, `calibration` and `health` on the command line, with right words and wrong ones."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from appliance.calibrate.health import HealthFile, HealthTrend, TrendPoint
from appliance.store.instrument import load_calibration
from appliance.store.lock import hold_lock
from appliance.store.names import CALIBRATION_FILE
from tests.support.commands import ROOT, Shell, kingfisher

SMALL_RIG = ROOT / "hw_sim" / "rigs" / "small.toml"


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    """Commands in this process: starting one is most of what they take. A few have a process of their own all the same."""
    monkeypatch.setattr("faulthandler.enable", lambda **_: None)  # a process has one, and here it is the test run's
    return Shell(capsys)


def test_the_simulated_devices_pass_the_check_and_identify_themselves() -> None:
    said = kingfisher("check", "--rig", SMALL_RIG)
    assert said.code == 0, said.out + said.err
    devices, _, buses = said.out.partition("\n\n")
    header, *lines = devices.splitlines()
    assert header.split()[:4] == ["DEVICE", "SERIAL", "LINK", "FIRMWARE"]
    rows = {line.split()[0]: line.split()[1] for line in lines}
    assert rows == dict.fromkeys(["camera.left", "camera.right", "board", "keys", "projector", "display"], "ok")
    assert lines[0].split()[:6] == ["camera.left", "ok", "KF-CAM-L", "5000", "Mbit/s", "1.0"]
    for words in ("KF-CAM-L (USB3", "1209:4b46", "HDMI-A-1 on /dev/dri/card0 (1024×768 60.00 Hz", "DP-1 on"):
        assert words in buses


def test_the_check_names_what_is_wrong_with_each_device(shell: Shell, tmp_path: Path) -> None:
    """The rig wants another left camera than the one that is there, and another firmware of the board."""
    text = SMALL_RIG.read_text(encoding="utf-8").replace('serial = "KF-CAM-L"', 'serial = "KF-CAM-7"')
    text = text.replace("[board]", '[board]\nfirmware = "2.0"')
    faults = '[rig.wires_options]\nfaults = ["camera.right slow", "keypad off"]'
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace("[rig.wires_options]", faults), encoding="utf-8")
    done = shell("check", "--rig", rig, "--json")
    assert done.code == 1
    said = {one["device"]: one for one in done.document}
    assert [name for name, one in said.items() if not one["ok"]] == ["camera.left", "camera.right", "board", "keys"]
    assert "KF-CAM-7 not found" in said["camera.left"]["summary"]
    assert "480 Mbit/s" in said["camera.right"]["summary"]
    assert "firmware 1.4.2; the rig file wants 2.0" in said["board"]["summary"]
    # What could be meant stands beside what is missing.
    assert "KF-CAM-L (USB3 Vision" in said["camera.left"]["details"]["there"]
    assert said["keys"]["details"]["there"] == "nothing"


def test_beside_a_running_instrument_nothing_is_touched_and_a_wrong_rig_file_is_refused(
    shell: Shell, tmp_path: Path
) -> None:
    rig, root = tmp_path / "rig.toml", tmp_path / "root"
    text = SMALL_RIG.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(root))
    rig.write_text(text, encoding="utf-8")
    with hold_lock(root):
        before = sorted(root.rglob("*"))
        for verb in ("run", "check"):
            said = shell(verb, "--rig", rig)
            assert (said.code != 0, f"process {os.getpid()}" in said.err) == (True, True)
        assert sorted(root.rglob("*")) == before
    rig.write_text(text.replace("exposure_ms = 12.0", "exposure_ms = 0.012", 1), encoding="utf-8")  # seconds were meant
    said = shell("run", "--rig", rig)
    assert (said.code != 0, "camera.left.exposure_ms 0.012" in said.err) == (True, True), said.err


@pytest.mark.parametrize(
    ("script", "code", "word"),
    [("press fire", 2, "scan, back, up, down"), ("wait state REVIEW 1", 3, "after 1 s the state is")],
)
def test_a_script_says_at_which_line_it_failed(script: str, code: int, word: str, shell: Shell, tmp_path: Path) -> None:
    path = tmp_path / "dive.script"
    path.write_text(script + "\n")
    said = shell("sim", "--rig", SMALL_RIG, "--root", tmp_path / "root", "--script", path)
    last = said.err.splitlines()[-1]
    assert (said.code, f"line 1: {script}" in last, word in last) == (code, True, True)


def test_an_alarm_is_taken_back_by_a_length_check_that_is_an_answer_to_it(shell: Shell, tmp_path: Path) -> None:
    root, report = tmp_path / "root", tmp_path / "check.json"
    path = root / CALIBRATION_FILE
    for folder in (root / "scans", path.parent):
        folder.mkdir(parents=True)
    nominal = ("calibration", "show", "nominal", "--rig", SMALL_RIG, "--root", root, "--out", path)
    assert shell(*nominal).code == 0
    before, again = path.read_bytes(), shell(*nominal)
    assert (again.code, str(path) in again.error, path.read_bytes() == before) == (2, True, True), "never replaced"
    used = load_calibration(path).hash
    normal = TrendPoint("000002", (1.0, 0.0, 0.0, 0.0), (1.0,) * 4, 1.0, 1.0, 1.0, False)
    knocked = TrendPoint("000003", (-280.0, 0.0, 0.0, 0.0), (1.0,) * 4, 1.0, 280.0, 279.0, True)
    HealthFile(root, used).write(HealthTrend(judged=3, points=(normal, knocked), alarm="right camera turned"))

    def accepted(calibration: str = used, e_l_percent: float = 0.02, scan: str = "000003") -> tuple[int, str]:
        content = {
            "about": {"calibration": calibration}, "complete": True, "scans": [{"scan": scan, "artefact": "ball-bar"}],
            "summary": {"e_l_ball_bar_percent": e_l_percent},
        }  # fmt: skip
        report.write_text(json.dumps(content))
        done = shell("calibration", "accept", report, "--root", root)
        return done.code, done.err

    def alarm() -> object:
        return shell("calibration", "show", "--json", "--root", root).document["health"]["alarm"]

    for refused, word in (
        (accepted(calibration="0" * 64), "the one in use"),
        (accepted(e_l_percent=0.3), "0.300 %; allowed are up to 0.1 %"),
        (accepted(scan="000002"), "before the alarm of scan 000003"),
    ):
        assert (refused[0], word in refused[1]) == (2, True), refused
    assert alarm() == "right camera turned"
    assert (accepted()[0], alarm()) == (0, None)
    assert accepted()[0] == 2, "there is nothing to accept any more"
