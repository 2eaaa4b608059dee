"""The signs of movement on images whose movement is known to the pixel: Gray edges, fringes, and what both mean in depth."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder
from appliance.verdict.motion.drift import DriftMap, drift_map
from appliance.verdict.motion.edges import EdgeShifts, edge_shifts
from appliance.verdict.motion.harm import SurfaceMap, depth_per_px, predict
from tests.support import synthetic

WIDTH, HEIGHT = 400, 300
SEQUENCE = build_sequence(16)
NOISE_DN = 0.8
VARIANCE = (NOISE_DN**2 + 1.0 / 12.0, 0.0)
Way = Callable[[int], float]


def photographed(moved_px: Way, seed: int = 1, noise_dn: float = NOISE_DN) -> np.ndarray:
    """Frames (n, h, w) uint8 of a slanted plane whose pattern columns are larger by ``moved_px`` in each frame."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    p, q = 20.3 + 2.37 * u + 0.11 * v, 15.1 + 2.41 * v
    rng = np.random.default_rng(seed)
    images = []
    for k, pattern in enumerate(SEQUENCE.patterns):
        profile = gaussian_filter1d(pattern.codes().astype(float), 1.2, mode="nearest")
        at = p + moved_px(k) if pattern.direction is Direction.X else q
        light = 20.0 + 0.75 * np.interp(at, np.arange(profile.size), profile)
        images.append(np.clip(np.rint(light + noise_dn * rng.standard_normal(light.shape)), 0, 255))
    return np.array(images).astype(np.uint8)


@cache
def still() -> np.ndarray:
    return photographed(lambda k: 0.0)


def decoded(frames: np.ndarray) -> CameraDecoder:
    decoder = CameraDecoder(SEQUENCE, WIDTH, HEIGHT)
    for k in range(len(SEQUENCE)):
        decoder.push(frames, k)
    return decoder


GRAY = SEQUENCE.axis(Direction.X).gray
SINE = SEQUENCE.axis(Direction.X).sine


def edges_moved(moved_px: float) -> EdgeShifts:
    frames = photographed(lambda k: moved_px if k in GRAY else 0.0)
    return edge_shifts(frames, decoded(still()), SEQUENCE)


@pytest.mark.parametrize("moved_px", [-0.6, -0.2, 0.0, 0.2, 0.6])
def test_gray_edges_tell_by_how_much_the_pattern_had_moved_in_their_frame(moved_px: float) -> None:
    found = edges_moved(moved_px)
    assert found.shift_px.shape == (len(GRAY), 12, 16)
    for frame in range(len(GRAY)):
        there = np.isfinite(found.shift_px[frame])
        if frame >= 2:  # coarser bits have an edge or two in the whole picture
            assert there.sum() > 12
        if there.any():
            assert np.median(found.shift_px[frame][there]) == pytest.approx(moved_px, abs=0.06 + 0.05 * abs(moved_px))


def test_cells_in_the_dark_have_no_edges() -> None:
    frames = still().copy()
    decoder = decoded(frames)
    frames[:, :, :200] = frames[SEQUENCE.dark][:, :200]
    found = edge_shifts(frames, decoder, SEQUENCE)
    assert np.isnan(found.shift_px[:, :, :7]).all()
    assert np.isfinite(found.shift_px[-1, 1:10, 9:14]).any()


def drift(per_frame_px: float, noise_dn: float = NOISE_DN) -> DriftMap:
    middle = float(np.mean(SINE))
    frames = photographed(lambda k: per_frame_px * (k - middle) if k in SINE else 0.0, noise_dn=noise_dn)
    return drift_map(frames, decoded(frames), SEQUENCE, VARIANCE)


@pytest.mark.parametrize("per_frame_px", [-0.2, -0.05, 0.0, 0.05, 0.2])
def test_fringes_tell_their_drift_with_its_sign_and_their_slope(per_frame_px: float) -> None:
    found = drift(per_frame_px)
    known = np.isfinite(found.drift_px)
    assert known.sum() > 100
    assert np.median(found.drift_px[known]) == pytest.approx(per_frame_px, rel=0.1, abs=0.004)
    assert np.median(found.slope_per_px[known]) == pytest.approx(2.37, rel=0.02)
    for steps in (found.early_px, found.late_px):
        assert np.nanmedian(steps) == pytest.approx(per_frame_px, rel=0.1, abs=0.01)


def test_the_drifts_uncertainty_is_the_scatter_it_has() -> None:
    found = drift(0.0)
    z = (found.drift_px / found.sd_px)[np.isfinite(found.drift_px)]
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.6


def test_a_cell_stands_where_its_pixels_are() -> None:
    found = drift(0.0)
    known = np.isfinite(np.pad(found.drift_px, 1, constant_values=np.nan))
    whole = known[1:-1, 1:-1] & known[:-2, 1:-1] & known[2:, 1:-1] & known[1:-1, :-2] & known[1:-1, 2:]
    rows, columns = np.nonzero(whole)
    assert len(rows) > 20
    p, q = 64.0 * (columns + 0.5), 64.0 * (rows + 0.5)
    v = (q - 15.1) / 2.41
    u = (p - 20.3 - 0.11 * v) / 2.37
    np.testing.assert_allclose(found.u_px[rows, columns], u, atol=4.0)
    np.testing.assert_allclose(found.v_px[rows, columns], v, atol=4.0)


# ----------------------------------------------------------------------------------------- depth and harm

CAL = synthetic.calibration()
INDEX = synthetic.WATER.index


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


def as_read(left_px: float, right_px: float, px_per_cycle: float) -> float:
    """Twice the mean square of what is left of two ripples of these amplitudes, the right one read off along parabolas through three pixels."""
    places = (np.arange(4000) + 0.5) / 4000.0 - 0.5
    phases = np.arange(12)[:, None] * np.pi / 6.0
    turn = 2.0 * np.pi / px_per_cycle
    before, here, after = (np.cos(phases + turn * k) for k in (-1.0, 0.0, 1.0))
    read = here + 0.5 * places * (after - before) + 0.5 * places**2 * (after + before - 2.0 * here)
    return float(2.0 * np.mean((left_px * np.cos(phases + turn * places) - right_px * read) ** 2))


@pytest.mark.parametrize("px_per_cycle", [3.2, 6.4, 40.0])
def test_a_ripple_that_is_three_pixels_long_is_read_too_small(px_per_cycle: float) -> None:
    left, right, _ = seen(500.0)
    shape = left.u_px.shape
    # The ripple goes through two cycles a period.
    right = replace(right, drift_px=np.full(shape, -0.06), slope_per_px=np.full(shape, -8.0 / px_per_cycle))
    moving = replace(left, drift_px=np.full(shape, 0.05))
    per_px = depth_per_px(moving, right, CAL.rig, INDEX)
    harm = predict(moving, right, surface(shape), None, CAL.rig, INDEX, 16, 1 / 60)
    left_over2 = as_read(0.05, -0.06, px_per_cycle)
    np.testing.assert_allclose((harm.ripple_mm / (0.9 * per_px)) ** 2, left_over2 / 8.0, rtol=1e-4)
    assert left_over2 / 0.11**2 == pytest.approx({3.2: 0.91, 6.4: 0.99, 40.0: 1.0}[px_per_cycle], abs=0.01)


def test_noise_is_that_of_the_left_pixel_and_four_fifths_of_the_right_one() -> None:
    left, right, _ = seen(500.0)
    shape = left.u_px.shape
    moving = replace(left, drift_px=np.full(shape, 0.05))
    noisier = replace(right, noise_rad2=np.full(shape, 3e-3))
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    harm = predict(moving, noisier, surface(shape), None, CAL.rig, INDEX, 16, 1 / 60)
    np.testing.assert_allclose(harm.noise_mm, np.abs(per_px) * 0.02 * np.sqrt(1.0 + 0.8 * 3.0))
    assert harm.noise_rms_mm == pytest.approx(np.sqrt(np.mean(harm.noise_mm**2)))


def test_a_shake_makes_less_of_a_ripple_than_its_drift_says() -> None:
    left, right, _ = seen(500.0)
    moving = replace(left, drift_px=np.full(left.u_px.shape, 0.1))
    every, less = (
        predict(moving, right, surface(left.u_px.shape), None, CAL.rig, INDEX, 16, 1 / 60, steps2)
        for steps2 in (1.0, 0.49)
    )
    assert less.ripple == pytest.approx(0.7 * (every.ripple or 0.0), rel=1e-3)


def test_an_even_drift_makes_a_ripple_of_an_eighth_of_its_square_and_a_speed() -> None:
    left, right, _ = seen(500.0)
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    moving = replace(left, drift_px=np.full(per_px.shape, 0.12)), replace(right, drift_px=np.full(per_px.shape, 0.02))
    harm = predict(*moving, surface(per_px.shape), None, CAL.rig, INDEX, 16, 1 / 60)
    np.testing.assert_allclose(harm.drift_px, 0.10, rtol=1e-9)
    np.testing.assert_allclose(harm.depth_rate_mm_s, per_px * 0.10 * 60.0, rtol=1e-9)
    # Fringes of 6.4 right pixels: a ripple of half of that.
    read = as_read(0.12, 0.02, 3.2)
    assert read == pytest.approx(0.1**2, rel=0.1)
    np.testing.assert_allclose(harm.ripple_mm, np.abs(per_px) * 0.9 * np.sqrt(read / 8.0), rtol=1e-3)
    rms = np.sqrt(np.mean((per_px * 0.9) ** 2 * read / 8.0))
    noise = 0.02 * np.sqrt(1.8 * np.mean(per_px**2))
    assert harm.ripple_rms_mm == pytest.approx(rms, rel=1e-3)
    assert harm.noise_rms_mm == pytest.approx(noise)
    assert harm.ripple == pytest.approx(rms / noise, rel=1e-3)
    assert harm.added == pytest.approx(np.sqrt(1.0 + (rms / noise) ** 2) - 1.0, rel=1e-3)
    assert harm.weight.tolist() == np.full(per_px.shape, 30.0).tolist()


def test_what_is_within_its_uncertainty_harms_nothing_and_what_is_unknown_is_left_out() -> None:
    left, right, _ = seen(500.0)
    shape = left.u_px.shape
    unsure = replace(left, drift_px=np.full(shape, 0.01), sd_px=np.full(shape, 0.02))
    harm = predict(unsure, right, surface(shape), None, CAL.rig, INDEX, 16, 1 / 60)
    assert harm.ripple == 0.0
    assert harm.added == 0.0
    holes = np.full(shape, 0.1)
    holes[0] = np.nan
    harm = predict(replace(left, drift_px=holes), right, surface(shape), None, CAL.rig, INDEX, 16, 1 / 60)
    assert (harm.weight[0] == 0.0).all()
    assert (harm.weight[1:] == 30.0).all()
    few = np.full(shape, np.nan)
    few[0, :3] = 0.1
    assert predict(replace(left, drift_px=few), right, surface(shape), None, CAL.rig, INDEX, 16, 1 / 60).added is None
    few[0, 3] = 0.1
    harm = predict(replace(left, drift_px=few), right, surface(shape), None, CAL.rig, INDEX, 16, 1 / 60)
    assert harm.added is not None


def test_a_cell_much_less_certain_than_the_others_is_left_out() -> None:
    left, right, _ = seen(500.0)
    sd = np.full(left.u_px.shape, 1e-3)
    sd[1, 1], sd[2, 2] = 5e-3, 3e-3
    harm = predict(replace(left, sd_px=sd), right, surface(sd.shape), None, CAL.rig, INDEX, 16, 1 / 60)
    assert (harm.weight[1, 1], harm.weight[2, 2]) == (0.0, 30.0)


def test_paint_that_moves_to_and_fro_harms_although_the_fringes_stand_still() -> None:
    left, right, _ = seen(500.0)
    painted = replace(left, texture_per_px2=np.full(left.u_px.shape, 0.02), sd_px=np.full(left.u_px.shape, 1e-6))
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    calm = predict(painted, right, surface(per_px.shape), None, CAL.rig, INDEX, 16, 1 / 60)
    shaken = predict(painted, right, surface(per_px.shape), 0.36, CAL.rig, INDEX, 16, 1 / 60)
    assert calm.ripple == pytest.approx(0.0, abs=1e-3)
    slope2 = 0.5 * (2.0**2 + 2.5**2)
    expected_px = 16.0 / (2.0 * np.pi) * np.sqrt(0.01 * slope2 * 0.25 * 0.36)
    assert shaken.ripple_rms_mm == pytest.approx(expected_px * 0.9 * np.sqrt(np.mean(per_px**2)), rel=0.02)


def told(seed: int) -> tuple[DriftMap, DriftMap, SurfaceMap]:
    """Cells that differ in everything, some of them with a hole in one map or the other."""
    rng = np.random.default_rng(seed)
    left, right, _ = seen(500.0)
    shape = left.u_px.shape
    maps = [
        replace(
            one,
            **{name: rng.uniform(0.05, 0.15, shape) for name in ("drift_px", "early_px", "late_px")},
            sd_px=rng.uniform(0.01, 0.02, shape),
            noise_rad2=rng.uniform(1e-3, 2e-3, shape),
            texture_per_px2=rng.uniform(0.0, 0.03, shape),
            uneven_rad2=rng.uniform(0.0, 0.01, shape),
            second2=rng.uniform(0.0, 0.02, shape),
        )
        for one in (left, right)
    ]
    maps[0].texture_per_px2[0, 0] = maps[1].texture_per_px2[0, 1] = np.nan
    maps[0].drift_px[1, 1] = maps[1].second2[1, 2] = np.nan
    maps[1].u_px[1, 3] = maps[1].v_px[1, 3] = np.nan
    points = rng.integers(5, 60, shape).astype(float)
    across, noise_px = rng.uniform(0.5, 1.0, shape), rng.uniform(0.01, 0.03, shape)
    noise_px[2, 2] = np.nan
    return maps[0], maps[1], SurfaceMap(points, across, noise_px)


@pytest.mark.parametrize("double_step2", [None, 0.5])
def test_a_cells_ripple_is_the_sum_of_what_the_module_names(double_step2: float | None) -> None:
    left, right, stands = told(3)
    per_px = depth_per_px(left, right, CAL.rig, INDEX)
    harm = predict(left, right, stands, double_step2, CAL.rig, INDEX, 16, 1 / 60)
    some = 0
    for at in np.ndindex(*per_px.shape):
        known = at not in {(1, 1), (1, 2), (1, 3), (2, 2)}
        assert (harm.weight[at] > 0.0) == known
        if not known:
            continue
        a, b = (
            {name: float(getattr(one, name)[at]) for name in DriftMap.__dataclass_fields__} for one in (left, right)
        )
        variance = a["sd_px"] ** 2 + b["sd_px"] ** 2
        assert harm.sd_px[at] == pytest.approx(np.sqrt(variance))
        first, second, third = (
            as_read(a["drift_px"], b["drift_px"], 16.0 / (2.5 * cycles)) - variance for cycles in (1, 2, 3)
        )
        shaky = ((a["early_px"] - b["early_px"]) ** 2 + (a["late_px"] - b["late_px"]) ** 2) / 2.0 - 2.0 * variance
        texture = (np.nan_to_num(a["texture_per_px2"]) + np.nan_to_num(b["texture_per_px2"])) / 2.0
        # A tenth of the noise's variance may be noise that was not stated; 2 maps, each of 2 pixels' errors.
        beyond = (a["uneven_rad2"] + b["uneven_rad2"]) / 2.0 - 0.2 * (a["noise_rad2"] + b["noise_rad2"])
        painted = 0.3**2 * max(beyond, 0.0)
        if double_step2 is not None:
            painted += texture * (2.0**2 + 2.5**2) / 2.0 * double_step2 / 4.0
        ripple2 = second / 8.0 + (first + third) * (a["second2"] + b["second2"]) / 2.0
        ripple2 += (16.0 / (2.0 * np.pi)) ** 2 * (shaky * texture + painted)
        if ripple2 > 0.0:
            some += 1
            assert harm.ripple_mm[at] == pytest.approx(abs(per_px[at]) * stands.across[at] * np.sqrt(ripple2), rel=1e-3)
        else:
            assert np.isnan(harm.ripple_mm[at])
    assert some >= 8


def test_cells_count_by_their_points() -> None:
    left, right, _ = seen(500.0)
    per_px = np.abs(depth_per_px(left, right, CAL.rig, INDEX))
    drift, points, noise = np.full(per_px.shape, 0.1), np.full(per_px.shape, 10.0), np.full(per_px.shape, 0.02)
    drift[:2], points[:2], noise[:2] = 0.2, 90.0, 0.01
    moving = replace(left, drift_px=drift, sd_px=np.full(per_px.shape, 1e-6))
    still = replace(right, sd_px=np.full(per_px.shape, 1e-6))
    stands = SurfaceMap(points, np.ones(per_px.shape), noise)
    harm = predict(moving, still, stands, None, CAL.rig, INDEX, 16, 1 / 60)
    # The left camera's alone drifts, and its coordinates are those of its pixels.
    ripple = np.sqrt(np.average((per_px * drift) ** 2 / 8.0, weights=points))
    noisy = np.sqrt(1.8 * np.average((per_px * noise) ** 2, weights=points))
    assert harm.ripple_rms_mm == pytest.approx(ripple, rel=1e-6)
    assert harm.noise_rms_mm == pytest.approx(noisy)
    assert harm.ripple == pytest.approx(ripple / noisy, rel=1e-6)
    assert np.array_equal(harm.u_px, left.u_px)
    assert np.array_equal(harm.v_px, left.v_px)


def test_where_no_cell_is_known_nothing_is_predicted_and_nothing_warns() -> None:
    left, right, _ = seen(500.0)
    blind = replace(left, drift_px=np.full(left.u_px.shape, np.nan))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        harm = predict(blind, right, surface(left.u_px.shape), None, CAL.rig, INDEX, 16, 1 / 60)
    assert (harm.ripple, harm.added, harm.ripple_rms_mm, harm.noise_rms_mm) == (None, None, None, None)
    assert not harm.weight.any()


def test_where_either_camera_sees_nothing_depth_is_not_known() -> None:
    left, right, _ = seen(500.0)
    for one in (left, right):
        one.u_px[:], one.v_px[:] = np.nan, np.nan
        assert np.isnan(depth_per_px(left, right, CAL.rig, INDEX)).all()
