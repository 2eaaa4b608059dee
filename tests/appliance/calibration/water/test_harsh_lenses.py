"""Lens fields up to order 11, flawed windows and bent boards: lengths hold, and where they cannot, it is said."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from appliance.calibration import parameters
from appliance.calibration.air.adjustment import AirCalibration, calibrate_air
from appliance.calibration.file import Calibration, CalibrationError, decode, encode
from appliance.calibration.recordings import Recording
from appliance.calibration.water.bundle import adjust
from appliance.calibration.water.expected import Columns, Doubt, expected
from appliance.calibration.water.method import Method, WaterResult
from appliance.checksummed_file import with_checksum
from hw_sim.truth import TrueRig, in_air
from tests.support.calibrating import (
    HEIGHT_PX,
    WIDTH_PX,
    Errors,
    air_of,
    board_views,
    calibration_recordings,
    evaluate,
    hidden_rig,
    start_of,
)

pytestmark = pytest.mark.dive

SEED = 10_001
NONE = slice(0, 0)


@dataclass(frozen=True)
class Case:
    truth: TrueRig
    air: AirCalibration
    start: Calibration
    recordings: list[Recording]
    known: WaterResult
    unknown: WaterResult
    """From a start as it was made before fields were written down."""
    errors: Errors
    errors_unknown: Errors


@pytest.fixture(scope="module")
def case() -> Case:
    truth = hidden_rig("outside", SEED)
    air = air_of(truth)
    start = start_of(air)
    recordings = calibration_recordings(truth)
    known = adjust(recordings, start, Method.SPLINE)
    unknown = adjust(recordings, replace(start, air_field=None), Method.SPLINE)
    errors, errors_unknown = (evaluate(truth, r.calibration.rig) for r in (known, unknown))
    return Case(truth, air, start, recordings, known, unknown, errors, errors_unknown)


def test_a_lens_field_of_order_eleven_spoils_no_length_and_no_plane(case: Case) -> None:
    assert case.errors_unknown.length > 0.05, "a field that does no harm proves nothing"
    assert case.errors.length < 0.03
    assert case.errors.flatness < 0.03
    assert case.known.calibration.residual_px == pytest.approx(0.04, rel=0.1)
    assert case.known.warnings == ()


def test_lengths_that_may_miss_what_is_usual_are_announced_in_percent_with_a_remedy(case: Case) -> None:
    said = [w for w in case.unknown.warnings if w.startswith("lengths may be wrong by")]
    assert len(said) == 1, case.unknown.warnings
    assert "calibrate in air again" in said[0]
    assert case.unknown.expected is not None
    assert case.unknown.expected.length_percent > 0.05


def test_what_is_expected_of_lengths_is_of_the_size_of_what_comes(case: Case) -> None:
    told = case.known.expected
    assert told is not None
    assert 0.3 < case.errors.length / told.length_percent < 2.0
    assert 0.3 < case.errors.flatness / told.flat_percent < 3.0


def test_a_pose_that_is_unsure_makes_lengths_unsure_by_as_much(case: Case) -> None:
    """The right camera with its window turned by 0.01° about y: what that does to a bar follows from two rays."""
    turn = np.radians(0.01)
    covariance = np.zeros((parameters.COUNT,) * 2)
    covariance[23, 23] = turn**2
    rig = case.known.calibration.rig
    columns = Columns(tuple(range(parameters.COUNT)), (NONE, NONE))
    nothing = np.zeros(parameters.COUNT)
    bar = case.recordings[0]
    found = expected(rig, bar, Doubt(covariance, nothing, 0.0, 0.0), columns)
    # Two rays from a base b that turn by dα meet z² dα / b farther away. So lengths across the view grow by z dα / b, those
    # along it by twice that. The worst bar leans by 35°, at the far end of the volume.
    z, b, lean = 1.07 * 522.5, 230.0, np.radians(35.0)
    assert found.length_percent == pytest.approx(100.0 * 2.0 * z * turn / b * (1.0 + np.sin(lean) ** 2), rel=0.1)
    covariance[:] = 0.0
    rest = expected(rig, bar, Doubt(covariance, nothing, 0.0, 0.05), columns)
    assert rest.length_percent > 0.02
    # Six standard deviations of some 10 µm of depth, over the 250 mm of a plane that fills the view.
    assert 0.02 < rest.flat_percent < 0.06
    water = expected(rig, bar, Doubt(covariance, nothing, 1e-4, 0.0), columns)
    # Nothing adjusted to it: distances in water go with the index of what is beyond the window.
    assert water.length_percent == pytest.approx(100.0 * 2.0 * 1e-4 / 1.335, rel=0.5)
    none = expected(rig, bar, Doubt(covariance, nothing, 0.0, 0.0), columns)
    assert (none.length_percent, none.flat_percent) == (0.0, 0.0)


def test_a_start_keeps_what_the_boards_said_and_a_calibration_in_water_does_not(case: Case) -> None:
    again = decode(encode(case.start))
    assert again == case.start
    assert again.air_field is not None
    assert case.known.calibration.air_field is None
    old = replace(case.start, air_field=None)
    assert b"air_field" not in encode(old), "as before it was known"
    assert decode(encode(old)) == old


def test_a_damaged_field_from_air_is_refused_by_name(case: Case) -> None:
    import json

    content = json.loads(encode(case.start))
    del content["sha256"]
    content["air_field"]["root"] = content["air_field"]["root"][:-8]
    with pytest.raises(CalibrationError, match=r"air_field\.root is .* allowed: the factor of a covariance"):
        decode(with_checksum(content))


def test_a_board_bent_to_a_saddle_a_twist_and_an_s_bends_no_lens() -> None:
    truth = hidden_rig("modelled", 10_003)
    bent = replace(truth, artefacts=replace(truth.artefacts, board_form_mm=(0.05, -0.05, 0.03)))
    air = calibrate_air(board_views(bent), WIDTH_PX, HEIGHT_PX, with_field=False)
    sd = np.sqrt(np.diag(air.covariance))
    dry = in_air(truth)
    for k, (camera, true) in enumerate(((air.rig.left, dry.left), (air.rig.right, dry.right))):
        assert abs(camera.lens.f_px[0] - true.f_px[0]) < 4.0 * sd[8 * k]
    assert air.residual_px == pytest.approx(0.03, rel=0.05)
    assert air.field is None
