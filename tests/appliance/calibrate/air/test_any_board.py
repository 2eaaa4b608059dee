"""A board that nobody described is found by trying; what does not fit is named with what was seen."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.base import silent
from appliance.calibrate.air.any_board import (
    BoardDescription,
    BoardNotFoundError,
    search_board,
)
from appliance.calibrate.air.board import FAMILIES, BoardDesign, NoBoard, find_corners, find_markers, spread_of
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


def searched(*images: Image, wanted: BoardDescription | None = None) -> BoardDesign:
    return search_board(shown(*images), wanted or BoardDescription(15.0), silent)


TAGS = ("16h5", "25h9", "36h10", "36h11")
TILTED = Pose((30.0, 0.0, 260.0), (20.0, -10.0, 5.0))


@pytest.mark.parametrize(
    ("name", "across", "down"),
    [("4X4_100", 11, 8), ("5X5_250", 11, 8), ("ARUCO_MIP_36h12", 11, 8), ("APRILTAG_16h5", 7, 6)],
)
def test_dictionary_layout_squares_and_markers_are_found(name: str, across: int, down: int) -> None:
    legacy, square_mm = name != "4X4_100", 15.0 if across == 11 else 20.0
    dictionary = int(getattr(cv2.aruco, f"DICT_{name}"))
    printed = Printed(across, down, square_mm, 0.75 * square_mm, dictionary, legacy=legacy)
    found = searched(picture(printed, TILTED, "left", 1), wanted=BoardDescription(square_mm))
    assert name.startswith(found.family)
    assert (found.across, found.down, found.legacy) == (across, down, legacy)
    assert found.marker_mm == pytest.approx(0.75 * square_mm, abs=0.6)


def test_corners_of_the_old_layout_are_where_they_truly_are() -> None:
    """On the simulator's own pictures, with noise and blur."""
    rig = in_air(draw_truth("modelled", 3, 800, 600, WATER.index))
    board = BoardDesign(ACROSS, DOWN, SQUARE_MM, MARKER_MM, cv2.aruco.DICT_4X4_250, legacy=True).pattern()
    drawn = np.asarray(board.generateImage((ACROSS * CELLS, DOWN * CELLS)), np.uint8)
    renderer = Renderer(rig, Scene(object="board"), (drawn > 127).astype(np.uint8))
    (pose,) = poses_in_air(1, 5)
    both = taken(renderer, pose, AIR, 1)
    found = searched(both.left, both.right, wanted=BoardDescription(SQUARE_MM))
    assert (found.across, found.down, found.legacy) == (ACROSS, DOWN, True)
    corners = find_corners(both.left, found, strict=False)
    assert not isinstance(corners, NoBoard)
    numbers = sorted(corners)
    assert len(numbers) > 100
    truly = true_corners_px(rig, "left", pose, np.asarray(found.pattern().getChessboardCorners())[numbers])
    assert np.sqrt(np.mean((np.stack([corners[n] for n in numbers]) - truly) ** 2)) < 0.05


def test_what_was_told_and_is_not_so_is_named_with_what_was_seen() -> None:
    image = picture(Printed(), TILTED, "left", 1)
    for wanted, words in (
        (BoardDescription(15.0, 10, 8), "11 squares across and 8"),
        (BoardDescription(15.0, 11, 9), "--board 11x9"),
        (BoardDescription(15.0, 11, 8, 14.0), "--board: markers of 14 mm: in the images a marker's side is 0.7"),
    ):
        with pytest.raises(BoardNotFoundError, match=words):
            searched(image, wanted=wanted)
    # The number of squares may be told either way round.
    design = searched(image, wanted=BoardDescription(15.0, 8, 11, 11.25))
    assert (design.across, design.down, design.marker_mm) == (11, 8, 11.25)


def test_of_a_board_that_is_seen_in_parts_the_squares_are_still_counted() -> None:
    """A part of a board would fit any number of squares across, sheared."""
    printed = Printed(13, 10, 15.0, 11.25)
    upper = picture(printed, Pose((-30.0, 40.0, 200.0), (0.0, 0.0, 0.0)), "left", 1)
    lower = picture(printed, Pose((90.0, -30.0, 230.0), (10.0, 10.0, 0.0)), "left", 2)
    found = searched(upper, lower)
    assert all(len(find_markers(one, found.family).ids) < found.markers for one in (upper, lower)), (
        "no picture shows it whole"
    )
    assert (found.across, found.down, found.legacy) == (13, 10, True)


def test_mirrored_pictures_and_ones_without_a_board_are_named() -> None:
    image = picture(Printed(), TILTED, "left", 1)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    with pytest.raises(BoardNotFoundError, match="picture 0: the image is mirrored"):
        searched(mirrored)
    found = find_corners(mirrored, searched(image), strict=False)
    assert isinstance(found, NoBoard)
    assert "mirrored" in found.reason
    grey = np.random.default_rng(1).integers(60, 190, (540, 720)).astype(np.uint8)
    with pytest.raises(BoardNotFoundError, match=", ".join(FAMILIES)):
        searched(grey)
    assert set(FAMILIES) == {
        "5X5",
        "4X4",
        "6X6",
        "7X7",
        "ARUCO_ORIGINAL",
        "ARUCO_MIP_36h12",
        *(f"APRILTAG_{one}" for one in TAGS),
    }
    for size, dictionary in (one for family in FAMILIES.values() for one in family):
        assert len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList) == size


def test_a_small_board_is_used_here_and_refused_by_the_guided_way() -> None:
    """An eighth of the picture is plenty, a twentieth will do; what the instrument asks for its own calibration stays."""
    printed = Printed(legacy=False)
    far = Pose((30.0, 0.0, 620.0), poses(1, 3)[0].turns_deg)
    left, design = picture(printed, far, "left", 1), searched(picture(printed, TILTED, "left", 1))
    assert isinstance(find_corners(left, design, strict=False), dict)
    own = find_corners(left, design, strict=True)
    assert isinstance(own, NoBoard)
    assert "small" in own.reason


def test_the_spread_of_corners_is_their_box_in_the_picture() -> None:
    assert spread_of(np.array([[10.0, 20.0], [60.0, 70.0], [30.0, 30.0]]), (100, 200)) == pytest.approx(0.125)
