"""The published search finds distances of perpendicular ports, and shows its limits where ports are tilted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording, RecordingError
from appliance.calibration.water.interface import SearchSettings, cubic, search_distances
from appliance.calibration.water.operator import search_with_operator, with_operator
from appliance.calibration.water.shapes import fit_plane, triangulate
from appliance.optics.model import StereoRig
from hw_sim.truth import TrueRig
from tests.support.calibrating import calibration_recordings, hidden_rig
from tests.support.truth import true_calibration

SETTINGS = SearchSettings(reach_mm=2.0, points_per_recording=400)


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
    result = search_distances(calibration_recordings(truth, noise_px=0.0), start, SETTINGS)
    assert result.calibration.rig.left.port.distance_mm == pytest.approx(truth.left.port.d_mm, abs=0.15)
    assert result.calibration.rig.right.port.distance_mm == pytest.approx(truth.right.port.d_mm, abs=0.15)
    assert result.warnings == ()
    assert max(abs(e) for e in result.length_errors) < 1e-4


def test_published_flatness_is_a_range_with_the_noise_as_its_floor() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (0.0, 0.0))
    recordings = calibration_recordings(truth)
    still = replace(SETTINGS, reach_mm=0.5, steps_mm=(0.5,))
    published = search_distances(recordings, start, replace(still, noise_free=False))
    noise_free = search_distances(recordings, start, still)
    assert min(published.flatness_errors) > 2.0 * max(noise_free.flatness_errors)


def test_a_minimum_at_the_limit_is_named() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (3.0, 3.0))
    result = search_distances(calibration_recordings(truth), start, replace(SETTINGS, reach_mm=1.0))
    assert any("at the limit of the search" in w for w in result.warnings)


def test_operator_flattens_planes(tilted: tuple[TrueRig, Calibration, list[Recording]]) -> None:
    _, start, recordings = tilted
    found = search_distances(recordings, start, SETTINGS).calibration
    bows = []
    for rig in (found.rig, with_operator(recordings, found)):
        bow = 0.0
        for plane in recordings[2:]:
            points = triangulate(rig, plane.left_px, plane.right_px, plane.water.index)
            normal, offset = fit_plane(points)
            terms = cubic((points[:, :2] - points[:, :2].mean(axis=0)) / 125.0)
            bow += float(np.ptp(terms @ np.linalg.lstsq(terms, points @ normal - offset, rcond=None)[0]))
        bows.append(bow)
    assert bows[1] < 0.75 * bows[0], bows


def test_operator_ends_with_one_more_search(tilted: tuple[TrueRig, Calibration, list[Recording]]) -> None:
    _, start, recordings = tilted
    plain = search_distances(recordings, start, SETTINGS)
    result = search_with_operator(recordings, start, SETTINGS)
    assert result.statistic < plain.statistic
    assert result.calibration.rig.left.correction is not None
    assert result.calibration.method == "search of distances, operator"
    assert result.calibration.made_from == plain.calibration.made_from


def test_missing_artefacts_are_named(tilted: tuple[TrueRig, Calibration, list[Recording]]) -> None:
    _, start, recordings = tilted
    with pytest.raises(RecordingError, match="no recording of a ball bar"):
        search_distances(recordings[2:], start)
    with pytest.raises(RecordingError, match="operator needs two"):
        with_operator(recordings[:3], start)
