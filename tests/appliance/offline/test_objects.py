"""Stored scans become one object by the command line: placed against the truth, or left out with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.file import encode
from appliance.cli.main import main
from appliance.storage import objects
from appliance.storage.ply import PlyError, read_ply
from hw_sim.objects.motion import pose_matrix
from hw_sim.scene import Scene
from tests.support.rendered import render_scan
from tests.support.stored import store
from tests.support.truth import complete_calibration, left_to_rig

POSES = {
    "000001": (0.0, 0.0, 545.0, 5.0, -8.0, 12.0),
    "000002": (35.0, -20.0, 550.0, -3.0, 4.0, 22.0),
    "000003": (60.0, 10.0, 540.0, 4.0, 2.0, 5.0),
}
BARE = "000004"


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("dive")
    (root / "scans").mkdir()
    scenes = {name: Scene(object="shell", pose=pose, ambient=0.01) for name, pose in POSES.items()}
    scenes[BARE] = Scene(object="plane", texture="none", ambient=0.01)
    for name, scene in scenes.items():
        scan = render_scan(scene, "realistic", 5, 400, 16)
        store(scan, root / "scans" / name, exposure_ms=12.0)
        truth = scan.renderer.truth
    (root / "calibration").mkdir()
    (root / "calibration" / "truth.json").write_bytes(encode(complete_calibration(truth)))
    # The true place of each view, for the tests.
    origin = left_to_rig(truth, np.zeros((1, 3)))[0]
    axes = (left_to_rig(truth, np.eye(3)) - origin).T
    np.savez(root / "frame.npz", origin=origin, axes=axes)
    return root


def run(root: Path, *words: str) -> int:
    return main(["object", *words, "--root", str(root)])


def calibrated(root: Path) -> tuple[str, ...]:
    return ("--calibration", str(root / "calibration" / "truth.json"), "--foreign-calibration")


def test_scans_of_a_shell_are_placed_and_a_bare_plane_is_left_out(
    dive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dive, "new", "find", "000001", "000002") == 0
    capsys.readouterr()
    out = dive / "find.ply"
    code = run(dive, "solve", "find", "000003", BARE, "--out", str(out), "--spacing", "1", "--json", *calibrated(dive))
    assert code == 0
    solved = objects.read(dive, "find")
    assert solved.places is not None
    assert sorted(solved.places.places) == sorted(POSES)
    assert list(solved.places.left_out) == [BARE]
    printed = json.loads(capsys.readouterr().out)
    assert printed["places"]["left_out"] == solved.places.left_out
    with np.load(dive / "frame.npz") as kept:
        origin, axes = kept["origin"], kept["axes"]
    middle = np.array([0.0, 0.0, 530.0])

    def at_object(
        name: str, point: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        R, t = pose_matrix(POSES[name])
        return np.asarray((axes @ point + origin - t) @ R)

    for name, place in solved.places.places.items():
        there = np.array(place.rotation) @ middle + np.array(place.translation_mm)
        # Brought to the object by the first scan's true place, it must be where this scan's own brings the middle.
        off = np.linalg.norm(at_object("000001", there) - at_object(name, middle))
        assert off < 0.08 + 3.0 * place.sigma_mm
        assert place.sigma_mm < 0.1
    assert out.stat().st_size > 100_000
    with pytest.raises(PlyError):
        read_ply(out)  # a surface of many scans does not pass for one scan's cloud


def test_what_is_asked_of_an_unknown_object_or_one_scan_is_refused_in_a_line(
    dive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dive, "show", "nothing") == 1
    assert "object 'nothing': there is none" in capsys.readouterr().err
    assert run(dive, "new", "alone", "000001") == 0
    assert run(dive, "solve", "alone", *calibrated(dive)) == 1
    assert "at least 2 are needed" in capsys.readouterr().err
    assert run(dive, "solve", "alone", "--out", str(dive / "x.xyz")) == 2
    assert ".ply, .e57, .las" in capsys.readouterr().err
    assert run(dive, "new", "alone") == 2
    assert run(dive, "add", "alone", "000001") == 1
    assert "is in it already" in capsys.readouterr().err


def test_scans_that_slide_alone_end_with_an_error_and_say_why(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dive, "new", "apart", "000001", BARE) == 0
    assert run(dive, "solve", "apart", *calibrated(dive)) == 1
    shown = capsys.readouterr().out
    assert "left out" in shown
    assert run(dive, "show") == 0
    assert "apart" in capsys.readouterr().out
