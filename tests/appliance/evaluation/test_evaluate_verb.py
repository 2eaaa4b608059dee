"""`kingfisher evaluate` on stored scans of simulated artefacts: true errors, a page that stands alone, reasons in words."""

from __future__ import annotations

import base64
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.calibration.file import encode
from appliance.cli import main
from appliance.optics.model import HousedCamera, StereoRig
from hw_sim.objects.shapes import FRUSTUM_BASE_MM, FRUSTUM_TOP_MM
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig
from tests.support.rendered import render_scan
from tests.support.stored import store
from tests.support.truth import true_calibration

ARTEFACTS = ("ballbar", "plane", "frustum")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TrueRig]:
    """A folder with a scan of each artefact, and the calibration that states the truth."""
    folder = tmp_path_factory.mktemp("bench")
    truth = None
    for name in ARTEFACTS:
        scan = render_scan(Scene(object=name), "modelled", 3, 400, 16)
        truth = scan.renderer.truth
        store(scan, folder / name)
    assert truth is not None
    (folder / "calibration.json").write_bytes(encode(true_calibration(truth, "KF-<7>")))
    return folder, truth


def evaluate(folder: Path, text: str, name: str = "list.toml", calibration: str = "calibration.json") -> int:
    (folder / name).write_text(text)
    argv = ["evaluate", str(folder / name), "--root", str(folder), "--out", str(folder / "report.html")]
    return main([*argv, "--calibration", str(folder / calibration), "--foreign-calibration"])


def listed(length_mm: float) -> str:
    return f"""
operator = "Ada & Co"
[limits]
sd_mm = 0.3
pf_mm = 5.0
[[scan]]
scan = "./ballbar"
artefact = "ball-bar"
length_mm = {length_mm}
length_sd_mm = 0.01
radius_mm = 15.0
radius_sd_mm = 0.002
serial = "KB-7"
[[scan]]
scan = "./plane"
artefact = "plane"
[[scan]]
scan = "./frustum"
artefact = "frustum"
top_mm = {FRUSTUM_TOP_MM}
base_mm = {FRUSTUM_BASE_MM * 1.01}
"""


def test_errors_are_those_of_the_truth(bench: tuple[Path, TrueRig]) -> None:
    """The certificate of the bar is 0.5 % too long and that of the frustum's base 1 %: so are the errors."""
    folder, truth = bench
    assert evaluate(folder, listed(truth.artefacts.ball_distance_mm * 1.005)) == 0
    said = json.loads((folder / "report.json").read_text())
    assert said["complete"] is True
    summary = said["summary"]
    assert summary["e_l_ball_bar_percent"] == pytest.approx(100 * (1 - 1 / 1.005), abs=0.012)
    assert summary["e_l_frustum_percent"] == pytest.approx(100 * (1 - 1 / 1.01), abs=0.02)
    assert summary["e_f_sys_percent"] < 0.01 < summary["e_f_percent"] < 0.15
    assert 0.01 < summary["noise_mm"] < 0.06
    bar, _, frustum = said["scans"]
    assert bar["lengths"][0]["e_l_percent"] < 0.0
    assert [length["name"] for length in frustum["lengths"]] == [
        f"{n} {k}" for n in ("top", "base") for k in range(1, 5)
    ]
    for scan in said["scans"]:
        for surface in scan["surfaces"]:
            assert surface["rejected"] <= 0.003 * (surface["points"] + surface["rejected"])
    by = {(one["quantity"], one["of"]): one for one in bar["quantities"]}
    spacing = by["SD", "length"]
    assert spacing["value_mm"] == pytest.approx(-0.005 * truth.artefacts.ball_distance_mm, abs=0.02)
    assert 0.02 < spacing["expanded_uncertainty_mm"] < 0.03, "twice the certificate's 0.01 mm, and some noise"
    assert (spacing["kept"], by["PF", "first ball"]["kept"]) == ("fail", "pass")
    assert (by["PS", "first ball"]["kept"], said["limits_kept"]) == ("no limit stated", "fail")
    assert (summary["sd_mm"], summary["f_mm"]) == (
        spacing["value_mm"], said["scans"][1]["quantities"][0]["value_mm"],
    )  # fmt: skip
    assert summary["f_mm"] == pytest.approx(2.5 * summary["e_f_percent"])
    assert bar["provenance"]["temperatures_c"] == {"projector": 41.5, "case": None}
    assert bar["provenance"]["artefact_serial"] == "KB-7"
    assert said["about"]["operator"] == "Ada & Co"


def test_a_scan_listed_twice_is_refused_before_it_counts_twice(
    bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = bench
    (folder / "report.html").unlink(missing_ok=True)
    plane = '[[scan]]\nscan = "{}"\nartefact = "plane"\n'
    assert evaluate(folder, plane.format("./plane") + plane.format(folder / "ballbar" / ".." / "plane")) == 2
    assert "scan[1] ('" in (said := capsys.readouterr().err)
    assert "is scan[0] ('./plane') once more" in said
    assert not (folder / "report.html").exists()


def test_a_wrong_calibration_cannot_hide_its_errors(bench: tuple[Path, TrueRig]) -> None:
    """Ports tilted by 0.3° and moved by 3 mm: on the instrument no point would pass, here the errors are measured."""
    folder, truth = bench
    text = listed(truth.artefacts.ball_distance_mm)
    assert evaluate(folder, text) == 0
    right = json.loads((folder / "report.json").read_text())
    true = true_calibration(truth)
    tilt = math.tan(math.radians(0.3))

    def moved(camera: HousedCamera, sign: float) -> HousedCamera:
        normal = np.add(camera.port.normal, (0.0, sign * tilt, 0.0))
        normal /= np.linalg.norm(normal)
        n = (float(normal[0]), float(normal[1]), float(normal[2]))
        return replace(camera, port=replace(camera.port, normal=n, distance_mm=camera.port.distance_mm + 3.0 * sign))

    rig = StereoRig(moved(true.rig.left, 1.0), moved(true.rig.right, -1.0))
    (folder / "wrong.json").write_bytes(encode(replace(true, rig=rig)))
    assert evaluate(folder, text, calibration="wrong.json") == 0
    wrong = json.loads((folder / "report.json").read_text())
    for a, b in zip(right["scans"], wrong["scans"], strict=True):
        assert b["provenance"]["points"] == pytest.approx(a["provenance"]["points"], rel=0.01)
        assert a["provenance"]["ray_gap_mm"] < 0.1 < 1.0 < b["provenance"]["ray_gap_mm"]
    assert wrong["summary"]["e_l_ball_bar_percent"] > 3.0 * right["summary"]["e_l_ball_bar_percent"]


def test_the_page_stands_alone(bench: tuple[Path, TrueRig]) -> None:
    folder, truth = bench
    assert evaluate(folder, listed(truth.artefacts.ball_distance_mm)) == 0
    page = (folder / "report.html").read_text()
    assert not re.search(r"https?://|<script|<link", page)
    sources = re.findall(r'src="([^"]*)"', page)
    assert len(sources) == 2 * (2 + 1 + 6)  # a map and a histogram of each surface
    for source in sources:
        data = base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True)
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert image.std() > 10.0
    assert "after VDI/VDE 2634" in page
    assert "no limit stated" in page
    assert "expanded" in page
    assert "Ada &amp; Co" in page
    assert "KF-&lt;7&gt;" in page
    assert json.loads((folder / "report.json").read_text())["about"]["calibration"] in page


def test_what_is_not_there_is_said_and_the_rest_is_evaluated(
    bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = bench
    text = {
        "scan": [
            {"scan": "./plane", "artefact": "ball-bar", "length_mm": 150.0},
            {"scan": "./plane", "artefact": "plane"},
        ]
    }
    assert evaluate(folder, json.dumps(text), "list.json") == 1
    assert "no ball was found" in capsys.readouterr().out
    said = json.loads((folder / "report.json").read_text())
    assert said["complete"] is False
    assert said["summary"]["e_l_ball_bar_percent"] is None
    assert said["summary"]["e_f_percent"] > 0.0
    assert "Not evaluated: no ball was found" in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "at least one [[scan]]"),
        ("x", "not readable"),
        ('colour = "red"', "colour is unknown"),
        ('[[scan]]\nscan = "1"\nartefact = "teapot"', "ball-bar, plane, frustum"),
        ('[[scan]]\nscan = "1"\nartefact = "ball-bar"', "no calibrated length; give length_mm"),
        ('[[scan]]\nscan = "1"\nartefact = "ball-bar"\nlength_mm = -3', "1..2000"),
        ('[[scan]]\nscan = "1"\nartefact = "ball-bar"\nlength_mm = nan', "1..2000"),
        ('[[scan]]\nscan = "1"\nartefact = "plane"\nlength_mm = 150', "scan[0].length_mm is unknown"),
        ('[[scan]]\nscan = 1\nartefact = "plane"', "the scan's number or its folder"),
        ('reference_mm = 0\n[[scan]]\nscan = "1"\nartefact = "plane"', "10..5000"),
    ],
)
def test_a_wrong_list_is_refused_in_one_line(
    tmp_path: Path, text: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "list.toml").write_text(text)
    out = tmp_path / "report.html"
    assert main(["evaluate", str(tmp_path / "list.toml"), "--root", str(tmp_path), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not out.exists()


def test_the_list_is_never_overwritten(bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = bench
    assert evaluate(folder, "{}", "report.json") == 2
    assert "is the list itself" in capsys.readouterr().err
    assert (folder / "report.json").read_text() == "{}"
