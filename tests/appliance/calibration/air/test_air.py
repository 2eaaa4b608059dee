"""The calibration in air finds the lenses, says how sure it is, and says in words which views it did not believe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.air.adjustment import AirCalibrationError, calibrate_air
from hw_sim.truth import in_air
from tests.support.calibrating import HEIGHT_PX, WIDTH_PX, board_views, hidden_rig


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


def test_what_was_not_believed_is_named_and_too_few_views_are_refused() -> None:
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
    with pytest.raises(AirCalibrationError, match="4 usable views of the board; 6 are needed"):
        calibrate_air(views[:4], WIDTH_PX, HEIGHT_PX, with_field=False)
