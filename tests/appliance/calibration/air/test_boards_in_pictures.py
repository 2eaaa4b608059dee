"""Pictures that a simulated instrument takes of a board calibrate it: corners are true, and lengths follow."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.air.adjustment import AirCalibration, BoardView, calibrate_air
from appliance.calibration.air.board import NoBoard, find_board
from appliance.calibration.water.shapes import triangulate
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, in_air, project
from hw_sim.water.medium import AIR
from tests.support.board_pictures import (
    BOARD,
    Pictures,
    picture,
    poses_in_air,
    true_corners_px,
    views_of_boards,
)
from tests.support.calibrating import HEIGHT_PX, WIDTH_PX, hidden_rig


@pytest.fixture(scope="module")
def truth() -> TrueRig:
    """A rig without lens field: what is wrong is then the corners' fault."""
    return hidden_rig("modelled", 3)


@pytest.fixture(scope="module")
def views(truth: TrueRig) -> list[BoardView]:
    return views_of_boards(truth, 10)


@pytest.fixture(scope="module")
def air(views: list[BoardView]) -> AirCalibration:
    return calibrate_air(views, WIDTH_PX, HEIGHT_PX, with_field=False)


@pytest.fixture(scope="module")
def pictures(truth: TrueRig) -> Pictures:
    return picture(Renderer(in_air(truth), Scene(object="board")), poses_in_air(1, 5)[0], AIR, 1)


def test_corners_are_where_exact_optics_says(truth: TrueRig, views: list[BoardView]) -> None:
    dry = in_air(truth)
    errors: dict[str, list[np.ndarray]] = {"left": [], "right": []}
    for view, pose in zip(views, poses_in_air(10, 1), strict=True):
        for side, seen in (("left", view.left_px), ("right", view.right_px)):
            errors[side].append(seen - true_corners_px(dry, side, pose, view.corners_mm))
    for found in errors.values():
        pooled = np.concatenate(found)
        assert len(pooled) > 1000
        assert np.sqrt(np.mean(pooled**2)) < 0.03
        assert np.abs(pooled.mean(axis=0)).max() < 0.003
        assert np.abs(pooled).max() < 0.15


def lengths_off_percent(dry: TrueRig, air: AirCalibration) -> np.ndarray:
    """Deviations of 150 mm in many directions, all over where the board was, from exact pixels."""
    rng = np.random.default_rng(8)
    found = []
    for _ in range(60):
        middle = rng.uniform([-35.0, -25.0, 490.0], [35.0, 25.0, 600.0])
        depth, turn = np.radians(rng.uniform([-40.0, -90.0], [40.0, 90.0]))
        way = [np.cos(depth) * np.cos(turn), np.cos(depth) * np.sin(turn), np.sin(depth)]
        ends = middle + np.outer([-75.0, 75.0], way)
        left, right = project(dry, "left", ends), project(dry, "right", ends)
        assert all(np.all((uv > 0) & (uv < [WIDTH_PX, HEIGHT_PX])) for uv in (left, right))
        a, b = triangulate(air.rig, left, right, 1.0)
        found.append(100.0 * (float(np.linalg.norm(b - a)) / 150.0 - 1.0))
    return np.array(found)


def test_lengths_in_air_are_right_to_a_hundredth_of_a_percent(truth: TrueRig, air: AirCalibration) -> None:
    dry = in_air(truth)
    assert abs(dry.artefacts.board_scale - 1.0) < 3e-5
    assert np.abs(lengths_off_percent(dry, air)).max() < 0.01


@pytest.mark.dive
@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [3, 5])
def test_lengths_in_air_of_real_lenses_are_right_to_three_hundredths_of_a_percent(seed: int) -> None:
    """What a lens does beyond the five-parameter model is the limit."""
    rig = hidden_rig("realistic", seed)
    off = lengths_off_percent(in_air(rig), calibrate_air(views_of_boards(rig), WIDTH_PX, HEIGHT_PX, with_field=False))
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.abs(off).max() < 0.06


def test_every_view_was_used_and_says_what_is_left_of_it(air: AirCalibration) -> None:
    assert air.left_out == ()
    assert len(air.views) == 10
    assert [view.remarks for view in air.views] == [()] * 10
    assert all(view.residual_px < 0.03 for view in air.views)


def test_too_much_and_too_little_light_are_named(truth: TrueRig, pictures: Pictures) -> None:
    renderer = Renderer(in_air(truth), Scene(object="board"))
    for exposure_s, words in ((0.03, "pair 1: the left image is overexposed; less light"), (0.0005, "is dark; more")):
        spoilt = picture(renderer, pictures.pose, AIR, 1, exposure_s)
        found = find_board("pair 1", spoilt.left, spoilt.right, BOARD)
        assert isinstance(found, NoBoard), exposure_s
        assert words in found.reason


def test_a_far_board_is_named(truth: TrueRig) -> None:
    far = picture(Renderer(in_air(truth), Scene(object="board")), (0.0, 0.0, 1500.0, 5.0, 5.0, 0.0), AIR, 1)
    found = find_board("pair 1", far.left, far.right, BOARD)
    assert isinstance(found, NoBoard)
    assert found.reason == "pair 1: the board is small in the left image; bring it nearer"


def hidden_beyond(image: np.ndarray, column: int) -> np.ndarray:
    """An arm before the board."""
    covered = image.copy()
    covered[:, column:] = 60
    return covered


def test_a_hidden_board_is_named(pictures: Pictures, views: list[BoardView]) -> None:
    nearly_all = find_board("pair 1", pictures.left, hidden_beyond(pictures.right, 330), BOARD)
    assert isinstance(nearly_all, NoBoard)
    assert "corners in the right image" in nearly_all.reason
    half = find_board("pair 1", pictures.left, hidden_beyond(pictures.right, 750), BOARD)
    assert isinstance(half, BoardView)
    air = calibrate_air([*views, half], WIDTH_PX, HEIGHT_PX, with_field=False)
    (remark,) = air.views[-1].remarks
    assert "the board is half hidden" in remark
