"""Views that do not determine two cameras, and pairs that do not belong together, are named; small boards are enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.air.calibrate import AirCalibrationError, calibrate_air, check_pairs
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.determined import UndeterminedError, solve_symmetric
from appliance.measure.calibration.parameters import RIG_PARAMETERS
from tests.support.any_boards import BASE_MM, F_PX, HEIGHT_PX, WIDTH_PX, poses
from tests.support.calibrating import Pose

Array = NDArray[np.float64]
Image = dict[int, Array]


def board(across: int, down: int, square_mm: float = 15.0) -> Array:
    """Inner corners (n, 3) of a board of so many squares."""
    x, y = np.meshgrid(np.arange(across - 1) * square_mm, np.arange(down - 1) * square_mm)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)


def seen(corners_mm: Array, pose: Pose, side: str, noise_px: float, seed: int) -> Image:
    """Corners of a board about the pose, as one of two parallel pinholes sees them."""
    rng = np.random.default_rng([seed, side == "left"])
    points = (corners_mm - corners_mm.mean(axis=0)) @ pose.rotation.T + pose.at_mm
    points[:, 0] -= BASE_MM if side == "right" else 0.0
    px = F_PX * points[:, :2] / points[:, 2:] + [(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2]
    return dict(enumerate(px + rng.normal(0.0, noise_px, px.shape)))


def views(where: Sequence[Pose], corners_mm: Array, noise_px: float = 0.03, missing_right: int = -1) -> list[BoardView]:
    """Views v0, v1, …; from ``missing_right`` on, the right picture is the next pose's."""
    found = []
    for k, pose in enumerate(where):
        j = k if missing_right < 0 or k < missing_right else k + 1
        right = seen(corners_mm, where[j], "right", noise_px, j) if j < len(where) else None
        found.append(BoardView.of(f"v{k}", corners_mm, seen(corners_mm, pose, "left", noise_px, k), right))
    return found


def leant(*turns_deg: tuple[float, float]) -> list[Pose]:
    """Boards at eight places near and far, which lean in turn."""
    places = ((0, 0, 360), (10, 5, 400), (-10, 5, 320), (8, -6, 380), (-8, -6, 340), (0, 8, 390), (5, 5, 330), (-5, 0, 370))  # fmt: skip
    return [
        Pose((BASE_MM / 2 + x, float(y), float(z)), (*turns_deg[k % len(turns_deg)], 0.0))
        for k, (x, y, z) in enumerate(places)
    ]


def test_a_board_of_three_rows_of_corners_calibrates() -> None:
    """An S down such a board is a lean of it: without what is known of boards, nothing would tell them apart."""
    found = calibrate_air(views(poses(9, 5), board(5, 4)), WIDTH_PX, HEIGHT_PX, with_field=False)
    sd = np.sqrt(np.diag(found.covariance))
    for k, camera in ((0, found.rig.left), (8, found.rig.right)):
        assert abs(camera.lens.f_px[0] - F_PX) < 5.0 * sd[k]
        assert sd[k] < 0.01 * F_PX
    assert np.linalg.norm(found.rig.right.translation_mm) == pytest.approx(BASE_MM, rel=0.01)


@pytest.mark.parametrize(
    ("turns_deg", "ways"), [([(0.0, 0.0)], 0), ([(1.0, -1.0), (-2.0, 0.0), (0.0, 2.0)], 0), ([(20.0, 0.0)], 1)]
)
def test_boards_that_do_not_lean_are_told_tilts_seen_and_wanted(
    turns_deg: list[tuple[float, float]], ways: int
) -> None:
    with pytest.raises(AirCalibrationError, match=f"^tilt missing.*leans in {ways} directions"):
        calibrate_air(views(leant(*turns_deg), board(11, 8)), WIDTH_PX, HEIGHT_PX)


def test_what_stays_open_is_named_with_its_size() -> None:
    """Boards that lean little, small and blurred: a principal distance known to a tenth is none."""
    small = views(leant((8.0, 0.0), (0.0, 8.0), (-8.0, 0.0)), board(6, 5), noise_px=0.4)
    with pytest.raises(AirCalibrationError, match=r"do not determine left principal distance \(px\) better than ± "):
        calibrate_air(small, WIDTH_PX, HEIGHT_PX, with_field=False)


@pytest.mark.parametrize("first", [0, 7])
def test_the_first_pair_after_a_missing_picture_is_named(first: int) -> None:
    where = poses(10, 5)
    shifted = views(where, board(11, 8), missing_right=first)
    with pytest.raises(AirCalibrationError, match=rf"^pair v{first}: .*a right image is missing"):
        calibrate_air(shifted, WIDTH_PX, HEIGHT_PX, with_field=False)
    exchanged = [replace(view, left_px=view.right_px, right_px=view.left_px) for view in shifted]
    with pytest.raises(AirCalibrationError, match=rf"^pair v{first}: .*a left image is missing"):
        calibrate_air(exchanged, WIDTH_PX, HEIGHT_PX, with_field=False)
    if first == 0:
        with pytest.raises(AirCalibrationError, match=r"^pair v0: .*a right image is missing"):
            check_pairs(shifted[:8], WIDTH_PX, HEIGHT_PX)  # told before all are looked at
    for silent in (views(where, board(11, 8)), views(where, board(11, 8), missing_right=7)[:8], []):
        check_pairs(silent, WIDTH_PX, HEIGHT_PX)


def test_one_pair_of_two_moments_costs_itself_alone() -> None:
    where = poses(10, 5)
    good = views(where, board(11, 8))
    mixed = replace(good[4], right_px=views(where[::-1], board(11, 8))[4].right_px)
    found = calibrate_air([*good[:4], mixed, *good[5:]], WIDTH_PX, HEIGHT_PX, with_field=False)
    (said,) = found.left_out
    assert said.startswith("v4: the left and the right image show the board in different poses, ")
    assert found.pairs == tuple(f"v{k}" for k in range(10) if k != 4)
    k = RIG_PARAMETERS.names[RIG_PARAMETERS.air].index("left principal distance (px)")
    assert abs(found.rig.left.lens.f_px[0] - F_PX) < 5.0 * np.sqrt(found.covariance[k, k])


def test_pairs_of_which_no_three_agree_are_no_calibration() -> None:
    where = poses(12, 5)
    left, right = views(where[:6], board(11, 8)), views(where[6:], board(11, 8))
    mixed = [replace(view, right_px=other.right_px) for view, other in zip(left, right, strict=True)]
    with pytest.raises(
        AirCalibrationError, match=r"pair v\d: .*; so do [34] other stereo pairs: only [12] stereo pairs agree"
    ):
        calibrate_air(mixed, WIDTH_PX, HEIGHT_PX, with_field=False)


def test_a_single_row_of_corners_tells_no_place() -> None:
    good, wide = views(poses(8, 5), board(15, 8)), board(15, 8)
    row = {k: px for k, px in seen(wide, poses(1, 9)[0], "left", 0.03, 9).items() if wide[k, 1] == 0.0}
    assert len(row) == 14
    assert len(BoardView.of("row", wide, row, row).corners_mm) == 0
    one = BoardView("row", wide[list(row)], np.stack(list(row.values())), np.stack(list(row.values())))
    found = calibrate_air([*good, one], WIDTH_PX, HEIGHT_PX, with_field=False)
    assert found.left_out == ("row: few corners of the board, or a single row; bring more of it into view",)


UNITS = ("length (mm)", "turn (rad)", "shift (mm)")


def test_units_of_any_size_are_solved() -> None:
    rows = np.random.default_rng(1).normal(size=(9, 3)) * [1e6, 1e-6, 1.0]
    truth = np.array([3e-6, 2e6, -1.0])
    assert solve_symmetric(rows.T @ rows, rows.T @ (rows @ truth), UNITS) == pytest.approx(truth)
    scale = np.sqrt(np.diag(rows.T @ rows))
    inverse = solve_symmetric(rows.T @ rows, np.eye(3), UNITS) * np.outer(scale, scale)
    assert np.allclose(inverse @ (rows.T @ rows / np.outer(scale, scale)), np.eye(3), atol=1e-6)


@pytest.mark.parametrize(
    ("free", "names"),
    [
        ([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 1.0]], UNITS[:2]),
        ([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], UNITS[1:2]),
        ([[1.0, 0.0, 0.0], [0.0, 1.0, np.nan], [0.0, np.nan, 1.0]], UNITS[1:]),
        ([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], UNITS[1:2]),
    ],
)
def test_what_is_free_is_named(free: list[list[float]], names: tuple[str, ...]) -> None:
    with pytest.raises(UndeterminedError) as raised:
        solve_symmetric(np.array(free), np.ones(3), UNITS)
    assert raised.value.names == names
