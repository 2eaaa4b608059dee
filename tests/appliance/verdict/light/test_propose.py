"""A second exposure is proposed where it shows clearly more than any single one, and it serves what the first one loses."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.scan.exposure import NOMINAL, Exposure, Span, ladder
from appliance.verdict.light.propose import LEAST_COMMON, LEAST_GAINED, propose_second

STEPS = ladder(60.0, 500, 0.0, Span())
FULL_DN = 253.0
DEPTH = 0.45
"""Modulation over the brightest level."""
ENOUGH_DN = 5.0
"""What decoding asks for."""

Tones = dict[float, float]
"""Share of the lit pixels by their brightest level at 12 ms, in grey values."""


def light_of(tones: Tones, count: int = 10_000) -> tuple[np.ndarray[tuple[int], np.dtype[np.float32]], ...]:
    top = np.concatenate([np.full(round(share * count), level, np.float32) for level, share in tones.items()])
    return top, np.float32(DEPTH) * top


def second_to(tones: Tones, present: Exposure = NOMINAL) -> Exposure | None:
    top, modulation = light_of({level * present.light / 12_000.0: share for level, share in tones.items()})
    return propose_second([(top, modulation)] * 2, [FULL_DN] * 2, present, STEPS)


def shown(tones: Tones, *exposures: Exposure) -> float:
    """Share of the pixels that at least one of them shows."""
    factors = [one.light / 12_000.0 for one in exposures]
    seen = {level: any(ENOUGH_DN / DEPTH <= level * f < FULL_DN for f in factors) for level in tones}
    return sum(share for level, share in tones.items() if seen[level])


TOO_DARK: Tones = {200.0: 0.5, 60.0: 0.2, 5.0: 0.3}
TOO_BRIGHT: Tones = {800.0: 0.4, 100.0: 0.2, 20.0: 0.4}
MANY: Tones = {180.0: 0.2, 120.0: 0.2, 60.0: 0.1, 15.0: 0.2, 5.0: 0.3}


def test_what_is_too_dark_gets_a_longer_exposure_and_what_is_too_bright_a_shorter_one() -> None:
    darker, brighter = second_to(TOO_BRIGHT), second_to(TOO_DARK)
    assert darker is not None
    assert brighter is not None
    assert darker.light < 12_000 < brighter.light


@pytest.mark.parametrize("present", [Exposure(8_000), Exposure(12_000), Exposure(16_000)])
@pytest.mark.parametrize("tones", [TOO_DARK, TOO_BRIGHT, MANY, {250.0: 0.3, 90.0: 0.3, 12.0: 0.2, 4.0: 0.2}])
def test_the_pair_shows_clearly_more_than_any_single_exposure_and_no_other_pair_does_better(
    tones: Tones, present: Exposure
) -> None:
    second = second_to(tones, present)
    best_alone = max(shown(tones, one) for one in (present, *STEPS))
    with_common = [one for one in STEPS if shown_by_both(tones, present, one) >= LEAST_COMMON]
    best_pair = max((shown(tones, present, one) for one in with_common), default=0.0)
    if second is None:
        assert best_pair < best_alone + LEAST_GAINED or best_alone > 0.95
        return
    assert shown(tones, present, second) >= best_pair - 0.01
    assert shown(tones, present, second) >= best_alone + LEAST_GAINED


def shown_by_both(tones: Tones, first: Exposure, second: Exposure) -> float:
    return shown(tones, first) + shown(tones, second) - shown(tones, first, second)


def test_of_second_exposures_that_show_the_same_the_one_that_spoils_least_is_taken() -> None:
    second = second_to(MANY)
    assert second is not None
    as_good = [one for one in STEPS if shown(MANY, NOMINAL, one) >= shown(MANY, NOMINAL, second)]
    alone = [shown(MANY, one) for one in as_good]
    assert min(alone) < shown(MANY, second) == max(alone)


def test_one_exposure_that_serves_is_not_followed_by_a_second() -> None:
    assert second_to({200.0: 0.5, 20.0: 0.5}) is None
    assert second_to({600.0: 0.5, 80.0: 0.5}) is None, "a shorter one shows all of it: that is EXPOSE's"


def test_two_exposures_that_have_nothing_in_common_cannot_be_laid_against_each_other() -> None:
    assert second_to({250.0: 0.5, 3.0: 0.5}) is None
