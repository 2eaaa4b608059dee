"""The word that tells the diver to go closer or back."""

import itertools

import pytest

from appliance.optics.volume import STANDARD, WorkingVolume
from appliance.ranging.reach import Range, Reach, reach_of

SMALL = WorkingVolume(264.0, 300.0, 336.0)


def at(distance_mm: float) -> Range:
    return Range(distance_mm, None, 0.3, 1)


@pytest.mark.parametrize(
    ("volume", "distance_mm", "word"),
    [
        (STANDARD, 439.0, Reach.BACK),
        (STANDARD, 441.0, Reach.OK),
        (STANDARD, 559.0, Reach.OK),
        (STANDARD, 561.0, Reach.CLOSER),
        (SMALL, 250.0, Reach.BACK),
        (SMALL, 330.0, Reach.OK),
        (SMALL, 350.0, Reach.CLOSER),
    ],
)
def test_the_measuring_volume_is_60_mm_to_either_side_of_500_and_another_housings_its_own(
    volume: WorkingVolume, distance_mm: float, word: Reach
) -> None:
    assert reach_of(at(distance_mm), volume=volume) is word
    assert reach_of(None, word) is Reach.UNKNOWN, "without a dot no word is invented"


@pytest.mark.parametrize("limit_mm", [440.0, 560.0])
def test_hands_that_tremble_at_a_limit_do_not_make_the_word_flicker(limit_mm: float) -> None:
    word, words = reach_of(at(limit_mm - 20.0)), []
    for step in range(40):
        drift_mm, tremor_mm = step - 20.0, 2.0 * (-1) ** step
        word = reach_of(at(limit_mm + drift_mm + tremor_mm), word)
        words.append(word)
    assert sum(a is not b for a, b in itertools.pairwise(words)) == 1
