"""Every method behind one function: on a rig that nobody knows each is as good as its model, and says what it lacks."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from appliance.calibration.file import Calibration, decode, encode
from appliance.calibration.recordings import Recording, RecordingError
from appliance.calibration.water.calibrate import calibrate
from appliance.calibration.water.method import Method, WaterResult
from appliance.optics.water import Water
from hw_sim.truth import TrueRig
from tests.support.calibrating import (
    CALIBRATION_BARS,
    CALIBRATION_PLANES,
    MORE_BARS,
    MORE_PLANES,
    Errors,
    air_of,
    calibration_recordings,
    evaluate,
    hidden_rig,
    start_of,
)
from tests.support.truth import WATER

SALT = Water(WATER.temperature_c, 35.0, WATER.wavelength_nm)
SEED = 1
SEEDS = range(1, 9)
TEN = (*CALIBRATION_BARS, *MORE_BARS), (*CALIBRATION_PLANES, *MORE_PLANES)
"""The poses of the bars, and of the planes."""


@dataclass(frozen=True)
class Case:
    truth: TrueRig
    start: Calibration
    recordings: list[Recording]
    results: dict[Method, WaterResult]
    errors: dict[Method, Errors]


@pytest.fixture(scope="module")
def case() -> Case:
    truth = hidden_rig("realistic", SEED)
    start = start_of(air_of(truth))
    recordings = calibration_recordings(truth)
    results = {m: calibrate(m, recordings, start) for m in Method}
    errors = {m: evaluate(truth, r.calibration.rig, frustums=3) for m, r in results.items()}
    return Case(truth, start, recordings, results, errors)


@pytest.fixture(scope="module")
def ten(case: Case) -> WaterResult:
    """Four bars and six planes."""
    return calibrate(Method.SPLINE, calibration_recordings(case.truth, *TEN), case.start)


@pytest.mark.dive
def test_each_method_is_worth_its_model(case: Case) -> None:
    paper, ports, spline = (case.errors[m] for m in (Method.PAPER, Method.PORTS, Method.SPLINE))
    pm, rm = (evaluate(case.truth, one.rig, frustums=3) for one in case.results[Method.PAPER].before.values())
    assert pm.length > 0.15
    assert rm.length < 0.7 * pm.length
    assert paper.frustum < rm.frustum
    assert ports.length < 0.5 * paper.length
    assert spline.length < 0.05
    assert spline.frustum < 0.08
    assert spline.flatness < 0.03 < ports.flatness


@pytest.mark.dive
def test_six_more_recordings_reach_the_target(case: Case, ten: WaterResult) -> None:
    errors = evaluate(case.truth, ten.calibration.rig, frustums=3)
    assert errors.length < 0.03
    assert errors.frustum < 0.06
    assert errors.flatness < 0.03
    assert not ten.warnings


@pytest.mark.dive
def test_salt_water_changes_the_rays_and_nothing_else(case: Case, ten: WaterResult) -> None:
    """Calibrated in fresh water; in the sea only the index is looked up anew."""
    sea = replace(case.truth, n_water=SALT.index)
    rig = ten.calibration.rig
    assert evaluate(sea, rig, planes=1, water=SALT).length < 0.03
    assert evaluate(sea, rig, planes=1, water=WATER).length > 0.3, "the same points taken for fresh water"


@pytest.mark.dive
def test_ten_degrees_change_the_rays_and_nothing_else(case: Case, ten: WaterResult) -> None:
    cold = Water(WATER.temperature_c - 15.0, 0.0, WATER.wavelength_nm)
    winter = replace(case.truth, n_water=cold.index)
    assert evaluate(winter, ten.calibration.rig, planes=1, water=cold).length < 0.03
    assert evaluate(winter, ten.calibration.rig, planes=1, water=WATER).length > 0.05


@pytest.mark.dive
def test_every_calibration_goes_through_its_file(case: Case) -> None:
    for result in case.results.values():
        for calibration in (result.calibration, *result.before.values()):
            assert decode(encode(calibration)) == calibration
            assert calibration.air_covariance is None, "it is no longer the prior of these values"
            assert calibration.air_field is None


@pytest.mark.dive
def test_what_is_left_has_one_measure(case: Case) -> None:
    """The bundle minimises what is reported for all; a model that cannot lean its ports leaves pixels."""
    left = {m: r.calibration.residual_px or 0.0 for m, r in case.results.items()}
    before = {name: one.residual_px or 0.0 for name, one in case.results[Method.PAPER].before.items()}
    assert left[Method.SPLINE] < left[Method.PORTS] < before["rm"]
    assert left[Method.PAPER] < before["rm"]
    assert left[Method.SPLINE] == pytest.approx(0.04, rel=0.1)
    for result in case.results.values():
        assert [r.name for r in result.residuals] == [r.name for r in case.recordings]
    assert not case.results[Method.SPLINE].warnings
    costs = case.results[Method.SPLINE].costs
    assert costs[-1] < 0.01 * costs[0]
    assert all(b <= a * (1.0 + 1e-6) for a, b in pairwise(costs))


@pytest.mark.dive
def test_without_a_covariance_only_ports_can_be_adjusted(case: Case) -> None:
    bare = replace(case.start, air_covariance=None)
    with pytest.raises(RecordingError, match="use ports"):
        calibrate(Method.SPLINE, case.recordings, bare)
    assert calibrate(Method.PORTS, case.recordings, bare).unobserved == ()


@pytest.mark.dive
def test_nothing_starts_from_a_finished_calibration(case: Case) -> None:
    for finished in (case.results[Method.SPLINE].calibration, case.results[Method.PAPER].before["pm"]):
        for method in Method:
            with pytest.raises(RecordingError, match="as a start must have"):
                calibrate(method, case.recordings, finished)


@pytest.mark.dive
def test_progress_is_told(case: Case) -> None:
    told: list[str] = []
    calibrate(Method.PORTS, case.recordings, case.start, told.append)
    assert told == ["calibrating: ports", "looking at what is left"]


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_eight_hidden_rigs_reach_the_stated_accuracy() -> None:
    """The table of docs/calibration.md, judged at poses that were not used."""
    found: dict[str, list[tuple[float, float, float, float]]] = {}
    for seed in SEEDS:
        truth = hidden_rig("realistic", seed)
        start = start_of(air_of(truth))
        four, ten = calibration_recordings(truth), calibration_recordings(truth, *TEN)
        runs = [(m.value, m, four) for m in Method]
        runs += [(f"{m.value}, six more", m, ten) for m in (Method.PORTS, Method.SPLINE)]
        rigs = [("air, ports as drawn", start.rig, 0.0)]
        for name, method, recordings in runs:
            begun = time.process_time()
            result = calibrate(method, recordings, start)
            rigs.append((name, result.calibration.rig, time.process_time() - begun))
            rigs += [(before, one.rig, 0.0) for before, one in result.before.items()]
        for name, rig, cpu_s in rigs:
            errors = evaluate(truth, rig, frustums=7)
            found.setdefault(name, []).append((errors.length, errors.frustum, errors.flatness, cpu_s))
    median = {name: np.median(values, axis=0) for name, values in found.items()}
    worst = {name: np.max(values, axis=0) for name, values in found.items()}
    for name in found:
        m, w = median[name], worst[name]
        print(
            f"| {name} | {m[0]:.3f} % | {w[0]:.3f} % | {m[1]:.3f} % | {w[1]:.3f} % | {m[2]:.3f} % | {w[2]:.3f} % "
            f"| {m[3]:.1f} s |"
        )
    assert median["ports"][0] < 0.04
    assert worst["ports"][0] < 0.08
    assert median["spline"][0] < 0.035
    assert median["spline"][2] < 0.03
    assert median["spline, six more"][0] < 0.02
    assert median["spline, six more"][1] < 0.05
