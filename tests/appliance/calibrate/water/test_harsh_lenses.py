"""Lens fields up to order 11, flawed windows and bent boards: lengths hold, and where they cannot, it is said."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from appliance.calibrate.air.calibrate import calibrate_air
from appliance.calibrate.water.bundle import adjust
from appliance.calibrate.water.method import Method, WaterResult
from hw_sim.truth import in_air
from tests.support import calibrating
from tests.support.calibrating import Errors, calibration_recordings, evaluate, hidden_rig

pytestmark = pytest.mark.dive


@dataclass(frozen=True)
class Case:
    known: WaterResult
    unknown: WaterResult
    """From a start as it was made before fields were written down."""
    errors: Errors
    errors_unknown: Errors


@pytest.fixture(scope="module")
def case() -> Case:
    truth = hidden_rig("outside", 10_001)
    start, recordings = calibrating.start_of(calibrating.air_of(truth)), calibration_recordings(truth)
    known, unknown = (adjust(recordings, one, Method.SPLINE) for one in (start, replace(start, air_field=None)))
    errors, errors_unknown = (evaluate(truth, one.calibration.rig) for one in (known, unknown))
    return Case(known, unknown, errors, errors_unknown)


def test_a_lens_field_of_order_eleven_spoils_no_length_and_no_plane(case: Case) -> None:
    assert case.errors_unknown.length > 0.05, "a field that does no harm proves nothing"
    assert case.errors.length < 0.03
    assert case.errors.flatness < 0.03
    assert case.known.calibration.residual_px == pytest.approx(0.04, rel=0.1)
    assert case.known.warnings == ()


def test_what_is_expected_of_lengths_is_what_comes_and_announced_where_it_is_much(case: Case) -> None:
    told, doubtful = case.known.expected, case.unknown.expected
    assert told is not None
    assert 0.3 < case.errors.length / told.length_percent < 2.0
    assert 0.3 < case.errors.flatness / told.flat_percent < 3.0
    assert doubtful is not None
    assert doubtful.length_percent > 0.05
    (said,) = [w for w in case.unknown.warnings if w.startswith("lengths may be wrong by")]
    assert "calibrate in air again" in said


def test_a_board_bent_to_a_saddle_a_twist_and_an_s_bends_no_lens() -> None:
    truth = hidden_rig("modelled", 10_003)
    bent = replace(truth, artefacts=replace(truth.artefacts, board_form_mm=(0.05, -0.05, 0.03)))
    air = calibrate_air(calibrating.board_views(bent), calibrating.WIDTH_PX, calibrating.HEIGHT_PX, with_field=False)
    sd, dry = np.sqrt(np.diag(air.covariance)), in_air(truth)
    for k, (camera, true) in enumerate(((air.rig.left, dry.left), (air.rig.right, dry.right))):
        assert abs(camera.lens.f_px[0] - true.f_px[0]) < 4.0 * sd[8 * k]
    assert air.residual_px == pytest.approx(0.03, rel=0.05)
    assert air.field is None
