"""Four recordings in water calibrate a rig that nobody knows: judged at poses that were not used."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import pytest

from appliance.calibration.air.adjustment import AirCalibration
from appliance.calibration.file import Calibration, decode, encode
from appliance.calibration.recordings import Recording, RecordingError
from appliance.calibration.water.bundle import BundleSettings, adjust
from appliance.calibration.water.method import Method, WaterResult
from appliance.calibration.water.shapes import fit_plane, triangulate
from appliance.optics.water import Water
from hw_sim.truth import TrueRig
from tests.support.calibrating import (
    CALIBRATION_BARS,
    air_of,
    calibration_recordings,
    evaluate,
    hidden_rig,
    record_plane,
    start_of,
)


@dataclass(frozen=True)
class Case:
    truth: TrueRig
    air: AirCalibration
    start: Calibration
    recordings: list[Recording]


def case_of(truth_set: str, seed: int) -> Case:
    truth = hidden_rig(truth_set, seed)
    air = air_of(truth)
    return Case(truth, air, start_of(air), calibration_recordings(truth))


@pytest.fixture(scope="module")
def realistic() -> Case:
    return case_of("realistic", 1)


@pytest.fixture(scope="module")
def modelled() -> Case:
    """A rig with neither lens field nor wedge: everything it has is in the model."""
    return case_of("modelled", 1)


@pytest.fixture(scope="module")
def ports(realistic: Case) -> WaterResult:
    return adjust(realistic.recordings, realistic.start, Method.PORTS)


@pytest.fixture(scope="module")
def spline(realistic: Case) -> WaterResult:
    return adjust(realistic.recordings, realistic.start, Method.SPLINE)


@pytest.fixture(scope="module")
def fitting(modelled: Case) -> WaterResult:
    return adjust(modelled.recordings, modelled.start, Method.SPLINE, BundleSettings(spline_px=0.0))


def test_ports_are_found_within_their_stated_uncertainty(modelled: Case, fitting: WaterResult) -> None:
    by_name = {e.name: e for e in fitting.estimates}
    for side in ("left", "right"):
        true = modelled.truth.eye(side).port
        for axis, k in (("x", 0), ("y", 1)):
            estimate = by_name[f"{side} port tilt {axis} (rad)"]
            assert abs(estimate.change - true.normal[k] / true.normal[2]) < 4.0 * estimate.sd
        distance = by_name[f"{side} interface distance (mm)"]
        assert distance.sd < 0.5
        assert (
            abs(distance.change - (true.d_mm - 30.0)) < 4.0 * distance.sd + 0.1
        )  # 0.1: glass differs from the drawing


def test_a_rig_that_fits_the_model_raises_no_systematic_rest(fitting: WaterResult) -> None:
    assert fitting.systematic_px < 0.01
    assert fitting.calibration.residual_px == pytest.approx(0.04, rel=0.1)
    assert not [w for w in fitting.warnings if "systematically" in w or "does not explain" in w]


def test_each_rung_measures_unseen_objects_as_well_as_stated(
    realistic: Case, ports: WaterResult, spline: WaterResult
) -> None:
    before = evaluate(realistic.truth, realistic.start.rig)
    by_ports = evaluate(realistic.truth, ports.calibration.rig)
    by_spline = evaluate(realistic.truth, spline.calibration.rig)
    assert before.length > 0.1, "a rig that needs no calibration proves nothing"
    assert by_ports.length < 0.06
    assert by_ports.flatness < 0.12
    assert by_spline.length < 0.05
    assert by_spline.flatness < 0.04


def test_lens_field_is_noticed_and_its_remedy_named(ports: WaterResult, spline: WaterResult) -> None:
    assert any("image correction" in w for w in ports.warnings), ports.warnings
    assert spline.systematic_px < 0.25 * ports.systematic_px
    assert not any("systematically" in w for w in spline.warnings)


def test_wrong_water_is_noticed_by_length_or_warning(modelled: Case) -> None:
    salt = Water(20.0, 35.0, 530.0)
    wrong = [replace(r, water=salt) for r in modelled.recordings]
    result = adjust(wrong, modelled.start, Method.PORTS)
    assert result.warnings, "fresh water taken for salt: half a percent of every length"


def test_what_recordings_cannot_tell_is_listed(fitting: WaterResult) -> None:
    assert "left port tilt y (rad)" not in fitting.unobserved
    assert "right camera's shift x (mm)" in fitting.unobserved, "the calibration in air knows the base better"


def test_three_per_mille_of_mismatches_change_nothing_that_matters(modelled: Case) -> None:
    rng = np.random.default_rng(5)
    spoilt = []
    for r in modelled.recordings:
        right = r.right_px.copy()
        bad = rng.choice(len(right), max(1, len(right) * 3 // 1000), replace=False)
        right[bad] += rng.normal(0.0, 20.0, (len(bad), 2))
        spoilt.append(replace(r, right_px=right))
    clean = adjust(modelled.recordings, modelled.start, Method.PORTS)
    result = adjust(spoilt, modelled.start, Method.PORTS)
    for a, b in zip(clean.estimates, result.estimates, strict=True):
        assert abs(a.change - b.change) < 2.0 * a.sd


def test_planes_alone_are_refused(realistic: Case) -> None:
    with pytest.raises(RecordingError, match="record a ball bar"):
        adjust(realistic.recordings[2:], realistic.start, Method.PORTS)


def test_swapped_certificate_is_refused(realistic: Case) -> None:
    wrong = [replace(realistic.recordings[0], length_mm=100.0), *realistic.recordings[1:]]
    with pytest.raises(RecordingError, match=r"certificate says 100 mm"):
        adjust(wrong, realistic.start, Method.PORTS)


def test_all_rungs_solve_in_seconds(realistic: Case) -> None:
    begun = time.process_time()
    adjust(realistic.recordings, realistic.start, Method.SPLINE)
    assert time.process_time() - begun < 15.0


def test_the_file_carries_all_that_was_solved(realistic: Case, spline: WaterResult) -> None:
    solved = spline.calibration
    again = decode(encode(solved))
    assert again == solved
    assert evaluate(realistic.truth, again.rig, 2, 1) == evaluate(realistic.truth, solved.rig, 2, 1)
    assert solved.method == "bundle, spline"
    assert solved.made_from[-1] == "recording plane 1"


def test_same_recordings_same_calibration(realistic: Case) -> None:
    settings = BundleSettings(points_per_recording=300)
    one = adjust(realistic.recordings, realistic.start, Method.PORTS, settings=settings)
    two = adjust(realistic.recordings, realistic.start, Method.PORTS, settings=settings)
    assert one.calibration.hash == two.calibration.hash


def test_a_recording_with_too_few_points_is_refused(realistic: Case) -> None:
    with pytest.raises(RecordingError, match="at least 30 are needed"):
        record_plane(realistic.truth, CALIBRATION_BARS[0], "scrap", 20, 0.0, 1)


def test_a_plane_seen_along_one_line_is_named(realistic: Case) -> None:
    """About that line the plane may turn as it likes."""
    bar, plane = realistic.recordings[0], realistic.recordings[-1]
    along = np.linspace(100.0, 1500.0, len(plane.left_px))
    line = replace(plane, left_px=np.stack([along, np.full(len(along), 600.0)], -1))
    rig = realistic.start.rig
    points = triangulate(rig, plane.left_px, plane.right_px, plane.water.index)
    normal, offset = fit_plane(points)
    origin, direction = rig.left.rays(line.left_px, plane.water.index)
    on = origin + ((offset - origin @ normal) / (direction @ normal))[:, None] * direction
    line = replace(line, right_px=rig.right.project(on, plane.water.index))
    with pytest.raises(RecordingError, match=f"do not determine the place of {plane.name}"):
        adjust([bar, line], realistic.start, Method.PORTS)
