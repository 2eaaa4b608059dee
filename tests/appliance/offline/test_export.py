"""The verb ``export`` writes what the scan's frames give, in the format that the suffix names, and refuses the rest in one line."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from appliance.calibration.file import encode
from appliance.cli.output import Exit
from appliance.instrument import design_of
from tests.support.commands import Shell
from tests.support.e57 import read_e57
from tests.support.planes import NORMAL, small_rig, store_plane

Plane = tuple[Path, Path, NDArray[np.float32]]
"""A stored scan, the file of its calibration, and the points that the instrument had."""


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Plane:
    root = tmp_path_factory.mktemp("plane")
    rig = small_rig(root / "storage")
    folder, points = store_plane(rig)
    (root / "calibration.json").write_bytes(encode(design_of(rig)))
    return folder, root / "calibration.json", points


def test_points_mesh_and_grid_of_one_scan(
    shell: Shell, plane: Plane, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, calibration, points = plane

    def export(name: str, *more: str) -> dict[str, object]:
        said = shell("export", folder, "--calibration", calibration, "--out", tmp_path / name, "--json", *more)
        # On a busy machine it says what it is at.
        assert (said.code, "error" in said.err or "warning" in said.err) == (Exit.OK, False)
        document: dict[str, object] = said.document
        return document

    assert export("plane.e57")["unit"] == "m"
    read = read_e57(tmp_path / "plane.e57")
    found = 1000.0 * np.stack([read.columns[f"cartesian{axis}"] for axis in "XYZ"], 1)
    # In the order of the pixels, as the instrument has them.
    np.testing.assert_allclose(found, points, atol=0.001)
    report = export("plane.stl", "--mesh")
    assert (report["unit"], report["format"]) == ("mm", "stl")
    mesh: Any = trimesh.load(tmp_path / "plane.stl", process=False)
    assert len(mesh.triangles) == report["faces"]
    # The plane's own normal, towards the camera.
    np.testing.assert_allclose(np.average(mesh.face_normals, axis=0, weights=mesh.area_faces), -NORMAL, atol=0.01)
    export("plane.npz")
    monkeypatch.chdir(tmp_path)
    unnamed = shell("export", folder, "--calibration", calibration)
    assert (unnamed.code, unnamed.lines["file"]) == (Exit.OK, f"{folder.name}.ply"), "the scan's name, in this folder"
    with np.load(tmp_path / "plane.npz") as grid:
        assert grid["mask"].shape == (300, 400)
        assert int(grid["mask"].sum()) == len(points)
        # The bright image is that of the pattern that lights everything.
        assert np.median(grid["grey"][grid["mask"]]) > 150


def test_many_scans_are_one_file_each_or_refused(shell: Shell, plane: Plane, tmp_path: Path) -> None:
    folder, calibration, points = plane
    other = tmp_path / "000042"
    shutil.copytree(folder, other)
    one_file = shell("export", folder, other, "--calibration", calibration, "--out", tmp_path / "all.ply")
    assert (one_file.code, "put {} where" in one_file.error) == (Exit.USAGE, True)
    pattern = tmp_path / "of-{}.npz"
    twice = shell("export", folder, folder, "--calibration", calibration, "--out", pattern)
    assert (twice.code, "both would be written" in twice.error) == (Exit.USAGE, True)
    assert not list(tmp_path.glob("*.npz"))
    said = shell("export", folder, other, "--calibration", calibration, "--out", pattern, "--json")
    assert said.code == Exit.OK
    assert [Path(str(one["file"])).name for one in said.document] == [f"of-{folder.name}.npz", "of-000042.npz"]
    for name in (folder.name, "000042"):
        with np.load(tmp_path / f"of-{name}.npz") as grid:
            assert int(grid["mask"].sum()) == len(points)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--out", "plane.xyz"), ".ply, .e57, .las, .npz, not as .xyz"), (("--out", "plane.stl"), "not as .stl"),
        (("--out", "plane.npz", "--mesh"), ".ply, .stl, .obj, not as .npz"), (("--out", "nowhere/plane.ply"), "nowhere"),
    ],
)  # fmt: skip
def test_what_cannot_be_written_is_refused_before_the_work(
    words: tuple[str, ...], said: str, shell: Shell, plane: Plane, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    found = shell("export", plane[0], *words)
    assert found.code == Exit.USAGE
    assert said in found.error
    assert not list(tmp_path.iterdir())
