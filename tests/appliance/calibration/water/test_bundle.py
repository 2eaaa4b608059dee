"""Four recordings in water calibrate a rig that nobody knows: judged at poses that were not used."""

from __future__ import annotations

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


def test_ports_are_found_within_their_stated_uncertainty_and_nothing_systematic_is_left(
    modelled: Case, fitting: WaterResult
) -> None:
    by_name = {e.name: e for e in fitting.estimates}
    for side in ("left", "right"):
        true = modelled.truth.eye(side).port
        for axis, k in (("x", 0), ("y", 1)):
            estimate = by_name[f"{side} port tilt {axis} (rad)"]
            assert abs(estimate.change - true.normal[k] / true.normal[2]) < 4.0 * estimate.sd
        distance = by_name[f"{side} interface distance (mm)"]
        assert distance.sd < 0.5
        # 0.1 mm: glass differs from the drawing.
        assert abs(distance.change - (true.d_mm - 30.0)) < 4.0 * distance.sd + 0.1
    assert fitting.systematic_px < 0.01
    assert fitting.calibration.residual_px == pytest.approx(0.04, rel=0.1)
    assert not [w for w in fitting.warnings if "systematically" in w or "does not explain" in w]
    assert "left port tilt y (rad)" not in fitting.unobserved
    assert "right camera's shift x (mm)" in fitting.unobserved, "the calibration in air knows the base better"


def test_each_rung_measures_unseen_objects_as_well_as_stated_and_names_the_next(
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
    assert any("image correction" in w for w in ports.warnings), ports.warnings
    assert spline.systematic_px < 0.25 * ports.systematic_px
    assert not any("systematically" in w for w in spline.warnings)
    assert decode(encode(spline.calibration)) == spline.calibration
    assert (spline.calibration.method, spline.calibration.made_from[-1]) == ("bundle, spline", "recording plane 1")


def test_mismatches_change_nothing_that_matters_and_wrong_water_warns(modelled: Case) -> None:
    """Three per mille of the points are mismatched."""
    rng = np.random.default_rng(5)
    spoilt = []
    for r in modelled.recordings:
        right = r.right_px.copy()
        bad = rng.choice(len(right), max(1, len(right) * 3 // 1000), replace=False)
        right[bad] += rng.normal(0.0, 20.0, (len(bad), 2))
        spoilt.append(replace(r, right_px=right))
    clean, result = (adjust(some, modelled.start, Method.PORTS) for some in (modelled.recordings, spoilt))
    for a, b in zip(clean.estimates, result.estimates, strict=True):
        assert abs(a.change - b.change) < 2.0 * a.sd
    salt = [replace(r, water=Water(20.0, 35.0, 530.0)) for r in modelled.recordings]
    assert adjust(salt, modelled.start, Method.PORTS).warnings, "fresh water taken for salt: half a percent of lengths"


def test_recordings_that_calibrate_nothing_are_refused(realistic: Case) -> None:
    swapped = [replace(realistic.recordings[0], length_mm=100.0), *realistic.recordings[1:]]
    for recordings, named in ((realistic.recordings[2:], "ball bar"), (swapped, "100 mm")):
        with pytest.raises(RecordingError, match=named):
            adjust(recordings, realistic.start, Method.PORTS)
    with pytest.raises(RecordingError, match="30"):
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
