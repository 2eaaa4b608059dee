"""Calibration in air finds the lenses and how sure it is, also of views that differ; what was not believed is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import BoardTolerance
from appliance.calibrate.air.calibrate import AirCalibration, AirCalibrationError, calibrate_air
from appliance.calibrate.air.linearised import BoardView
from appliance.measure.calibration.parameters import RIG_PARAMETERS
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
def clean(views: list[BoardView]) -> AirCalibration:
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


def calibrated(views: list[BoardView]) -> AirCalibration:
    return calibrate_air(views, WIDTH_PX, HEIGHT_PX, with_field=False)


def sd_of(found: AirCalibration, name: str) -> float:
    k = RIG_PARAMETERS.names[RIG_PARAMETERS.air].index(name)
    return float(np.sqrt(found.covariance[k, k]))


def focal_lengths(found: AirCalibration) -> Array:
    return np.array([found.rig.left.lens.f_px[0], found.rig.right.lens.f_px[0]])


def test_views_that_one_camera_has_alone_tell_about_its_lens(truth: TrueRig, views: list[BoardView]) -> None:
    few = calibrated(views[:6])
    mixed = calibrated([*views[:6], *(only(view, "left") for view in views[6:11]), only(views[11], "right")])
    dry, left = in_air(truth), "left principal distance (px)"
    assert sd_of(mixed, left) < 0.9 * sd_of(few, left)
    for side, f_px, true in zip(("left", "right"), focal_lengths(mixed), (dry.left, dry.right), strict=True):
        assert abs(f_px - true.f_px[0]) < 5.0 * sd_of(mixed, f"{side} principal distance (px)")
    base_mm = np.linalg.norm(np.subtract(dry.right.t_mm, dry.left.t_mm))
    assert np.linalg.norm(mixed.rig.right.translation_mm) == pytest.approx(base_mm, rel=1e-3)
    assert (mixed.pairs, mixed.left_out) == (tuple(view.name for view in views[:6]), ())
    alone = mixed.views[-2]
    assert (len(alone.left_px), len(alone.right_px), len(alone.remarks)) == (len(views[10].left_px), 0, 1)
    assert alone.noise_px[1] is None


def test_a_view_counts_as_much_as_its_noise_lets_it(views: list[BoardView], clean: AirCalibration) -> None:
    """Half of the views five times as noisy: the noise is told, and the result is nearer to that without it than unweighted."""
    spoilt = [noisy(view, 0.15, k) if k % 2 else view for k, view in enumerate(views)]
    found = calibrated(spoilt)
    assert found.left_out == ()
    for k, view in enumerate(found.views):
        assert view.noise_px[0] == pytest.approx(0.153 if k % 2 else 0.03, rel=0.25), view.name
    off = np.abs(focal_lengths(found) - focal_lengths(clean)).max()
    assert off < 0.15, "half of what it is unweighted"


def test_a_board_that_moved_and_exchanged_pictures_are_left_out_and_blurred_ones_not(views: list[BoardView]) -> None:
    spoilt = list(views)
    spoilt[3] = replace(views[3], left_px=views[3].right_px, right_px=views[3].left_px)
    spoilt[5] = replace(views[5], right_px=views[5].right_px + np.array([1.0, 0.7]))
    spoilt[9] = noisy(views[9], 0.2, 9)
    found = calibrated(spoilt)
    assert sorted(said.split(":")[0] for said in found.left_out) == ["board 3", "board 5"]
    assert any("exchanged" in said for said in found.left_out)
    assert "board 9" in found.pairs
    assert not found.exchanged
    every = [replace(view, left_px=view.right_px, right_px=view.left_px) for view in views]
    assert calibrated(every).exchanged, "cameras that are called the wrong way round"


def test_a_board_known_to_be_flat_keeps_flat(views: list[BoardView], clean: AirCalibration) -> None:
    flat = calibrate_air(views, WIDTH_PX, HEIGHT_PX, BoardTolerance(bow_mm=1e-6), with_field=False)
    assert np.abs(flat.shapes_mm).max() < 1e-6
    assert np.abs(clean.shapes_mm).max() > 1e-3, "these are bent"
    assert flat.residual_px > clean.residual_px


def test_too_few_views_are_counted_by_camera(views: list[BoardView]) -> None:
    few = [*views[:4], *(only(view, "left") for view in views[4:8])]
    with pytest.raises(AirCalibrationError, match="8 usable views of the board, the right one 4, both together 4;"):
        calibrated(few)
    pairless = [only(view, side) for view in views[:8] for side in ("left", "right")]
    with pytest.raises(AirCalibrationError, match="the right one 9, both together 1;"):
        calibrated([*pairless, views[9]])


def test_corners_that_one_camera_alone_sees_are_kept(views: list[BoardView]) -> None:
    board_mm = views[0].corners_mm
    left = {k: views[0].left_px[k] for k in range(40)}
    right = {k: views[0].right_px[k] for k in range(20, 60)}
    view = BoardView.of("v", board_mm, left, right)
    assert len(view.corners_mm) == 60
    assert np.isnan(view.left_px[40:]).all()
    assert np.isnan(view.right_px[:20]).all()
    assert np.array_equal(view.right_px[20:], views[0].right_px[20:60])
    assert len(BoardView.of("v", board_mm, left, {k: right[k] for k in range(20, 31)}).corners_mm) == 40, (
        "eleven are too few"
    )


def test_lenses_and_base_are_found_within_their_covariance() -> None:
    truth = hidden_rig("modelled", 3)
    air = calibrate_air(board_views(truth), WIDTH_PX, HEIGHT_PX, with_field=False)
    dry = in_air(truth)
    sd = np.sqrt(np.diag(air.covariance))
    for k, (camera, true) in enumerate(((air.rig.left, dry.left), (air.rig.right, dry.right))):
        found = np.array([camera.lens.f_px[0], *camera.lens.c_px, *camera.lens.distortion])
        wanted = np.array([true.f_px[0], *true.c_px, *true.distortion])
        assert np.all(np.abs(found - wanted) < 4.5 * sd[8 * k : 8 * k + 8])
    base = np.array(dry.left.R).T @ (np.array(dry.right.t_mm) - np.array(dry.left.t_mm))
    assert np.all(np.abs(np.array(air.rig.right.translation_mm) - base) < 4.5 * sd[19:22])
    assert sd[0] < 0.3, "twenty boards must hold the principal distance"
    assert air.residual_px == pytest.approx(0.03, rel=0.1)
    assert air.left_out == ()


def test_what_was_not_believed_is_named() -> None:
    """A board that moved between the cameras, and a single corner beside glare."""
    views = board_views(hidden_rig("modelled", 3), 10)
    spoilt = views[2].right_px.copy()
    spoilt[40] += (0.9, -0.7)
    views[2] = replace(views[2], right_px=spoilt)
    views[4] = replace(views[4], right_px=views[4].right_px + np.array([1.5, 1.0]))
    air = calibrate_air(views, WIDTH_PX, HEIGHT_PX, with_field=False)
    (said,) = air.left_out
    assert said.startswith("board 4: residual")
    assert "moved" in said
    fitted = {view.name: view for view in air.views}["board 2"]
    assert len(fitted.left_px) == len(spoilt) - 1, "the corner goes alone"
    assert len(fitted.remarks) == 1
