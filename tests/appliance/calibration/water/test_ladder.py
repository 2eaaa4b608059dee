"""Every method behind one function: on a rig that nobody knows each is as good as its model, and says what it lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from appliance.calibration.air.adjustment import BoardView
from appliance.calibration.file import Calibration, CalibrationError, decode, encode
from appliance.calibration.recordings import Recording, RecordingError
from appliance.calibration.water.bundle import BundleSettings
from appliance.calibration.water.interface import SearchSettings
from appliance.calibration.water.ladder import LadderResult, LadderSettings, Method, calibrate
from appliance.optics.water import Water
from hw_sim.truth import TrueRig
from tests.support.calibrating import (
    CALIBRATION_BARS,
    CALIBRATION_PLANES,
    MORE_BARS,
    MORE_PLANES,
    Errors,
    air_of,
    board_views,
    calibration_recordings,
    evaluate,
    hidden_rig,
    start_of,
)
from tests.support.truth import WATER

pytestmark = pytest.mark.dive

SALT = Water(WATER.temperature_c, 35.0, WATER.wavelength_nm)
SEED = 1
QUICK = LadderSettings(BundleSettings(points_per_recording=600), SearchSettings(points_per_recording=120))
TEN = (*CALIBRATION_BARS, *MORE_BARS), (*CALIBRATION_PLANES, *MORE_PLANES)
"""The poses of the bars, and of the planes."""


@dataclass(frozen=True)
class Case:
    truth: TrueRig
    start: Calibration
    recordings: list[Recording]
    boards: list[BoardView]
    results: dict[Method, LadderResult]
    errors: dict[Method, Errors]


@pytest.fixture(scope="module")
def case() -> Case:
    truth = hidden_rig("realistic", SEED)
    start = start_of(air_of(truth))
    recordings = calibration_recordings(truth)
    boards = board_views(truth, 15, 3, wet=True)
    results = {m: calibrate(m, recordings, start, settings=QUICK, boards=boards) for m in Method}
    errors = {m: evaluate(truth, r.calibration.rig, frustums=3) for m, r in results.items()}
    return Case(truth, start, recordings, boards, results, errors)


@pytest.fixture(scope="module")
def ten(case: Case) -> LadderResult:
    """Four bars and six planes."""
    return calibrate(Method.BA_SPLINE, calibration_recordings(case.truth, *TEN), case.start, settings=QUICK)


def test_each_step_of_the_ladder_is_worth_its_model(case: Case) -> None:
    length = {m: e.length for m, e in case.errors.items()}
    frustum = {m: e.frustum for m, e in case.errors.items()}
    flat = {m: e.flatness for m, e in case.errors.items()}
    assert length[Method.PM_MAPPED] > 0.15
    assert flat[Method.PAPER_RM_PRINTED] > 1.5 * flat[Method.RM], "no distance mends the misprint"
    assert length[Method.RM] < 0.7 * length[Method.PM_MAPPED]
    assert length[Method.BA_PORTS] < 0.5 * length[Method.RM]
    assert max(length[m] for m in (Method.PM_WATER, Method.BA_ALL, Method.BA_SPLINE, Method.RAY_FIELD)) < 0.05
    assert max(frustum[m] for m in (Method.BA_SPLINE, Method.RAY_FIELD)) < 0.08
    assert max(flat[m] for m in (Method.BA_SPLINE, Method.RAY_FIELD)) < 0.03 < flat[Method.BA_PORTS]


def test_six_more_recordings_reach_the_target(case: Case, ten: LadderResult) -> None:
    errors = evaluate(case.truth, ten.calibration.rig, frustums=3)
    assert errors.length < 0.03
    assert errors.frustum < 0.06
    assert errors.flatness < 0.03
    assert not ten.warnings


def test_salt_water_changes_the_rays_and_nothing_else(case: Case, ten: LadderResult) -> None:
    """Calibrated in fresh water; in the sea only the index is looked up anew."""
    sea = replace(case.truth, n_water=SALT.index)
    rig = ten.calibration.rig
    assert evaluate(sea, rig, planes=1, water=SALT).length < 0.03
    assert evaluate(sea, rig, planes=1, water=WATER).length > 0.3, "the same points taken for fresh water"


def test_ten_degrees_change_the_rays_and_nothing_else(case: Case, ten: LadderResult) -> None:
    cold = Water(WATER.temperature_c - 15.0, 0.0, WATER.wavelength_nm)
    winter = replace(case.truth, n_water=cold.index)
    assert evaluate(winter, ten.calibration.rig, planes=1, water=cold).length < 0.03
    assert evaluate(winter, ten.calibration.rig, planes=1, water=WATER).length > 0.05


def test_a_pinhole_from_fresh_water_is_useless_in_the_sea(case: Case) -> None:
    sea = replace(case.truth, n_water=SALT.index)
    rig = case.results[Method.PM_WATER].calibration.rig
    assert case.errors[Method.PM_WATER].length < 0.05
    assert evaluate(sea, rig, planes=1, water=SALT).length > 0.3


def test_the_misprinted_model_is_never_saved(case: Case) -> None:
    result = case.results[Method.PAPER_RM_PRINTED]
    assert not result.can_be_saved
    with pytest.raises(CalibrationError, match="comparison only"):
        encode(result.calibration)


def test_every_other_calibration_goes_through_its_file(case: Case) -> None:
    for method, result in case.results.items():
        if result.can_be_saved:
            again = decode(encode(result.calibration))
            assert again == result.calibration, method
            assert again.air_covariance is None, "it is no longer the prior of these values"


def test_what_is_left_has_one_measure(case: Case) -> None:
    """The bundle minimises what is reported for all; a model that cannot lean its ports leaves pixels."""
    left = {m: r.calibration.residual_px or 0.0 for m, r in case.results.items()}
    assert (
        left[Method.RAY_FIELD] <= left[Method.BA_SPLINE] < left[Method.BA_ALL] < left[Method.BA_PORTS] < left[Method.RM]
    )
    assert left[Method.BA_SPLINE] == pytest.approx(0.04, rel=0.1)
    for result in case.results.values():
        assert [r.name for r in result.residuals] == [r.name for r in case.recordings]
    for method in (Method.PM_MAPPED, Method.RM):
        assert any("does not explain" in w for w in case.results[method].warnings), method
    assert not case.results[Method.BA_SPLINE].warnings


def test_pictures_have_what_they_need(case: Case) -> None:
    valley = case.results[Method.RM].valley
    assert valley is not None
    assert valley.statistic.shape == (len(valley.d1_mm), len(valley.d2_mm))
    assert np.ptp(valley.d1_mm) == pytest.approx(8.0)
    costs = case.results[Method.BA_SPLINE].costs
    assert len(costs) > 3
    assert costs[-1] < 0.01 * costs[0]
    assert all(b <= a * (1.0 + 1e-6) for a, b in pairwise(costs))


def test_the_published_flatness_has_its_own_valley(case: Case) -> None:
    published = LadderSettings(search=SearchSettings(noise_free=False, reach_mm=2.0, steps_mm=(1.0, 0.5)))
    valley = calibrate(Method.RM, case.recordings, case.start, settings=published).valley
    assert valley is not None
    assert len(valley.d1_mm) == 5
    noise_free = case.results[Method.RM].valley
    assert noise_free is not None
    assert valley.statistic.min() > noise_free.statistic.min(), "a range of noisy points has a floor"


def test_a_field_from_four_recordings_is_warned_about(case: Case) -> None:
    assert any("at least 4 bars and 6 planes" in w for w in case.results[Method.RAY_FIELD].warnings)


def test_without_a_covariance_only_ports_can_be_adjusted(case: Case) -> None:
    bare = replace(case.start, air_covariance=None)
    with pytest.raises(RecordingError, match="use ba_ports"):
        calibrate(Method.BA_SPLINE, case.recordings, bare)
    assert calibrate(Method.BA_PORTS, case.recordings, bare).unobserved == ()


def test_nothing_starts_from_a_finished_calibration(case: Case) -> None:
    for method in (Method.BA_SPLINE, Method.PM_WATER):
        with pytest.raises(RecordingError, match="as a start must have"):
            calibrate(Method.RM, case.recordings, case.results[method].calibration)


def test_progress_is_told(case: Case) -> None:
    told: list[str] = []
    calibrate(Method.PM_MAPPED, case.recordings, case.start, progress=told.append)
    assert told[0] == "calibrating: pm_mapped"
    assert len(told) > 1
