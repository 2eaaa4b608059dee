"""Pictures that another laboratory took of its own board calibrate its cameras by one command, as OpenCV's own bundle does.

The pictures are not part of the project: ``KINGFISHER_REAL_PICTURES`` names the folder that has ``stereo_board`` in it, 13 pairs
of a printed board of 25 x 18 squares of 7.5 mm (dictionary 5x5, old layout). Without it these tests are skipped.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import BoardTolerance
from appliance.calibrate.air.board import BoardDesign, NoBoard, find_corners
from appliance.calibrate.air.calibrate import calibrate_air
from appliance.calibrate.air.linearised import BoardView, bend_of
from appliance.cli import main

Array = NDArray[np.float64]

FOLDER = "stereo_board"
SIZE = (2048, 1500)

pytestmark = [
    pytest.mark.skipif("KINGFISHER_REAL_PICTURES" not in os.environ, reason="KINGFISHER_REAL_PICTURES names no folder"),
    pytest.mark.timeout(600),
]


@pytest.fixture(scope="module")
def folder() -> Path:
    return Path(os.environ["KINGFISHER_REAL_PICTURES"]) / FOLDER


@pytest.fixture(scope="module")
def views(folder: Path) -> list[BoardView]:
    """Corners of all pairs, with the board as its owner describes it."""
    design = BoardDesign(25, 18, 7.5, 5.6, cv2.aruco.DICT_5X5_1000, legacy=True)
    board_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)
    found = []
    for path in sorted(folder.glob("*_left.png")):
        sides: list[dict[int, Array]] = []
        for one in (path, path.with_name(path.name.replace("_left", "_right"))):
            image = cv2.imread(str(one), cv2.IMREAD_GRAYSCALE)
            assert image is not None
            corners = find_corners(np.asarray(image, np.uint8), design, strict=False)
            assert not isinstance(corners, NoBoard), one
            sides.append(corners)
        found.append(BoardView.of(path.name, board_mm, *sides))
    return found


def opencv(views: list[BoardView], shapes_mm: Array) -> tuple[float, float, float]:
    """``stereoCalibrate`` on the corners that both cameras see, with the same lens (five coefficients, square pixels) and the board
    bent by ``shapes_mm``; all of one weight. Returns both focal lengths, px, and the baseline, mm."""
    bend = bend_of(views)
    board: list[Any] = []
    seen: dict[str, list[Any]] = {"left": [], "right": []}
    for view in views:
        both = view.has("left") & view.has("right")
        corners = view.corners_mm[both].copy()
        corners[:, 2] += bend.of(corners) @ shapes_mm
        board.append(corners.astype(np.float32))
        for side, px in (("left", view.left_px), ("right", view.right_px)):
            seen[side].append(px[both].astype(np.float32).reshape(-1, 1, 2))
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_USE_INTRINSIC_GUESS
    lenses: list[Any] = []
    for side in ("left", "right"):
        guess = np.array([[3000.0, 0, (SIZE[0] - 1) / 2], [0, 3000.0, (SIZE[1] - 1) / 2], [0, 0, 1]])
        lenses += cv2.calibrateCamera(board, seen[side], SIZE, guess, np.zeros(5), flags=flags)[1:3]
    (K1, d1), (K2, d2) = (lenses[:2], lenses[2:])
    until = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-9)
    found: Any = cv2.stereoCalibrate(
        board, seen["left"], seen["right"], K1, d1, K2, d2, SIZE, flags=flags, criteria=until
    )
    return float(found[1][0, 0]), float(found[3][0, 0]), float(np.linalg.norm(found[6]))


def test_one_command_calibrates_from_at_least_twelve_of_thirteen_pairs(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "pair.json"
    assert (
        main(["calibration", "air", str(folder), "--pair", "NAME", "--board", "7.5", "--out", str(out), "--json"]) == 0
    )
    report = json.loads(capsys.readouterr().out)
    assert report["board_squares"] == [25, 18]
    assert report["legacy_layout"]
    assert len(report["pairs"]) >= 12
    assert report["residual_px"] <= 0.15


def test_a_bent_board_gives_what_opencv_gives_once_it_is_told_how_the_board_is_bent(views: list[BoardView]) -> None:
    """The board stands 0.2 mm off a plane: adjusted, the corners fit better by a sixth, and so do OpenCV's, told of it."""
    bent = calibrate_air(views, *SIZE, with_field=False)
    assert bent.residual_px <= 0.15
    rig = bent.rig
    left_px, right_px, baseline_mm = opencv(views, bent.shapes_mm)
    assert rig.left.lens.f_px[0] == pytest.approx(left_px, rel=0.003)
    assert rig.right.lens.f_px[0] == pytest.approx(right_px, rel=0.003)
    assert float(np.linalg.norm(rig.right.translation_mm)) == pytest.approx(baseline_mm, rel=0.001)
    assert (
        bent.residual_px < 0.9 * calibrate_air(views, *SIZE, BoardTolerance(bow_mm=1e-6), with_field=False).residual_px
    )
