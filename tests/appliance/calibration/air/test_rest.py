"""A view counts when the board rested while it was recorded, and is not where it was before."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.air.adjustment import BoardView
from appliance.calibration.air.board import NoBoard
from appliance.calibration.air.coverage import coverage
from appliance.calibration.air.rest import view_of
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, in_air
from hw_sim.water.medium import AIR
from tests.support.board_pictures import BOARD, picture
from tests.support.truth import WATER

AT = (10.0, 5.0, 560.0, 20.0, -22.0, 10.0)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(in_air(draw_truth("modelled", 3, 800, 600, WATER.index)), Scene(object="board"))


def recorded(renderer: Renderer, by_mm: float, x_mm: float = AT[0]) -> tuple[np.ndarray, np.ndarray]:
    """Three pictures of each camera while the board moves along x."""
    shots = [picture(renderer, (x_mm + by_mm * k / 2, *AT[1:]), AIR, k) for k in range(3)]
    return np.stack([s.left for s in shots]), np.stack([s.right for s in shots])


def test_a_resting_board_is_a_view_with_less_noise(renderer: Renderer) -> None:
    view = view_of("01", *recorded(renderer, 0.0), [], BOARD)
    assert isinstance(view, BoardView)
    assert len(view.corners_mm) > 100


def test_a_moving_board_is_told_to_rest(renderer: Renderer) -> None:
    found = view_of("01", *recorded(renderer, 0.3), [], BOARD)  # 6 mm/s in 50 ms
    assert isinstance(found, NoBoard)
    assert found.reason.startswith("01: the board moved by 0.")
    assert found.reason.endswith("let it rest")


def test_the_same_place_again_is_no_view(renderer: Renderer) -> None:
    known = view_of("01", *recorded(renderer, 0.0), [], BOARD)
    assert isinstance(known, BoardView)
    again = view_of("02", *recorded(renderer, 0.0, AT[0] + 2.0), [known], BOARD)
    assert isinstance(again, NoBoard)
    assert "is where it was in view 01" in again.reason
    assert isinstance(view_of("02", *recorded(renderer, 0.0, AT[0] + 40.0), [known], BOARD), BoardView)


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
    sides = [f"its {side} edge away" for side in ("left", "right", "top", "bottom")]
    for about_deg, wanted in ((11.0, 4), (13.0, 3)):
        assert sum(side in coverage([leant(0.0, about_deg, 0.0)], 800, 600).missing[-1] for side in sides) == wanted
    every = [leant(a, b, 0.0) for a, b in ((25, 0), (-25, 0), (0, 25), (0, -25))]
    assert coverage([leant(0.0, 0.0, 0.0), *every], 800, 600).missing == ()
