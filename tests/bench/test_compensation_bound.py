"""The bound that the compensation is measured against holds for any method, the four sines alone included."""

from __future__ import annotations

import numpy as np
import pytest

from bench.verdict.compensation_bound import all_frames, four_sines, shrunk_steps


def test_no_method_can_do_better_than_the_bound_and_four_sines_alone_do_far_worse() -> None:
    still, along = shrunk_steps(0.0, 16), shrunk_steps(40.0, 16)
    assert four_sines(still) == pytest.approx(1.0)
    assert all_frames(still, 14) <= 1.0
    assert all_frames(along, 14) < 1.2 < 3.5 < four_sines(along)
    # Monte Carlo of the four sines' least squares.
    rng, phase = np.random.default_rng(7), 0.7
    A = np.stack([np.ones(4), np.cos(along), -np.sin(along)], -1)
    seen = 100.0 + 80.0 * np.cos(phase + along) + rng.normal(0.0, 0.02, (20_000, 4))
    _, c, s = np.linalg.lstsq(A, seen.T, rcond=None)[0]
    scatter = np.std(np.unwrap(np.arctan2(s, c)))
    cos, sin = np.cos(phase), np.sin(phase)
    N = np.linalg.inv(A.T @ A)[1:, 1:]
    assert scatter == pytest.approx(0.02 / 80.0 * np.sqrt(np.array([-sin, cos]) @ N @ np.array([-sin, cos])), rel=0.03)
