"""Pictures of a board become corners, or a sentence that says why not; the corners calibrate."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from appliance.calibration.air.adjustment import BoardView, calibrate_air
from appliance.calibration.air.board import BoardDesign, NoBoard, find_board
from tests.support.calibrating import Pose

DESIGN = BoardDesign()
WIDTH, HEIGHT = 800, 600
F_PX, BASE_MM, TOE_DEG = 1277.8, 230.0, 12.41
DOTS_PER_MM = 8


def picture(pose: Pose, side: str) -> np.ndarray:
    """The board through a pinhole: a homography from print to image."""
    size = (int(DESIGN.across * DESIGN.square_mm * DOTS_PER_MM), int(DESIGN.down * DESIGN.square_mm * DOTS_PER_MM))
    paper = DESIGN.pattern().generateImage(size)
    sign = 1.0 if side == "left" else -1.0
    camera = Pose((-sign * BASE_MM / 2, 0.0, 0.0), (0.0, sign * TOE_DEG, 0.0))
    R = camera.rotation.T @ pose.rotation
    t = camera.rotation.T @ (np.array(pose.at_mm) - camera.at_mm)
    K = np.array([[F_PX, 0, (WIDTH - 1) / 2], [0, F_PX, (HEIGHT - 1) / 2], [0, 0, 1]])
    half = np.array([DESIGN.across, DESIGN.down]) * DESIGN.square_mm / 2
    to_mm = np.array([[1 / DOTS_PER_MM, 0, 0.5 / DOTS_PER_MM], [0, 1 / DOTS_PER_MM, 0.5 / DOTS_PER_MM], [0, 0, 1]])
    to_mm[:2, 2] -= half
    H = K @ np.column_stack([R[:, 0], R[:, 1], t]) @ to_mm
    shrink = 3  # rendered finer and averaged: edges fall on parts of pixels
    fine = np.array([[shrink, 0, (shrink - 1) / 2], [0, shrink, (shrink - 1) / 2], [0, 0, 1.0]])
    big = cv2.warpPerspective(paper, fine @ H, (WIDTH * shrink, HEIGHT * shrink), borderValue=120)
    image = cv2.resize(big, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(20 + image.astype(np.float64) * 0.7, np.uint8)


def pose_of(k: int) -> Pose:
    rng = np.random.default_rng(k)
    turns = rng.uniform(-25, 25, 3)
    at = rng.uniform([-20, -15, 560], [20, 15, 680])
    return Pose((float(at[0]), float(at[1]), float(at[2])), (float(turns[0]), float(turns[1]), float(turns[2])))


def test_pictures_of_a_board_calibrate_the_pair() -> None:
    views = [
        find_board(f"pair {k}", picture(pose_of(k), "left"), picture(pose_of(k), "right"), DESIGN) for k in range(9)
    ]
    found = [view for view in views if isinstance(view, BoardView)]
    assert len(found) >= 7, views
    air = calibrate_air(found, WIDTH, HEIGHT, with_field=False)
    assert air.residual_px < 0.15
    assert air.rig.left.lens.f_px[0] == pytest.approx(F_PX, rel=4e-3)
    assert np.linalg.norm(air.rig.right.translation_mm) == pytest.approx(BASE_MM, rel=3e-3)


def test_an_empty_image_says_which_side_and_what_to_do() -> None:
    grey = np.full((HEIGHT, WIDTH), 90, np.uint8)
    found = find_board("pair 1", picture(pose_of(1), "left"), grey, DESIGN)
    assert isinstance(found, NoBoard)
    assert found.reason.startswith("pair 1: 0 corners in the right image")
    assert "into view" in found.reason


def test_glare_is_named() -> None:
    image = picture(pose_of(1), "left")
    image[:200] = 255
    found = find_board("pair 1", image, image, DESIGN)
    assert isinstance(found, NoBoard)
    assert "overexposed" in found.reason


def test_a_distant_board_is_sent_nearer() -> None:
    far = Pose((0.0, 0.0, 2600.0), (0.0, 0.0, 0.0))
    found = find_board("pair 1", picture(far, "left"), picture(far, "right"), DESIGN)
    assert isinstance(found, NoBoard)
    assert found.reason == "pair 1: the board is small in the left image; bring it nearer"
