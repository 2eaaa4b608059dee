"""The word that tells the diver to go closer or back."""

import itertools

import pytest

from appliance.optics.volume import WorkingVolume
from appliance.ranging.reach import Range, Reach, reach_of


def at(distance_mm: float) -> Range:
    return Range(distance_mm, None, 0.3, 1)


@pytest.mark.parametrize(
    ("distance_mm", "word"),
    [(380.0, Reach.BACK), (439.0, Reach.BACK), (441.0, Reach.OK), (559.0, Reach.OK), (561.0, Reach.CLOSER)],
)
def test_the_measuring_volume_is_60_mm_to_either_side_of_500(distance_mm: float, word: Reach) -> None:
    assert reach_of(at(distance_mm)) is word


@pytest.mark.parametrize(
    ("distance_mm", "word"), [(250.0, Reach.BACK), (270.0, Reach.OK), (330.0, Reach.OK), (350.0, Reach.CLOSER)]
)
def test_another_housing_has_another_range(distance_mm: float, word: Reach) -> None:
    assert reach_of(at(distance_mm), volume=WorkingVolume(264.0, 300.0, 336.0)) is word


def test_without_a_dot_no_word_is_invented() -> None:
    assert reach_of(None, Reach.OK) is Reach.UNKNOWN


@pytest.mark.parametrize("limit_mm", [440.0, 560.0])
def test_hands_that_tremble_at_a_limit_do_not_make_the_word_flicker(limit_mm: float) -> None:
    word, words = reach_of(at(limit_mm - 20.0)), []
    for step in range(40):
        drift_mm, tremor_mm = step - 20.0, 2.0 * (-1) ** step
        word = reach_of(at(limit_mm + drift_mm + tremor_mm), word)
        words.append(word)
    assert sum(a is not b for a, b in itertools.pairwise(words)) == 1
