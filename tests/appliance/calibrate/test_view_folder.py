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

from appliance.base.sealed_file import ContentError
from appliance.calibrate.air.board import BoardDesign
from appliance.calibrate.pictures import ViewFolder
from appliance.store.atomic import StorageError

LEFT: NDArray[np.uint8] = np.arange(64, dtype=np.uint8).reshape(8, 8)
RIGHT: NDArray[np.uint8] = LEFT[::-1].copy()


def test_a_view_is_both_pictures_pixel_by_pixel_under_a_number_that_only_grows(tmp_path: Path) -> None:
    views = ViewFolder(tmp_path / "new" / "views", "KF-1", None)
    assert views.next_name() == "01"
    views.save("01", LEFT, RIGHT)
    for name, wanted in (("left", LEFT), ("right", RIGHT)):
        image = cv2.imread(str(views.folder / "01" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        np.testing.assert_array_equal(image, wanted)
    assert {path.name for path in views.folder.iterdir()} == {"board.json", "01"}
    for name in ("02", "99"):
        views.save(name, LEFT, RIGHT)
    shutil.rmtree(views.folder / "02")
    for name in ("7", "120 of another day"):
        (views.folder / name).mkdir()
    assert views.next_name() == "100", "one that was taken away does not come back as another"
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match="file/views"):
        ViewFolder(tmp_path / "file" / "views", "KF-1", None)


def test_who_goes_on_finds_the_folders_board_and_what_a_loss_of_power_left_of_a_view_is_gone(tmp_path: Path) -> None:
    usual = BoardDesign()
    ViewFolder(tmp_path, "KF-1", None).save("01", LEFT, RIGHT)
    for name in (".02", ".git"):
        (tmp_path / name).mkdir()
    (tmp_path / ".02" / "left.png").write_bytes(b"half")
    assert ViewFolder(tmp_path, "KF-1", None).design == ViewFolder(tmp_path, "KF-1", usual).design == usual
    assert sorted(path.name for path in tmp_path.iterdir()) == [".git", "01", "board.json"]
    assert ViewFolder.session(tmp_path) == ("KF-1", usual)
    assert ViewFolder.session(tmp_path / "01") is None
    content = json.loads((tmp_path / "board.json").read_text())
    assert content == {"schema": 1, "rig_serial": "KF-1", "board": str(usual)}
    for serial, design, said in (("KF-2", None, "KF-1.*KF-2"), ("KF-1", replace(usual, across=14), f"{usual}, not ")):
        with pytest.raises(ContentError, match=said):
            ViewFolder(tmp_path, serial, design)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"{", "not readable as JSON"), (b"[1]", "a JSON object"), (b'{"schema": 2, "rig_serial": "KF-1", "board": "x"}', "schema 2"),
        (b'{"schema": 1, "rig_serial": "KF-1"}', "board is missing"), (b'{"schema": 1, "rig_serial": "KF-1", "board": "x"}', "board x"),
    ],
)  # fmt: skip
def test_a_damaged_session_is_refused_and_left(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "board.json").write_bytes(content)
    with pytest.raises(ContentError, match=rf"board\.json: {said}.*; restore it, or remove it and give --board$"):
        ViewFolder(tmp_path, "KF-1", None)
    assert (tmp_path / "board.json").read_bytes() == content
