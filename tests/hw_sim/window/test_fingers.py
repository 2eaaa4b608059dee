"""A person's presses keep their lengths and their order in a world that is slower than the person."""

from __future__ import annotations

import itertools

import pytest

from hw_sim.window.fingers import Fingers

Change = tuple[str, bool, float]
"""Key, whether it goes down, and when: seconds of real time."""


def play(changes: list[Change], speed: float) -> list[float]:
    """World times in s at which the changes happen, in a world that began with real time and has a ``speed``."""
    fingers = Fingers()
    return [fingers.at(key, down, int(s * 1e9), int(speed * s * 1e9)) / 1e9 for key, down, s in changes]


DOUBLE: list[Change] = [("back", True, 5.0), ("back", False, 5.08), ("back", True, 5.14), ("back", False, 5.30)]


@pytest.mark.parametrize("speed", [1.0, 0.6, 0.1])
def test_a_long_press_is_as_long_as_the_person_pressed(speed: float) -> None:
    down, up = play([("back", True, 5.0), ("back", False, 6.2)], speed)
    assert down == pytest.approx(5.0 * speed), "it begins at once"
    assert up - down == pytest.approx(1.2)


@pytest.mark.parametrize("speed", [1.0, 0.6, 0.1])
def test_quick_taps_stay_apart_and_in_order(speed: float) -> None:
    times = play(DOUBLE, speed)
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([0.08, 0.06, 0.16])


def test_nothing_happens_in_the_past() -> None:
    for speed in (1.0, 0.5):
        for (_, _, s), at_s in zip(DOUBLE, play(DOUBLE, speed), strict=True):
            assert at_s >= speed * s - 1e-9


def test_a_slow_world_does_not_fall_further_behind_with_each_press() -> None:
    presses = [(("scan", down, k + (0.0 if down else 0.1))) for k in range(1, 31) for down in (True, False)]
    times = play(presses, 0.5)
    late_s = [at - 0.5 * s for (_, down, s), at in zip(presses, times, strict=True) if down]
    assert max(late_s) < 0.1


def test_a_long_press_that_is_still_on_its_way_is_not_overtaken() -> None:
    times = play([("back", True, 1.0), ("back", False, 3.0), ("scan", True, 3.05), ("scan", False, 3.15)], 0.2)
    assert times == sorted(times)
    assert times[1] - times[0] == pytest.approx(2.0)
