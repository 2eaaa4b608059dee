"""The adjustment and the cameras mean the same by a correction, and its slopes are those of its cost."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from appliance.calibration import parameters
from appliance.calibration.design import Design, design_calibration
from appliance.calibration.recordings import ArtefactKind, Recording, RecordingError
from appliance.calibration.water.bundle import BundleSettings, Problem, adjust
from appliance.calibration.water.method import Method
from appliance.optics.model import StereoRig
from appliance.optics.water import Water

WATER = Water(20.0, 0.0, 530.0)
DRAWN = design_calibration(Design(11.5, 4.5 * 4, 230.0, 12.41, 30.0, 5.0, 1.77), "KF", 400, 300, WATER)
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
    x[: parameters.COUNT] = 5.0 * parameters.STEPS * rng.normal(0.0, 1.0, parameters.COUNT)
    for nodes in (problem._left_nodes, problem._right_nodes):
        x[nodes] = 0.2 * rng.normal(0.0, 1.0, nodes.stop - nodes.start)
    return problem, x, problem.rig(x)


def test_what_a_rig_with_corrections_sees_leaves_no_residual_at_its_own_values() -> None:
    _, x, rig = corrected()
    problem = problem_of(Method.SPLINE, recordings(rig))
    at = x.copy()
    residuals: list[np.ndarray] = []
    for _ in range(4):  # the artefacts' places are fitted, all else stays
        hessian, gradient, _, residuals = problem.linearise(at)
        places = slice(problem._right_nodes.stop, problem.size)
        at[places] -= np.linalg.solve(hessian[places, places], gradient[places])
    for residual in residuals:
        # The right correction is looked up at the matched pixel, not where the point falls: that is all that may be left.
        assert np.sqrt(np.mean(residual**2)) < 0.003
    *_, bare = problem_of(Method.PORTS, recordings(rig)).linearise(np.zeros(6 + 6 + 8))
    assert np.sqrt(np.mean(np.concatenate(bare) ** 2)) > 0.05, "which it would, if the rig were taken as it starts"


@pytest.mark.parametrize("method", [Method.PORTS, Method.SPLINE])
def test_the_gradient_is_the_slope_of_the_cost_in_every_group_of_unknowns(method: Method) -> None:
    problem = problem_of(method, recordings(corrected()[2], 0.02))
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
            way[group] *= parameters.STEPS[group]
        elif name == "places":
            way[group] *= np.concatenate([place.steps for place in problem._places])
        else:
            way[group] *= 1e-3
        before, after = (problem.linearise(x + sign * way)[2] for sign in (-1, 1))
        # The cost is a sum of squares, the gradient half of its slope.
        assert (after - before) / 4.0 == pytest.approx(float(gradient @ way), rel=0.02, abs=2e-3), name


def test_a_port_that_stands_nearer_and_leans_is_found_from_exact_recordings() -> None:
    x = np.zeros(parameters.COUNT)
    x[:6] = 0.004, -0.003, 1.2, -0.005, 0.002, -0.8
    truth = parameters.rig_with(START.rig, x)
    result = adjust(recordings(truth, 0.01, 300), START, Method.PORTS, BundleSettings(noise_px=0.01))
    for estimate, true in zip(result.estimates, x[:6], strict=True):
        assert abs(estimate.change - true) < 4.5 * estimate.sd, estimate
    assert result.calibration.residual_px == pytest.approx(0.01, rel=0.15)
    assert result.costs[-1] < 0.5 * result.costs[0]
    assert len(result.costs) <= 11
    assert [w.split(":")[0] for w in result.warnings] == ["1 bars and 2 planes"]


def test_a_calibration_states_the_water_of_its_first_recording() -> None:
    """The design that it starts from states another one, and recordings may be of water that has warmed a little."""
    seen_first = Water(19.0, 1.0, 530.0)
    first, *others = recordings(START.rig, 0.01)
    result = adjust([replace(first, water=seen_first), *others], START, Method.PORTS, SETTINGS)
    assert result.calibration.water == seen_first
    assert START.water == others[0].water != seen_first


def test_far_points_lose_weight_in_proportion_and_near_ones_none() -> None:
    """Huber: within four standard deviations squared, beyond them straight on."""
    exact = recordings(START.rig)
    costs = []
    for off_px in (0.0, 0.08, 0.16, 0.32, 0.64):
        right = exact[0].right_px.copy()
        right[7, 0] += off_px
        problem = problem_of(Method.PORTS, [replace(exact[0], right_px=right), *exact[1:]])
        # At the places that exact recordings give, so that nothing but this residual counts.
        problem._places = problem_of(Method.PORTS, exact)._places
        costs.append(problem.linearise(np.zeros(problem.size))[2])
    assert np.subtract(costs, costs[0]) == pytest.approx([0.0, 4.0, 16.0, 48.0, 112.0], abs=0.05)


def test_an_adjustment_that_does_not_settle_says_so() -> None:
    with pytest.raises(RecordingError, match="did not converge in 1 steps; check the certificates"):
        adjust(recordings(corrected()[2]), START, Method.PORTS, BundleSettings(steps_at_most=1, small_step=1e-9))


def test_a_spline_needs_the_covariance_of_the_air_and_widens_it() -> None:
    exact = recordings(START.rig)
    with pytest.raises(RecordingError, match=r"no covariance from air, which spline needs; .* use ports"):
        adjust(exact, DRAWN, Method.SPLINE, SETTINGS)
    prior = problem_of(Method.SPLINE, exact).prior_sd
    assert prior[0] == pytest.approx(np.radians(0.7))
    assert prior[2] == pytest.approx(3.0)
    refocus = 1e-4 * START.rig.left.lens.f_px[0]
    assert prior[6] == pytest.approx(np.hypot(0.05, refocus), rel=1e-6)
    assert prior[14] == pytest.approx(np.hypot(0.05, refocus), rel=1e-6)
    assert prior[7] == pytest.approx(0.05, rel=1e-6)
    assert prior[22] == pytest.approx(np.hypot(1e-4, np.radians(0.01)), rel=1e-6)
    assert prior[25] == pytest.approx(np.hypot(0.05, 0.02), rel=1e-6)


def test_each_method_gives_a_rig_with_what_it_may_change_and_no_more() -> None:
    exact = recordings(START.rig)
    for method, settings, corrected in (
        (Method.PORTS, SETTINGS, None),
        (Method.SPLINE, replace(SETTINGS, spline_px=0.0), None),
        (Method.SPLINE, SETTINGS, (6, 5)),
    ):
        problem = problem_of(method, exact, settings)
        rig = problem.rig(np.zeros(problem.size))
        for camera in (rig.left, rig.right):
            assert (camera.correction.intervals if camera.correction else None) == corrected


def test_nodes_are_held_by_their_size_and_by_their_bends_not_by_a_slope() -> None:
    problem = problem_of(Method.SPLINE, recordings(START.rig))
    columns, rows, value_sd, bend_sd = 9, 8, 0.15, 0.05
    for nodes in (problem._left_nodes, problem._right_nodes):
        count = columns * rows
        assert nodes.stop - nodes.start == 2 * count
        block = problem.prior[nodes, nodes]
        x, y = (a.ravel() for a in np.meshgrid(np.arange(columns), np.arange(rows)))

        def energy(surface: np.ndarray, block: np.ndarray = block, count: int = count, second: bool = False) -> float:
            values = np.zeros(2 * count)
            values[count * second : count * (second + 1)] = surface
            return float(values @ block @ values)

        for second in (False, True):
            even = np.full(count, 0.3)
            assert energy(even, second=second) == pytest.approx(count * (0.3 / value_sd) ** 2)
            slope = 0.01 * x - 0.02 * y
            assert energy(slope, second=second) == pytest.approx(float(np.sum(slope**2)) / value_sd**2)
            bent = 0.01 * x**2.0
            held = float(np.sum(bent**2)) / value_sd**2 + rows * (columns - 2) * (0.02 / bend_sd) ** 2
            assert energy(bent, second=second) == pytest.approx(held)
            bent = 0.01 * y**2.0
            held = float(np.sum(bent**2)) / value_sd**2 + columns * (rows - 2) * (0.02 / bend_sd) ** 2
            assert energy(bent, second=second) == pytest.approx(held)
