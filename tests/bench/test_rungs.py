"""Rungs that the product does not have are as good as their models: each on a rig that nobody knows, at poses that were not used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES
from bench.metrology.printed import PrintedCamera
from bench.metrology.rungs import RungInput, climb
from tests.support.calibrating import Pose, air_of, calibration_recordings, evaluate, hidden_rig, start_of
from tests.support.truth import WATER


@pytest.mark.dive
def test_each_rung_is_worth_its_model() -> None:
    truth = hidden_rig("realistic", 1)
    bars, planes = ([Pose(p[:3], p[3:]) for p in poses] for poses in (CALIBRATION_BARS, CALIBRATION_PLANES))
    recordings = {one.name: one for one in calibration_recordings(truth, bars, planes)}
    # Without the lenses' fields from air the image correction is a coarse one, and solved in a tenth of the time.
    known = RungInput(replace(start_of(air_of(truth)), air_field=None), recordings, truth)
    made = climb(known, ("pm_mapped", "paper_rm_printed", "rm", "ray_field"))
    assert [one.recordings for one in made] == [0, 4, 4, 10]
    errors = {one.rung: evaluate(truth, one.calibration.rig, frustums=1) for one in made}
    assert errors["pm_mapped"].length > 0.15
    assert errors["rm"].length < 0.7 * errors["pm_mapped"].length
    assert errors["paper_rm_printed"].flatness > 1.5 * errors["rm"].flatness, "no distance mends the misprint"
    assert (errors["ray_field"].length < 0.05, errors["ray_field"].flatness < 0.03) == (True, True)


def test_the_printed_equations_are_those_of_the_paper_and_a_point_on_a_ray_is_seen_at_its_pixel() -> None:
    """Eqs. 1 to 4 by hand, for rays at r = 0.05, 0.2 and 0.3 of the principal distance; d is that of the outer face."""
    port, index = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77), WATER.index
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
