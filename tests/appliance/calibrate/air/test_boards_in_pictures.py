"""Pictures that a simulated instrument takes of a board calibrate it: corners are true, lengths follow; boards that tell nothing are named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.air.board import NoBoard, find_board
from appliance.calibrate.air.calibrate import AirCalibration, calibrate_air
from appliance.calibrate.air.coverage import EDGES, coverage
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.air.rest import NEW_PLACE, REST_PX, view_of
from appliance.calibrate.water.artefact import triangulate
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, in_air, project
from hw_sim.water.medium import AIR
from tests.support.board_pictures import BOARD, Pictures, picture, poses_in_air, true_corners_px, views_of_boards
from tests.support.calibrating import HEIGHT_PX, WIDTH_PX, hidden_rig
from tests.support.truth import WATER

Image = NDArray[np.uint8]
SIZE_PX = 640, 480
VIEWS = 6


@pytest.fixture(scope="module")
def truth() -> TrueRig:
    """A rig without lens field: what is wrong is then the corners' fault."""
    return draw_truth("modelled", 3, *SIZE_PX, WATER.index)


@pytest.fixture(scope="module")
def views(truth: TrueRig) -> list[BoardView]:
    return views_of_boards(truth, VIEWS)


@pytest.fixture(scope="module")
def shots(truth: TrueRig) -> list[Pictures]:
    """Three pictures of a board that rests, one after it has moved by 0.3 mm, and one from far away."""
    renderer = Renderer(in_air(truth), Scene(object="board"))
    (x, *rest), far = poses_in_air(1, 5)[0], (0.0, 0.0, 1250.0, 5.0, 5.0, 0.0)
    at, moved = (x, *rest), (x + 0.3, *rest)
    return [picture(renderer, pose, AIR, k) for k, pose in enumerate((at, at, at, moved, far))]  # type: ignore[arg-type]


def corners_off_px(dry: TrueRig, views: Sequence[BoardView], side: str) -> np.ndarray:
    found = [
        getattr(view, f"{side}_px") - true_corners_px(dry, side, pose, view.corners_mm)
        for view, pose in zip(views, poses_in_air(len(views), 1), strict=True)
    ]
    return np.concatenate(found)


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
        size_px = dry.left.width_px, dry.left.height_px
        assert all(np.all((uv > 0) & (uv < size_px)) for uv in (left, right))
        a, b = triangulate(air.rig, left, right, 1.0)
        found.append(100.0 * (float(np.linalg.norm(b - a)) / 150.0 - 1.0))
    return np.array(found)


def test_corners_and_lengths_are_as_exact_optics_says(truth: TrueRig, views: list[BoardView]) -> None:
    dry = in_air(truth)
    for side in ("left", "right"):
        off = corners_off_px(dry, views, side)
        assert len(off) > 600
        assert np.sqrt(np.mean(off**2)) < 0.065
        assert np.abs(off.mean(axis=0)).max() < 0.005
        assert np.abs(off).max() < 0.25
    air = calibrate_air(views, *SIZE_PX, with_field=False)
    assert air.left_out == ()
    assert [view.remarks for view in air.views] == [()] * VIEWS
    assert all(view.residual_px < 0.09 for view in air.views)
    assert abs(dry.artefacts.board_scale - 1.0) < 3e-5
    assert np.abs(lengths_off_percent(dry, air)).max() < 0.012


@pytest.mark.dive
@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [3, 5])
def test_lengths_in_air_of_real_lenses_are_right_to_three_hundredths_of_a_percent(seed: int) -> None:
    """What a lens does beyond the five-parameter model is the limit."""
    rig = hidden_rig("realistic", seed)
    dry, seen = in_air(rig), views_of_boards(rig)
    corners = corners_off_px(dry, seen, "left")
    assert np.sqrt(np.mean(corners**2)) < 0.03
    assert np.abs(corners.mean(axis=0)).max() < 0.003
    off = lengths_off_percent(dry, calibrate_air(seen, WIDTH_PX, HEIGHT_PX, with_field=False))
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.abs(off).max() < 0.06


def lit(image: Image, times: float) -> Image:
    return np.asarray(np.clip(image.astype(float) * times, 0, 255), np.uint8)


def hidden_beyond(image: Image, column: int) -> Image:
    """An arm before the board."""
    covered = image.copy()
    covered[:, column:] = 60
    return covered


def test_light_distance_and_an_arm_before_the_board_are_named(shots: list[Pictures], views: list[BoardView]) -> None:
    near, far = shots[0], shots[-1]
    for left, right, words in (
        (lit(near.left, 5.0), lit(near.right, 5.0), "pair 1: the left image is saturated; use less light"),
        (lit(near.left, 0.07), lit(near.right, 0.07), "is dark; use more"),
        (far.left, far.right, "pair 1: the board is small in the left image, "),
        (near.left, hidden_beyond(near.right, 132), "corners in the right image"),
    ):
        _, reasons = find_board("pair 1", {"left": left, "right": right}, BOARD, strict=True)
        assert any(words in reason for reason in reasons), words
    half, reasons = find_board(
        "pair 1", {"left": near.left, "right": hidden_beyond(near.right, 300)}, BOARD, strict=True
    )
    assert not reasons
    (remark,) = calibrate_air([*views, half], *SIZE_PX, with_field=False).views[-1].remarks
    assert "the board is partly hidden" in remark


def test_a_view_counts_when_the_board_rested_and_is_not_where_it_was_before(shots: list[Pictures]) -> None:
    left, right = (np.stack([getattr(one, side) for one in shots[:4]]) for side in ("left", "right"))
    view = view_of("02", left[:3], right[:3], [], BOARD)
    assert isinstance(view, BoardView)
    assert len(view.corners_mm) > 100
    found = view_of("02", left[1:], right[1:], [], BOARD)  # 6 mm/s in 50 ms
    assert isinstance(found, NoBoard)
    assert found.reason.startswith("02: the board moved by 0.")
    assert found.reason.endswith("hold it still")
    assert (REST_PX, NEW_PLACE * SIZE_PX[0]) == (0.1, 16.0)
    for off_px, new in ((15.5, False), (16.5, True)):
        known = replace(view, name="01", left_px=np.add(view.left_px, [off_px, 0.0]))
        again = view_of("02", left[:3], right[:3], [known], BOARD)
        assert isinstance(again, BoardView) == new
        assert new or (isinstance(again, NoBoard) and "has the pose of view 01" in again.reason)


def test_what_is_missing_is_said_until_it_was_seen() -> None:
    """Points at will: nine regions, both images, four leans."""
    grid = np.stack([a.ravel() for a in np.meshgrid(np.linspace(-150, 150, 31), np.linspace(-115, 115, 24))], -1)
    corners = np.concatenate([grid, np.zeros((len(grid), 1))], 1)

    def leant(about_x_deg: float, about_y_deg: float, shift_px: float) -> BoardView:
        a, b = np.radians([about_x_deg, about_y_deg])
        Rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        Ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        at = corners @ (Ry @ Rx).T + [0.0, 0.0, 500.0]
        uv = 1280.0 * at[:, :2] / at[:, 2:] + [399.5, 299.5]
        moved = uv + np.array([shift_px, 0.0])
        inside = np.all((moved > 0) & (moved < [799, 599]), axis=1)
        return BoardView("v", corners[inside], moved[inside], uv[inside])

    flat = coverage([leant(0.0, 0.0, 330.0)], 800, 600).missing
    assert flat[0].startswith("no corners yet at the top left, ")
    assert flat[0].endswith("of the left image")
    assert "at the right" not in flat[0]
    assert "near the left edge" in flat[0]
    assert "near the right edge" not in flat[0]
    lean = (
        "no board yet with its left edge away or with its right edge away or with its top edge away or with its bottom "
        "edge away: lean it by 20° to 35°"
    )
    assert flat[-1] == lean
    one = coverage([leant(0.0, 0.0, 0.0), leant(0.0, 25.0, 0.0)], 800, 600).missing
    assert one == (lean.replace("with its left edge away or ", ""),), "its right edge is nearer now"
    # An eighth of the width is near an edge, and twelve degrees are a lean.
    for shift_px, near in ((80.0, True), (90.0, False)):
        said = " ".join(coverage([leant(0.0, 0.0, shift_px)], 800, 600).missing)
        assert ("near the left edge" not in said) == near
    # Six corners are enough at an edge; five are not.
    for count, near in ((6, True), (5, False)):
        four = np.repeat([[10.0, 300.0], [790.0, 300.0], [400.0, 10.0], [400.0, 590.0]], count, axis=0)
        said = coverage([BoardView("v", np.pad(four, ((0, 0), (0, 1))), four, four)], 800, 600).missing[0]
        assert [f"near the {edge} edge" in said for edge in EDGES] == [not near] * 4
    sides = [f"its {side} edge away" for side in ("left", "right", "top", "bottom")]
    for about_deg, wanted in ((11.0, 4), (13.0, 3)):
        assert sum(side in coverage([leant(0.0, about_deg, 0.0)], 800, 600).missing[-1] for side in sides) == wanted
    every = [leant(a, b, 0.0) for a, b in ((25, 0), (-25, 0), (0, 25), (0, -25))]
    assert coverage([leant(0.0, 0.0, 0.0), *every], 800, 600).missing == ()
