"""A scan in air with the rig file and calibration for water is named: 58 % of a surface came, with gaps of 71 µm, and no warning."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.optics.model import StereoRig
from appliance.optics.volume import STANDARD, WorkingVolume
from appliance.scan.fault import FaultCode
from appliance.scan.grade import Grade, grade
from appliance.verdict.medium import AIR, FEWEST, judge_medium
from hw_sim.truth import draw_truth, in_air
from tests.support.truth import WATER, true_calibration

Array = NDArray[np.float64]


def rig_of(kind: str, *, air: bool = False) -> StereoRig:
    """The true rig of a set, in water or as it is in air."""
    truth = draw_truth(kind, 3, 400, 300, WATER.index)
    return true_calibration(in_air(truth) if air else truth).rig


def seen(rig: StereoRig, index: float, distance_mm: float = 520.0) -> tuple[Array, Array]:
    """The pixels (n, 2) in which both cameras see a plane that leans, in a medium of that index."""
    camera = rig.left
    size = np.array([camera.width_px, camera.height_px]) - 1.0
    u, v = np.meshgrid(*(n * np.linspace(0.05, 0.95, 25) for n in size))
    uv = np.stack([u.ravel(), v.ravel()], -1)
    origin, way = camera.rays(uv, index)
    normal, through = np.array([0.2, -0.1, 1.0]), np.array([60.0, 0.0, distance_mm])
    points = origin + way * (((through - origin) @ normal) / (way @ normal))[:, None]
    right = rig.right.project(points, index)
    inside = ((right > 0.0) & (right < size)).all(axis=1)
    return uv[inside], right[inside]


@pytest.mark.parametrize(
    ("kind", "stated"), [("nominal", "nominal"), ("realistic", "realistic"), ("realistic", "nominal")]
)
def test_a_world_in_air_is_named_also_by_an_instrument_that_has_only_its_drawing(kind: str, stated: str) -> None:
    found = judge_medium(*seen(rig_of(kind, air=True), AIR), rig_of(stated), WATER.index)
    assert found.fault is not None, found.verdict
    assert found.fault.code is FaultCode.NOT_IN_WATER
    assert found.fault.numbers["water_gap_mm"] > 2.0 * found.fault.numbers["air_gap_mm"]
    assert grade(90.0, 0.02, [found.fault.code]) is Grade.BAD


@pytest.mark.parametrize(
    ("kind", "stated"), [("nominal", "nominal"), ("realistic", "nominal"), ("hard", "nominal"), ("hard", "hard")]
)
@pytest.mark.parametrize("distance_mm", [420.0, 640.0])
def test_water_is_never_taken_for_air(kind: str, stated: str, distance_mm: float) -> None:
    found = judge_medium(*seen(rig_of(kind), WATER.index, distance_mm), rig_of(stated), WATER.index)
    assert found.fault is None
    assert found.verdict.passed is not False


def test_with_few_matches_or_in_stated_air_nothing_is_said() -> None:
    rig = rig_of("nominal", air=True)
    left, right = seen(rig, AIR)
    few = judge_medium(left[: FEWEST - 1], right[: FEWEST - 1], rig_of("nominal"), WATER.index)
    assert (few.verdict.passed, few.fault) == (None, None)
    assert judge_medium(left, right, rig, AIR).verdict.passed is None
    assert judge_medium(left[:FEWEST], right[:FEWEST], rig_of("nominal"), WATER.index).verdict.passed is False


@pytest.mark.parametrize(("index", "passed"), [(1.07, False), (1.08, None), (1.12, None), (1.13, True)])
def test_air_is_named_where_rays_miss_by_half_and_water_believed_where_they_miss_by_less(
    index: float, passed: bool | None
) -> None:
    rig = rig_of("nominal")
    found = judge_medium(*seen(rig, index), rig, WATER.index)
    assert found.verdict.passed is passed
    assert (found.fault is not None) is (passed is False)


@pytest.mark.parametrize(
    ("share", "larger", "passed"), [(0.45, 1.0, None), (0.5, 1.0, False), (0.6, 2.0, None), (0.7, 2.0, False)]
)
def test_a_tenth_of_a_millimetre_in_the_standard_housing_speaks_for_air(
    share: float, larger: float, passed: bool | None
) -> None:
    """The middle of the picture alone: gaps of 0.095, 0.131, 0.180 and more than 0.2 mm; the limit grows with the housing."""
    left, right = seen(rig_of("nominal", air=True), AIR)
    off = np.abs(left - np.median(left, axis=0))
    middle = (off <= share * off.max(axis=0) + 1e-9).all(axis=1)
    rig = rig_of("nominal")
    volume = WorkingVolume(*(larger * mm for mm in astuple(STANDARD)))
    found = judge_medium(left[middle], right[middle], replace(rig, volume=volume), WATER.index)
    assert found.verdict.passed is passed
