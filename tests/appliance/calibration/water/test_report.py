"""What a calibration in water leaves of its recordings, and what its report says of it to people and programs."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.calibration.design import Design, design_calibration
from appliance.calibration.judgement import Estimate
from appliance.calibration.recordings import ArtefactKind, Recording
from appliance.calibration.water.method import Method, WaterResult
from appliance.calibration.water.report import as_html, as_json
from appliance.calibration.water.residuals import Residuals, residuals_of
from appliance.optics.model import StereoRig
from appliance.optics.water import Water

WATER = Water(20.0, 0.0, 530.0)
START = design_calibration(Design(11.5, 4.5 * 4, 230.0, 12.41, 30.0, 5.0, 1.77), "KF", 400, 300, WATER)


def plane_seen_by(rig: StereoRig, noise_px: float = 0.0, n: int = 300) -> Recording:
    rng = np.random.default_rng(3)
    xy = rng.uniform([-75.0, -55.0], [75.0, 55.0], (n, 2))
    points = np.column_stack([xy, 520.0 + 0.1 * xy[:, 0] - 0.05 * xy[:, 1]])
    left, right = (camera.project(points, WATER.index) for camera in (rig.left, rig.right))
    right = right + noise_px * rng.standard_normal(right.shape)
    return Recording("plane", ArtefactKind.PLANE, left, right, WATER, np.zeros(n, np.intp))


def leaning(rig: StereoRig, degrees: float) -> StereoRig:
    """The rig with its right port turned about y."""
    tilt = math.radians(degrees)
    port = replace(rig.right.port, normal=(math.sin(tilt), 0.0, math.cos(tilt)))
    return replace(rig, right=replace(rig.right, port=port))


def test_the_rig_that_recorded_leaves_nothing_but_noise_and_another_one_more() -> None:
    exact = residuals_of(plane_seen_by(START.rig), START.rig)
    assert exact.name == "plane"
    assert exact.left_px.shape == exact.miss_px.shape == (300, 2)
    assert exact.rms_px < 1e-4
    assert residuals_of(plane_seen_by(START.rig, 0.05), START.rig).rms_px == pytest.approx(0.05, rel=0.1)
    assert residuals_of(plane_seen_by(START.rig), leaning(START.rig, 1.0)).rms_px > 0.02


def test_a_miss_points_from_where_a_point_is_matched_to_where_the_rig_would_see_it() -> None:
    recording = plane_seen_by(START.rig)
    right = recording.right_px.copy()
    right[17] += (0.0, 5.0)  # across the rows: no place of the plane explains it
    assert len(residuals_of(plane_seen_by(START.rig, n=900), START.rig, 200).left_px) <= 200
    missed = residuals_of(replace(recording, right_px=right), START.rig)
    k = int(np.argmin(np.linalg.norm(missed.left_px - recording.left_px[17], axis=1)))
    assert missed.miss_px[k] == pytest.approx((0.0, -5.0), abs=0.1)


def solved(**changed: Any) -> WaterResult:
    calibration = replace(START, rig=leaning(START.rig, 1.0), residual_px=0.041)
    places = np.array([[10.0, 10.0]] * 4)
    return replace(
        WaterResult(
            Method.PORTS,
            calibration,
            ("the water & the bar do not go together",),
            (Residuals("bar <1>", places, np.full((4, 2), 0.3)),),
            0.012,
            (Estimate("right port tilt x (rad)", 0.0174, 0.0122, 0.0001), Estimate("shift", 0.0, 0.1, 0.1)),
            (300.0, 20.0),
        ),
        **changed,
    )


def test_programs_are_told_the_ports_before_and_after_what_is_left_and_what_was_not_seen() -> None:
    said = json.loads(json.dumps(as_json(solved(), START, {"who": "Ada"}, {"7": "too dark"})))
    assert said["schema"] == 1
    assert said["about"]["who"] == "Ada"
    assert said["about"]["started_from"] == START.hash != said["about"]["calibration"] == solved().calibration.hash
    assert (said["about"]["water_temperature_c"], said["about"]["water_salinity_psu"]) == (20.0, 0.0)
    assert said["about"]["water_index"] == pytest.approx(1.3354, abs=5e-4)
    assert said["ports"]["left"]["before"] == said["ports"]["left"]["after"]
    assert said["ports"]["right"]["before"]["tilt_x_deg"] == pytest.approx(0.0)
    assert said["ports"]["right"]["after"] == pytest.approx({"distance_mm": 30.0, "tilt_x_deg": 1.0, "tilt_y_deg": 0.0})
    assert (said["residual_px"], said["systematic_px"]) == (0.041, 0.012)
    assert said["recordings"] == [{"name": "bar <1>", "points": 4, "residual_px": pytest.approx(0.3)}]
    assert said["unobserved"] == ["shift"]
    assert said["estimates"][0] == {
        "name": "right port tilt x (rad)", "change": 0.0174, "prior_sd": 0.0122, "sd": 0.0001, "at_prior": False,
    }  # fmt: skip
    assert said["costs"] == [300.0, 20.0]
    assert said["before"] == {}
    assert said["left_out"] == {"7": "too dark"}
    assert said["warnings"] == ["the water & the bar do not go together"]


def test_the_published_way_tells_what_each_of_its_models_leaves() -> None:
    result = solved(method=Method.PAPER, before={"pm": replace(START, residual_px=0.9), "rm": START})
    said = as_json(result, START, {}, {})
    assert said["before"]["pm"]["residual_px"] == 0.9
    assert said["before"]["rm"] == {"calibration": START.hash, "residual_px": None}
    assert "residual_px 0.9" in as_html(result, START, {}, {})


def test_the_page_has_every_drawing_and_escapes_names() -> None:
    page = as_html(solved(), START, {"who": "Ada & Co"}, {"<7>": "too dark"})
    assert page.startswith("<!doctype html>")
    assert page.endswith("</html>\n")
    for words in (
        "Ada &amp; Co", "the water &amp; the bar do not go together", "Scan &lt;7&gt; not used: too dark.",
        "bar &lt;1&gt;: an arrow as long as a cell is 0.471 px",
        "Convergence", "What the recordings could see",
    ):  # fmt: skip
        assert words in page, words
    assert page.count("<svg") == 3
    assert not re.search(r'(src|href)="(?!data:)', page), "nothing is loaded from elsewhere"
    assert "<td>bar &lt;1&gt;</td><td>4</td><td>0.3</td>" in page
    bare = as_html(solved(residuals=(), estimates=(), costs=(), warnings=()), START, {}, {})
    for words in ("<svg", "published", "Convergence", "could see", 'class="no"'):
        assert words not in bare, words
