"""Errors to be expected of lengths and planes are those that triangulating with another rig gives, and are told with the right remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.recordings import ArtefactKind, Recording
from appliance.calibrate.water.expected import (
    AdjustmentUncertainty,
    Columns,
    ExpectedErrors,
    coefficients_of,
    expected_depth_error_mm2,
    expected_errors,
    warnings_about_expected,
)
from appliance.measure.calibration.depth_error import BORDER, DEPTH_ERROR_TERMS, along_ray, shapes
from appliance.measure.calibration.design import design_calibration
from appliance.measure.calibration.parameters import RIG_PARAMETERS
from appliance.measure.light.correction import ImageCorrection
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.volume import STANDARD
from tests.support.calibrating import SMALL
from tests.support.golden_texts import Says
from tests.support.truth import WATER

Array = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 400, 300
START = design_calibration(SMALL, "KF", WIDTH_PX, HEIGHT_PX, WATER).rig
ACTIVE = (5, *range(6, 28))
"""Not all parameters, and not in the places of their names."""
NODES = (5, 4)
_COUNT = 2 * 8 * 7
_ENDS = np.cumsum([len(ACTIVE), _COUNT, _COUNT])
GROUPS = [slice(int(a), int(b)) for a, b in pairwise(_ENDS)]
COLUMNS = Columns(ACTIVE, (GROUPS[0], GROUPS[1]))
SIZE = int(_ENDS[-1]) + 5
"""The artefacts' places come last; nothing depends on them."""
LENGTH_MM, RADIUS_MM = 120.0, 25.0
NO_PX = np.zeros((60, 2))
BAR = Recording(
    "bar", ArtefactKind.BALL_BAR, NO_PX, NO_PX, WATER, np.repeat([0, 1], 30), LENGTH_MM, radius_mm=RADIUS_MM
)
PLANE = Recording("plane", ArtefactKind.PLANE, NO_PX, NO_PX, WATER, np.zeros(60, np.intp))
NONE, NOTHING = np.zeros((SIZE, SIZE)), np.zeros(SIZE)


def with_surfaces(rig: StereoRig, x: Array) -> StereoRig:
    """The rig with small corrections, and the nodes of ``x`` added: first all nodes across, then all down."""
    cameras: list[HousedCamera] = []
    for eye, camera in enumerate((rig.left, rig.right)):
        base = np.random.default_rng(30 + eye)
        correction = base.normal(0.0, 0.03, _COUNT) + x[GROUPS[eye]].reshape(2, -1).T.ravel()
        cameras.append(
            replace(camera, correction=ImageCorrection(WIDTH_PX, HEIGHT_PX, NODES, tuple(correction.tolist())))
        )
    return StereoRig(cameras[0], cameras[1])


RIG = with_surfaces(START, np.zeros(SIZE))


def changed(x: Array) -> StereoRig:
    values = np.zeros(RIG_PARAMETERS.count)
    values[list(ACTIVE)] = x[: len(ACTIVE)]
    return with_surfaces(RIG_PARAMETERS.changed(START, values), x)


def met(rig: StereoRig, seen: tuple[Array, Array], index: float) -> Array:
    """Points nearest to both rays of each pair of pixels, by least squares."""
    normal, side = np.zeros((len(seen[0]), 3, 3)), np.zeros((len(seen[0]), 3))
    for camera, uv in zip((rig.left, rig.right), seen, strict=True):
        origin, way = camera.rays(uv, index)
        across = np.eye(3) - way[:, :, None] * way[:, None, :]
        normal += across
        side += np.einsum("nij,nj->ni", across, origin)
    return np.asarray(np.linalg.solve(normal, side[:, :, None])[:, :, 0])


def axes() -> tuple[Array, Array]:
    middle = RIG.volume_centre_mm(WATER.index)
    base = np.asarray(RIG.right.translation_mm)
    x = base / np.linalg.norm(base)
    z = middle - base / 2.0
    z = z - x * (z @ x)
    z /= np.linalg.norm(z)
    return middle, np.stack([x, np.cross(z, x), z])


def places() -> list[Array]:
    """The middle of the volume, and 7 % of its distance nearer and farther."""
    middle, frame = axes()
    return [middle + part * (middle @ frame[2]) * frame[2] for part in (-0.07, 0.0, 0.07)]


def bars() -> list[tuple[Array, Array]]:
    """For each of the twelve bars its direction and the near sides of its balls, (14, 3)."""
    _, frame = axes()
    sixth = np.radians(60.0) * np.arange(6)
    near = np.array([[0.0, 0.0, -1.0], *([0.6 * np.cos(a), 0.6 * np.sin(a), -0.8] for a in sixth)]) * RADIUS_MM
    found = []
    leans = [[0.0, 35.0, -35.0, 0.0], [35.0, -35.0, 0.0, 35.0], [-35.0, 0.0, 35.0, -35.0]]
    for at, of_depth in zip(places(), leans, strict=True):
        for roll, lean in zip(np.radians([0.0, 45.0, 90.0, -45.0]), np.radians(of_depth), strict=True):
            way = np.array([np.cos(lean) * np.cos(roll), np.cos(lean) * np.sin(roll), np.sin(lean)]) @ frame
            found.append((way, np.concatenate([at + s * LENGTH_MM / 2.0 * way + near @ frame for s in (-1.0, 1.0)])))
    return found


def planes() -> list[Array]:
    """Grids of 9 × 7 points over 200 mm × 150 mm."""
    _, frame = axes()
    grid = np.array([[x, y, 0.0] for y in np.linspace(-75.0, 75.0, 7) for x in np.linspace(-100.0, 100.0, 9)])
    return [at + grid @ frame for at in places()]


Change = Callable[[float], tuple[StereoRig, float, float]]
"""To a size: another rig, how much farther to the right the right camera's pixels lie, another index."""


def moves(points: Array, change: Change) -> Array:
    """How points move for each unit of a change, which only computing knows of: pixels are those of ``RIG``."""
    seen = RIG.left.project(points, WATER.index), RIG.right.project(points, WATER.index)
    ends = []
    for size in (1e-4, -1e-4):
        rig, aside_px, index = change(size)
        ends.append(met(rig, (seen[0], seen[1] + np.array([aside_px, 0.0])), index))
    return (ends[0] - ends[1]) / 2e-4


def wrong_percent(change: Change, each_place_its_own: bool = False) -> tuple[float, float]:
    """The largest error of a length and bend of a plane that a change of one standard deviation makes expect."""
    lengths, bends = [], []
    for way, points in bars():
        first, second = moves(points, change).reshape(2, 7, 3).mean(axis=1) @ way
        lengths.append(np.hypot(first, second) if each_place_its_own else second - first)
    normal = axes()[1][2]
    for points in planes():
        heights = moves(points, change) @ normal
        if not each_place_its_own:
            design = np.column_stack([np.ones(len(points)), points @ axes()[1][:2].T])
            heights = heights - design @ np.linalg.lstsq(design, heights, rcond=None)[0]
        bends.append(np.sqrt(np.mean(heights**2)))
    # Two standard deviations of a length; six from the lowest to the highest place of a plane of a diagonal of 250 mm.
    return 100.0 * 2.0 * float(np.abs(lengths).max()) / LENGTH_MM, 100.0 * 6.0 * float(max(bends)) / 250.0


def some(group: str, seed: int = 31) -> Array:
    """A change of all unknowns of a group."""
    x = np.zeros(SIZE)
    rng = np.random.default_rng(seed)
    if group == "rig":
        x[: len(ACTIVE)] = 3.0 * rng.normal(size=len(ACTIVE)) * RIG_PARAMETERS.steps[list(ACTIVE)]
    else:
        where = GROUPS[["left nodes", "right nodes"].index(group)]
        x[where] = 0.05 * rng.normal(size=where.stop - where.start)
    return x


def of_size(x: Array, size: float) -> tuple[StereoRig, float, float]:
    return changed(size * x), 0.0, WATER.index


def test_an_unknown_that_is_unsure_makes_expect_what_another_rig_would_measure() -> None:
    seeds = ("left nodes", 31), ("right nodes", 31), *(("rig", seed) for seed in (35, 39, 42, 45))
    for x in (some(group, seed) for group, seed in seeds):  # each makes another bar worst
        found = expected_errors(RIG, BAR, AdjustmentUncertainty(np.outer(x, x), NOTHING, 0.0, 0.0), COLUMNS)
        wanted = wrong_percent(partial(of_size, x))
        assert (found.length_percent, found.flat_percent) == pytest.approx(wanted, rel=0.01)


def test_what_is_left_is_an_error_of_each_place_and_the_index_counts_with_the_adjustments_answer() -> None:
    found = expected_errors(RIG, BAR, AdjustmentUncertainty(NONE, NOTHING, 0.0, 0.03), COLUMNS)
    wanted = wrong_percent(lambda size: (RIG, 0.03 * size, WATER.index), each_place_its_own=True)
    assert (found.length_percent, found.flat_percent) == pytest.approx(wanted, rel=0.01)
    answer = 100.0 * some("rig")
    found = expected_errors(RIG, BAR, AdjustmentUncertainty(NONE, answer, 2e-4, 0.0), COLUMNS)
    wanted = wrong_percent(lambda size: (changed(2e-4 * size * answer), 0.0, WATER.index + 2e-4 * size))
    assert (found.length_percent, found.flat_percent) == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("name", ["length_percent", "flat_percent"])
def test_doubts_that_have_nothing_to_do_with_each_other_add_as_squares(name: str) -> None:
    """Three that make expect the same: together at most the root of three times as much, which they would in the same worst place."""

    def size(doubt: AdjustmentUncertainty) -> float:
        return float(getattr(expected_errors(RIG, BAR, doubt, COLUMNS), name))

    square = np.outer(some("rig"), some("rig"))
    a, b, c = (
        0.01 / size(one)
        for one in (
            AdjustmentUncertainty(square, NOTHING, 0.0, 0.0),
            AdjustmentUncertainty(NONE, NOTHING, 1e-3, 0.0),
            AdjustmentUncertainty(NONE, NOTHING, 0.0, 0.1),
        )
    )
    assert 0.015 < size(AdjustmentUncertainty(square * a**2, NOTHING, 1e-3 * b, 0.1 * c)) <= 0.01 * 3.0**0.5 * 1.00001


def test_ten_recordings_must_do_better_than_four() -> None:
    for bars, planes, length, flat, warned in (
        (2, 2, 0.05, 0.05, False), (2, 2, 0.051, 0.01, True), (2, 2, 0.01, 0.051, True), (4, 6, 0.025, 0.05, False),
        (4, 6, 0.026, 0.01, True), (3, 9, 0.05, 0.05, False), (4, 5, 0.05, 0.05, False),
    ):  # fmt: skip
        said = warnings_about_expected(ExpectedErrors(length, flat), [BAR] * bars + [PLANE] * planes, 0.0, True)
        assert len(said) == warned, (bars, planes, length, flat)


def test_the_remedy_is_for_what_is_missing(says: Says) -> None:
    for bars, rest_px, known in ((2, 0.01, True), (4, 0.0, True), (2, 0.011, True), (2, 0.2, False), (4, 0.0, False)):
        says(*warnings_about_expected(ExpectedErrors(0.0812, 0.0634), [BAR] * bars + [PLANE] * 6, rest_px, known))


def test_coefficients_are_those_that_made_a_depth_error_whatever_overlaps_absorb() -> None:
    rng = np.random.default_rng(3)
    z = rng.uniform(480.0, 570.0, 400)
    points = z[:, None] * np.column_stack([rng.uniform(-BORDER, BORDER, (400, 2)), np.ones(400)])
    true = rng.normal(size=DEPTH_ERROR_TERMS) * 0.02
    error = shapes(points) @ true
    np.testing.assert_allclose(coefficients_of(points, error, STANDARD), true, atol=1e-10)
    absorbed = 0.3 + 0.002 * points[:, 0] - 0.001 * points[:, 1] + 0.002 * (z - 525.0)
    np.testing.assert_allclose(coefficients_of(points, error + absorbed, STANDARD), true, atol=1e-10)
    assert along_ray(points)[:, 2] == pytest.approx(1.0)


@pytest.mark.parametrize("column", [0, 9, 21, len(ACTIVE) + 20])
def test_the_shared_depth_error_is_that_of_triangulating_with_another_rig(column: int) -> None:
    sd = 1e-3
    u, v = np.meshgrid(np.linspace(-BORDER, BORDER, 11), np.linspace(-0.75 * BORDER, 0.75 * BORDER, 9))
    points = np.concatenate(
        [
            far * np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
            for far in (0.92 * 525.0, 525.0, 1.09 * 525.0, 1.17 * 525.0)
        ]
    )
    seen = RIG.left.project(points, WATER.index), RIG.right.project(points, WATER.index)
    both = np.isfinite(np.column_stack(seen)).all(axis=1)
    seen = seen[0][both], seen[1][both]
    x = np.zeros(SIZE)
    x[column] = sd
    off = met(changed(x), seen, WATER.index) - met(changed(np.zeros(SIZE)), seen, WATER.index)
    expected_mm = coefficients_of(points[both], off[:, 2], STANDARD)
    covariance = np.zeros((SIZE, SIZE))
    covariance[column, column] = sd**2
    stated = expected_depth_error_mm2(
        RIG, WATER.index, AdjustmentUncertainty(covariance, np.zeros(SIZE), 0.0, 0.0), COLUMNS
    )
    np.testing.assert_allclose(
        np.sqrt(np.diag(stated)), np.abs(expected_mm), rtol=0.02, atol=0.01 * np.abs(expected_mm).max()
    )
    strongest = int(np.abs(expected_mm).argmax())
    signs = np.sign(stated[strongest]) * np.sign(expected_mm[strongest])
    clear = np.abs(expected_mm) > 0.3 * np.abs(expected_mm).max()
    np.testing.assert_array_equal(signs[clear], np.sign(expected_mm)[clear])


def test_what_is_left_in_pixels_and_the_water_add_to_the_shared_depth_error() -> None:
    nothing = AdjustmentUncertainty(np.zeros((SIZE, SIZE)), np.zeros(SIZE), 0.0, 0.0)
    bare = expected_depth_error_mm2(RIG, WATER.index, nothing, COLUMNS)
    assert not bare.any()
    rest = expected_depth_error_mm2(RIG, WATER.index, replace(nothing, rest_px=0.02), COLUMNS)
    water = expected_depth_error_mm2(RIG, WATER.index, replace(nothing, index_sd=1e-4), COLUMNS)
    assert np.linalg.matrix_rank(water, tol=1e-12) == 1
    assert np.diag(rest).min() > 0.0
    double = expected_depth_error_mm2(RIG, WATER.index, replace(nothing, rest_px=0.04), COLUMNS)
    np.testing.assert_allclose(double, 4.0 * rest)
