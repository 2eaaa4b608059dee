"""Rungs that the product does not have are as good as their models: each on a rig that nobody knows, at poses that were not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.water.bundle import BundleSettings
from appliance.calibration.water.method import Method
from appliance.optics.pinhole import Lens
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES
from bench.metrology.printed import PrintedCamera
from bench.metrology.ray_field import FieldProblem
from bench.metrology.rungs import WAYS, Known, climb
from tests.support.calibrating import Pose, air_of, calibration_recordings, evaluate, hidden_rig, start_of
from tests.support.truth import WATER

HERE = tuple(name for name in WAYS if name not in ("pm_water", "ba_spline_4_points", "ba_spline_10"))
"""All rungs but those that take long, or that others contain."""


@pytest.fixture(scope="module")
def known() -> Known:
    truth = hidden_rig("realistic", 1)
    bars, planes = ([Pose(p[:3], p[3:]) for p in poses] for poses in (CALIBRATION_BARS, CALIBRATION_PLANES))
    recordings = {one.name: one for one in calibration_recordings(truth, bars, planes)}
    # Without the lenses' fields from air the image correction is a coarse one, and solved in a tenth of the time.
    return Known(replace(start_of(air_of(truth)), air_field=None), recordings, truth)


@pytest.mark.dive
def test_each_rung_is_worth_its_model(known: Known) -> None:
    made = climb(known, HERE)
    assert [one.recordings for one in made] == [0, *[4] * 7, 10]
    errors = {one.rung: evaluate(known.truth, one.calibration.rig, frustums=1) for one in made}
    length = {rung: one.length for rung, one in errors.items()}
    flat = {rung: one.flatness for rung, one in errors.items()}
    assert length["pm_mapped"] > 0.15
    assert flat["paper_rm_printed"] > 1.5 * flat["rm"], "no distance mends the misprint"
    assert max(length["rm"], length["rm_noise_free"]) < 0.7 * length["pm_mapped"]
    assert length["ba_ports"] < 0.5 * length["rm"]
    assert max(length[rung] for rung in ("ba_all", "ba_spline_4", "ray_field")) < 0.05
    assert max(flat[rung] for rung in ("ba_spline_4", "ray_field")) < 0.03 < flat["ba_all"]


def test_the_printed_equations_are_those_of_the_paper_and_a_point_on_a_ray_is_seen_at_its_pixel(known: Known) -> None:
    """Eqs. 1 to 4 by hand, for rays at r = 0.05, 0.2 and 0.3 of the principal distance; d is that of the outer face."""
    port, index = known.start.rig.left.port, WATER.index
    camera = PrintedCamera(1600, 1200, Lens((1000.0, 1000.0), (0.0, 0.0)), port)
    d_mm, glass_mm = port.distance_mm + port.thickness_mm, port.thickness_mm
    for r in (0.05, 0.2, 0.3):
        pixel = np.array([[1000.0 * r, 0.0]])
        origin, direction = camera.rays(pixel, index)
        sine = r / np.hypot(1.0, r)
        in_glass, in_water = sine / port.glass_index, sine / index
        shift_mm = d_mm * r / in_water - d_mm - glass_mm * r * (r - in_glass / np.sqrt(1.0 - in_glass**2))
        np.testing.assert_allclose(origin, [[0.0, 0.0, -shift_mm]], atol=1e-9)
        np.testing.assert_allclose(direction[0, 0] / direction[0, 2], in_water / np.sqrt(1.0 - in_water**2), rtol=1e-9)
        np.testing.assert_allclose(camera.project(origin + 500.0 * direction, index), pixel, atol=1e-6)


def test_the_slope_of_the_cost_by_the_shifts_of_rays_is_its_gradient(known: Known) -> None:
    settings = BundleSettings(points_per_recording=200)
    problem = FieldProblem(list(known.recordings.values())[:5], known.start, Method.SPLINE, settings)
    rng = np.random.default_rng(8)
    x = np.zeros(problem.size)
    for at in problem.shifts:
        x[at] = 0.02 * rng.normal(size=at.stop - at.start)
    _, gradient, _, _ = problem.linearise(x)
    for at in problem.shifts:
        way = np.zeros(problem.size)
        way[at] = 1e-3 * rng.normal(size=at.stop - at.start)
        before, after = (problem.linearise(x + sign * way)[2] for sign in (-1, 1))
        # The cost is a sum of squares, the gradient half of its slope.
        assert (after - before) / 4.0 == pytest.approx(float(gradient @ way), rel=0.02, abs=2e-3)
