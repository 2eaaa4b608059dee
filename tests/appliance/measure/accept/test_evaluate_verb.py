"""`kingfisher evaluate` on stored scans of simulated artefacts: true errors, a page that stands alone, reasons in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from appliance.cli import main
from appliance.measure.calibration.file import encode_calibration
from hw_sim.objects.shapes import FRUSTUM_BASE_MM, FRUSTUM_TOP_MM
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig
from tests.support.rendered import render_scan
from tests.support.stored import store
from tests.support.truth import true_calibration

Bench = tuple[Path, TrueRig]
Capture = pytest.CaptureFixture[str]
ARTEFACTS = ("ballbar", "plane", "frustum")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A folder with a scan of each artefact, and the calibration that states the truth."""
    folder = tmp_path_factory.mktemp("bench")
    truth = None
    for name in ARTEFACTS:
        scan = render_scan(Scene(object=name), "modelled", 3, 400, 16)
        truth = scan.renderer.truth
        store(scan, folder / name)
    assert truth is not None
    (folder / "calibration.json").write_bytes(encode_calibration(true_calibration(truth, "KF-<7>")))
    return folder, truth


def evaluate(folder: Path, text: str, name: str = "list.toml", calibration: str = "calibration.json") -> int:
    (folder / name).write_text(text)
    argv = ["evaluate", str(folder / name), "--root", str(folder), "--out", str(folder / "report.html")]
    return main([*argv, "--calibration", str(folder / calibration), "--foreign-calibration"])


@pytest.fixture(scope="module")
def listed(bench: Bench) -> str:
    """The certificate of the bar is 0.5 % too long and that of the frustum's base 1 %: so are the errors."""
    length = {"length_mm": bench[1].artefacts.ball_distance_mm * 1.005, "length_sd_mm": 0.01}
    radius = {"radius_mm": 15.0, "radius_sd_mm": 0.002, "serial": "KB-7"}
    edges = {"top_mm": FRUSTUM_TOP_MM, "base_mm": FRUSTUM_BASE_MM * 1.01}
    scans = [
        {"scan": "./ballbar", "artefact": "ball-bar", **length, **radius},
        {"scan": "./plane", "artefact": "plane"},
        {"scan": "./frustum", "artefact": "frustum", **edges},
    ]
    return json.dumps({"operator": "Ada & Co", "limits": {"sd_mm": 0.3, "pf_mm": 5.0}, "scan": scans})


@pytest.fixture(scope="module")
def report(bench: Bench, listed: str) -> tuple[Any, str]:
    """What is said to programs, and the page."""
    folder, _ = bench
    assert evaluate(folder, listed, "list.json") == 0
    return json.loads((folder / "report.json").read_text()), (folder / "report.html").read_text()


def test_errors_are_those_of_the_truth(bench: Bench, report: tuple[Any, str]) -> None:
    truth, (said, _) = bench[1], report
    assert said["complete"] is True
    summary = said["summary"]
    assert summary["e_l_ball_bar_percent"] == pytest.approx(100 * (1 - 1 / 1.005), abs=0.012)
    assert summary["e_l_frustum_percent"] == pytest.approx(100 * (1 - 1 / 1.01), abs=0.02)
    assert summary["e_f_sys_percent"] < 0.01 < summary["e_f_percent"] < 0.15
    assert 0.01 < summary["noise_mm"] < 0.06
    bar, plane, frustum = said["scans"]
    assert bar["lengths"][0]["e_l_percent"] < 0.0
    named = [f"{name} {k}" for name in ("top", "base") for k in range(1, 5)]
    assert [length["name"] for length in frustum["lengths"]] == named
    for surface in (one for scan in said["scans"] for one in scan["surfaces"]):
        assert surface["rejected"] <= 0.003 * (surface["points"] + surface["rejected"])
    by = {(one["quantity"], one["of"]): one for one in bar["quantities"]}
    spacing = by["SD", "length"]
    assert spacing["value_mm"] == pytest.approx(-0.005 * truth.artefacts.ball_distance_mm, abs=0.02)
    assert 0.02 < spacing["expanded_uncertainty_mm"] < 0.03, "twice the certificate's 0.01 mm, and some noise"
    assert [by[one]["kept"] for one in (("SD", "length"), ("PF", "first ball"), ("PS", "first ball"))] == [
        "fail", "pass", "no limit stated",
    ]  # fmt: skip
    assert said["limits_kept"] == "fail"
    assert (summary["sd_mm"], summary["f_mm"]) == (spacing["value_mm"], plane["quantities"][0]["value_mm"])
    assert summary["f_mm"] == pytest.approx(2.5 * summary["e_f_percent"])
    assert bar["provenance"]["temperatures_c"] == {"projector": 41.5, "case": None}
    assert (bar["provenance"]["artefact_serial"], said["about"]["operator"]) == ("KB-7", "Ada & Co")


def test_a_scan_listed_twice_and_a_page_over_the_list_are_refused(bench: Bench, capsys: Capture) -> None:
    folder, _ = bench
    (folder / "report.html").unlink(missing_ok=True)
    plane = '[[scan]]\nscan = "{}"\nartefact = "plane"\n'
    assert evaluate(folder, plane.format("./plane") + plane.format(folder / "ballbar" / ".." / "plane")) == 2
    assert "scan[1] ('" in (said := capsys.readouterr().err)
    assert "is scan[0] ('./plane') again" in said
    assert not (folder / "report.html").exists()
    assert evaluate(folder, "{}", "report.json") == 2
    assert "is the list of scans" in capsys.readouterr().err
    assert (folder / "report.json").read_text() == "{}"


def test_what_is_not_there_is_said_and_the_rest_is_evaluated(bench: Bench, capsys: Capture) -> None:
    folder, _ = bench
    bar = {"scan": "./plane", "artefact": "ball-bar", "length_mm": 150.0}
    text = {"scan": [bar, {"scan": "./plane", "artefact": "plane"}]}
    assert evaluate(folder, json.dumps(text), "list.json") == 1
    assert "no ball was found" in capsys.readouterr().out
    said = json.loads((folder / "report.json").read_text())
    assert said["complete"] is False
    assert said["summary"]["e_l_ball_bar_percent"] is None
    assert said["summary"]["e_f_percent"] > 0.0
    assert "Not evaluated: no ball was found" in (folder / "report.html").read_text()


def test_a_wrong_list_is_refused_in_one_line(tmp_path: Path, capsys: Capture) -> None:
    path, out, scan = tmp_path / "list.toml", tmp_path / "report.html", '[[scan]]\nscan = "1"\nartefact = '
    for text, words in (
        ("", "at least one [[scan]]"), ("x", "not readable"), ('colour = "red"', "colour is unknown"),
        (f'{scan}"teapot"', "ball-bar, plane, frustum"), (f'{scan}"ball-bar"', "no calibrated length; give length_mm"),
        (f'{scan}"ball-bar"\nlength_mm = -3', "1..2000"), (f'{scan}"ball-bar"\nlength_mm = nan', "1..2000"),
        (f'{scan}"plane"\nlength_mm = 150', "scan[0].length_mm is unknown"),
        ('[[scan]]\nscan = 1\nartefact = "plane"', "the scan's number or its folder"), (f'reference_mm = 0\n{scan}"plane"', "10..5000"),
    ):  # fmt: skip
        path.write_text(text)
        assert main(["evaluate", str(path), "--root", str(tmp_path), "--out", str(out)]) == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1
    assert not out.exists()
