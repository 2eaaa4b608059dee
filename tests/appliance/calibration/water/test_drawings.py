"""The drawings of a calibration's report show the numbers that they are of, in the places where people look for them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.judgement import Estimate
from appliance.calibration.water.drawings import cost_svg, residual_svg, seen_svg
from appliance.calibration.water.residuals import Residuals

Array = NDArray[np.float64]


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


def test_the_cost_falls_from_left_to_right_between_powers_of_ten() -> None:
    svg = cost_svg((2000.0, 100.0, 20.0))
    dots = numbers(svg, "circle")
    assert [dot["cx"] for dot in dots] == [40.0, 240.0, 440.0]
    # 240 high: 10 000 is at 20, 10 at 200.
    wanted = [20 + 180 * (4 - np.log10(cost)) / 3 for cost in (2000.0, 100.0, 20.0)]
    assert [dot["cy"] for dot in dots] == pytest.approx(wanted, abs=0.06)
    assert re.findall(r">([^<]+)</text>", svg) == ["1e4", "1e1", "0", "1", "2"]
    for dot in dots:
        assert f"{dot['cx']:.1f},{dot['cy']:.1f}" in svg, "the line passes through them"
    one = numbers(cost_svg((100.0,)), "circle")
    assert [(dot["cx"], dot["cy"]) for dot in one] == [(40.0, 200.0)], "a whole power is the lower end of its decade"


def test_a_bar_is_as_long_as_what_the_recordings_took_from_the_prior() -> None:
    estimates = (
        Estimate("tilt", 0.001, 0.01, 0.0025),
        Estimate("shift", 0.0, 0.2, 0.2),
        Estimate("worse than before", 0.0, 0.1, 0.3),
    )
    svg = seen_svg(estimates)
    bars = re.findall(r'<rect x="260" y="(\d+)" width="([\d.]+)" height="12" fill="(#\w+)"/>', svg)
    assert bars == [
        ("6", "200", "#ddd"), ("6", "150.0", "#2166ac"), ("23", "200", "#ddd"), ("23", "0.0", "#b2182b"),
        ("40", "200", "#ddd"), ("40", "0.0", "#b2182b"),
    ]  # fmt: skip
    assert 'viewBox="0 0 480 59"' in svg
    assert re.findall(r'y="(\d+)">(\w+)', svg)[0] == ("16", "tilt")
