"""What the projector's response bends coordinates by is found as by plain least squares, taken out, and believed up to written limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.points.straighten import STRAIGHT, PhaseBend, measure_bend, take_out
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


def by_numpy(p: Floats, apart: int) -> tuple[Floats, Floats]:
    """Least squares of all second differences of rows, period 16 px: terms and their standard errors."""
    before, here, after = p[:, : -2 * apart], p[:, apart:-apart], p[:, 2 * apart :]
    unit = [tuple(float(j == k) for j in range(4)) for k in range(4)]
    R = np.stack(
        [(wave(before, one, 16) - 2.0 * wave(here, one, 16) + wave(after, one, 16)).ravel() for one in unit], 1
    )
    y = (before - 2.0 * here + after).ravel()
    inverse = np.linalg.inv(R.T @ R)
    terms = inverse @ R.T @ y
    return terms, np.sqrt(np.diag(inverse) * float(np.sum((y - R @ terms) ** 2)) / (len(y) - 4))


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
def test_a_bend_is_taken_out_and_where_none_is_none_is_found(
    period_px: int, slope: float, terms_px: tuple[float, ...]
) -> None:
    true = surface((100, 130), slope, 0.03 * period_px / 16)
    p, q = (bent(one, terms_px, period_px) for one in true)
    maps = lit(p, q, 1, 129)
    found = measure_bend([maps], period_px)
    assert found.counts == any(terms_px)
    if found.counts:
        assert np.abs(np.array(found.terms_px) - np.array(terms_px)).max() < 0.012 * period_px / 16
        take_out(maps, found, period_px)
        for after, before, exact in zip(maps[:2], (p, q), true, strict=True):
            assert rms((after - exact)[:, 1:129]) < 0.15 * rms(before - exact)
            np.testing.assert_array_equal(after[:, [0, 129]], before[:, [0, 129]].astype(np.float32), "it is not lit")


@pytest.mark.parametrize("times", [4.5, 5.5])
def test_a_term_is_believed_from_five_standard_errors_on(times: float) -> None:
    v, u = np.mgrid[0:40, 0:40].astype(np.float64)
    p = 31.0 + 0.37 * u + 0.11 * v + 0.02 * np.random.default_rng(3).standard_normal(u.shape)
    by_chance, error = by_numpy(p, 4)
    p = bent(p, (times * float(error[0]) - float(by_chance[0]), 0.0, 0.0, 0.0), 16)
    terms, error = by_numpy(p, 4)
    assert terms[0] / error[0] == pytest.approx(times, abs=0.3)
    found = measure_bend([lit(p, np.full(p.shape, np.nan))], 16)
    assert found.terms_px == (pytest.approx(terms[0], rel=0.01) if times > 5.0 else 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("period_px", "slope", "apart", "down"),
    [(16, 0.35, 4, False), (16, 4.0, 1, True), (64, 0.7, 8, True), (16, 0.02, 16, False)],
)
def test_eighty_differences_are_enough_over_a_third_of_a_turn(
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


def test_a_bend_counts_by_its_rms_from_a_tenth_of_the_noise_on_and_costs_noise_by_its_slope() -> None:
    """(1 − s)³ has the mean 1 + 3 s² where s has the mean 0: s² is half of (k b 8π/P)² for each term."""
    bend = PhaseBend((0.3, 0.0, -0.4, 0.0), 3.4)
    assert bend.rms_px == pytest.approx(0.5 / math.sqrt(2.0))
    assert bend.counts, "errors are larger by half a percent"
    assert not PhaseBend(bend.terms_px, 3.6).counts
    for order in range(4):
        small = PhaseBend(tuple(0.05 / (k + 1) * (k == order) for k in range(4)), 0.0)
        assert small.variance_factor(64) - 1.0 == pytest.approx(1.5 * (np.pi / 8 * 0.05) ** 2, rel=1e-6)
