"""The terms of a bend are those of plain least squares, and where they end to be believed is where it is written."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.reconstruct.straighten import STRAIGHT, PhaseBend, measure_bend, take_out

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
    for _ in range(100):
        decoded = true_px + wave(decoded, terms_px, period_px)
    return decoded


def by_numpy(maps: Maps, apart: tuple[int, int], period_px: int) -> tuple[Floats, Floats, float]:
    """Least squares of all second differences: terms, their standard errors, noise of a coordinate."""
    rows, values = [], []
    first, end = maps.illuminated_columns[0]
    for one, d in zip((maps.p_px.astype(np.float64), maps.q_px.astype(np.float64).T), apart, strict=True):
        before, here, after = one[:, : -2 * d], one[:, d:-d], one[:, 2 * d :]
        regressors = [
            wave(before, term, period_px) - 2.0 * wave(here, term, period_px) + wave(after, term, period_px)
            for term in ((0.0,) * k + (1.0,) for k in range(4))
        ]
        y = before - 2.0 * here + after
        use = np.isfinite(y)
        column = (
            np.arange(d, one.shape[1] - d)[None, :] if one.shape == maps.p_px.shape else np.arange(len(one))[:, None]
        )
        use &= (column >= first) & (column < end)
        rows.append(np.stack([r[use] for r in regressors], 1))
        values.append(y[use])
    R, y = np.concatenate(rows), np.concatenate(values)
    inverse = np.linalg.inv(R.T @ R)
    terms = inverse @ R.T @ y
    variance = float(np.sum((y - R @ terms) ** 2)) / (len(y) - 4)
    return terms, np.sqrt(np.diag(inverse) * variance), math.sqrt(variance / 6.0)


APART = 4, 2
"""Over so many pixels the phase of columns and that of rows of ``surface`` turns by about 0.35."""


def surface(noise_px: float, seed: int) -> tuple[Floats, Floats]:
    """A small surface (25, 30) of which columns grow by 0.37 and rows by 0.74 px per pixel."""
    v, u = np.mgrid[0:25, 0:30].astype(np.float64)
    rng = np.random.default_rng(seed)
    return (
        31.0 + 0.37 * u + 0.11 * v + noise_px * rng.standard_normal(u.shape),
        77.0 + 0.74 * v - 0.13 * u + noise_px * rng.standard_normal(u.shape),
    )


def test_terms_and_noise_are_those_of_least_squares() -> None:
    terms_px = (0.1, -0.05, 0.05, 0.03)
    p, q = surface(0.01, 1)
    p[4:6, 9] = np.nan
    maps = lit(bent(p, terms_px, 16), bent(q, terms_px, 16), 4, 28)
    found = measure_bend([maps], 16)
    terms, _, noise_px = by_numpy(maps, APART, 16)
    assert found.terms_px == pytest.approx(terms, abs=3e-4)
    assert found.noise_px == pytest.approx(noise_px, rel=1e-3)
    assert found.terms_px == pytest.approx(terms_px, abs=0.01)


def test_a_handful_of_samples_pays_for_the_four_terms_that_were_fitted_to_it() -> None:
    """Of some hundred second differences the fit takes four: noise would be stated two in a hundred too small."""
    p, _ = surface(0.02, 2)
    maps = lit(p[:6, :24], np.full((6, 24), np.nan))
    _, _, noise_px = by_numpy(maps, APART, 16)
    assert measure_bend([maps], 16).noise_px == pytest.approx(noise_px, rel=2e-3)


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("times", [4.5, 5.5])
def test_a_term_is_believed_from_five_standard_errors_on(seed: int, times: float) -> None:
    p, q = surface(0.02, seed)
    by_chance, error, _ = by_numpy(lit(p, q), APART, 16)
    size = times * float(error[0]) - float(by_chance[0])
    maps = lit(bent(p, (size, 0.0, 0.0, 0.0), 16), bent(q, (size, 0.0, 0.0, 0.0), 16))
    terms, error, _ = by_numpy(maps, APART, 16)
    assert terms[0] / error[0] == pytest.approx(times, abs=0.3)
    found = measure_bend([maps], 16)
    wanted = pytest.approx(terms[0], rel=0.01) if times > 5.0 else 0.0
    assert found.terms_px == (wanted, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("period_px", "slope", "apart"), [(16, 0.35, 4), (16, 1.4, 1), (16, 4.0, 1), (64, 0.7, 8), (16, 0.02, 16)]
)
@pytest.mark.parametrize("down", [False, True])
def test_eighty_second_differences_are_enough_over_a_third_of_a_turn(
    period_px: int, slope: float, apart: int, down: bool
) -> None:
    """Of a line of pixels there are as many fewer as it is long, less two distances; no more than 16 px apart."""
    rng = np.random.default_rng(7)
    for count, enough in ((80, True), (79, False)):
        n = count + 2 * apart
        line = 20.0 + slope * np.arange(n) + 0.01 * rng.standard_normal(n)
        none = np.full(n, np.nan)
        maps = lit(none[:, None], line[:, None]) if down else lit(line[None], none[None])
        found = measure_bend([maps], period_px)
        assert (found != STRAIGHT) == enough
        assert (found.noise_px > 0.0) == enough


def test_of_a_larger_image_every_second_pixel_of_every_second_row_is_asked() -> None:
    """Some 1,500 of any map: of 7,200 pixels 1,800."""
    rng = np.random.default_rng(8)
    for rows, enough in ((40, True), (38, False)):
        p = np.full((80, 90), np.nan)
        # Second differences reach 2 px to each side: they are at 8 of 12 columns, and 4 of these are asked.
        p[2 : 2 + rows, 20:32] = 30.0 + 0.7 * np.arange(12) + 0.01 * rng.standard_normal((rows, 12))
        assert (measure_bend([lit(p, np.full_like(p, np.nan))], 16) != STRAIGHT) == enough


def test_second_differences_beyond_a_sixteenth_of_a_period_are_edges() -> None:
    """Of spikes of less than half a pixel, the second difference there counts as noise; that of higher ones does not."""
    rng = np.random.default_rng(9)
    u = np.arange(40.0)
    for edge_px, counts in ((0.8, True), (1.3, False), (1.6, False)):
        p = 20.0 + 0.74 * u + rng.uniform(0.0, 16.0, (60, 1))
        p[:, 20] += 0.5 * edge_px * rng.choice([-1.0, 1.0], 60)
        found = measure_bend([lit(p, np.full(p.shape, np.nan))], 16)
        # It is the whole of a second difference once and half of one twice; two pixels apart, a row has 36.
        wanted = edge_px**2 * (1.0 * counts + 0.5) / (36.0 - (not counts)) / 6.0
        assert found.noise_px**2 == pytest.approx(wanted, rel=0.1)


def test_two_terms_of_three_and_four_tenths_have_an_rms_of_a_half_over_the_root_of_two() -> None:
    bend = PhaseBend((0.3, 0.0, -0.4, 0.0), 3.4)
    assert bend.rms_px == pytest.approx(0.5 / math.sqrt(2.0))
    assert bend.counts, "a tenth of the noise makes errors larger by half a percent"
    assert not PhaseBend(bend.terms_px, 3.6).counts


@pytest.mark.parametrize("order", range(4))
@pytest.mark.parametrize("period_px", [16, 64])
def test_what_is_taken_out_is_the_wave_itself_at_every_phase(order: int, period_px: int) -> None:
    terms_px = tuple(0.5 if k == order else 0.0 for k in range(4))
    p = np.linspace(-0.5, 200.0, 400).reshape(2, 200)
    q = p[::-1] + 3.3
    maps = lit(p, q, 1, 199)
    take_out(maps, PhaseBend(terms_px, 0.01), period_px)
    for found, before in ((maps.p_px, p), (maps.q_px, q)):
        wanted = before - wave(before, terms_px, period_px)
        wanted[:, [0, 199]] = before[:, [0, 199]]
        assert np.abs(found - wanted).max() < 3e-4


def test_the_variance_factor_of_a_small_bend_is_one_and_three_times_its_mean_square_slope() -> None:
    """(1 − s)³ has the mean 1 + 3 s² where s has the mean 0: s² is half of (k b 8π/P)² for each term."""
    for order in range(4):
        terms_px = tuple(0.05 / (k + 1) if k == order else 0.0 for k in range(4))
        slope = 8.0 * np.pi / 64 * 0.05
        assert PhaseBend(terms_px, 0.0).variance_factor(64) - 1.0 == pytest.approx(1.5 * slope**2, rel=1e-6)
