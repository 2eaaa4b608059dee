"""Views that differ calibrate a pair: each camera's own ones, noisy ones, far ones; exchanged and moved ones are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.air.adjustment import AirCalibrationError, calibrate_air
from appliance.calibration.air.any_views import AnyCalibration, calibrate_any, view_of
from appliance.calibration.air.joint import BoardTolerance
from appliance.calibration.air.linearised import BoardView
from appliance.calibration.parameters import AIR, NAMES
from hw_sim.truth import TrueRig, in_air
from tests.support.calibrating import HEIGHT_PX, WIDTH_PX, board_views, hidden_rig

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def truth() -> TrueRig:
    return hidden_rig("modelled", 3)


@pytest.fixture(scope="module")
def views(truth: TrueRig) -> list[BoardView]:
    return board_views(truth, 12)


@pytest.fixture(scope="module")
def clean(views: list[BoardView]) -> AnyCalibration:
    return calibrated(views)


def only(view: BoardView, side: str) -> BoardView:
    """The view as one camera has it, the other having nothing."""
    nowhere = np.full_like(view.left_px, np.nan)
    return replace(view, right_px=nowhere) if side == "left" else replace(view, left_px=nowhere)


def noisy(view: BoardView, sd_px: float, seed: int) -> BoardView:
    rng = np.random.default_rng(seed)
    return replace(
        view,
        left_px=view.left_px + rng.normal(0.0, sd_px, view.left_px.shape),
        right_px=view.right_px + rng.normal(0.0, sd_px, view.right_px.shape),
    )


def calibrated(views: list[BoardView]) -> AnyCalibration:
    return calibrate_any(views, WIDTH_PX, HEIGHT_PX)


def sd_of(found: AnyCalibration, name: str) -> float:
    k = NAMES[AIR].index(name)
    return float(np.sqrt(found.air.covariance[k, k]))


def focal_lengths(found: AnyCalibration) -> Array:
    return np.array([found.air.rig.left.lens.f_px[0], found.air.rig.right.lens.f_px[0]])


def test_ordinary_views_give_what_the_instruments_own_calibration_gives(
    views: list[BoardView], clean: AnyCalibration
) -> None:
    found, own = clean, calibrate_air(views, WIDTH_PX, HEIGHT_PX, with_field=False)
    assert found.air.residual_px == pytest.approx(own.residual_px, rel=1e-3)
    assert len(found.pairs) == 12
    assert not found.exchanged
    # Noise is the same in all views, so that weights are nearly so: the rest is a part of what noise does.
    sd = np.sqrt(np.diag(own.covariance))
    assert np.all(
        np.abs(focal_lengths(found) - [own.rig.left.lens.f_px[0], own.rig.right.lens.f_px[0]]) < 0.5 * sd[[0, 8]]
    )
    assert np.allclose(found.air.rig.right.translation_mm, own.rig.right.translation_mm, atol=0.01)


def test_views_that_one_camera_has_alone_tell_about_its_lens(truth: TrueRig, views: list[BoardView]) -> None:
    few = calibrated(views[:6])
    mixed = calibrated([*views[:6], *(only(view, "left") for view in views[6:])])
    left = "left principal distance (px)"
    assert sd_of(mixed, left) < 0.9 * sd_of(few, left)
    assert abs(mixed.air.rig.left.lens.f_px[0] - in_air(truth).left.f_px[0]) < 5.0 * sd_of(mixed, left)
    assert mixed.pairs == tuple(view.name for view in views[:6])
    alone = mixed.air.views[-1]
    assert (len(alone.left_px), len(alone.right_px)) == (len(views[-1].left_px), 0)
    assert alone.remarks == ("only the left camera has it",)
    assert mixed.noise_px["board 11"][1] is None


def test_each_camera_may_have_views_of_its_own(truth: TrueRig, views: list[BoardView]) -> None:
    sides = ["left", "right"] * 4
    found = calibrated([*views[:4], *(only(view, side) for view, side in zip(views[4:], sides, strict=True))])
    assert found.air.left_out == ()
    dry = in_air(truth)
    for side, f_px, true in zip(("left", "right"), focal_lengths(found), (dry.left, dry.right), strict=True):
        assert abs(f_px - true.f_px[0]) < 5.0 * sd_of(found, f"{side} principal distance (px)")
    base_mm = np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm))
    assert np.linalg.norm(found.air.rig.right.translation_mm) == pytest.approx(base_mm, rel=1e-3)


def test_a_view_counts_as_much_as_its_noise_lets_it(views: list[BoardView], clean: AnyCalibration) -> None:
    """Half of the views five times as noisy: the noise is told, and the result is nearer to that without it than unweighted."""
    spoilt = [noisy(view, 0.15, k) if k % 2 else view for k, view in enumerate(views)]
    found = calibrated(spoilt)
    assert found.air.left_out == ()
    for k, view in enumerate(views):
        sd = found.noise_px[view.name]
        assert sd[0] == pytest.approx(0.153 if k % 2 else 0.03, rel=0.25), view.name
    plain = calibrate_air(spoilt, WIDTH_PX, HEIGHT_PX, with_field=False)
    f_plain = np.array([plain.rig.left.lens.f_px[0], plain.rig.right.lens.f_px[0]])
    off, off_plain = (np.abs(f - focal_lengths(clean)).max() for f in (focal_lengths(found), f_plain))
    assert off < 0.5 * off_plain


def test_a_board_that_moved_is_left_out_and_a_blurred_one_is_not(views: list[BoardView]) -> None:
    moved = replace(views[5], right_px=views[5].right_px + np.array([1.0, 0.7]))
    blurred = noisy(views[9], 0.2, 9)
    found = calibrated([*views[:5], moved, *views[6:9], blurred, *views[10:]])
    (said,) = found.air.left_out
    assert said.startswith("board 5: residual")
    assert said.endswith("the board moved between the cameras' exposures")
    assert "board 9" in found.pairs


def test_a_pair_with_exchanged_pictures_is_named(views: list[BoardView]) -> None:
    swapped = replace(views[3], left_px=views[3].right_px, right_px=views[3].left_px)
    found = calibrated([*views[:3], swapped, *views[4:]])
    assert found.air.left_out == ("board 3: its left and right pictures are exchanged; name them the other way round",)
    assert not found.exchanged


def test_cameras_that_are_called_the_wrong_way_round_are_noticed(views: list[BoardView]) -> None:
    every = [replace(view, left_px=view.right_px, right_px=view.left_px) for view in views]
    assert calibrated(every).exchanged


def test_a_single_mistaken_corner_is_left_out_alone(views: list[BoardView]) -> None:
    spoilt = views[2].left_px.copy()
    spoilt[40] += (0.9, -0.7)
    found = calibrated([*views[:2], replace(views[2], left_px=spoilt), *views[3:]])
    assert found.air.left_out == ()
    (remark,) = found.air.views[2].remarks
    assert remark.startswith("1 corners left out, up to ")


def test_a_board_known_to_be_flat_keeps_flat(views: list[BoardView], clean: AnyCalibration) -> None:
    flat = calibrate_any(views, WIDTH_PX, HEIGHT_PX, BoardTolerance(bow_mm=1e-6))
    assert np.abs(flat.shapes_mm).max() < 1e-6
    assert np.abs(clean.shapes_mm).max() > 1e-3, "these are bent"
    assert flat.air.residual_px > clean.air.residual_px


def test_too_few_views_are_counted_by_camera(views: list[BoardView]) -> None:
    few = [*views[:4], *(only(view, "left") for view in views[4:8])]
    with pytest.raises(
        AirCalibrationError, match="left camera has 8 usable views of the board, the right one 4, and 4 are"
    ):
        calibrated(few)
    pairless = [only(view, side) for view in views[:8] for side in ("left", "right")]
    with pytest.raises(AirCalibrationError, match="the right one 9, and 1 are of both; 6 of each camera and 3 of both"):
        calibrated([*pairless, views[9]])


def test_corners_that_one_camera_alone_sees_are_kept(views: list[BoardView]) -> None:
    board_mm = views[0].corners_mm
    left = {k: views[0].left_px[k] for k in range(40)}
    right = {k: views[0].right_px[k] for k in range(20, 60)}
    view = view_of("v", board_mm, left, right)
    assert len(view.corners_mm) == 60
    assert np.isnan(view.left_px[40:]).all()
    assert np.isnan(view.right_px[:20]).all()
    assert np.array_equal(view.right_px[20:], views[0].right_px[20:60])
    assert len(view_of("v", board_mm, left, {k: right[k] for k in range(20, 31)}).corners_mm) == 40, (
        "eleven are too few"
    )
