"""Stored scans become one object by the command line: placed against the truth, or left out with a reason."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from appliance.calibrate.health import OVERLAP_LIMIT
from appliance.cli.main import main
from appliance.desk import object_store as objects
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS
from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument, load_calibration
from appliance.store.library import Library
from appliance.store.ply import PlyError, read_ply
from hw_sim.objects.motion import pose_matrix
from hw_sim.scene import Scene
from tests.appliance.store.scenes import ORIGIN, frames, record
from tests.support.commands import notebook_says
from tests.support.drawn import drawing
from tests.support.rendered import render_scan
from tests.support.stored import store
from tests.support.truth import complete_calibration, left_to_rig

POSES = {
    "000001": (0.0, 0.0, 545.0, 5.0, -8.0, 12.0),
    "000002": (35.0, -20.0, 550.0, -3.0, 4.0, 22.0),
    "000003": (60.0, 10.0, 540.0, 4.0, 2.0, 5.0),
}
BARE = "000004"
NUMBERS = {"000001": 2, "000003": 2, BARE: 3}
"""Objects that the diver said they belong to."""


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("dive")
    (root / "scans").mkdir()
    scenes = {name: Scene(object="shell", pose=pose, ambient=0.01) for name, pose in POSES.items()}
    scenes[BARE] = Scene(object="plane", texture="none", ambient=0.01)
    for name, scene in scenes.items():
        scan = render_scan(scene, "realistic", 5, 400, 16)
        store(scan, root / "scans" / name, exposure_ms=12.0, belongs_to=NUMBERS.get(name))
        truth = scan.renderer.truth
    (root / "calibration").mkdir()
    (root / "calibration" / "truth.json").write_bytes(encode_calibration(complete_calibration(truth)))
    # The true place of each view, for the tests.
    origin = left_to_rig(truth, np.zeros((1, 3)))[0]
    axes = (left_to_rig(truth, np.eye(3)) - origin).T
    np.savez(root / "frame.npz", origin=origin, axes=axes)
    return root


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A root with scans of these numbers that show nothing."""
    library = Library(tmp_path / "small")
    library.prepare()
    for k in range(1, 5):
        said = record(object=NUMBERS.get(f"{k:06d}"))
        library.begin(frames(k), said, ORIGIN).publish(said)
    rig = load_rig()
    (library.root / "calibration").mkdir()
    (library.root / "calibration" / "truth.json").write_bytes(encode_calibration(Instrument(rig).design()))
    return library.root


def run(root: Path, *words: str) -> int:
    return main(["object", *words, "--root", str(root)])


def cloud(root: Path, name: str, *words: str) -> int:
    return main(["cloud", f"object:{name}", *words, "--spacing", "1", "--root", str(root), *calibrated(root)])


def calibrated(root: Path) -> tuple[str, ...]:
    return ("--calibration", str(root / "calibration" / "truth.json"), "--foreign-calibration")


@pytest.mark.dive
def test_scans_of_a_shell_are_placed_and_a_bare_plane_is_left_out(
    dive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dive, "add", "find", "000001", "000002") == 0
    capsys.readouterr()
    out = dive / "find.ply"
    code = run(dive, "solve", "find", "000003", BARE, "--json", *calibrated(dive))
    assert code == 5, "a scan is left out, and a program notices"
    solved = objects.read_object(dive, "find")
    assert solved.places is not None
    assert sorted(solved.places.places) == sorted(POSES)
    assert list(solved.places.left_out) == [BARE]
    printed = json.loads(capsys.readouterr().out)
    assert printed["places"]["left_out"] == solved.places.left_out
    assert cloud(dive, "find", "--out", str(out)) == 0
    with np.load(dive / "frame.npz") as kept:
        origin, axes = kept["origin"], kept["axes"]
    middle = np.array([0.0, 0.0, 530.0])

    def at_object(name: str, point: NDArray[np.float64]) -> NDArray[np.float64]:
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


def vertices_of(path: Path) -> Any:
    """The vertices of a PLY file, by another library."""
    with path.open("rb") as opened:
        return trimesh.load(opened, file_type="ply").metadata["_ply_raw"]["vertex"]["data"]


@pytest.mark.dive
def test_a_solved_object_is_written_again_in_every_form_without_solving(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dive, "add", "kept", *sorted(POSES)) == 0
    assert cloud(dive, "kept", "--out", str(tmp_path / "x.ply")) == 1
    assert "is not solved: kingfisher object solve 'kept'" in capsys.readouterr().err
    again, grid_file, mesh, page = (tmp_path / name for name in ("again.ply", "grids.npz", "mesh.ply", "page.html"))
    assert run(dive, "solve", "kept", *calibrated(dive)) == 0
    before = (dive / "objects" / "kept" / "object.json").read_bytes()
    assert cloud(dive, "kept", "--out", str(again), "--out", str(grid_file)) == 0
    assert cloud(dive, "kept", "--out", str(mesh), "--mesh", "--close-holes", "30") == 0
    words = ("object:kept", "--out", str(page), "--spacing", "1", "--root", str(dive), *calibrated(dive))
    assert (main(["report", *words]), "kept" in page.read_text(encoding="utf-8")) == (0, True)
    assert (dive / "objects" / "kept" / "object.json").read_bytes() == before
    read: Any = trimesh.load(mesh, process=False)
    assert len(read.faces) > 5_000

    # Each scan's grid, put where it lies, is on the surface of all of them.
    places = objects.read_object(dive, "kept").places
    assert places is not None
    points = vertices_of(again)
    parts = sum(points[f"sigma_{part}_mm"] ** 2 for part in ("beside", "place", "bending"))
    np.testing.assert_allclose(points["sigma"] ** 2, parts, rtol=1e-4)
    assert np.median(points["sigma_bending_mm"]) > 0.005, "the usual bow of a calibration that states none"
    surface = cKDTree(np.stack([points[axis] for axis in "xyz"], 1))
    with np.load(grid_file) as grids:
        assert grids["scans"].tolist() == sorted(POSES)
        for name in POSES:
            grid = np.stack([grids[f"{name}/{axis}_mm"] for axis in "xyz"], -1)
            at = grid[grids[f"{name}/mask"]] @ grids[f"{name}/rotation"].T + grids[f"{name}/translation_mm"]
            assert np.median(surface.query(at[::50])[0]) < 1.0
            np.testing.assert_allclose(grids[f"{name}/place_covariance"], places.places[name].covariance)


@pytest.mark.dive
def test_the_notebook_about_objects_runs_from_the_first_cell_to_the_last(
    dive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(dive, "add", "book", "000001", "000002") == 0
    assert run(dive, "solve", "book", *calibrated(dive)) == 0
    monkeypatch.setenv("KINGFISHER_ROOT", str(dive))
    monkeypatch.setenv("KINGFISHER_OBJECT", "book")
    monkeypatch.setenv("KINGFISHER_CALIBRATION", str(dive / "calibration" / "truth.json"))
    monkeypatch.chdir(tmp_path)
    text = notebook_says("first_object.ipynb")
    assert "accepted: True" in text
    # The same two scans by the verb, and by hand.
    (off_um,) = re.findall(r"led from where the object has it: ([0-9.]+) µm", text)
    (laid_um,) = re.findall(r"laid on within ([0-9]+) µm", text)  # moved by a millimetre, and back
    apart, sigma_um = re.findall(r"([0-9.]+) mm, sigma ([0-9]+) µm", text)[0]  # the shell's middle, from two places
    assert (float(off_um) < 20.0, float(laid_um) < 30.0) == (True, True)
    assert (10.0 < float(apart) < 60.0, 0.0 < float(sigma_um) < 200.0) == (True, True)
    assert {"object.ply", "coarse.ply"} == {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("object show nothing", 1, "object 'nothing': there is none"), ("object add alone 000001", 1, "already"), ("object solve alone", 1, "at least 2"),
        ("cloud object:alone --out x.xyz", 2, ".ply, .e57, .las"), ("cloud object:alone --out x.las --close-holes 5", 2, "--close-holes"),
        ("cloud object:alone --out x.las --scans", 2, "--scans"), ("cloud object:alone --mesh --out x.las", 2, "--out FILE.ply --mesh"),
        ("cloud object:alone --out x.html", 2, "kingfisher report"), ("object add none --taken-as 7", 2, "there are 2, 3"),
        ("object add alone", 2, "--taken-as"), ("compare object:alone none.stl", 1, "none.stl"), ("cloud 1 object:alone", 2, "give it alone"),
        ("report 1 object:alone", 2, "or one object"), ("cloud 1 --spacing 1", 2, "--spacing: is for objects"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_with_an_object_is_refused_in_a_line(
    words: str, code: int, said: str, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(small, "add", "alone", "000001") == 0
    more = calibrated(small) if words.startswith("object solve") else ()
    assert main([*words.split(), "--root", str(small), *more]) == code
    assert said in capsys.readouterr().err


def members(root: Path, name: str) -> list[str]:
    return [one.name for one in objects.read_object(root, name).scans]


def test_the_scans_of_an_object_of_the_dive_are_collected_by_its_number(
    small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(small, "add", "two", "--taken-as", "2") == 0
    assert members(small, "two") == ["000001", "000003"]
    assert run(small, "add", "two", "000002", "--taken-as", "2") == 0
    assert members(small, "two") == ["000001", "000003", "000002"], "what it has is not added again"
    assert run(small, "add", "two", "--taken-as", "3") == 0
    assert members(small, "two")[-1] == BARE
    capsys.readouterr()
    assert main(["scans", "list", "--json", "--root", str(small)]) == 0
    assert {one["scan"]: one["object"] for one in json.loads(capsys.readouterr().out)} == {"000002": None, **NUMBERS}


@pytest.mark.dive
@pytest.mark.parametrize(("wrong_by", "alarms"), [(0.0, False), (0.008, True)])
def test_what_overlaps_tell_of_the_calibration_goes_into_its_health(
    dive: Path, capsys: pytest.CaptureFixture[str], wrong_by: float, alarms: bool
) -> None:
    """Ten micrometres are stated. One lens's third-order distortion is wrong by 0.008, which bends the depth by some tenths of a millimetre."""
    true = load_calibration(dive / "calibration" / "truth.json")
    lens = true.rig.right.lens
    k1, k2, p1, p2, k3 = lens.distortion
    right = replace(true.rig.right, lens=replace(lens, distortion=(k1 + wrong_by, k2, p1, p2, k3)))
    stated = tuple(tuple(row) for row in (0.01**2 * np.eye(DEPTH_ERROR_TERMS)).tolist())
    bent = replace(true, rig=replace(true.rig, right=right), depth_error_mm2=stated)
    used = dive / "calibration" / "current.json"
    used.write_bytes(encode_calibration(bent))
    name = f"bent {wrong_by}"
    try:
        words = ("--calibration", str(used), "--foreign-calibration", "--json")
        assert run(dive, "solve", name, *sorted(POSES), *words) == 0
        score = json.loads(capsys.readouterr().out)["places"]["shared_error_score"]
        assert (score > OVERLAP_LIMIT) is alarms
        assert main(["calibration", "show", "--root", str(dive), "--json"]) == 0
        shown = json.loads(capsys.readouterr().out)["health"]
    finally:
        used.unlink()
    assert [one["object"] for one in shown["overlaps"]] == [name]
    assert shown["overlaps"][0]["score"] == pytest.approx(score)
    assert (shown["alarm"] is not None) is alarms
    if alarms:
        assert f"scans of object {name} overlap as with a common depth error" in shown["alarm"]


@pytest.mark.dive
def test_a_solved_object_and_a_scan_are_compared_with_a_drawing(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vertices, faces = drawing("shell", (-106.0, -81.0, -42.0), (106.0, 81.0, 13.0))
    # The drawing has a shallow dimple that the shell has not: there the shell stands out.
    dimple_mm = 0.8 * np.exp(-((vertices[:, 0] - 20.0) ** 2 + vertices[:, 1] ** 2) / (2.0 * 8.0**2))
    vertices[:, 2] += dimple_mm * (vertices[:, 2] < np.median(vertices[:, 2]))
    file, out, page = dive / "shell.stl", dive / "off.ply", dive / "off.html"
    trimesh.Trimesh(vertices, faces, process=False).export(file)
    assert run(dive, "add", "drawn", "000001", "000002") == 0
    assert run(dive, "solve", "drawn", *calibrated(dive)) == 0
    capsys.readouterr()
    of_dive = ("--root", str(dive), *calibrated(dive))
    outs = ("--tolerance", "0.3", "--out", str(out), "--out", str(page))
    assert main(["compare", "object:drawn", str(file), "--json", "--spacing", "0.8", *outs, *of_dive]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["fitting_percent"] > 95.0, said["warnings"], said["rms_mm"] < 0.15) == (True, [], True)
    assert 0.4 < said["percentiles_mm"]["99.5"] < 0.7, "of the dimple"
    assert 0.5 < said["out_of_tolerance_percent"] < 5.0
    read = vertices_of(out)
    at, off = np.stack([read[axis] for axis in "xyz"], 1), read["deviation_mm"]
    # In the drawing's frame, and positive where the shell stands out of the drawing.
    from_dimple_mm = np.hypot(at[:, 0] - 20.0, at[:, 1])
    assert 0.6 < np.median(off[from_dimple_mm < 3.0]) < 0.85
    assert abs(np.nanmedian(off[from_dimple_mm > 30.0])) < 0.02
    assert "shell.stl" in page.read_text()

    # An object may stand for a drawing, and a scan be compared with it; a thing of another form is told.
    assert main(["compare", "000003", "object:drawn", "--json", "--spacing", "0.8", *of_dive]) == 0
    measured = json.loads(capsys.readouterr().out)
    assert measured["nominal"] == "object drawn"
    # Nine tenths of a millimetre between its pixels: most of it follows the surface, and borders do not.
    assert measured["percentiles_mm"]["84"] - measured["percentiles_mm"]["16"] < 0.12
    wrong = dive / "wrong.stl"
    trimesh.creation.box((40.0, 40.0, 40.0)).export(wrong)
    assert main(["compare", "000001", str(wrong), *of_dive]) == 1
    assert "is it the same thing" in capsys.readouterr().err
    assert run(dive, "solve", "alone", "000001", BARE, *calibrated(dive)) == 1
    assert "left out" in capsys.readouterr().out


def test_what_cannot_be_compared_is_refused_in_a_line(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = str(small / "wrong.stl")
    trimesh.creation.box((40.0, 40.0, 40.0)).export(wrong)
    for words, code, said in (
        ((str(small / "none.stl"),), 1, "none.stl"), (("object:nobody",), 1, "object 'nobody'"), ((wrong, "--out", str(small / "x.stl")), 2, ".stl"),
    ):  # fmt: skip
        assert main(["compare", "000001", *words, "--root", str(small), *calibrated(small)]) == code
        assert said in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["compare", "000001", wrong, "--start", "1,2,3", "--root", str(small)])
    assert "six numbers" in capsys.readouterr().err
