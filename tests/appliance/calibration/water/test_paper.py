"""The published search finds distances of perpendicular ports, and shows its limits where ports are tilted."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording, RecordingError
from appliance.calibration.water.paper import search_distances, with_operator
from appliance.optics.model import StereoRig
from hw_sim.truth import TrueRig
from tests.support.calibrating import calibration_recordings, hidden_rig
from tests.support.truth import true_calibration

REACH_MM = 2.0


def upright(truth: TrueRig, off_mm: tuple[float, float]) -> tuple[TrueRig, Calibration]:
    """A rig with perpendicular ports, and its true calibration but for the interface distances."""
    eyes = {
        side: replace(truth.eye(side), port=replace(truth.eye(side).port, normal=(0.0, 0.0, 1.0)))
        for side in ("left", "right")
    }
    straight = replace(truth, left=eyes["left"], right=eyes["right"])
    calibration = true_calibration(straight)
    cameras = [
        replace(camera, port=replace(camera.port, distance_mm=camera.port.distance_mm + off))
        for camera, off in zip((calibration.rig.left, calibration.rig.right), off_mm, strict=True)
    ]
    return straight, replace(calibration, rig=StereoRig(cameras[0], cameras[1]))


@pytest.fixture(scope="module")
def tilted() -> tuple[TrueRig, Calibration, list[Recording]]:
    truth = hidden_rig("realistic", 3)
    _, start = upright(truth, (0.5, -0.5))
    return truth, start, calibration_recordings(truth)


def test_distances_of_perpendicular_ports_are_found() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (0.9, -0.7))
    result = search_distances(calibration_recordings(truth, noise_px=0.0), start, reach_mm=REACH_MM)
    assert result.calibration.rig.left.port.distance_mm == pytest.approx(truth.left.port.d_mm, abs=0.15)
    assert result.calibration.rig.right.port.distance_mm == pytest.approx(truth.right.port.d_mm, abs=0.15)
    assert result.warnings == ()


def test_a_minimum_at_the_limit_is_named() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (3.0, 3.0))
    result = search_distances(calibration_recordings(truth), start, reach_mm=1.0)
    assert any("at the limit of the search" in w for w in result.warnings)


def test_missing_artefacts_are_named(tilted: tuple[TrueRig, Calibration, list[Recording]]) -> None:
    _, start, recordings = tilted
    with pytest.raises(RecordingError, match="no recording of a ball bar"):
        search_distances(recordings[2:], start)
    with pytest.raises(RecordingError, match="operator needs two"):
        with_operator(recordings[:3], start)
