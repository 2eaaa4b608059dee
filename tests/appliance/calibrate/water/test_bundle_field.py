"""The adjustment and the cameras mean the same by a correction, and its slopes are those of its cost."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from appliance.calibrate.recordings import ArtefactKind, Recording, RecordingError
from appliance.calibrate.water.bundle import BundleSettings, Problem, adjust
from appliance.calibrate.water.method import Method
from appliance.measure.calibration.design import design_calibration
from appliance.measure.calibration.parameters import RIG_PARAMETERS
from appliance.measure.light.model import StereoRig
from appliance.measure.light.water import Water
from tests.support.calibrating import SMALL
from tests.support.truth import WATER

DRAWN = design_calibration(SMALL, "KF", 400, 300, WATER)
SETTINGS = BundleSettings(points_per_recording=60)
AIR_COVARIANCE = np.diag(np.array([0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-4, 1e-4, 1e-3] * 2 + [1e-4] * 3 + [0.05] * 3) ** 2)
START = replace(DRAWN, air_covariance=tuple(tuple(row) for row in AIR_COVARIANCE.tolist()))
CENTRES = np.array([[-30.0, -10.0, 500.0], [40.0, 20.0, 540.0]])
RADIUS_MM = 20.0


def seen(rig: StereoRig, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rig.left.project(points, WATER.index), rig.right.project(points, WATER.index)


def recordings(rig: StereoRig, noise_px: float = 0.0, points: int = 60) -> list[Recording]:
    """Two planes and a bar as ``rig`` sees them, exactly but for noise of the right pixels."""
    rng = np.random.default_rng(4)
    found = []
    for k, (z, tilt) in enumerate(((470.0, 0.15), (570.0, -0.2))):
        xy = rng.uniform([-75.0, -55.0], [75.0, 55.0], (points, 2))
        left, right = seen(rig, np.column_stack([xy, z + tilt * xy[:, 0]]))
        found.append(Recording(f"plane {k}", ArtefactKind.PLANE, left, right, WATER, np.zeros(points, np.intp)))
    away = np.add(rng.normal(0.0, 0.5, (2 * points, 3)), [0.0, 0.0, -2.0])
    label = np.repeat([0, 1], points)
    on_balls = CENTRES[label] + RADIUS_MM * away / np.linalg.norm(away, axis=1, keepdims=True)
    left, right = seen(rig, on_balls)
    length = float(np.linalg.norm(CENTRES[1] - CENTRES[0]))
    bar = Recording("bar", ArtefactKind.BALL_BAR, left, right, WATER, label, length_mm=length, radius_mm=RADIUS_MM)
    return [replace(r, right_px=r.right_px + rng.normal(0.0, 1.0, r.right_px.shape) * noise_px) for r in [*found, bar]]


def problem_of(method: Method, seen: list[Recording], settings: BundleSettings = SETTINGS) -> Problem:
    return Problem(seen, START, method, settings)


@cache
def corrected() -> tuple[Problem, np.ndarray, StereoRig]:
    """A problem with image corrections, unknowns at some place, and the rig that these mean."""
    problem = problem_of(Method.SPLINE, recordings(START.rig))
    rng = np.random.default_rng(6)
    x = np.zeros(problem.size)
    x[: RIG_PARAMETERS.count] = 5.0 * RIG_PARAMETERS.steps * rng.normal(0.0, 1.0, RIG_PARAMETERS.count)
    for nodes in (problem._left_nodes, problem._right_nodes):
        x[nodes] = 0.2 * rng.normal(0.0, 1.0, nodes.stop - nodes.start)
    return problem, x, problem.rig(x)


@pytest.mark.parametrize("method", [Method.PORTS, Method.SPLINE])
def test_the_gradient_is_the_slope_of_the_cost_in_every_group_of_unknowns(method: Method) -> None:
    problem = problem_of(method, recordings(corrected()[2], 0.02))
    problem.mean[: len(problem.prior_sd)] = 50.0 * problem.prior_sd  # as boards in air may say, and much more
    rng = np.random.default_rng(8)
    x = np.zeros(problem.size)
    groups = {"ports": slice(0, 6), "places": slice(problem._right_nodes.stop, problem.size)}
    if method is Method.SPLINE:
        groups |= {"lenses": slice(6, 22), "pose": slice(22, 28)}
        groups |= {"left nodes": problem._left_nodes, "right nodes": problem._right_nodes}
    _, gradient, _, _ = problem.linearise(x)
    for name, group in groups.items():
        way = np.zeros(problem.size)
        way[group] = rng.normal(0.0, 1.0, group.stop - group.start)
        if name in {"ports", "lenses", "pose"}:
            way[group] *= RIG_PARAMETERS.steps[group]
        elif name == "places":
            way[group] *= np.concatenate([place.steps for place in problem._poses])
        else:
            way[group] *= 1e-3
        before, after = (problem.linearise(x + sign * way)[2] for sign in (-1, 1))
        # The cost is a sum of squares, the gradient half of its slope.
        assert (after - before) / 4.0 == pytest.approx(float(gradient @ way), rel=0.02, abs=2e-3), name


def test_far_points_lose_weight_in_proportion_and_near_ones_none() -> None:
    """Huber: within four standard deviations squared, beyond them straight on."""
    exact = recordings(START.rig)
    costs = []
    for off_px in (0.0, 0.08, 0.16, 0.32, 0.64):
        right = exact[0].right_px.copy()
        right[7, 0] += off_px
        problem = problem_of(Method.PORTS, [replace(exact[0], right_px=right), *exact[1:]])
        # At the places that exact recordings give, so that nothing but this residual counts.
        problem._poses = problem_of(Method.PORTS, exact)._poses
        costs.append(problem.linearise(np.zeros(problem.size))[2])
    assert np.subtract(costs, costs[0]) == pytest.approx([0.0, 4.0, 16.0, 48.0, 112.0], abs=0.05)


def test_an_adjustment_that_does_not_settle_says_so_and_one_that_does_states_the_water_of_its_first_recording() -> None:
    """The design that it starts from states another one, and recordings may be of water that has warmed a little."""
    with pytest.raises(RecordingError, match="did not converge in 1 steps"):
        adjust(recordings(corrected()[2]), START, Method.PORTS, BundleSettings(steps_at_most=1, small_step=1e-9))
    first, *others = recordings(START.rig, 0.01)
    seen_first = Water(19.0, 1.0, 530.0)
    result = adjust([replace(first, water=seen_first), *others], START, Method.PORTS, SETTINGS)
    assert result.calibration.water == seen_first != START.water
    assert result.calibration.rig.left.correction is None


def test_a_plane_seen_along_one_line_is_named() -> None:
    """About that line the plane may turn as it likes."""
    line = np.column_stack([np.linspace(-75.0, 75.0, 60), np.zeros(60), np.full(60, 520.0)])
    plane = Recording("line", ArtefactKind.PLANE, *seen(START.rig, line), WATER, np.zeros(60, np.intp))
    with pytest.raises(RecordingError, match="the place of line"):
        adjust([recordings(START.rig)[-1], plane], START, Method.PORTS, SETTINGS)


def test_a_spline_needs_the_covariance_of_the_air_and_widens_it() -> None:
    exact = recordings(START.rig)
    with pytest.raises(RecordingError, match="use ports"):
        adjust(exact, DRAWN, Method.SPLINE, SETTINGS)
    refocus = float(np.hypot(0.05, 1e-4 * START.rig.left.lens.f_px[0]))
    pose = {22: np.hypot(1e-4, np.radians(0.01)), 25: np.hypot(0.05, 0.02)}
    wanted = {0: np.radians(0.7), 2: 3.0, 6: refocus, 14: refocus, 7: 0.05, **pose}
    prior = problem_of(Method.SPLINE, exact).prior_sd
    assert {k: prior[k] for k in wanted} == pytest.approx(wanted, rel=1e-6)
    bare = problem_of(Method.SPLINE, exact, replace(SETTINGS, spline_px=0.0))
    assert bare.rig(np.zeros(bare.size)).left.correction is None


def test_nodes_are_held_by_their_size_and_by_their_bends_not_by_a_slope() -> None:
    problem = problem_of(Method.SPLINE, recordings(START.rig))
    columns, rows, value_sd, bend_sd = 9, 8, 0.15, 0.05
    count = columns * rows
    x, y = (a.ravel() for a in np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)))
    bent = rows * (columns - 2), columns * (rows - 2)
    for nodes in (problem._left_nodes, problem._right_nodes):
        block = problem.prior[nodes, nodes]
        assert len(block) == 2 * count
        surfaces = (np.full(count, 0.3), 0), (0.01 * x - 0.02 * y, 0), (0.01 * x**2, bent[0]), (0.01 * y**2, bent[1])
        for surface, bends in surfaces:
            held = float(np.sum(surface**2)) / value_sd**2 + bends * (0.02 / bend_sd) ** 2
            for second in (False, True):
                values = np.concatenate([0.0 * surface, surface] if second else [surface, 0.0 * surface])
                assert float(values @ block @ values) == pytest.approx(held)
