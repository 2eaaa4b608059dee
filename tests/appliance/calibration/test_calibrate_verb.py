"""`kingfisher calibrate water` on stored scans of a hidden rig: its ports are found, and the report says how well."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.file import encode, load
from appliance.cli import main
from appliance.optics.model import StereoRig
from appliance.optics.port import Port
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


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TrueRig]:
    """The published four recordings, a list of them, and the calibration in air: lenses as they are, ports as drawn."""
    folder = tmp_path_factory.mktemp("water")
    truth = None
    poses = {"bar": CALIBRATION_BARS, "plane": CALIBRATION_PLANES}
    for name, both in poses.items():
        for k, pose in enumerate(both):
            scene = Scene(object="ballbar" if name == "bar" else name, pose=(*pose.at_mm, *pose.turns_deg))
            scan = render_scan(scene, "modelled", 3, 400, 16, 0.008)
            truth = scan.renderer.truth
            store(scan, folder / f"{name}-{k}")
    assert truth is not None
    rig = true_calibration(truth).rig
    start = replace(
        true_calibration(truth, "KF-0001"),
        method="air",
        rig=StereoRig(replace(rig.left, port=DRAWN), replace(rig.right, port=DRAWN)),
        air_covariance=tuple(tuple(float(v) for v in row) for row in np.diag(np.square(SD))),
    )
    (folder / "air.json").write_bytes(encode(start))
    (folder / "list.toml").write_text(listed(truth))
    return folder, truth


def listed(truth: TrueRig, planes: tuple[str, ...] = ("plane-0", "plane-1")) -> str:
    bars = "".join(
        f'[[scan]]\nscan = "./bar-{k}"\nartefact = "ball-bar"\nlength_mm = {truth.artefacts.ball_distance_mm}\n'
        f'length_sd_mm = 0.002\nradius_mm = {BALL_RADIUS_MM}\nserial = "KB-<7>"\n'
        for k in (0, 1)
    )
    return 'operator = "Ada & Co"\n' + bars + "".join(f'[[scan]]\nscan = "./{p}"\nartefact = "plane"\n' for p in planes)


def calibrate(folder: Path, *more: str, name: str = "list.toml", start: bool = True) -> int:
    begin = ["--start", str(folder / "air.json")] if start else []
    return main(["calibrate", "water", str(folder / name), "--root", str(folder), *begin, *more])


def tilt_deg(normal: tuple[float, float, float]) -> np.ndarray:
    return np.degrees(np.array(normal[:2]) / normal[2])


def test_the_ports_of_a_hidden_rig_are_found(bench: tuple[Path, TrueRig]) -> None:
    folder, truth = bench
    out = folder / "found.json"
    assert calibrate(folder, "--out", str(out)) == 0
    found = load(out)
    assert found.method == "bundle, spline"
    assert found.rig_serial == "KF-0001"
    assert found.made_at.startswith("20")
    assert [text for text in found.made_from if text.startswith("recording")] == [
        f"recording {name}" for name in ("bar-0", "bar-1", "plane-0", "plane-1")
    ]
    for side in ("left", "right"):
        port = getattr(found.rig, side).port
        true = truth.eye(side).port
        before = np.abs(tilt_deg(true.normal)[1])
        assert np.abs(tilt_deg(port.normal) - tilt_deg(true.normal))[1] < max(0.02, 0.2 * before)
        assert abs(port.distance_mm - true.d_mm) < 1.0
    said = json.loads((folder / "found-report.json").read_text())
    assert said["about"]["calibration"] == found.hash
    assert said["about"]["artefact_serials"] == "KB-<7>"
    assert said["residual_px"] < 0.06
    assert {r["name"] for r in said["recordings"]} == {"bar-0", "bar-1", "plane-0", "plane-1"}
    assert len(said["estimates"]) == 28
    assert said["costs"][-1] < 0.01 * said["costs"][0]


def test_the_published_way_writes_its_three_models_and_replaces_none(
    bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = bench
    out = folder / "paper.json"
    assert calibrate(folder, "--out", str(out), "--method", "paper") == 0
    pm, rm, rmd = (load(folder / f"{name}.json") for name in ("paper-pm", "paper-rm", "paper"))
    assert pm.rig.left.lens_in_water
    assert (rm.method, rmd.method) == ("search of distances", "search of distances, operator")
    assert pm.made_at == rm.made_at == rmd.made_at
    said = json.loads((folder / "paper-report.json").read_text())
    assert said["before"]["rm"] == {"calibration": rm.hash, "residual_px": rm.residual_px}
    assert said["residual_px"] < 0.1 * (rm.residual_px or 0.0)
    out.unlink()
    assert calibrate(folder, "--out", str(out), "--method", "paper") == 2
    assert "paper-pm.json exists already" in capsys.readouterr().err


def test_a_scan_without_its_artefact_is_left_out_and_said(
    bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, truth = bench
    (folder / "wrong.toml").write_text(listed(truth, ("plane-0", "plane-1", "bar-0")))
    more = ["--out", str(folder / "rest.json"), "--method", "ports", "--install"]
    assert calibrate(folder, *more, name="wrong.toml") == 1
    said = capsys.readouterr().out
    assert "bar-0 not used: " in said
    assert "not installed" in said
    assert not (folder / "calibration" / "current.json").exists()
    assert (folder / "rest.json").exists()


def test_what_cannot_be_done_is_said_before_the_work(
    bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, truth = bench
    (folder / "taken.json").write_text("precious")
    assert calibrate(folder, "--out", str(folder / "taken.json")) == 2
    assert (folder / "taken.json").read_text() == "precious"
    frustum = listed(truth) + '[[scan]]\nscan = "./plane-0"\nartefact = "frustum"\ntop_mm = 80.0\n'
    (folder / "frustum.toml").write_text(frustum)
    assert calibrate(folder, "--out", str(folder / "none.json"), name="frustum.toml") == 2
    assert "take it out of the list" in capsys.readouterr().err
    assert not (folder / "none.json").exists()


def test_installed_and_taken_back(bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = bench
    current = folder / "calibration" / "current.json"
    root = ["--root", str(folder)]
    assert main(["calibrate", "restore", *root]) == 2
    assert calibrate(folder, "--out", str(folder / "a.json"), "--method", "ports", "--install") == 0
    assert load(current) == load(folder / "a.json")
    assert calibrate(folder, "--out", str(folder / "b.json"), "--method", "spline", "--install") == 0
    assert load(current) == load(folder / "b.json")
    assert main(["calibrate", "restore", *root]) == 0
    assert load(current) == load(folder / "a.json")
    assert main(["calibrate", "restore", *root]) == 0
    assert load(current) == load(folder / "b.json")
    capsys.readouterr()


def test_another_instruments_start_is_refused(bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = bench
    (folder / "other.json").write_bytes(encode(replace(load(folder / "air.json"), rig_serial="KF-0002")))
    assert calibrate(folder, "--start", str(folder / "other.json"), start=False) == 1
    assert "is of instrument KF-0002; this one is KF-0001" in capsys.readouterr().err


def test_planes_alone_calibrate_nothing(bench: tuple[Path, TrueRig], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = bench
    (folder / "planes.toml").write_text('[[scan]]\nscan = "./plane-0"\nartefact = "plane"\n')
    assert calibrate(folder, "--out", str(folder / "none.json"), name="planes.toml") == 1
    assert "record a ball bar" in capsys.readouterr().err
    assert not (folder / "none.json").exists()
