"""What a drift of the fringes means in depth, and how much of the noise its ripple is."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.measure.light.patterns import RISING_STEPS, PatternSequence, build_sequence
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm, PairOffset, SurfaceMap, depth_per_px, predict
from tests.support import synthetic

CAL = synthetic.calibration()
INDEX = synthetic.WATER.index
OURS, RISING = build_sequence(16), build_sequence(16, steps=RISING_STEPS)


def seen(depth_mm: float) -> tuple[DriftMap, DriftMap, np.ndarray]:
    """Cells of a plane at a depth as either camera sees them, of slopes 2.0 and 2.5 px per px, and the points (n, 3)."""
    x, y = np.meshgrid(np.linspace(-60.0, 60.0, 5), np.linspace(-40.0, 40.0, 4))
    points = np.stack([x + 100.0, y, np.full_like(x, depth_mm)], -1)
    maps = []
    for camera, slope in ((CAL.rig.left, 2.0), (CAL.rig.right, 2.5)):
        uv = camera.project(points, INDEX)
        zeros: dict[str, Any] = {name: np.zeros(x.shape) for name in DriftMap.__dataclass_fields__}
        zeros |= {"u_px": uv[..., 0], "v_px": uv[..., 1], "slope_per_px": np.full(x.shape, slope)}
        zeros |= {"noise_rad2": np.full(x.shape, 1e-3)}
        maps.append(DriftMap(**(zeros | {"sd_px": np.full(x.shape, 1e-4)})))
    return maps[0], maps[1], points


@pytest.mark.parametrize("depth_mm", [440.0, 600.0])
def test_a_px_of_the_fringes_is_so_many_mm_along_the_left_ray(depth_mm: float) -> None:
    left, right, points = seen(depth_mm)
    found = depth_per_px(left, right, CAL.rig, INDEX)
    # One px of E is 1/2.5 px of the right image to the right; the point on the left ray that is seen there:
    origin, along = CAL.rig.left.rays(np.stack([left.u_px, left.v_px], -1), INDEX)
    away = np.linalg.norm(points - origin, axis=-1)
    step_mm = 0.5
    shifted = CAL.rig.right.project(origin + along * (away + step_mm)[..., None], INDEX)
    mm_per_px = step_mm / (shifted[..., 0] - right.u_px)
    np.testing.assert_allclose(found, mm_per_px / 2.5, rtol=0.01)


def surface(shape: tuple[int, ...]) -> SurfaceMap:
    return SurfaceMap(np.full(shape, 30.0), np.full(shape, 0.9), np.full(shape, 0.02))


def harm_of(
    left: DriftMap,
    right: DriftMap,
    sequence: PatternSequence = RISING,
    pair_way2: float | None = None,
    offset: PairOffset | None = None,
) -> Harm:
    drift, there = {"left": left, "right": right}, surface(left.u_px.shape)
    return predict(drift, there, pair_way2, CAL.rig, INDEX, sequence, 1 / 60, offset)


def test_an_even_drift_is_that_of_left_less_right_and_a_speed_and_makes_a_ripple_over_noise() -> None:
    left, right, _ = seen(500.0)
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    moving = replace(left, drift_px=np.full(per_px.shape, 0.12)), replace(right, drift_px=np.full(per_px.shape, 0.02))
    harm = harm_of(*moving)
    np.testing.assert_allclose(harm.drift_px, 0.10, rtol=1e-9)
    np.testing.assert_allclose(harm.depth_rate_mm_s, per_px * 0.10 * 60.0, rtol=1e-9)
    # An eighth of its square.
    rms = np.sqrt(np.mean((per_px * 0.9) ** 2 * 0.1**2 / 8.0))
    noise = 0.02 * np.sqrt(1.8 * np.mean(per_px**2))
    assert harm.ripple_rms_mm == pytest.approx(rms, rel=1e-3)
    assert harm.noise_rms_mm == pytest.approx(noise)
    assert harm.added == pytest.approx(np.sqrt(1.0 + (harm.ripple or 0.0) ** 2) - 1.0, rel=1e-3)


def test_in_our_order_a_drift_makes_no_ripple_but_for_the_second_harmonic() -> None:
    left, right, _ = seen(500.0)
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    moving = replace(left, drift_px=np.full(per_px.shape, 0.12)), replace(right, drift_px=np.full(per_px.shape, 0.02))
    plain, rising = harm_of(*moving, OURS), harm_of(*moving)
    assert plain.ripple_rms_mm == 0.0
    assert plain.drift_over_noise == pytest.approx(rising.ripple), "other judges see it all the same"
    # A shake has an offset of the pairs: where it drifts, or everywhere alike.
    for offset in (PairOffset(0.49), PairOffset(0.0, 0.49 * 0.1**2)):
        shaken = harm_of(*moving, OURS, offset=offset)
        assert shaken.ripple == pytest.approx(0.7 * (rising.ripple or 0.0), rel=1e-3)
        assert shaken.drift_over_noise == pytest.approx(rising.ripple, rel=1e-3)
    # Ways of 3 and 1 images.
    left, right = (replace(one, second2=np.full(per_px.shape, 0.01)) for one in moving)
    bent = harm_of(left, right, OURS)
    assert bent.ripple_rms_mm == pytest.approx(np.sqrt(np.mean((per_px * 0.9) ** 2 * 2.5 * 0.01 * 0.1**2)), rel=1e-3)


@pytest.mark.parametrize(("sequence", "times"), [(RISING, 1.0), (OURS, 2.0)])
def test_what_is_uneven_counts_twice_where_the_contradiction_holds_half_of_it(
    sequence: PatternSequence, times: float
) -> None:
    left, right, _ = seen(500.0)
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    left, right = (replace(one, uneven_rad2=np.full(per_px.shape, 0.01)) for one in (left, right))
    harm = harm_of(left, right, sequence)
    # Of 0.3² of the square, less a fifth of the noise of both cameras, 1e-3 rad² each.
    expected_px = 16.0 / (2.0 * np.pi) * 0.3 * np.sqrt(times * (0.01 - 0.2 * 2e-3))
    assert harm.ripple_rms_mm == pytest.approx(expected_px * 0.9 * np.sqrt(np.mean(per_px**2)), rel=0.01)


def test_what_is_within_its_uncertainty_harms_nothing_and_what_is_unknown_is_left_out() -> None:
    left, right, _ = seen(500.0)
    shape = left.u_px.shape
    harm = harm_of(replace(left, drift_px=np.full(shape, 0.01), sd_px=np.full(shape, 0.02)), right)
    assert (harm.ripple, harm.added) == (0.0, 0.0)
    drift = np.full(shape, 0.1)
    drift[0] = np.nan
    weight = harm_of(replace(left, drift_px=drift), right).weight
    assert (weight == np.where(np.isnan(drift), 0.0, 30.0)).all()
    for cells, known in ((3, False), (4, True)):
        few = np.full(shape, np.nan)
        few[0, :cells] = 0.1
        assert (harm_of(replace(left, drift_px=few), right).added is not None) is known
    # A cell much less certain than the others is left out.
    sd = np.full(shape, 1e-3)
    sd[1, 1], sd[2, 2] = 5e-3, 3e-3
    weight = harm_of(replace(left, sd_px=sd), right).weight
    assert (weight[1, 1], weight[2, 2]) == (0.0, 30.0)


def test_paint_that_moves_harms_although_the_fringes_stand_still() -> None:
    left, right, _ = seen(500.0)
    painted = replace(left, texture_per_px2=np.full(left.u_px.shape, 0.02), sd_px=np.full(left.u_px.shape, 1e-6))
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    calm, moved = (harm_of(painted, right, OURS, way2) for way2 in (None, 0.36))
    assert calm.ripple == pytest.approx(0.0, abs=1e-3)
    # Half of the texture is the right camera's, which sees none. Fringes that drift take w² E² of it, ways of 3 and 1.
    drifting = harm_of(replace(painted, drift_px=np.full(per_px.shape, 0.1)), right, OURS)
    expected_px = 16.0 / (2.0 * np.pi) * np.sqrt(0.01 * 1.25 * 0.1**2)
    assert drifting.ripple_rms_mm == pytest.approx(expected_px * 0.9 * np.sqrt(np.mean(per_px**2)), rel=0.02)
    expected_px = 16.0 / (2.0 * np.pi) * np.sqrt(0.01 * 0.5 * (2.0**2 + 2.5**2) * 0.125 * 0.36)
    assert moved.ripple_rms_mm == pytest.approx(expected_px * 0.9 * np.sqrt(np.mean(per_px**2)), rel=0.02)


def test_where_no_cell_is_known_nothing_is_predicted_and_nothing_warns() -> None:
    left, right, _ = seen(500.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        harm = harm_of(replace(left, drift_px=np.full(left.u_px.shape, np.nan)), right)
    assert (harm.ripple, harm.added, harm.ripple_rms_mm, harm.noise_rms_mm) == (None, None, None, None)
    assert not harm.weight.any()
    for one in (left, right):
        one.u_px[:], one.v_px[:] = np.nan, np.nan
        assert np.isnan(depth_per_px(left, right, CAL.rig, INDEX)).all(), "where either camera sees nothing"
