"""What the projector's response bends coordinates by is found as by plain least squares, taken out, and believed up to written limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.reconstruct.straighten import STRAIGHT, PhaseBend, measure_bend, take_out
from tests.support.bias import rms

Floats = NDArray[np.float64]


class Maps(NamedTuple):
    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]
    illuminated_columns: NDArray[np.int32]


def lit(p: Floats, q: Floats, first: int = 0, end: int | None = None) -> Maps:
    """Maps that are illuminated in the columns from ``first`` on, up to the one before ``end``."""
    columns = np.tile(np.array([first, p.shape[1] if end is None else end], np.int32), (len(p), 1))
    return Maps(p.astype(np.float32), q.astype(np.float32), columns)


def wave(p: Floats, terms_px: tuple[float, ...], period_px: int) -> Floats:
    """Σ b_k sin kθ of coordinates."""
    theta = 8.0 * np.pi * (p + 0.5) / period_px
    return np.asarray(np.sum([b * np.sin((k + 1) * theta) for k, b in enumerate(terms_px)], axis=0))


def bent(true_px: Floats, terms_px: tuple[float, ...], period_px: int) -> Floats:
    """What decoding gives of true coordinates."""
    decoded = true_px.copy()
    for _ in range(150):
        decoded = true_px + wave(decoded, terms_px, period_px)
    return decoded


def surface(shape: tuple[int, int], slope: float, noise_px: float, seed: int = 7) -> tuple[Floats, Floats]:
    """True columns and rows of a gently bent surface with noise; rows grow as fast as columns."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float64)
    rng = np.random.default_rng(seed)
    p = 40.0 + slope * u + 0.07 * v + 4e-4 * slope * (u - 90.0) ** 2
    q = 30.0 + slope * v - 0.05 * u + 3e-4 * slope * (v - 70.0) ** 2
    return p + noise_px * rng.standard_normal(shape), q + noise_px * rng.standard_normal(shape)


def by_numpy(p: Floats, apart: int) -> tuple[Floats, Floats, float]:
    """Least squares of all second differences of rows, period 16 px: terms, their standard errors, noise of a coordinate."""
    before, here, after = p[:, : -2 * apart], p[:, apart:-apart], p[:, 2 * apart :]
    unit = [tuple(float(j == k) for j in range(4)) for k in range(4)]
    waves = [wave(before, one, 16) - 2.0 * wave(here, one, 16) + wave(after, one, 16) for one in unit]
    y = before - 2.0 * here + after
    use = np.isfinite(y)
    R, y = np.stack([one[use] for one in waves], 1), y[use]
    inverse = np.linalg.inv(R.T @ R)
    terms = inverse @ R.T @ y
    variance = float(np.sum((y - R @ terms) ** 2)) / (len(y) - 4)
    return terms, np.sqrt(np.diag(inverse) * variance), math.sqrt(variance / 6.0)


@pytest.mark.parametrize(
    ("period_px", "slope", "terms_px"),
    [
        (16, 2.56, (-0.2, 0.08, 0.0, 0.0)),
        (16, 0.64, (0.3, -0.05, 0.02, 0.0)),
        (64, 2.56, (0.8, 0.15, 0.0, 0.0)),
        (16, 2.56, (0.0, 0.0, 0.0, 0.0)),
        (64, 0.64, (0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_a_bend_of_any_size_is_taken_out_and_where_there_is_none_none_is_found(
    period_px: int, slope: float, terms_px: tuple[float, ...]
) -> None:
    true = surface((100, 130), slope, 0.03 * period_px / 16)
    p, q = (bent(one, terms_px, period_px) for one in true)
    p[40:50, 60:80] = np.nan
    maps = lit(p, q)
    found = measure_bend([maps], period_px)
    assert found.counts == any(terms_px)
    if any(terms_px):
        assert np.abs(np.array(found.terms_px) - np.array(terms_px)).max() < 0.012 * period_px / 16
        take_out(maps, found, period_px)
        for after, before, exact in zip(maps[:2], (p, q), true, strict=True):
            assert rms(after - exact) < 0.15 * rms(before - exact)
        assert np.isnan(maps.p_px[40:50, 60:80]).all(), "where there is no coordinate there is none afterwards"


@pytest.mark.parametrize("times", [4.5, 5.5])
def test_a_term_is_believed_from_five_standard_errors_on(times: float) -> None:
    v, u = np.mgrid[0:40, 0:40].astype(np.float64)
    p = 31.0 + 0.37 * u + 0.11 * v + 0.02 * np.random.default_rng(3).standard_normal(u.shape)
    by_chance, error, _ = by_numpy(p, 4)
    p = bent(p, (times * float(error[0]) - float(by_chance[0]), 0.0, 0.0, 0.0), 16)
    terms, error, _ = by_numpy(p, 4)
    assert terms[0] / error[0] == pytest.approx(times, abs=0.3)
    found = measure_bend([lit(p, np.full(p.shape, np.nan))], 16)
    assert found.terms_px == (pytest.approx(terms[0], rel=0.01) if times > 5.0 else 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("period_px", "slope", "apart", "down"),
    [(16, 0.35, 4, False), (16, 4.0, 1, True), (64, 0.7, 8, True), (16, 0.02, 16, False)],
)
def test_eighty_second_differences_are_enough_over_a_third_of_a_turn(
    period_px: int, slope: float, apart: int, down: bool
) -> None:
    """Of a line of pixels there are as many fewer as it is long, less two distances; no more than 16 px apart."""
    rng = np.random.default_rng(7)
    for count, enough in ((80, True), (79, False)):
        n = count + 2 * apart
        line = 20.0 + slope * np.arange(n) + 0.01 * rng.standard_normal(n)
        none = np.full(n, np.nan)
        found = measure_bend([lit(none[:, None], line[:, None]) if down else lit(line[None], none[None])], period_px)
        assert (found != STRAIGHT) == (found.noise_px > 0.0) == enough


def test_of_a_larger_image_every_second_pixel_of_every_second_row_is_asked() -> None:
    """Some 1,500 of any map: of 7,200 pixels 1,800."""
    rng = np.random.default_rng(8)
    for rows, enough in ((40, True), (38, False)):
        p = np.full((80, 90), np.nan)
        # Second differences reach 2 px to each side: they are at 8 of 12 columns, and 4 of these are asked.
        p[2 : 2 + rows, 20:32] = 30.0 + 0.7 * np.arange(12) + 0.01 * rng.standard_normal((rows, 12))
        assert (measure_bend([lit(p, np.full_like(p, np.nan))], 16) != STRAIGHT) == enough


def test_a_bend_counts_by_its_rms_from_a_tenth_of_the_noise_on() -> None:
    bend = PhaseBend((0.3, 0.0, -0.4, 0.0), 3.4)
    assert bend.rms_px == pytest.approx(0.5 / math.sqrt(2.0))
    assert bend.counts, "errors are larger by half a percent"
    assert not PhaseBend(bend.terms_px, 3.6).counts


@pytest.mark.parametrize(("order", "period_px"), [(0, 16), (1, 64), (2, 16), (3, 64)])
def test_what_is_taken_out_is_the_wave_itself_where_it_is_illuminated_and_noise_grows_by_its_slope(
    order: int, period_px: int
) -> None:
    """(1 − s)³ has the mean 1 + 3 s² where s has the mean 0: s² is half of (k b 8π/P)² for each term."""
    terms_px = tuple(0.5 * (k == order) for k in range(4))
    p = np.linspace(-0.5, 200.0, 400).reshape(2, 200)
    q = p[::-1] + 3.3
    maps = lit(p, q, 1, 199)
    take_out(maps, PhaseBend(terms_px, 0.01), period_px)
    for found, before in ((maps.p_px, p), (maps.q_px, q)):
        wanted = before - wave(before, terms_px, period_px)
        wanted[:, [0, 199]] = before[:, [0, 199]]
        assert np.abs(found - wanted).max() < 3e-4
    small = tuple(0.05 / (k + 1) * (k == order) for k in range(4))
    assert PhaseBend(small, 0.0).variance_factor(64) - 1.0 == pytest.approx(
        1.5 * (8 * np.pi / 64 * 0.05) ** 2, rel=1e-6
    )
