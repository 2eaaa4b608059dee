"""A folder that is being filled with views of a board: whole views only, numbers that only grow, one board, one instrument."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.air.board import BoardDesign
from appliance.offline.calibration.view_folder import FolderError, ViewFolder, read_session
from appliance.storage.atomic import StorageError

LEFT: NDArray[np.uint8] = np.arange(64, dtype=np.uint8).reshape(8, 8)
RIGHT: NDArray[np.uint8] = LEFT[::-1].copy()


def read(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return np.asarray(image, np.uint8)


def test_a_view_is_both_pictures_pixel_by_pixel_under_the_next_number(tmp_path: Path) -> None:
    views = ViewFolder(tmp_path / "new" / "views", "KF-1", None)
    assert views.next_name() == "01"
    views.save("01", LEFT, RIGHT)
    np.testing.assert_array_equal(read(views.folder / "01" / "left.png"), LEFT)
    np.testing.assert_array_equal(read(views.folder / "01" / "right.png"), RIGHT)
    assert {path.name for path in views.folder.iterdir()} == {"board.json", "01"}
    assert views.next_name() == "02"


def test_a_view_that_was_taken_away_does_not_come_back_as_another(tmp_path: Path) -> None:
    views = ViewFolder(tmp_path, "KF-1", None)
    for name in ("01", "02", "99"):
        views.save(name, LEFT, RIGHT)
    shutil.rmtree(tmp_path / "02")
    (tmp_path / "7").mkdir()
    (tmp_path / "120 of another day").mkdir()
    assert views.next_name() == "100"


def test_who_goes_on_finds_the_folders_board_and_what_a_loss_of_power_left_of_a_view_is_gone(tmp_path: Path) -> None:
    made = ViewFolder(tmp_path, "KF-1", None)
    made.save("01", LEFT, RIGHT)
    (tmp_path / ".02").mkdir()
    (tmp_path / ".02" / "left.png").write_bytes(b"half")
    (tmp_path / ".git").mkdir()
    again = ViewFolder(tmp_path, "KF-1", None)
    assert again.design == made.design == BoardDesign()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".git", "01", "board.json"]
    assert read_session(tmp_path) == ("KF-1", BoardDesign())
    assert read_session(tmp_path / "01") is None


def test_views_of_another_instrument_or_board_are_not_mixed(tmp_path: Path) -> None:
    usual = BoardDesign()
    ViewFolder(tmp_path, "KF-1", usual)
    with pytest.raises(FolderError, match=r"FOLDER .*: views of instrument KF-1; this one is KF-2; give another"):
        ViewFolder(tmp_path, "KF-2", None)
    text = str(usual)
    content = json.loads((tmp_path / "board.json").read_text())
    assert content == {"schema": 1, "rig_serial": "KF-1", "board": text}
    other = replace(usual, across=14)
    with pytest.raises(FolderError, match=rf"FOLDER .*: views of board {text}, not "):
        ViewFolder(tmp_path, "KF-1", other)
    assert ViewFolder(tmp_path, "KF-1", usual).design == usual


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"{", "cannot be read"),
        (b'{"schema": 2, "rig_serial": "KF-1", "board": "x"}', "schema 2; this version reads 1; give another folder"),
        (b'{"schema": 1, "rig_serial": "KF-1"}', "cannot be read .*board"),
        (
            b'{"schema": 1, "rig_serial": "KF-1", "board": "x"}',
            "cannot be read .* restore it, or remove it and give --board",
        ),
        (b"[1]", "cannot be read"),
    ],
)
def test_a_damaged_session_is_refused_with_what_to_do(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "board.json").write_bytes(content)
    with pytest.raises(FolderError, match=words):
        ViewFolder(tmp_path, "KF-1", None)
    assert (tmp_path / "board.json").read_bytes() == content


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match=r"cannot make .*file/views"):
        ViewFolder(tmp_path / "file" / "views", "KF-1", None)
