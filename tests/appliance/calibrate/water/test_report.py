"""What a calibration in water leaves of its recordings, and what its report says and draws of it for people and programs."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.calibrate.recordings import ArtefactKind, Recording
from appliance.calibrate.water.artefact import Residuals, residuals_of
from appliance.calibrate.water.judgement import Estimate
from appliance.calibrate.water.method import Method, WaterResult
from appliance.calibrate.water.report import as_html, as_json, residual_svg
from appliance.measure.calibration.design import design_calibration
from appliance.measure.light.model import StereoRig
from tests.support.calibrating import SMALL
from tests.support.truth import WATER

START = design_calibration(SMALL, "KF", 400, 300, WATER)


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
    assert exact.left_px.shape == exact.residual_px.shape == (300, 2)
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
    assert missed.residual_px[k] == pytest.approx((0.0, -5.0), abs=0.1)


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
    about, ports = said.pop("about"), said.pop("ports")
    assert (about["who"], about["water_temperature_c"], about["water_salinity_psu"]) == ("Ada", 20.0, 0.0)
    assert about["started_from"] == START.hash != about["calibration"] == solved().calibration.hash
    assert about["water_index"] == pytest.approx(1.3354, abs=5e-4)
    assert ports["left"]["before"] == ports["left"]["after"]
    assert ports["right"]["before"]["tilt_x_deg"] == pytest.approx(0.0)
    assert ports["right"]["after"] == pytest.approx({"distance_mm": 30.0, "tilt_x_deg": 1.0, "tilt_y_deg": 0.0})
    assert said["estimates"][0] == {
        "name": "right port tilt x (rad)", "change": 0.0174, "prior_sd": 0.0122, "sd": 0.0001, "at_prior": False,
    }  # fmt: skip
    wanted = {
        "schema": 1, "residual_px": 0.041, "systematic_px": 0.012, "costs": [300.0, 20.0], "before": {}, "left_out": {"7": "too dark"},
        "unobserved": ["shift"], "warnings": ["the water & the bar do not go together"],
        "recordings": [{"name": "bar <1>", "points": 4, "residual_px": pytest.approx(0.3)}],
    }  # fmt: skip
    assert {name: said[name] for name in wanted} == wanted
    result = solved(method=Method.PAPER, before={"pm": replace(START, residual_px=0.9), "rm": START})
    before = as_json(result, START, {}, {})["before"]
    assert before["pm"]["residual_px"] == 0.9
    assert before["rm"] == {"calibration": START.hash, "residual_px": None}
    assert "residual_px 0.9" in as_html(result, START, {}, {})


def test_the_page_has_every_drawing_and_escapes_names() -> None:
    page = as_html(solved(), START, {"who": "Ada & Co"}, {"<7>": "too dark"})
    assert page.startswith("<!doctype html>")
    assert page.endswith("</html>\n")
    for words in (
        "Ada &amp; Co", "the water &amp; the bar do not go together", "Scan &lt;7&gt; not used: too dark.",
        "bar &lt;1&gt;: an arrow of one cell is 0.471 px",
        "Convergence", "Observability of the parameters",
    ):  # fmt: skip
        assert words in page, words
    assert (page.count("<svg"), page.count("data:image/png")) == (2, 1)
    assert not re.search(r'(src|href)="(?!data:)', page), "nothing is loaded from elsewhere"
    assert "<td>bar &lt;1&gt;</td><td>4</td><td>0.3</td>" in page
    bare = as_html(solved(residuals=(), estimates=(), costs=(), warnings=()), START, {}, {})
    for words in ("<svg", "published", "Convergence", "Observability", 'class="no"'):
        assert words not in bare, words


def numbers(svg: str, element: str) -> list[dict[str, float]]:
    """The numeric attributes of every element of a kind, in order."""
    return [
        {name: float(value) for name, value in re.findall(r'([\w-]+)="(-?[\d.]+)"', body)}
        for body in re.findall(rf"<{element} ([^>]*)/?>", svg)
    ]


def test_arrows_are_the_means_of_cells_from_their_middles_and_the_longest_usual_one_fills_nine_tenths() -> None:
    """A picture of 400 x 300: cells of 20 px. Two of them have points enough, one has two, and one of them at the last pixel."""
    left = [(10.0, 10.0)] * 3 + [(399.6, 299.6)] * 5 + [(210.0, 10.0)] * 2
    miss = [(0.03, 0.0), (0.05, 0.0), (0.04, 0.0)] + [(0.0, -0.02)] * 5 + [(9.0, 9.0)] * 2
    svg, unit_px = residual_svg(Residuals("plane", np.array(left), np.array(miss)), (400, 300))
    dots, arrows = numbers(svg, "circle"), numbers(svg, "line")
    assert [(dot["cx"], dot["cy"]) for dot in dots] == [(10.0, 10.0), (390.0, 290.0)], (
        "cells of fewer than three are not shown"
    )
    (a, b) = ((one["x2"] - one["x1"], one["y2"] - one["y1"]) for one in arrows)
    assert [(one["x1"], one["y1"]) for one in arrows] == [(10.0, 10.0), (390.0, 290.0)]
    # 95 % of the way from 0.02 to 0.04 px is the longest usual one: 0.039 px are 18 px of the picture.
    assert a == pytest.approx((18.0 * 0.04 / 0.039, 0.0), abs=0.51)
    assert b == pytest.approx((0.0, -18.0 * 0.02 / 0.039), abs=0.51)
    assert unit_px == pytest.approx(0.039 / 0.9)
    assert 'viewBox="0 0 400 300"' in svg
    nothing, unit_px = residual_svg(Residuals("plane", np.array(left[:2]), np.array(miss[:2])), (400, 300))
    assert (numbers(nothing, "line"), unit_px) == ([], 0.0)
