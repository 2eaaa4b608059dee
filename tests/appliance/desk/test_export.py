"""The verb ``cloud`` writes what the scan's frames give, one file for each scan, and refuses the rest in one line."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.output import Exit
from appliance.measure.calibration.file import encode_calibration
from appliance.store.instrument import Instrument
from tests.support.commands import Shell
from tests.support.e57 import read_e57
from tests.support.planes import small_rig, store_plane

Plane = tuple[Path, Path, np.ndarray]
"""A stored scan, the file of its calibration, and the points that the instrument had."""


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Plane:
    root = tmp_path_factory.mktemp("plane")
    rig = small_rig(root / "storage")
    folder, points = store_plane(rig)
    (root / "calibration.json").write_bytes(encode_calibration(Instrument(rig).design()))
    return folder, root / "calibration.json", points


def test_points_of_one_scan_are_the_instruments_in_the_formats_unit(
    shell: Shell, plane: Plane, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, calibration, points = plane
    monkeypatch.chdir(tmp_path)
    unnamed = shell("cloud", folder, "--calibration", calibration)
    assert (unnamed.code, unnamed.lines["file"]) == (Exit.OK, f"{folder.name}.ply"), "the scan's name, in this folder"
    for more, wanted in ((), False), (("--normals",), True):
        assert shell("cloud", folder, *more, "--calibration", calibration, "--out", "plane.ply").code == Exit.OK
        assert (b"property float nx" in (tmp_path / "plane.ply").read_bytes()[:900]) == wanted
    said = shell("cloud", folder, "--calibration", calibration, "--out", "plane.e57", "--json")
    # On a busy machine it says what it is at.
    assert (said.code, "error" in said.err or "warning" in said.err) == (Exit.OK, False)
    assert said.document["unit"] == "m"
    columns = read_e57(tmp_path / "plane.e57").columns
    found_mm = 1000.0 * np.stack([columns[f"cartesian{axis}"] for axis in "XYZ"], 1)
    np.testing.assert_allclose(found_mm, points, atol=0.001)  # in the order of the pixels, as the instrument has them


def test_many_scans_are_one_file_each_or_refused(shell: Shell, plane: Plane, tmp_path: Path) -> None:
    folder, calibration, points = plane
    other, pattern = tmp_path / "000042", tmp_path / "of-{}.npz"
    shutil.copytree(folder, other)
    for scans, out, said in (
        ((folder, other), "all.ply", "put {} where"),
        ((folder, folder), pattern, "both would be"),
    ):
        refused = shell("cloud", *scans, "--calibration", calibration, "--out", tmp_path / out)
        assert (refused.code, said in refused.error) == (Exit.USAGE, True)
    assert not list(tmp_path.glob("*.npz"))
    written = shell("cloud", folder, other, "--calibration", calibration, "--out", pattern, "--json").document
    assert [Path(str(one["file"])).name for one in written] == [f"of-{folder.name}.npz", "of-000042.npz"]
    for name in (folder.name, "000042"):
        with np.load(tmp_path / f"of-{name}.npz") as grid:
            assert (grid["mask"].shape, int(grid["mask"].sum())) == ((300, 400), len(points))
            # The bright image is that of the pattern that lights everything.
            assert np.median(grid["grey"][grid["mask"]]) > 150


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--out", "plane.xyz"), ".ply, .e57, .las, .npz, .stl, .obj, not as .xyz"), (("--out", "plane.npz", "--mesh"), ".ply, .stl, .obj, not as .npz"),
        (("--out", "nowhere/plane.ply"), "nowhere"),
    ],
)  # fmt: skip
def test_what_cannot_be_written_is_refused_before_the_work(
    words: tuple[str, ...], said: str, shell: Shell, plane: Plane, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = shell("cloud", plane[0], *words)
    assert (found.code, said in found.error, list(tmp_path.iterdir())) == (Exit.USAGE, True, [])
