"""Which files are whose camera's images is told by their names, their number and their shape, before anything is decoded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from appliance.desk.foreign.description import ImageFiles
from appliance.desk.foreign.files import camera_files, exchange_sides, in_halves, in_turns
from appliance.desk.foreign.frames import Frame
from appliance.desk.foreign.problem import ForeignError


def told(folder: Path) -> str:
    """Each camera's side, its pattern and its images; or why there is none."""
    try:
        found = camera_files(folder)
    except ForeignError as error:
        return str(error)
    return "; ".join(
        f"{side} {one.patterns[0]}: {' '.join(f.path.stem for f in one.frames)}" for side, one in found.items()
    )


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        ("10 9 8", "left *.png: 8 9 10"),
        ("1_right/0 1_right/1 1_right/2 2_left/0 2_left/1 2_left/2", "left 2_left/*.png: 0 1 2; right 1_right/*.png: 0 1 2"),
        ("r0 r1 r2 l0 l1 l2", "left l*.png: l0 l1 l2; right r*.png: r0 r1 r2"),
        ("a_cam0 b_cam0 c_cam0 a_cam1 b_cam1 c_cam1", "left *cam0*.png: a_cam0 b_cam0 c_cam0; right *cam1*.png: a_cam1 b_cam1"),
        ("0 1 2 calib/1 mask", "left *.png: 0 1 2"),
        ("board0 board1 board2", "left *.png: board0 board1 board2"),
        ("1 2", "2 images; allowed are 3 to 2000; give the folder of one set"),
        ("a/1 a/2 b/1", "the names of its 3 images do not show the camera"),
        ("a/0 a/1 a/2 b/0 b/1 b/2 c/0 c/1 c/2", "the names of its 9 images do not show the camera"),
    ],
)  # fmt: skip
def test_cameras_are_told_by_the_names_of_their_files(tmp_path: Path, names: str, wanted: str) -> None:
    for name in names.split():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.png").touch()
    assert wanted in told(tmp_path)


@pytest.mark.parametrize(
    ("names", "wanted"),
    [("s3", "left a.npz#s3: a a a"), ("right3 left3", "left a.npz#left3: a a a; right a.npz#right3: a a a"),
     ("s2", "0 images; allowed"), ("left4 right3", "0 images; allowed"), ("a3 b3 c3", "0 images; allowed")],
)  # fmt: skip
def test_one_or_two_stacks_of_as_many_images_are_cameras(tmp_path: Path, names: str, wanted: str) -> None:
    content: dict[str, Any] = {name: np.zeros((int(name[-1]), 9, 9), np.uint8) for name in names.split()}
    np.savez(tmp_path / "a.npz", **content)
    assert wanted in told(tmp_path)


@pytest.mark.parametrize(
    ("shape", "wanted"),
    [((10, 19), ""), ((10, 20), "left beside right"), ((12, 10), ""), ((13, 10), "left above right")],
)
def test_only_a_long_picture_may_be_two(tmp_path: Path, shape: tuple[int, int], wanted: str) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros(shape, np.uint8))
    one = ImageFiles(("*.png",), frames=(Frame(tmp_path / "0.png"),))
    assert [[half.sides for half in both.values()] for both in in_halves(one)] == ([[wanted] * 2] if wanted else [])


@pytest.mark.parametrize(("count", "wanted"), [(4, []), (7, []), (6, ["024", "135", "012", "345"])])
def test_an_even_number_of_images_may_be_taken_in_turns(count: int, wanted: list[str]) -> None:
    one = ImageFiles(("*.png",), frames=tuple(Frame(Path(str(k))) for k in range(count)))
    ways = list(in_turns(one))
    assert ["".join(frame.name for frame in side.frames) for way in ways for side in way.values()] == wanted
    turned = [exchange_sides(way)["left"] for way in ways]
    assert [one.frames for one in turned] == [way["right"].frames for way in ways]
    assert [one.sides for one in turned] == ["right left", "right*3 left*3"][: len(ways)]
