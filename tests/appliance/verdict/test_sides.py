"""Left and right exchanged: told by the rays alone, also by an instrument that nobody has measured yet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.optics.model import StereoRig
from appliance.scan.fault import FaultCode
from appliance.scan.verdict import Judgement
from appliance.verdict.sides import judge_sides
from hw_sim.truth import draw_truth
from tests.support.synthetic import calibration as drawn_calibration
from tests.support.truth import WATER, true_calibration

INDEX = WATER.index
Array = NDArray[np.float64]


def seen(
    rig: StereoRig, distance_mm: float = 500.0, lean: tuple[float, float] = (0.2, -0.1), share: float = 0.9
) -> Array:
    """Return the pixels (n, 4) in which both cameras see a plane that leans, over a ``share`` of the left picture."""
    camera = rig.left
    size = np.array([camera.width_px, camera.height_px]) - 1.0
    u, v = np.meshgrid(*(0.5 * n * (1.0 + share * np.linspace(-1.0, 1.0, 25)) for n in size))
    uv = np.stack([u.ravel(), v.ravel()], -1)
    origin, way = camera.rays(uv, INDEX)
    normal, through = np.array([*lean, 1.0]), rig.volume_centre_mm(INDEX) * (distance_mm / 522.5)
    points = origin + way * (((through - origin) @ normal) / (way @ normal))[:, None]
    both = np.concatenate([uv, rig.right.project(points, INDEX)], axis=1)
    inside = ((both[:, 2:] > 0.0) & (both[:, 2:] < size)).all(axis=1)
    return np.asarray(both[inside])


def judged(pixels: Array, calibration: Calibration, exchanged: bool) -> Judgement:
    left, right = pixels[:, :2], pixels[:, 2:]
    return judge_sides(*((right, left) if exchanged else (left, right)), calibration.rig, INDEX)


@pytest.mark.parametrize("distance_mm", [400.0, 500.0, 522.5, 600.0, 680.0])
@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.6, 0.0), (-0.5, 0.4)])
def test_exchanged_cameras_are_named_wherever_the_object_is(distance_mm: float, lean: tuple[float, float]) -> None:
    calibration = drawn_calibration()
    pixels = seen(calibration.rig, distance_mm, lean)
    fault = judged(pixels, calibration, exchanged=True).fault
    assert fault is not None
    assert fault.code is FaultCode.SIDES_EXCHANGED
    assert "exchange the serial numbers of camera.left and camera.right in the rig file" in fault.detail
    right = judged(pixels, calibration, exchanged=False)
    assert (right.verdict.passed, right.fault) == (True, None)


@pytest.mark.parametrize("kind", ["realistic", "hard", "paper"])
def test_a_drawing_that_nobody_compared_with_the_instrument_tells_them_apart(kind: str) -> None:
    """At first light there is only the drawing: that is when serial numbers are exchanged."""
    for seed in range(20):
        pixels = seen(true_calibration(draw_truth(kind, seed, 400, 300, INDEX)).rig)
        assert judged(pixels, drawn_calibration(), exchanged=False).fault is None, seed
        assert judged(pixels, drawn_calibration(), exchanged=True).fault is not None, seed


def test_what_lies_near_the_axis_says_nothing() -> None:
    calibration = drawn_calibration()
    for exchanged in (False, True):
        judgement = judged(seen(calibration.rig, share=0.15), calibration, exchanged)
        assert (judgement.verdict.passed, judgement.fault) == (None, None)
        nothing = judge_sides(np.empty((0, 2)), np.empty((0, 2)), calibration.rig, INDEX)
        assert (nothing.verdict.passed, nothing.fault) == (None, None)


def test_a_camera_that_was_knocked_is_no_exchanged_one() -> None:
    """Ten times what a knock does: neither order brings the rays together, and nobody is accused."""
    calibration = drawn_calibration()
    turned = replace(calibration.rig.right, translation_mm=(232.0, 30.0, 40.0))
    rng = np.random.default_rng(1)
    pixels = seen(calibration.rig)
    scattered = np.concatenate([pixels[:, :2], pixels[:, 2:] + rng.normal(0.0, 8.0, (len(pixels), 2))], axis=1)
    for rig, shown in ((replace(calibration.rig, right=turned), pixels), (calibration.rig, scattered)):
        assert judged(shown, replace(calibration, rig=rig), exchanged=False).fault is None
