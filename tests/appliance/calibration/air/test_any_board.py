"""A board that nobody described is found by trying; what does not fit is named with what was seen."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.air.any_board import (
    BoardNotFoundError,
    FoundBoard,
    Wanted,
    find_corners_of,
    search_board,
)
from appliance.calibration.air.board import BoardDesign, NoBoard, find_board, find_corners
from hw_sim.objects.print import ACROSS, CELLS, DOWN, MARKER_MM, SQUARE_MM
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, in_air
from hw_sim.water.medium import AIR
from tests.support.any_boards import Printed, picture, poses
from tests.support.board_pictures import picture as taken
from tests.support.board_pictures import poses_in_air, true_corners_px
from tests.support.calibrating import Pose
from tests.support.truth import WATER

Image = NDArray[np.uint8]


def shown(*images: Image) -> list[tuple[str, Callable[[], Image]]]:
    return [(f"picture {k}", partial(np.asarray, image)) for k, image in enumerate(images)]


def searched(*images: Image, wanted: Wanted | None = None) -> FoundBoard:
    return search_board(shown(*images), wanted or Wanted(15.0), lambda what, share: None)


DICTIONARIES = [
    ("DICT_4X4_100", "4X4"),
    ("DICT_5X5_250", "5X5"),
    ("DICT_6X6_50", "6X6"),
    ("DICT_7X7_1000", "7X7"),
    ("DICT_ARUCO_ORIGINAL", "ARUCO_ORIGINAL"),
    ("DICT_ARUCO_MIP_36h12", "ARUCO_MIP_36h12"),
    ("DICT_APRILTAG_36h11", "APRILTAG_36h11"),
]


@pytest.mark.parametrize(("name", "family"), DICTIONARIES)
def test_dictionary_layout_squares_and_markers_are_found(name: str, family: str) -> None:
    legacy = name != "DICT_4X4_100"
    printed = Printed(dictionary=int(getattr(cv2.aruco, name)), legacy=legacy)
    found = searched(picture(printed, Pose((30.0, 0.0, 260.0), (20.0, -10.0, 5.0)), "left", 1))
    assert found.family == family
    assert (found.design.across, found.design.down, found.design.legacy) == (11, 8, legacy)
    assert found.design.marker_mm == pytest.approx(11.25, abs=0.6)
    assert found.design.square_mm == 15.0


@pytest.mark.parametrize("name", ["DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10"])
def test_rare_dictionaries_are_found_too(name: str) -> None:
    printed = Printed(7, 6, 20.0, 15.0, int(getattr(cv2.aruco, name)))
    found = searched(picture(printed, Pose((30.0, 0.0, 260.0), (10.0, 15.0, -20.0)), "left", 1))
    assert (f"DICT_{found.family}", found.design.across, found.design.down) == (name, 7, 6)


def test_corners_of_the_old_layout_are_where_they_truly_are() -> None:
    """On the simulator's own pictures, with noise and blur."""
    rig = in_air(draw_truth("modelled", 3, 800, 600, WATER.index))
    board = cv2.aruco.CharucoBoard(
        (ACROSS, DOWN), SQUARE_MM, MARKER_MM, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    )
    board.setLegacyPattern(True)
    drawn = np.asarray(board.generateImage((ACROSS * CELLS, DOWN * CELLS)), np.uint8)
    renderer = Renderer(rig, Scene(object="board"), (drawn > 127).astype(np.uint8))
    (pose,) = poses_in_air(1, 5)
    both = taken(renderer, pose, AIR, 1)
    found = searched(both.left, both.right, wanted=Wanted(SQUARE_MM))
    assert (found.design.across, found.design.down, found.design.legacy) == (ACROSS, DOWN, True)
    corners = find_corners_of(both.left, found)
    assert not isinstance(corners, NoBoard)
    numbers = sorted(corners)
    assert len(numbers) > 100
    truly = true_corners_px(rig, "left", pose, np.asarray(found.design.pattern().getChessboardCorners())[numbers])
    assert np.sqrt(np.mean((np.stack([corners[n] for n in numbers]) - truly) ** 2)) < 0.05
    assert isinstance(find_corners(both.left, found.design), dict)


def test_the_number_of_squares_may_be_told_either_way_round() -> None:
    image = picture(Printed(), Pose((30.0, 0.0, 260.0), (20.0, -10.0, 5.0)), "left", 1)
    for across, down in ((11, 8), (8, 11)):
        design = searched(image, wanted=Wanted(15.0, across, down, 11.25)).design
        assert (design.across, design.down, design.marker_mm) == (11, 8, 11.25)


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        (Wanted(15.0, 10, 8), "--board 10x8: the markers seen (5X5) lie as on a board of 11 squares across and 8"),
        (Wanted(15.0, 11, 6), "--board 11x6: the markers seen (5X5) lie as on a board of 11 squares across and 8"),
        (Wanted(15.0, 11, 9), "--board 11x9: the markers seen"),
        (Wanted(15.0, 11, 8, 14.0), "--marker-mm 14: in the pictures a marker's side is 0.7"),
    ],
)
def test_what_was_told_and_is_not_so_is_named_with_what_was_seen(wanted: Wanted, words: str) -> None:
    image = picture(Printed(), Pose((30.0, 0.0, 260.0), (20.0, -10.0, 5.0)), "left", 1)
    with pytest.raises(BoardNotFoundError) as raised:
        searched(image, wanted=wanted)
    assert words in str(raised.value)


def test_of_a_board_that_is_seen_in_parts_the_squares_are_still_counted() -> None:
    """A part of a board would fit any number of squares across, sheared."""
    printed = Printed(13, 10, 15.0, 11.25)
    upper = picture(printed, Pose((-30.0, 40.0, 200.0), (0.0, 0.0, 0.0)), "left", 1)
    lower = picture(printed, Pose((90.0, -30.0, 230.0), (10.0, 10.0, 0.0)), "left", 2)
    found = searched(upper, lower)
    assert found.markers < 13 * 10 // 2, "no picture shows it whole"
    assert (found.design.across, found.design.down, found.design.legacy) == (13, 10, True)


def test_mirrored_pictures_are_named() -> None:
    image = picture(Printed(), Pose((30.0, 0.0, 260.0), (20.0, -10.0, 5.0)), "left", 1)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    with pytest.raises(BoardNotFoundError, match="picture 0: the picture is mirrored"):
        searched(mirrored)
    found = find_corners_of(mirrored, searched(image))
    assert isinstance(found, NoBoard)
    assert found.reason == "the {side} picture is mirrored; give it as the camera saw it"


def test_without_a_board_all_that_was_tried_is_named() -> None:
    grey = np.random.default_rng(1).integers(60, 190, (540, 720)).astype(np.uint8)
    with pytest.raises(BoardNotFoundError) as raised:
        searched(grey)
    said = str(raised.value)
    assert "5X5, 4X4, 6X6, APRILTAG_36h11" in said
    assert "before and since OpenCV 4.6" in said
    assert "seen were no marker of any" in said


def test_a_small_board_is_used_here_and_refused_by_the_guided_way() -> None:
    """An eighth of the picture is plenty, a twentieth will do; what the instrument asks for its own calibration stays."""
    printed = Printed(legacy=False)
    pose = poses(1, 3)[0]
    far = Pose((30.0, 0.0, 620.0), pose.turns_deg)
    left, right = (picture(printed, far, side, 1) for side in ("left", "right"))
    found = searched(picture(printed, Pose((30.0, 0.0, 260.0), (20.0, -10.0, 5.0)), "left", 1))
    assert isinstance(find_corners_of(left, found), dict)
    own = find_board("pair 1", left, right, BoardDesign(11, 8, 15.0, 11.25, printed.dictionary))
    assert isinstance(own, NoBoard)
    assert own.reason == "pair 1: the board is small in the left image; bring it nearer"
