"""`kingfisher calibration water` on stored scans of a hidden rig: its ports are found, and the report says how well."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.cli import main
from appliance.measure.calibration.file import encode_calibration
from appliance.measure.light.model import StereoRig
from appliance.measure.light.port import Port
from appliance.store.instrument import load_calibration
from hw_sim.objects.shapes import BALL_RADIUS_MM
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig
from tests.support.calibrating import CALIBRATION_BARS, CALIBRATION_PLANES
from tests.support.rendered import render_scan
from tests.support.stored import store
from tests.support.truth import true_calibration

SD = [0.05, 0.05, 0.05, 1e-3, 3e-3, 1e-5, 1e-5, 3e-3] * 2 + [1e-5] * 3 + [0.01] * 3
"""Of a calibration in air, in the order of its parameters."""
DRAWN = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
Bench = tuple[Path, TrueRig]
Capture = pytest.CaptureFixture[str]
FOUR = ("bar-0", "bar-1", "plane-0", "plane-1")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The published four recordings, a list of them, and the calibration in air: lenses as they are, ports as drawn."""
    folder = tmp_path_factory.mktemp("water")
    for name, pose in zip(FOUR, (*CALIBRATION_BARS, *CALIBRATION_PLANES), strict=True):
        shown = "ballbar" if name.startswith("bar") else "plane"
        scan = render_scan(Scene(object=shown, pose=(*pose.at_mm, *pose.turns_deg)), "modelled", 3, 400, 16, 0.008)
        store(scan, folder / name)
    truth = scan.renderer.truth
    calibration = true_calibration(truth, "KF-0001")
    start = replace(
        calibration,
        method="air",
        rig=StereoRig(replace(calibration.rig.left, port=DRAWN), replace(calibration.rig.right, port=DRAWN)),
        air_covariance=tuple(tuple(float(v) for v in row) for row in np.diag(np.square(SD))),
    )
    (folder / "air.json").write_bytes(encode_calibration(start))
    (folder / "list.toml").write_text(listed(truth, *FOUR))
    return folder, truth


def listed(truth: TrueRig, *names: str) -> str:
    """A list in which whatever is no bar is called a plane."""
    length = f"length_mm = {truth.artefacts.ball_distance_mm}\nlength_sd_mm = 0.002\nradius_mm = {BALL_RADIUS_MM}\n"
    kinds = {"bar": f'artefact = "ball-bar"\n{length}serial = "KB-<7>"\n'}
    scans = (f'[[scan]]\nscan = "./{n}"\n' + kinds.get(n.partition("-")[0], 'artefact = "plane"\n') for n in names)
    return 'operator = "Ada & Co"\n' + "".join(scans)


def calibrate(folder: Path, *more: str, name: str = "list.toml", start: str = "air.json") -> int:
    words = ["--root", str(folder), "--calibration", str(folder / start)]
    return main(["calibration", "water", str(folder / name), *words, *more])


def tilt_deg(normal: tuple[float, float, float]) -> np.ndarray:
    return np.degrees(np.array(normal[:2]) / normal[2])


def test_the_ports_of_a_hidden_rig_are_found_installed_and_taken_back(bench: Bench) -> None:
    folder, truth = bench
    out, current = folder / "found.json", folder / "calibration" / "current.json"
    restore = ["calibration", "use", "--root", str(folder)]
    current.parent.mkdir()
    before = (folder / "air.json").read_bytes()
    current.write_bytes(before)
    assert main(restore) == 2, "there was none before"
    assert calibrate(folder, "--out", str(out), "--install") == 0
    found = load_calibration(out)
    assert (found.method, found.rig_serial) == ("bundle, spline", "KF-0001")
    assert found.made_at.startswith("20")
    assert [text for text in found.made_from if text.startswith("recording")] == [f"recording {one}" for one in FOUR]
    for side in ("left", "right"):
        port, true = getattr(found.rig, side).port, truth.eye(side).port
        off_deg = np.abs(tilt_deg(port.normal) - tilt_deg(true.normal))[1]
        assert off_deg < max(0.02, 0.2 * np.abs(tilt_deg(true.normal)[1]))
        assert abs(port.distance_mm - true.d_mm) < 1.0
    said = json.loads((folder / "found-report.json").read_text())
    assert (said["about"]["calibration"], said["about"]["artefact_serials"]) == (found.hash, "KB-<7>")
    assert said["residual_px"] < 0.06
    assert {r["name"] for r in said["recordings"]} == set(FOUR)
    assert len(said["estimates"]) == 28
    assert said["costs"][-1] < 0.01 * said["costs"][0]
    assert load_calibration(current) == found
    assert main(restore) == 0
    assert current.read_bytes() == before
    assert main([*restore, str(folder / "air.json")]) == 2, "nothing measures with one in air"
    assert main([*restore, str(out)]) == 0
    assert load_calibration(current) == found
    assert main(restore) == 0
    assert current.read_bytes() == before


def test_the_published_way_writes_its_three_models_and_replaces_none(bench: Bench, capsys: Capture) -> None:
    folder, _ = bench
    out = folder / "paper.json"
    assert calibrate(folder, "--out", str(out), "--method", "paper") == 0
    pm, rm, rmd = (load_calibration(folder / f"{name}.json") for name in ("paper-pm", "paper-rm", "paper"))
    assert pm.rig.left.lens_in_water
    assert (rm.method, rmd.method) == ("search of distances", "search of distances, operator")
    assert pm.made_at == rm.made_at == rmd.made_at
    said = json.loads((folder / "paper-report.json").read_text())
    assert said["before"]["rm"] == {"calibration": rm.hash, "residual_px": rm.residual_px}
    assert said["residual_px"] < 0.1 * (rm.residual_px or 0.0)
    out.unlink()
    assert calibrate(folder, "--out", str(out), "--method", "paper") == 2
    assert "paper-pm.json exists already" in capsys.readouterr().err


def test_a_scan_without_its_artefact_is_left_out_and_nothing_is_installed(bench: Bench, capsys: Capture) -> None:
    folder, truth = bench
    (folder / "wrong.toml").write_text(listed(truth, "bar-0", "plane-0").replace("./plane-0", "./bar-1"))
    more = ["--out", str(folder / "rest.json"), "--method", "ports", "--install"]
    assert calibrate(folder, *more, name="wrong.toml") == 1
    said = capsys.readouterr().out
    assert "bar-1 not used: " in said
    assert "not installed" in said
    assert (folder / "rest.json").exists()


def test_what_cannot_be_done_is_said_and_replaces_nothing(bench: Bench, capsys: Capture) -> None:
    folder, truth = bench
    (folder / "taken.json").write_text("precious")
    frustum = '[[scan]]\nscan = "./plane-0"\nartefact = "frustum"\ntop_mm = 80.0\n'
    (folder / "frustum.toml").write_text(listed(truth, *FOUR) + frustum)
    (folder / "planes.toml").write_text(listed(truth, "plane-0"))
    (folder / "other.json").write_bytes(
        encode_calibration(replace(load_calibration(folder / "air.json"), rig_serial="KF-0002"))
    )
    for out, name, start, code, words in (
        ("taken", "list", "air", 2, "exists already"),
        ("none", "frustum", "air", 2, "remove it from the list"),
        ("none", "planes", "air", 1, "record a ball bar"),
        ("none", "list", "other", 1, "is of instrument KF-0002; this one is KF-0001"),
    ):
        assert (
            calibrate(folder, "--out", str(folder / f"{out}.json"), name=f"{name}.toml", start=f"{start}.json") == code
        )
        assert words in capsys.readouterr().err
    assert (folder / "taken.json").read_text() == "precious"
    assert not (folder / "none.json").exists()
