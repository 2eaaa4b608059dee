"""Stored scans become one object by the command line: placed against the truth, or left out with a reason."""

from __future__ import annotations

import contextlib
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from appliance.calibration.depth_error import COUNT
from appliance.calibration.file import encode, load
from appliance.calibration.health import OVERLAP_LIMIT
from appliance.cli.main import main
from appliance.storage import objects
from appliance.storage.ply import PlyError, read_ply
from hw_sim.objects.motion import pose_matrix
from hw_sim.scene import Scene
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
    assert code == 5, "a scan is left out, and a program notices"
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


@pytest.mark.dive
def test_a_solved_object_is_written_again_in_every_form_without_solving(
    dive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dive, "new", "kept", "000001", "000002", "000003") == 0
    assert run(dive, "export", "kept", "--out", str(tmp_path / "x.ply"), *calibrated(dive)) == 1
    assert "is not solved: kingfisher object solve 'kept'" in capsys.readouterr().err
    solved_out = tmp_path / "solved.ply"
    assert run(dive, "solve", "kept", "--out", str(solved_out), "--spacing", "1", *calibrated(dive)) == 0
    file = dive / "objects" / "kept" / "object.json"
    before = file.read_bytes()
    capsys.readouterr()
    outs = [tmp_path / name for name in ("points.las", "grids.npz", "page.html")]
    words = [word for out in outs for word in ("--out", str(out))]
    assert run(dive, "export", "kept", *words, "--spacing", "1", "--json", *calibrated(dive)) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(out) for out in outs]
    again, mesh = tmp_path / "again.ply", tmp_path / "mesh.ply"
    assert run(dive, "export", "kept", "--out", str(again), "--spacing", "1", *calibrated(dive)) == 0
    assert again.read_bytes() == solved_out.read_bytes()
    closed = ("--mesh", "--close-holes", "30", "--spacing", "1")
    assert run(dive, "export", "kept", "--out", str(mesh), *closed, *calibrated(dive)) == 0
    assert file.read_bytes() == before

    with mesh.open("rb") as opened:
        read: Any = trimesh.load(opened, file_type="ply", process=False)
    vertices = read.metadata["_ply_raw"]["vertex"]["data"]
    assert len(read.faces) > 5_000
    assert {"sigma", "red", "nx"} <= set(vertices.dtype.names)
    measured = np.isfinite(vertices["sigma"])
    assert 0.0 < np.median(vertices["sigma"][measured]) < 0.2
    assert vertices["red"].max() > 60

    # Each scan's grid, put where it lies, is on the surface of all of them.
    places = objects.read(dive, "kept").places
    assert places is not None
    with again.open("rb") as opened:
        points = trimesh.load(opened, file_type="ply").metadata["_ply_raw"]["vertex"]["data"]
    surface = np.stack([points[axis] for axis in "xyz"], 1)
    np.testing.assert_allclose(
        points["sigma"] ** 2,
        points["sigma_beside_mm"] ** 2 + points["sigma_place_mm"] ** 2 + points["sigma_bending_mm"] ** 2,
        rtol=1e-4,
    )
    assert np.median(points["sigma_bending_mm"]) > 0.005, "the usual bow of a calibration that states none"
    with np.load(outs[1]) as grids:
        assert grids["scans"].tolist() == sorted(POSES)
        assert json.loads(str(grids["about"]))["unit"] == "mm"
        for name in POSES:
            grid = np.stack([grids[f"{name}/{axis}_mm"] for axis in "xyz"], -1)
            assert grid.shape == (300, 400, 3)
            at = grid[grids[f"{name}/mask"]] @ grids[f"{name}/rotation"].T + grids[f"{name}/translation_mm"]
            assert np.median(cKDTree(surface).query(at[::50])[0]) < 1.0
            np.testing.assert_allclose(grids[f"{name}/place_covariance"], places.places[name].covariance)
            assert np.isfinite(grids[f"{name}/sigma_mm"][grids[f"{name}/mask"]]).all()


@pytest.mark.dive
def test_the_notebook_about_objects_runs_from_the_first_cell_to_the_last(
    dive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(dive, "new", "book", "000001", "000002") == 0
    assert run(dive, "solve", "book", *calibrated(dive)) == 0
    notebook = json.loads((Path(__file__).parents[3] / "docs/notebooks/first_object.ipynb").read_text())
    monkeypatch.setenv("KINGFISHER_ROOT", str(dive))
    monkeypatch.setenv("KINGFISHER_OBJECT", "book")
    monkeypatch.setenv("KINGFISHER_CALIBRATION", str(dive / "calibration" / "truth.json"))
    monkeypatch.chdir(tmp_path)
    said = io.StringIO()
    names: dict[str, Any] = {}
    with contextlib.redirect_stdout(said):
        for k, cell in enumerate(notebook["cells"]):
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), f"cell {k}", "exec"), names)
    text = said.getvalue()
    assert "accepted: True" in text
    # The same two scans by the verb, and by hand.
    (off_um,) = re.findall(r"led from where the object has it: ([0-9.]+) µm", text)
    assert float(off_um) < 20.0
    (laid_um,) = re.findall(r"laid on within ([0-9]+) µm", text)
    assert float(laid_um) < 30.0, "moved by a millimetre, and back"
    apart, sigma_um = re.findall(r"([0-9.]+) mm, sigma ([0-9]+) µm", text)[0]
    assert 10.0 < float(apart) < 60.0, "the shell's middle, seen from two places"
    assert 0.0 < float(sigma_um) < 200.0
    assert {"object.ply", "coarse.ply"} == {path.name for path in tmp_path.iterdir()}


@pytest.mark.dive
def test_the_page_says_of_every_scan_and_pair_what_they_are_like(dive: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    assert run(dive, "new", "said", "000001", "000002", BARE) == 0
    assert run(dive, "solve", "said", "--out", str(out), "--spacing", "2", *calibrated(dive)) == 5
    page = out.read_text()
    rows = page[page.index('<table class="scans">') : page.index('<table class="pairs">')].split("<tr>")[2:]
    for row, name in zip(rows, ("000001", "000002", BARE), strict=True):
        cells = [re.sub(r"<[^>]*>", "", cell) for cell in row.split("<td>")]
        assert cells[1] == name
        points, distance, sigma, gap = cells[3:7]
        assert int(points.replace("\u202f", "")) > 10_000
        assert 450 < float(distance.removesuffix(" mm")) < 650
        assert 2.0 < float(sigma.removesuffix(" µm")) < 300.0
        assert 1.0 < float(gap.removesuffix(" µm")) < 300.0
        assert "2031-05-06" in cells[10]
    (pair,) = [
        row for row in page[page.index('<table class="pairs">') :].split("<tr>") if "000001</b> – <b>000002" in row
    ]
    cells = [re.sub(r"<[^>]*>", "", cell) for cell in pair.split("<td>")]
    assert int(cells[4]) > 10, "features in common"
    assert 0.0 < float(cells[7].removeprefix("± ").removesuffix("°")) < 0.1
    assert "Uncertainty over" in page


def test_options_of_meshes_are_refused_where_none_is_written(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dive, "new", "meshless", "000001", "000002") == 0
    assert run(dive, "solve", "meshless", "--out", "x.las", "--close-holes", "5", *calibrated(dive)) == 2
    assert "--close-holes: is for meshes, and none is written" in capsys.readouterr().err
    assert run(dive, "solve", "meshless", "--out", "x.las", "--scans", *calibrated(dive)) == 2
    assert "--scans: is for .e57 files, and none is written" in capsys.readouterr().err
    assert run(dive, "solve", "meshless", "--mesh", *calibrated(dive)) == 2
    assert "give --out FILE.ply --mesh" in capsys.readouterr().err


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


def members(root: Path, name: str) -> list[str]:
    return [one.name for one in objects.read(root, name).scans]


def test_the_scans_of_an_object_of_the_dive_are_collected_by_its_number(
    dive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(dive, "new", "two", "--taken-as", "2") == 0
    assert members(dive, "two") == ["000001", "000003"]
    assert run(dive, "add", "two", "000002", "--taken-as", "2") == 0
    assert members(dive, "two") == ["000001", "000003", "000002"], "what it has is not added again"
    assert run(dive, "add", "two", "--taken-as", "3") == 0
    assert members(dive, "two")[-1] == BARE
    capsys.readouterr()
    assert run(dive, "new", "none", "--taken-as", "7") == 2
    assert "there are 2, 3" in capsys.readouterr().err
    assert run(dive, "add", "two") == 2
    assert "--taken-as" in capsys.readouterr().err
    assert main(["scans", "list", "--json", "--root", str(dive)]) == 0
    assert {one["scan"]: one["object"] for one in json.loads(capsys.readouterr().out)} == {"000002": None, **NUMBERS}


def test_one_call_solves_what_was_taken_as_an_object(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = dive / "taken.ply"
    assert run(dive, "solve", "taken", "--taken-as", "2", "--out", str(out), *calibrated(dive)) == 0
    assert set(objects.read(dive, "taken").places.places) == {"000001", "000003"}  # type: ignore[union-attr]
    assert out.stat().st_size > 100_000


@pytest.mark.dive
@pytest.mark.parametrize(("wrong_by", "alarms"), [(0.0, False), (0.008, True)])
def test_what_overlaps_tell_of_the_calibration_goes_into_its_health(
    dive: Path, capsys: pytest.CaptureFixture[str], wrong_by: float, alarms: bool
) -> None:
    """Ten micrometres are stated. One lens's third-order distortion is wrong by 0.008, which bends the depth by some tenths of a millimetre."""
    true = load(dive / "calibration" / "truth.json")
    lens = true.rig.right.lens
    k1, k2, p1, p2, k3 = lens.distortion
    right = replace(true.rig.right, lens=replace(lens, distortion=(k1 + wrong_by, k2, p1, p2, k3)))
    stated = tuple(tuple(row) for row in (0.01**2 * np.eye(COUNT)).tolist())
    bent = replace(true, rig=replace(true.rig, right=right), depth_error_mm2=stated)
    used = dive / "calibration" / "current.json"
    used.write_bytes(encode(bent))
    name = f"bent {wrong_by}"
    try:
        words = ("--calibration", str(used), "--foreign-calibration", "--json")
        assert run(dive, "solve", name, *sorted(POSES), *words) == 0
        score = json.loads(capsys.readouterr().out)["places"]["shared_error_score"]
        assert (score > OVERLAP_LIMIT) is alarms
        assert main(["health", "show", "--root", str(dive), "--json"]) == 0
        shown = json.loads(capsys.readouterr().out)
    finally:
        used.unlink()
    assert [one["object"] for one in shown["overlaps"]] == [name]
    assert shown["overlaps"][0]["score"] == pytest.approx(score)
    assert (shown["alarm"] is not None) is alarms
    if alarms:
        assert f"scans of object {name} overlap as if all were bent" in shown["alarm"]


def test_scans_that_slide_alone_end_with_an_error_and_say_why(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(dive, "new", "apart", "000001", BARE) == 0
    assert run(dive, "solve", "apart", *calibrated(dive)) == 1
    shown = capsys.readouterr().out
    assert "left out" in shown
    assert run(dive, "show") == 0
    assert "apart" in capsys.readouterr().out


def test_a_solved_object_and_a_scan_are_compared_with_a_drawing(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vertices, faces = drawing("shell", (-106.0, -81.0, -42.0), (106.0, 81.0, 13.0))
    # The drawing has a shallow dimple that the shell has not: there the shell stands out.
    dimple_mm = 0.8 * np.exp(-((vertices[:, 0] - 20.0) ** 2 + vertices[:, 1] ** 2) / (2.0 * 8.0**2))
    dimple_mm *= vertices[:, 2] < np.median(vertices[:, 2])
    vertices[:, 2] += dimple_mm
    file, out, page = dive / "shell.stl", dive / "off.ply", dive / "off.html"
    trimesh.Trimesh(vertices, faces, process=False).export(file)
    assert run(dive, "new", "drawn", "000001", "000002") == 0
    assert run(dive, "solve", "drawn", *calibrated(dive)) == 0
    capsys.readouterr()
    given = (str(file), "--root", str(dive), "--json", "--spacing", "0.8", *calibrated(dive))
    assert (
        main(["object", "compare", "drawn", "--tolerance", "0.3", "--out", str(out), "--out", str(page), *given]) == 0
    )
    said = json.loads(capsys.readouterr().out)
    assert said["fitting_percent"] > 95.0
    assert said["warnings"] == []
    assert said["rms_mm"] < 0.15
    assert 0.4 < said["percentiles_mm"]["99.5"] < 0.7, "of the dimple"
    assert 0.5 < said["out_of_tolerance_percent"] < 5.0
    with out.open("rb") as opened:
        read = trimesh.load(opened, file_type="ply").metadata["_ply_raw"]["vertex"]["data"]
    at, off = np.stack([read[axis] for axis in "xyz"], 1), read["deviation_mm"]
    # In the drawing's frame, and positive where the shell stands out of the drawing.
    inside = np.hypot(at[:, 0] - 20.0, at[:, 1]) < 3.0
    assert 0.6 < np.median(off[inside]) < 0.85
    assert abs(np.nanmedian(off[np.hypot(at[:, 0] - 20.0, at[:, 1]) > 30.0])) < 0.02
    assert "shell.stl" in page.read_text()

    # An object may stand for a drawing, and a scan be compared with it.
    assert main(["compare", "000003", "drawn", *given[1:]]) == 0
    measured = json.loads(capsys.readouterr().out)
    assert measured["nominal"] == "object drawn"
    # Nine tenths of a millimetre between its pixels: most of it follows the surface, and borders do not.
    low, high = measured["percentiles_mm"]["16"], measured["percentiles_mm"]["84"]
    assert 0.5 * (high - low) < 0.06


def test_what_cannot_be_compared_is_refused_in_a_line(dive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = dive / "wrong.stl"
    trimesh.creation.box((40.0, 40.0, 40.0)).export(wrong)
    more = ("--root", str(dive), *calibrated(dive))
    assert main(["compare", "000001", str(wrong), *more]) == 1
    assert "must: is it the same thing, in mm" in capsys.readouterr().err
    assert main(["compare", "000001", str(dive / "none.stl"), *more]) == 1
    assert "none.stl: cannot be read" in capsys.readouterr().err
    assert main(["compare", "000001", "nobody", *more]) == 1
    assert "object 'nobody': there is none" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["compare", "000001", str(wrong), "--start", "1,2,3", *more])
    assert "allowed are six numbers" in capsys.readouterr().err
    assert main(["compare", "000001", str(wrong), "--out", str(dive / "x.stl"), *more]) == 2
