"""An object outside of the volume and a blinding lamp are no fault of patterns or cameras: they came as WRONG PATTERN and LCAM STUCK."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.patterns.sequence import Direction
from appliance.verdict.identity import judge_identity
from hw_sim.scene import Scene
from hw_sim.water import turbid
from tests.support.rendered import RenderedScan, render_scan


@pytest.fixture(scope="module")
def near() -> RenderedScan:
    """A pipe's front at 345 mm, in water that keeps it from being saturated."""
    scene = Scene(object="pipe", pose=(0.0, 0.0, 370.0, 0.0, 6.0, 20.0), texture="strong", water=turbid(2.0))
    return render_scan(scene, "realistic", 5, 400, 16)


def test_stripes_that_parallax_displaces_are_no_wrong_pattern(near: RenderedScan) -> None:
    judged = judge_identity(near.frames, near.sequence)
    assert judged.fault is None
    assert judged.verdict.passed is None


def test_a_wrong_gray_image_is_found_before_a_near_object_as_well(near: RenderedScan) -> None:
    """The fourth Gray image is the third once more, in both cameras."""
    frames = {side: stack.copy() for side, stack in near.frames.items()}
    gray = near.sequence.axis(Direction.X).gray
    for stack in frames.values():
        stack[gray[3]] = stack[gray[2]]
    judged = judge_identity(frames, near.sequence)
    assert judged.fault is not None


def test_a_lamp_that_blinds_a_camera_does_not_make_it_stuck() -> None:
    scene = replace(Scene(texture="strong"), ambient=3.0)
    scan = render_scan(scene, "realistic", 5, 400, 16)
    assert float(np.mean(scan.frames["left"].min(axis=0) == 255)) > 0.05
    assert judge_identity(scan.frames, scan.sequence).fault is None
