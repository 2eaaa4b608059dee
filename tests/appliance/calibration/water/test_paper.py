"""The published search finds distances of perpendicular ports, and shows its limits where ports are tilted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording, RecordingError
from appliance.calibration.water.paper import (
    calibrate_as_published,
    cubic,
    flatness_error,
    mapped_through_ports,
    search_distances,
    with_operator,
)
from appliance.calibration.water.shapes import fit_plane, triangulate
from appliance.optics.model import StereoRig
from hw_sim.truth import TrueRig
from tests.support.calibrating import calibration_recordings, hidden_rig
from tests.support.truth import WATER, true_calibration

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


def test_flatness_is_the_range_of_the_points_but_three_in_a_thousand() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-100.0, 100.0, (2000, 2)), np.tile([-0.125, 0.125], 1000) + 500.0])
    assert flatness_error(points) == pytest.approx(0.25 / 250.0, rel=0.02)
    points[:2, 2] += (3.0, -3.0)
    assert flatness_error(points) == pytest.approx(0.25 / 250.0, rel=0.1)
    points[2:8, 2] += 3.0
    assert flatness_error(points) > 2.5 / 250.0


def test_a_minimum_at_the_limit_is_named() -> None:
    truth, start = upright(hidden_rig("modelled", 4), (3.0, 3.0))
    result = search_distances(calibration_recordings(truth), start, reach_mm=1.0)
    assert any("at the limit of the search" in w for w in result.warnings)


def test_operator_flattens_planes(tilted: tuple[TrueRig, Calibration, list[Recording]]) -> None:
    _, start, recordings = tilted
    found = search_distances(recordings, start, reach_mm=REACH_MM).calibration
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


def test_the_operator_comes_between_two_searches_and_the_models_before_it_are_kept(
    tilted: tuple[TrueRig, Calibration, list[Recording]],
) -> None:
    _, start, recordings = tilted
    result = calibrate_as_published(recordings, start)
    rm, rmd = result.before["rm"], result.calibration
    assert rmd.rig.left.correction is not None
    assert rmd.rig == search_distances(recordings, replace(rm, rig=with_operator(recordings, rm))).calibration.rig
    assert rm.rig == search_distances(recordings, start).calibration.rig
    assert (rm.method, rmd.method) == ("search of distances", "search of distances, operator")
    assert rmd.made_from == rm.made_from == (*start.made_from, *(f"recording {r.name}" for r in recordings))
    assert result.before["pm"].rig.right.lens_in_water


def test_a_pinhole_comes_near_to_the_refracted_rays_within_the_volume(
    tilted: tuple[TrueRig, Calibration, list[Recording]],
) -> None:
    _, start, _ = tilted
    rig = mapped_through_ports(start, WATER).rig
    pixels = np.array([[200.0, 150.0], [800.0, 600.0], [1500.0, 1100.0]])
    for camera, pinhole in ((start.rig.left, rig.left), (start.rig.right, rig.right)):
        origin, direction = camera.rays(pixels, WATER.index)
        assert np.abs(pinhole.project(origin + 500.0 * direction, WATER.index) - pixels).max() < 0.1
        assert np.abs(pinhole.project(origin + 1500.0 * direction, WATER.index) - pixels).max() > 0.2


def test_missing_artefacts_are_named(tilted: tuple[TrueRig, Calibration, list[Recording]]) -> None:
    _, start, recordings = tilted
    with pytest.raises(RecordingError, match="no recording of a ball bar"):
        search_distances(recordings[2:], start)
    with pytest.raises(RecordingError, match="operator needs two"):
        with_operator(recordings[:3], start)
