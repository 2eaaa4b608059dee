"""Clocks that wander do so as crystals do: by the root of the time at first, by their rate later, and the same again."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.clocks import STEP_S, Clocks, Wander


def test_a_random_walk_grows_with_the_root_of_the_time() -> None:
    clocks = Clocks(walk_us=2.0)
    for seconds in (1.0, 9.0):
        ahead_us = [Wander(clocks, (seed,)).ahead_ns(round(seconds * 1e9)) / 1000 for seed in range(200)]
        assert np.std(ahead_us) == pytest.approx(2.0 * seconds**0.5, rel=0.12)
        assert abs(np.mean(ahead_us)) < 4 * 2.0 * seconds**0.5 / 200**0.5


def test_a_clock_runs_on_without_jumps_and_the_same_way_again() -> None:
    clocks = Clocks(wander_ppm=2.0, walk_us=0.5)
    one, other = Wander(clocks, (5, 1)), Wander(clocks, (5, 1))
    late = one.ahead_ns(10**12)
    assert late == other.ahead_ns(10**12), "whoever asks early or late gets the same"
    times = np.arange(0, 3 * 10**9, 10**7)
    ahead = np.array([one.ahead_ns(int(t)) for t in times])
    np.testing.assert_array_equal(ahead, [other.ahead_ns(int(t)) for t in times[::-1]][::-1])
    assert ahead[0] == 0
    assert np.abs(np.diff(ahead)).max() < 6 * 0.5e3 * STEP_S**0.5
    assert Wander(Clocks(), (5, 1)).ahead_ns(10**12) == 0
