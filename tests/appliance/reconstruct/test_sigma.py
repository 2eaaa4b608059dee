"""What a point expects of itself: the share of noise that reading off between pixels leaves, bends, ripple, and no memory."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.match import fill_inverse_map, match_row, right_maps
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.reconstruct.ripple import measure_ripple
from appliance.reconstruct.rows import LeftMaps
from appliance.reconstruct.scratch import PHASE_VARIANCE_RIGHT, RIGHT_SHARE, SIZE, P, Q, U, V
from hw_sim.scene import Scene
from tests.support import synthetic
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

WIDTH, HEIGHT = 400, 300
NOISE_PX = 0.03


def matched(p: np.ndarray, q: np.ndarray, asked_p: np.ndarray, asked_q: np.ndarray) -> np.ndarray:
    """A scratch row after matching ``asked`` coordinates (n,) in the right maps ``p`` and ``q`` (h, w)."""
    modulation = np.full(p.shape, 160, np.uint8)
    right = right_maps(p.astype(np.float32), q.astype(np.float32), modulation, 1024, 768)
    fill_inverse_map(right, 1)
    s = np.full(SIZE, np.nan, np.float32)
    n = len(asked_p)
    s[P : P + n], s[Q : Q + n] = asked_p, asked_q
    match_row(right, s, s, s, n, False, np.empty(n, np.int32))
    return s


def test_noise_of_the_right_coordinate_is_its_share_at_every_place_between_pixels() -> None:
    """A straight map with white noise, asked at known places: what scatters is what is said to."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    rng = np.random.default_rng(4)
    places = np.stack([np.repeat(np.linspace(-0.45, 0.45, 7), 7), np.tile(np.linspace(-0.45, 0.45, 7), 7)], -1)
    scatter, said = np.zeros(len(places)), np.zeros(len(places))
    for k, (du, dv) in enumerate(places):
        noisy = 100.0 + 2.0 * u + NOISE_PX * rng.standard_normal(u.shape)
        rows, columns = np.arange(10, 290, 7), np.arange(10, 390, 5)
        at_v, at_u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        s = matched(noisy, 20.0 + 2.0 * v, 100.0 + 2.0 * (at_u + du), 20.0 + 2.0 * (at_v + dv))
        n = len(at_u)
        error_px = 2.0 * (s[U : U + n] - (at_u + du))
        scatter[k] = np.nanmean(error_px**2) / NOISE_PX**2
        said[k] = np.nanmean(s[RIGHT_SHARE : RIGHT_SHARE + n])
    np.testing.assert_allclose(said, scatter, rtol=0.12)
    assert np.mean(said) == pytest.approx(0.80, abs=0.04), "less than a pixel's own"
    assert said.max() > 0.97
    assert said.min() < 0.62


@pytest.mark.parametrize("holes", [0.0, 0.1])
def test_the_variance_of_a_right_coordinate_is_that_of_the_pixel_it_is_read_off_from(holes: float) -> None:
    """Every pixel has a variance of its own; beside missing pixels a match is found by walking."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    p, q = 100.0 + 2.0 * u, 20.0 + 2.0 * v
    p[np.random.default_rng(5).random(p.shape) < holes] = np.nan
    variance_px2 = (1000.0 * v + u).astype(np.float32)
    right = right_maps(p, q, np.full(p.shape, 160, np.uint8), 1024, 768, variance_px2)
    fill_inverse_map(right, 1)
    at_u, at_v = np.meshgrid(np.arange(20.3, 380.0, 7.0), np.arange(20.3, 280.0, 7.0))
    n = at_u.size
    s = np.full(SIZE, np.nan, np.float32)
    s[P : P + n], s[Q : Q + n] = 100.0 + 2.0 * at_u.ravel(), 20.0 + 2.0 * at_v.ravel()
    match_row(right, s, s, s, n, False, np.empty(n, np.int32))
    found = np.isfinite(s[U : U + n])
    row, column = np.divmod(s[PHASE_VARIANCE_RIGHT : PHASE_VARIANCE_RIGHT + n][found], 1000.0)
    assert found.mean() > 0.6
    assert np.isfinite(p[row.astype(int), column.astype(int)]).all(), "a pixel with a coordinate"
    assert np.abs(s[U : U + n][found] - column).max() <= 0.75
    assert np.abs(s[V : V + n][found] - row).max() <= 0.75


def test_a_bent_surface_is_followed_between_pixels() -> None:
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    along, across = u - 200.0, v - 150.0
    p, q = 500.0 + 2.2 * along + 0.006 * along**2 + 0.0005 * across**2, 350.0 + 2.2 * across
    at_u, at_v = np.linspace(60.0, 340.0, 333), np.linspace(40.0, 260.0, 333)
    a, b = at_u - 200.0, at_v - 150.0
    s = matched(p, q, 500.0 + 2.2 * a + 0.006 * a**2 + 0.0005 * b**2, 350.0 + 2.2 * b)
    away = np.hypot(s[U : U + 333] - at_u, s[V : V + 333] - at_v)
    straight = 0.5 * 0.012 * 0.5**2 / 2.2
    assert np.nanmax(away) < 0.2 * straight
    assert np.isfinite(away).mean() > 0.97


@pytest.mark.parametrize("amplitude_px", [0.0, 0.08])
@pytest.mark.parametrize("slope", [0.65, 2.5])
def test_a_ripple_of_the_projector_is_found_in_the_scan_itself(amplitude_px: float, slope: float) -> None:
    """On a wavy surface with noise, in large and in small images."""
    v, u = np.mgrid[0:600, 0:800].astype(float)
    p = 40.0 + slope * 0.5 * u + 1.5 * np.sin(u / 70.0) + 0.8 * np.cos(v / 50.0 + u / 200.0)
    p = p + amplitude_px * np.sin(8.0 * np.pi * (p + 0.5) / 16.0 + 0.7)
    p += NOISE_PX * np.random.default_rng(2).standard_normal(p.shape)
    p[:, :20] = np.nan
    lit = np.tile(np.array([0, 800], np.int32), (600, 1))
    found = measure_ripple(p.astype(np.float32), lit, 16)
    assert found.amplitude_px == pytest.approx(amplitude_px, abs=0.012)
    assert found.noise_px == pytest.approx(NOISE_PX, rel=0.2)
    assert found.counts == (amplitude_px > 0.0 and slope > 1.0), "wide fringes lose nothing between pixels"


def clouds(pipeline: Pipeline, scan: RenderedScan) -> tuple[Cloud, Cloud]:
    for k in range(len(scan.sequence)):
        for side, frames in scan.frames.items():
            pipeline.push(side, frames, k)
    return pipeline.coarse(), pipeline.full()


def test_points_and_their_errors_know_nothing_of_the_scan_before() -> None:
    """To the last bit: the same frames give the same cloud, whatever was scanned before."""
    seen = render_scan(Scene(object="stones"), "modelled", 5, WIDTH, 16)
    before = render_scan(Scene(object="plane"), "modelled", 5, WIDTH, 16)
    calibration = true_calibration(seen.renderer.truth)
    with (
        Pipeline(calibration, WATER, build_sequence(16)) as used,
        Pipeline(calibration, WATER, build_sequence(16)) as fresh,
    ):
        clouds(used, before)
        for again, first in zip(clouds(used, seen), clouds(fresh, seen), strict=True):
            for column in ("pixel", "points_mm", "sigma_mm", "ray_gap_mm"):
                np.testing.assert_array_equal(getattr(again, column), getattr(first, column), column)


def test_points_of_maps_that_carry_variances_have_errors_by_both_cameras_variances() -> None:
    calibration = synthetic.calibration()
    scan = render_scan(Scene(object="plane", texture="none"), "nominal", 1, WIDTH, 16)

    def variance_mm2(left_px2: float, right_px2: float) -> float:
        maps = {
            side: np.full(pipeline.decoded(side).p_px.shape, variance_px2, np.float32)
            for side, variance_px2 in (("left", left_px2), ("right", right_px2))
        }
        cloud = pipeline.table.cloud(pipeline.find_changed(variance_px2=maps))
        assert len(cloud.pixel) > 0.95 * len(plain.pixel)
        return float(np.median(cloud.sigma_mm**2))

    with Pipeline(calibration, synthetic.WATER, scan.sequence) as pipeline:
        _, plain = clouds(pipeline, scan)
        # A ripple adds the same to all. The right one counts by 0.8 in the mean: reading off between pixels leaves so much.
        once = variance_mm2(0.004, 0.004)
        left, twice_left, right = variance_mm2(0.008, 0.004), variance_mm2(0.012, 0.004), variance_mm2(0.004, 0.008)
        assert twice_left - once == pytest.approx(2.0 * (left - once), rel=0.05)
        assert right - once == pytest.approx(0.8 * (left - once), rel=0.06)
        assert left > 1.2 * once
        np.testing.assert_array_equal(pipeline.table.cloud(pipeline.find_full()).sigma_mm, plain.sigma_mm)


def test_where_a_neighbour_is_missing_a_point_expects_more() -> None:
    calibration = synthetic.calibration()
    scan = render_scan(Scene(object="plane", texture="none"), "nominal", 1, WIDTH, 16)
    with Pipeline(calibration, synthetic.WATER, scan.sequence) as pipeline:
        _, cloud = clouds(pipeline, scan)
        valid = np.isfinite(pipeline.decoded("left").p_px)
    v, u = np.divmod(cloud.pixel.astype(int), WIDTH)
    inner = (u > 0) & (u < WIDTH - 1)
    v, u, sigma = v[inner], u[inner], cloud.sigma_mm[inner]
    border = ~(valid[v, u - 1] & valid[v, u + 1])
    assert 50 < np.count_nonzero(border) < 0.05 * len(u)
    assert np.median(sigma[border]) > 2.0 * np.median(sigma[~border])


def test_maps_read_between_pixels_are_refused_where_a_camera_has_no_variances() -> None:
    nothing, none = np.full((HEIGHT, WIDTH), np.nan, np.float32), np.zeros((HEIGHT, WIDTH), np.uint8)
    bare = LeftMaps(nothing, nothing, none, none, none, np.zeros((HEIGHT, 2), np.int32))
    known = bare._replace(variance_px2=np.ones_like(nothing))
    with Pipeline(synthetic.calibration(), synthetic.WATER, build_sequence(16)) as pipeline:
        for left, right in ((bare, bare), (known, bare), (bare, known)):
            with pytest.raises(ValueError, match="without variances"):
                pipeline.find_replaced(left, right)
