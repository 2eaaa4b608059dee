"""Foreign conventions, from image files to points that lie on the true surface; and each wrong word is noticed and named."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.base import silent
from appliance.cli.output import Exit
from appliance.desk.foreign.importing import import_described
from appliance.desk.foreign.problem import ForeignError
from tests.support.commands import Shell
from tests.support.foreign_sets import ForeignSet
from tests.support.truth import left_to_rig

Sets = Callable[[str], ForeignSet]
NEED_FOUR_STEPS = "need four steps of 90° in two directions with bright and dark"


def judged(made: ForeignSet, points_mm: NDArray[np.float32], there: NDArray[np.bool_]) -> tuple[float, float]:
    """Completeness against what all three eyes see, and the median distance from the true surface in mm."""
    seen = made.renderer.view("left", 0.0).seen_by_all
    distance = made.renderer.surface(0.0).distance_mm(left_to_rig(made.renderer.truth, points_mm[there]))
    return float((there & seen).sum() / seen.sum()), float(np.median(np.abs(distance)))


def points_of(grid: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
    return np.stack([grid[f"{axis}_mm"] for axis in "xyz"], -1)


# Two directions are made of a folder, below; the strangers' sets have a code alone, and several periods.
@pytest.mark.parametrize("name", ["eight-steps", "half-off"])
def test_points_of_another_rig_lie_on_the_surface(foreign_set: Sets, tmp_path: Path, name: str) -> None:
    made = foreign_set(name)
    out = tmp_path / "cloud.npz"
    report = import_described(made.description, out, silent)
    with np.load(out) as grid:
        there = grid["mask"]
        complete, off_mm = judged(made, points_of(grid), there)
        sigma_mm = float(np.median(grid["sigma_mm"][there]))
    assert report["points"] == int(there.sum()) > 10_000
    assert complete > 0.94
    assert off_mm < 0.08
    # What is said of the noise is of the size of the errors.
    assert 0.2 < sigma_mm / off_mm < 8.0
    assert report["wrong"] == []
    # With one direction nothing has checked the points, and the report says so.
    assert report["unchecked"][0].startswith("fringes of one direction only")
    assert report["gap_mm"] is None
    # All judges need the same, or are asked later: one line says so, not one for each.
    assert sum("motion" in line for line in report["unchecked"]) == 1
    assert sum(report["reasons"].values()) == there.size - report["points"]


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        ("three-steps", [("bright dark", "dark bright")], "are exchanged"),
        ("inverses", [("gray-x ~gray-x", "~gray-x gray-x")], "x.code_inverted = true"),
    ],
)  # fmt: skip
def test_a_wrong_word_is_named_with_what_fits(
    foreign_set: Sets, tmp_path: Path, name: str, changes: list[tuple[str, str]], said: str
) -> None:
    described = foreign_set(name).described(*changes)
    with pytest.raises(ForeignError, match=re.escape(said)):
        import_described(described, tmp_path / "cloud.ply", silent)
    assert not (tmp_path / "cloud.ply").exists()


def test_a_calibration_without_scale_makes_a_cloud_in_baselines(foreign_set: Sets, tmp_path: Path) -> None:
    made = foreign_set("three-steps")
    folder = made.description.parent
    numbers = cv2.FileStorage(str(folder / "stereo.yml"), cv2.FILE_STORAGE_READ)
    unscaled = cv2.FileStorage(str(folder / "unscaled.yml"), cv2.FILE_STORAGE_WRITE)
    length_mm = float(np.linalg.norm(numbers.getNode("T").mat()))
    for name in ("M1", "D1", "M2", "D2", "R"):
        unscaled.write(name, numbers.getNode(name).mat())
    unscaled.write("T", np.asarray(numbers.getNode("T").mat(), np.float64) / length_mm)
    unscaled.release()
    whole = import_described(made.description, tmp_path / "cloud.npz", silent)
    report = import_described(made.described(('"stereo.yml"', '"unscaled.yml"')), tmp_path / "cloud.las", silent)
    assert report["unit"] == "baselines"
    assert [note.partition(":")[0] for note in report["notes"]] == ["cameras.unit"]
    assert whole["notes"] == []
    assert report["baseline_baselines"] == pytest.approx(1.0)
    assert report["distance_baselines"] * length_mm == pytest.approx(whole["distance_mm"], rel=1e-4)
    assert report["points"] == pytest.approx(whole["points"], rel=1e-3)


def test_of_one_direction_texture_checks_the_cameras(shell: Shell, foreign_set: Sets, tmp_path: Path) -> None:
    made = foreign_set("eight-steps")
    found = shell("import", made.description, "--out", tmp_path / "cloud.npz", "--json")
    for about in ("cameras: which is left", "cameras: rotation and translation"):
        assert any(line.startswith(about) for line in found.document["fits"])
    assert any(line.startswith("cameras: a rotation about the columns: ") for line in found.document["unchecked"])
    assert found.document["unchecked"][-1].endswith(NEED_FOUR_STEPS)
    other = made.described(('left = "cam0', 'left = "camX'), ('right = "cam1', 'right = "cam0'), ("camX", "cam1"))
    refused = shell("import", other, "--out", tmp_path / "cloud.npz")
    assert "cameras: which is left" in refused.error


def test_a_wrong_word_may_be_insisted_on_and_the_file_tells(foreign_set: Sets, tmp_path: Path) -> None:
    # Phases of both cameras are wrong alike: points are there, and the file says what the images say against them.
    described, out = (
        foreign_set("eight-steps").described(("start_deg = 180", "start_deg = 130")),
        tmp_path / "cloud.npz",
    )
    with pytest.raises(ForeignError, match="contradict it"):
        import_described(described, out, silent)
    import_described(described, out, silent, as_described=True)
    with np.load(out) as grid:
        notes = json.loads(str(grid["about"]))["notes"]
    wrong = r"wrong: left: x.start_deg: phase and code are 5\d degrees apart: they fit with x.start_deg = 180"
    assert any(re.match(wrong, note) for note in notes)
    assert any(note.startswith("unchecked: fringes of one direction only") for note in notes)


def test_a_folder_becomes_a_cloud_and_a_description_that_works(shell: Shell, foreign_set: Sets, tmp_path: Path) -> None:
    made = foreign_set("two-directions")
    folder = made.description.parent
    found = shell("import", folder, "--out", tmp_path / "cloud.npz", "--json")
    assert found.code == Exit.OK, found.err
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "cloud.cloud.png",
        "cloud.npz",
        "cloud.roles.png",
        "cloud.toml",
    ]
    assert shell("import", tmp_path / "cloud.toml", "--out", tmp_path / "again.npz").code == Exit.OK
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "cloud.npz").read_bytes()
    said = shell("import", folder, "--out", tmp_path / "cloud.npz")
    assert said.code == Exit.USAGE
    assert "cloud.toml exists already; import it" in said.err
    with np.load(tmp_path / "cloud.npz") as grid:
        complete, off_mm = judged(made, points_of(grid), grid["mask"])
    assert complete > 0.94
    assert off_mm < 0.08
    assert found.document["gap_mm"] is not None
