"""Heat turns the mounts in proportion, depth bends the windows as the theory of plates has it, and the world does both."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hw_sim.in_dive import in_dive
from hw_sim.mount_shift import MountShift
from hw_sim.optics.mounts import EYES, Mounts
from hw_sim.truth import draw_truth, in_air, ray
from hw_sim.water.medium import Water
from tests.hw_sim.conftest import Bench

N_WATER = Water().index
RIG = draw_truth("realistic", 3, 1600, 1200, N_WATER)
MOUNTS = Mounts((0.001, 0.0, 0.0), (0.0, 0.0006, 0.0008), (0.0, 0.0, 0.0), 1e-5)


def test_each_eye_turns_in_proportion_to_the_heat() -> None:
    for warm_k in (4.0, -12.0):
        warm = in_dive(RIG, MOUNTS, warm_k)
        for name, per_k in (("left", 0.001), ("right", 0.001), ("projector", 0.0)):
            turn = np.array(RIG.eye(name).R).T @ np.array(warm.eye(name).R)
            angle_deg = math.degrees(math.asin(min(1.0, float(np.linalg.norm(turn - turn.T)) / 2.0 / 2.0**0.5)))
            assert angle_deg == pytest.approx(abs(per_k * warm_k), abs=1e-9)
            assert warm.eye(name).t_mm == RIG.eye(name).t_mm
            assert warm.eye(name).f_px[0] == pytest.approx(RIG.eye(name).f_px[0] * (1.0 + 1e-5 * warm_k), rel=1e-12)
    assert in_dive(RIG, Mounts(), 7.0) == RIG


def test_a_window_bends_as_a_plate_under_pressure_and_not_in_air() -> None:
    deep = Mounts(depth_m=30.0, window_radius_mm=30.0)
    # Largest deflection of a simply supported plate: (5 + ν) p a⁴ / (64 (1 + ν) D). Its curvature there, by the sag of a
    # parabola through middle and rim, is less than in the middle, which is bent most: by (5 + ν)/(6 + 2ν).
    nu, stiffness = 0.27, 4e11 * 0.005**3 / (12 * (1 - 0.27**2))
    pressure = 1025.0 * 9.81 * 30.0
    sag_mm = (5 + nu) * pressure * 0.03**4 / (64 * (1 + nu) * stiffness) * 1000.0
    middle = 2.0 * sag_mm / 30.0**2 * (6 + 2 * nu) / (5 + nu)
    assert deep.window_bend_per_mm(5.0) == pytest.approx(middle, rel=1e-9)
    under = in_dive(RIG, deep, 0.0)
    for name in EYES:
        flaws = under.eye(name).aberrations
        assert flaws is not None
        assert flaws.window_bend_per_mm == deep.window_bend_per_mm(RIG.eye(name).port.th_mm)
    uv = np.array([[20.0, 20.0], [799.5, 599.5], [1580.0, 1180.0]])
    turned_px = np.linalg.norm(ray(under, "left", uv)[1] - ray(RIG, "left", uv)[1], axis=1) * 2556.0
    assert 0.01 < turned_px[0] < 0.3, "some hundredths of a pixel in the corner"
    assert turned_px[1] < 0.1 * turned_px[0]
    assert in_dive(in_air(RIG), deep, 0.0) == in_air(RIG)


def test_the_world_warms_up_its_rig_and_keeps_a_knock(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(
        outside={"mounts": {"left_deg_per_k": [0.01, 0.0, 0.0]}}, water={"temperature_c": 10.0}, idle_speed=100.0
    )
    world = bench.world
    cold = np.array(world.truth.left.R)
    nominal = np.array(draw_truth("nominal", 1, 160, 120, Water(10.0).index).left.R)
    turn = nominal.T @ cold
    assert math.degrees(turn[2, 1]) == pytest.approx(0.01 * (10.0 - 20.0), rel=1e-4), "mounts are as drawn at 20 °C"
    world.knock(MountShift("left", yaw_deg=0.5))
    # A hot spring warms the case from outside, quicker than its own parts do.
    world.set_water(Water(temperature_c=40.0))
    bench.wires.clock.sleep_s(60.0)
    later = nominal.T @ np.array(world.truth.left.R)
    assert math.degrees(later[0, 2]) == pytest.approx(0.5, abs=0.01)
    assert math.degrees(later[2, 1]) > -0.095, "the case has warmed, and the camera with it"
