"""Four recordings in water calibrate a hidden rig; the published search finds distances of windows that do not lean."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from appliance.calibrate.air.calibrate import calibrate_air
from appliance.calibrate.recordings import Recording, RecordingError
from appliance.calibrate.water.bundle import BundleSettings, adjust
from appliance.calibrate.water.method import Method, WaterResult
from appliance.calibrate.water.paper import search_distances, with_operator
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import StereoRig
from appliance.measure.light.water import Water
from hw_sim.truth import TrueRig
from tests.support import calibrating
from tests.support.calibrating import calibration_recordings, hidden_rig
from tests.support.truth import true_calibration


@dataclass(frozen=True)
class Case:
    """A rig with neither lens field nor wedge: everything it has is in the model."""

    truth: TrueRig
    start: Calibration
    recordings: list[Recording]
    fitting: WaterResult


@pytest.fixture(scope="module")
def case() -> Case:
    truth = hidden_rig("modelled", 1)
    start = calibrating.start_of(
        calibrate_air(calibrating.board_views(truth), calibrating.WIDTH_PX, calibrating.HEIGHT_PX, with_field=False)
    )
    recordings = calibration_recordings(truth)
    return Case(truth, start, recordings, adjust(recordings, start, Method.SPLINE, BundleSettings(spline_px=0.0)))


def test_ports_are_found_within_their_stated_uncertainty_and_nothing_systematic_is_left(case: Case) -> None:
    by_name = {e.name: e for e in case.fitting.estimates}
    for side in ("left", "right"):
        true = case.truth.eye(side).port
        for axis, k in (("x", 0), ("y", 1)):
            estimate = by_name[f"{side} port tilt {axis} (rad)"]
            assert abs(estimate.change - true.normal[k] / true.normal[2]) < 4.0 * estimate.sd
        distance = by_name[f"{side} interface distance (mm)"]
        assert distance.sd < 0.5
        # 0.1 mm: glass differs from the drawing.
        assert abs(distance.change - (true.d_mm - 30.0)) < 4.0 * distance.sd + 0.1
    assert case.fitting.systematic_px < 0.01
    assert case.fitting.calibration.residual_px == pytest.approx(0.04, rel=0.1)
    assert not [w for w in case.fitting.warnings if "systematically" in w or "does not explain" in w]
    assert "left port tilt y (rad)" not in case.fitting.unobserved
    assert "right camera's shift x (mm)" in case.fitting.unobserved, "the calibration in air knows the base better"
    made = case.fitting.calibration
    assert (made.method, made.made_from[-1]) == ("bundle, spline", "recording plane 1")


def test_mismatches_change_nothing_that_matters_and_wrong_water_warns(case: Case) -> None:
    """Three per mille of the points are mismatched."""
    rng = np.random.default_rng(5)
    spoilt = []
    for r in case.recordings:
        right = r.right_px.copy()
        bad = rng.choice(len(right), max(1, len(right) * 3 // 1000), replace=False)
        right[bad] += rng.normal(0.0, 20.0, (len(bad), 2))
        spoilt.append(replace(r, right_px=right))
    clean, result = (adjust(some, case.start, Method.PORTS) for some in (case.recordings, spoilt))
    for a, b in zip(clean.estimates, result.estimates, strict=True):
        assert abs(a.change - b.change) < 2.0 * a.sd
    salt = [replace(r, water=Water(20.0, 35.0, 530.0)) for r in case.recordings]
    assert adjust(salt, case.start, Method.PORTS).warnings, "fresh water taken for salt: half a percent of lengths"


def test_recordings_that_calibrate_nothing_are_refused(case: Case) -> None:
    swapped = [replace(case.recordings[0], length_mm=100.0), *case.recordings[1:]]
    for recordings, named in ((case.recordings[2:], "ball bar"), (swapped, "100 mm")):
        with pytest.raises(RecordingError, match=named):
            adjust(recordings, case.start, Method.PORTS)
    with pytest.raises(RecordingError, match="no recording of a ball bar"):
        search_distances(case.recordings[2:], case.start)
    with pytest.raises(RecordingError, match="method needs two"):
        with_operator(case.recordings[:3], case.start)
    with pytest.raises(RecordingError, match="30"):
        calibrating.record_plane(case.truth, calibrating.CALIBRATION_BARS[0], "scrap", 20, 0.0, 1)


def upright(truth: TrueRig, off_mm: tuple[float, float]) -> tuple[TrueRig, Calibration]:
    """A rig with perpendicular ports, and its true calibration but for the interface distances."""
    left, right = (replace(one, port=replace(one.port, normal=(0.0, 0.0, 1.0))) for one in (truth.left, truth.right))
    straight = replace(truth, left=left, right=right)
    calibration = true_calibration(straight)
    first, second = (
        replace(camera, port=replace(camera.port, distance_mm=camera.port.distance_mm + off))
        for camera, off in zip((calibration.rig.left, calibration.rig.right), off_mm, strict=True)
    )
    return straight, replace(calibration, rig=StereoRig(first, second))


def test_distances_of_perpendicular_ports_are_found() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (0.9, -0.7))
    result = search_distances(calibration_recordings(truth, noise_px=0.0), start, reach_mm=2.0)
    assert result.calibration.rig.left.port.distance_mm == pytest.approx(truth.left.port.d_mm, abs=0.15)
    assert result.calibration.rig.right.port.distance_mm == pytest.approx(truth.right.port.d_mm, abs=0.15)
    assert result.warnings == ()


def test_a_minimum_at_the_limit_is_named() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (3.0, 3.0))
    result = search_distances(calibration_recordings(truth), start, reach_mm=1.0)
    assert any("at the limit of the search" in w for w in result.warnings)
