"""What the projector's response bends coordinates by is found in the coordinates themselves, taken out, and nothing else is touched."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.optics.water import Water
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.straighten import PhaseBend, measure_bend, take_out
from appliance.scan.sides import SIDES
from hw_sim.outside import draw_outside
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, with_glass
from tests.support.bias import coordinate_errors, depth_errors, rms
from tests.support.rendered import EXPOSURE_S, FRAME_S, pictures, render_scan
from tests.support.truth import WATER, true_calibration

SHAPE = (150, 200)
NOISE_PX = 0.03


def bent(true_px: NDArray[np.float64], terms_px: tuple[float, ...], period_px: int) -> NDArray[np.float32]:
    """Solve p = true + Σ b sin kθ(p) by fixed-point steps: what decoding gives of a true coordinate."""
    decoded = true_px.copy()
    for _ in range(200):
        theta = 8.0 * np.pi * (decoded + 0.5) / period_px
        decoded = true_px + sum(b * np.sin((k + 1) * theta) for k, b in enumerate(terms_px))
    return decoded.astype(np.float32)


def surface(period_px: int, slope: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """True columns and rows of a gently bent surface, with a little noise."""
    v, u = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float64)
    rng = np.random.default_rng(10_500)
    p = 40.0 + slope * u + 0.07 * v + 4e-4 * slope * (u - 90.0) ** 2
    q = 30.0 + slope * v - 0.05 * u + 3e-4 * slope * (v - 70.0) ** 2
    noise = NOISE_PX * period_px / 16.0
    return p + noise * rng.standard_normal(SHAPE), q + noise * rng.standard_normal(SHAPE)


class Maps(NamedTuple):
    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]
    illuminated_columns: NDArray[np.int32]


def lit(p: NDArray[np.floating], q: NDArray[np.floating]) -> Maps:
    """Maps that are illuminated everywhere."""
    return Maps(p.astype(np.float32), q.astype(np.float32), np.tile(np.array([0, p.shape[1]], np.int32), (len(p), 1)))


@pytest.mark.parametrize(
    ("period_px", "slope", "terms_px"),
    [
        (16, 2.56, (0.06, 0.0, 0.0, 0.0)),
        (16, 2.56, (-0.2, 0.08, 0.0, 0.0)),
        (16, 0.64, (0.3, -0.05, 0.02, 0.0)),
        (64, 2.56, (0.8, 0.15, 0.0, 0.0)),
        (64, 0.64, (0.4, 0.0, 0.0, 0.0)),
    ],
)
def test_a_bend_of_any_size_is_taken_out(period_px: int, slope: float, terms_px: tuple[float, ...]) -> None:
    p_true, q_true = surface(period_px, slope)
    p, q = bent(p_true, terms_px, period_px), bent(q_true, terms_px, period_px)
    p[40:50, 60:80] = np.nan
    found = measure_bend([lit(p, q)], period_px)
    assert found.counts
    assert np.abs(np.array(found.terms_px) - np.array(terms_px)).max() < 0.012 * period_px / 16
    before, maps = rms(p - p_true), lit(p, q)
    take_out(maps, found, period_px)
    assert rms(maps.p_px - p_true) < 0.15 * before
    assert rms(maps.q_px - q_true) < 0.15 * before
    assert np.isnan(maps.p_px[40:50, 60:80]).all(), "where there is no coordinate there is none afterwards"


def test_where_nothing_is_bent_nothing_is_found() -> None:
    for period_px, slope in ((16, 2.56), (16, 0.64), (64, 0.64)):
        p, q = (one.astype(np.float32) for one in surface(period_px, slope))
        assert not measure_bend([lit(p, q)], period_px).counts


def test_a_handful_of_pixels_says_nothing() -> None:
    p, q = np.full((2, *SHAPE), np.nan, np.float32)
    p_true, q_true = surface(16, 2.56)
    p[70:73, 90:93] = bent(p_true[70:73, 90:93], (0.5, 0.0, 0.0, 0.0), 16)
    q[70:73, 90:93] = q_true[70:73, 90:93]
    assert not measure_bend([lit(p, q)], 16).counts


def test_only_the_illuminated_part_changes() -> None:
    p_true, q_true = surface(16, 2.56)
    maps = lit(bent(p_true, (0.3, 0.0, 0.0, 0.0), 16), bent(q_true, (0.3, 0.0, 0.0, 0.0), 16))
    maps.illuminated_columns[:, 1] = 100
    before = maps.p_px.copy()
    take_out(maps, PhaseBend((0.3, 0.0, 0.0, 0.0), NOISE_PX), 16)
    changed = maps.p_px != before
    assert changed[:, :100].mean() > 0.95
    assert not changed[:, 100:].any()


def test_the_variance_grows_as_the_corrected_noise_does() -> None:
    """Judged by drawing noise on the phasors: each decoded coordinate is one of a bent fringe."""
    terms_px, period_px = (0.35, -0.05, 0.0, 0.0), 16
    rng = np.random.default_rng(10_501)
    true = rng.uniform(100.0, 116.0, 400_000)
    clean = bent(true, terms_px, period_px).astype(np.float64)
    noisy = (clean + 0.01 * rng.standard_normal(clean.size)).reshape(1, -1)
    bend, maps = PhaseBend(terms_px, 0.01), lit(noisy, noisy)
    take_out(maps, bend, period_px)
    gained = np.mean((maps.p_px[0] - true) ** 2) / 0.01**2
    assert bend.variance_factor(period_px) == pytest.approx(gained, rel=0.05)
    assert gained > 1.3
    assert PhaseBend((0.0,) * 4, 0.01).variance_factor(16) == pytest.approx(1.0)


def test_a_projector_of_bit_planes_seen_for_a_part_of_its_frame_leaves_no_ripple_and_sigma_is_true() -> None:
    """12 ms of 16.7: seen by a camera some bits are longer than others, and points scatter three times as much."""
    seed, sequence = 10_003, build_sequence(16)
    scene = Scene("plane", outside=draw_outside(seed, ("projector",)))
    truth = with_glass(draw_truth("modelled", seed, 320, 240, scene.index), scene.glass_more)
    renderer, shown = Renderer(truth, scene), pictures(sequence)
    frames = {
        side: np.stack(
            [
                renderer.expose(
                    side, [LightSlice(picture, EXPOSURE_S, 0.0005, FRAME_S)], 0.0, EXPOSURE_S, 0.0, (False, False),
                    2 * k + (side == "left"), k * FRAME_S,
                )
                for k, picture in enumerate(shown)
            ]
        )
        for side in SIDES
    }  # fmt: skip
    # The LED's own colour makes another index of water: the wavelength at which the product's formula has it.
    at_nm = np.linspace(500.0, 560.0, 601)
    index = np.array([Water(20.0, 0.0, float(nm)).index for nm in at_nm])
    water = Water(20.0, 0.0, float(at_nm[np.argmin(np.abs(index - truth.n_water))]))
    with Pipeline(true_calibration(truth), water, sequence) as pipeline:
        for k in range(len(sequence)):
            for side in SIDES:
                pipeline.push(side, frames[side], k)
        pipeline.coarse()
        as_decoded = rms(coordinate_errors(renderer, pipeline, "left").error_px)
        cloud = pipeline.full()
        straight = rms(coordinate_errors(renderer, pipeline, "left").error_px)
        noisier = {pipeline.decoded(side).copied().variance_factor for side in SIDES}
        pipeline.full()
        again = rms(coordinate_errors(renderer, pipeline, "left").error_px)
    assert straight < 0.5 * as_decoded
    assert again == straight, "the second time there is nothing left to take out"
    assert len(noisier) == 1
    assert min(noisier) > 1.02, "who merges these maps with others knows that they are noisier"
    errors = depth_errors(renderer, cloud)
    inner = errors.seen & (np.abs(errors.along_ray_mm) < 1.0)
    assert rms((errors.along_ray_mm / cloud.sigma_mm)[inner]) == pytest.approx(1.0, abs=0.1)


def test_where_motion_is_undone_the_maps_stay_as_they_were_decoded() -> None:
    scan = render_scan(Scene("plane"), "modelled", 3, 160, 16)
    with Pipeline(true_calibration(scan.renderer.truth), WATER, scan.sequence) as pipeline:
        for k in range(len(scan.sequence)):
            for side in SIDES:
                pipeline.push(side, scan.frames[side], k)
        pipeline.coarse()
        decoded = pipeline.decoded("left").p_px.copy()
        pipeline.find_full(straightened=False)
        np.testing.assert_array_equal(pipeline.decoded("left").p_px, decoded)
        pipeline.find_full()
        assert (pipeline.decoded("left").p_px != decoded).mean() > 0.3
        assert pipeline.decoded("left").variance_factor != 1.0
        for k in range(len(scan.sequence)):
            for side in SIDES:
                pipeline.push(side, scan.frames[side], k)
        pipeline.coarse()
        assert pipeline.decoded("left").variance_factor == 1.0, "another scan"
