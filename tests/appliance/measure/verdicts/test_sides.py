"""What the rays alone tell, also of an instrument that nobody has measured yet: cameras exchanged, and air for water."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.light.model import StereoRig
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.verdict import Grade, Judgement, grade
from appliance.measure.verdicts.medium import AIR, FEWEST, judge_medium
from appliance.measure.verdicts.sides import judge_sides
from hw_sim.truth import draw_truth, in_air
from tests.support.golden_texts import Says
from tests.support.synthetic import calibration as drawn_calibration
from tests.support.truth import WATER, true_calibration

Array = NDArray[np.float64]
DRAWN = drawn_calibration().rig


def seen(
    rig: StereoRig,
    distance_mm: float = 500.0,
    lean: tuple[float, float] = (0.2, -0.1),
    share: float = 0.9,
    index: float = WATER.index,
) -> tuple[Array, Array]:
    """Return the pixels (n, 2) in which both cameras see a plane that leans, over a ``share`` of the left picture."""
    camera = rig.left
    size = np.array([camera.width_px, camera.height_px]) - 1.0
    u, v = np.meshgrid(*(0.5 * n * (1.0 + share * np.linspace(-1.0, 1.0, 25)) for n in size))
    uv = np.stack([u.ravel(), v.ravel()], -1)
    origin, way = camera.rays(uv, index)
    normal, through = np.array([*lean, 1.0]), rig.volume_centre_mm(WATER.index) * (distance_mm / 522.5)
    points = origin + way * (((through - origin) @ normal) / (way @ normal))[:, None]
    right = rig.right.project(points, index)
    inside = ((right > 0.0) & (right < size)).all(axis=1)
    return uv[inside], right[inside]


def judged(pixels: tuple[Array, Array], rig: StereoRig, exchanged: bool) -> Judgement:
    return judge_sides(*(pixels[::-1] if exchanged else pixels), rig, WATER.index)


@pytest.mark.parametrize(
    ("distance_mm", "lean"), [(400.0, (0.6, 0.0)), (522.5, (0.0, 0.0)), (680.0, (0.0, 0.0)), (680.0, (-0.5, 0.4))]
)
def test_exchanged_cameras_are_named_at_any_distance(distance_mm: float, lean: tuple[float, float], says: Says) -> None:
    pixels = seen(DRAWN, distance_mm, lean)
    fault = judged(pixels, DRAWN, exchanged=True).fault
    assert fault is not None
    assert fault.code is FaultCode.SIDES_EXCHANGED
    says(fault.detail)
    right = judged(pixels, DRAWN, exchanged=False)
    assert (right.verdict.passed, right.fault) == (True, None)


@pytest.mark.parametrize("kind", ["realistic", "hard", "paper"])
def test_a_drawing_that_nobody_compared_with_the_instrument_tells_them_apart(kind: str) -> None:
    """At first light there is only the drawing: that is when serial numbers are exchanged."""
    for seed in range(3):
        pixels = seen(true_calibration(draw_truth(kind, seed, 400, 300, WATER.index)).rig)
        accused = [judged(pixels, DRAWN, exchanged).fault is not None for exchanged in (False, True)]
        assert accused == [False, True], seed


def test_what_lies_near_the_axis_says_nothing() -> None:
    for exchanged in (False, True):
        for pixels in (seen(DRAWN, share=0.15), (np.empty((0, 2)), np.empty((0, 2)))):
            judgement = judged(pixels, DRAWN, exchanged)
            assert (judgement.verdict.passed, judgement.fault) == (None, None)


def test_a_camera_that_was_knocked_is_no_exchanged_one() -> None:
    """Ten times what a knock does: neither order brings the rays together, and nobody is accused."""
    knocked = replace(DRAWN, right=replace(DRAWN.right, translation_mm=(232.0, 30.0, 40.0)))
    left, right = seen(DRAWN)
    scattered = right + np.random.default_rng(1).normal(0.0, 8.0, right.shape)
    assert judged((left, right), knocked, exchanged=False).fault is None
    assert judged((left, scattered), DRAWN, exchanged=False).fault is None


# ---------------------------------------------------------------------------------------------- air or water


def rig_of(kind: str, *, air: bool = False) -> StereoRig:
    """The true rig of a set, in water or as it is in air."""
    truth = draw_truth(kind, 3, 400, 300, WATER.index)
    return true_calibration(in_air(truth) if air else truth).rig


@pytest.mark.parametrize(("kind", "stated"), [("realistic", "realistic"), ("realistic", "nominal")])
def test_a_world_in_air_is_named_also_by_an_instrument_that_has_only_its_drawing(kind: str, stated: str) -> None:
    found = judge_medium(*seen(rig_of(kind, air=True), index=AIR), rig_of(stated), WATER.index)
    assert found.fault is not None, found.verdict
    assert found.fault.code is FaultCode.NOT_IN_WATER
    assert found.fault.numbers["water_gap_mm"] > 2.0 * found.fault.numbers["air_gap_mm"]
    assert grade(90.0, 0.02, [found.fault.code]) is Grade.BAD


@pytest.mark.parametrize(("stated", "distance_mm"), [("nominal", 420.0), ("nominal", 640.0), ("hard", 640.0)])
def test_water_is_never_taken_for_air(stated: str, distance_mm: float) -> None:
    found = judge_medium(*seen(rig_of("hard"), distance_mm), rig_of(stated), WATER.index)
    assert found.fault is None
    assert found.verdict.passed is not False


def test_with_few_matches_or_in_stated_air_nothing_is_said() -> None:
    rig = rig_of("nominal", air=True)
    left, right = seen(rig, index=AIR)
    few = judge_medium(left[: FEWEST - 1], right[: FEWEST - 1], rig_of("nominal"), WATER.index)
    assert (few.verdict.passed, few.fault) == (None, None)
    assert judge_medium(left, right, rig, AIR).verdict.passed is None
    assert judge_medium(left[:FEWEST], right[:FEWEST], rig_of("nominal"), WATER.index).verdict.passed is False


@pytest.mark.parametrize(("index", "passed"), [(1.07, False), (1.08, None), (1.12, None), (1.13, True)])
def test_air_is_named_where_rays_miss_by_half_and_water_where_by_less(index: float, passed: bool | None) -> None:
    rig = rig_of("nominal")
    found = judge_medium(*seen(rig, index=index), rig, WATER.index)
    assert found.verdict.passed is passed
    assert (found.fault is not None) is (passed is False)


@pytest.mark.parametrize(
    ("share", "larger", "passed"), [(0.45, 1.0, None), (0.5, 1.0, False), (0.6, 2.0, None), (0.7, 2.0, False)]
)
def test_a_tenth_of_a_millimetre_in_the_housing_speaks_for_air(
    share: float, larger: float, passed: bool | None
) -> None:
    """The middle of the picture alone: gaps of 0.095, 0.131, 0.180 and more than 0.2 mm; the limit grows with the housing."""
    left, right = seen(rig_of("nominal", air=True), index=AIR)
    off = np.abs(left - np.median(left, axis=0))
    middle = (off <= share * off.max(axis=0) + 1e-9).all(axis=1)
    rig = rig_of("nominal")
    volume = WorkingVolume(*(larger * mm for mm in astuple(STANDARD)))
    found = judge_medium(left[middle], right[middle], replace(rig, volume=volume), WATER.index)
    assert found.verdict.passed is passed
