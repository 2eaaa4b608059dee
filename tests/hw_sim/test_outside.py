"""The world ``outside``: families are drawn independently of each other, from ranges with a source, or set by hand."""

from __future__ import annotations

from dataclasses import asdict, fields, replace

import pytest

from hw_sim.options import OptionError, options_from
from hw_sim.outside import ALL, FAMILIES, Outside, draw_outside
from hw_sim.ranges import Range
from hw_sim.scene import Scene


def test_the_ordinary_world_has_none_of_it() -> None:
    assert Scene().outside == Outside()
    assert options_from({}).scene().outside == Outside()
    assert all(getattr(Outside(), f.name) is None for f in fields(Outside))


def test_every_family_is_a_field_of_the_value_and_has_a_generator_of_its_own() -> None:
    assert set(FAMILIES) == {f.name for f in fields(Outside)}
    numbers = [family.number for family in FAMILIES.values()]
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize("name", list(FAMILIES))
def test_switching_a_family_off_changes_no_other(name: str) -> None:
    everything = draw_outside(11, list(FAMILIES))
    assert draw_outside(11, [name]) == replace(Outside(), **{name: getattr(everything, name)})
    others = [other for other in FAMILIES if other != name]
    assert draw_outside(11, others) == replace(everything, **{name: None})
    assert draw_outside(11, [name]) == draw_outside(11, [name])
    assert draw_outside(11, [name]) != draw_outside(12, [name])


@pytest.mark.parametrize("name", list(FAMILIES))
def test_a_strength_that_is_not_given_is_none_of_it(name: str) -> None:
    drawn = asdict(getattr(draw_outside(1, [name]), name))
    neutral = asdict(FAMILIES[name].kind())
    assert drawn != neutral
    assert options_from({"outside": {name: {}}}).scene().outside == replace(Outside(), **{name: FAMILIES[name].kind()})


def test_options_draw_the_set_and_take_strengths_by_hand() -> None:
    drawn = options_from({"outside": {"seed": 3}}).scene().outside
    assert drawn == draw_outside(3, ALL)
    assert options_from({"outside": {"seed": 3, "families": ["clocks"]}}).scene().outside == draw_outside(3, ["clocks"])
    by_hand = options_from({"outside": {"seed": 3, "clocks": {"walk_us": 7.0}}}).scene().outside
    assert drawn.clocks is not None
    assert by_hand == replace(drawn, clocks=replace(drawn.clocks, walk_us=7.0))
    alone = options_from({"outside": {"clocks": {"walk_us": 7.0}}}).scene().outside
    assert alone == Outside(clocks=FAMILIES["clocks"].kind(walk_us=7.0))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"sed": 3}, "outside: unknown 'sed'; did you mean 'seed'?"),
        ({"seed": 3, "families": ["clock"]}, "outside: family 'clock'; allowed are .*clocks"),
        ({"families": ["clocks"]}, "families without a seed; add seed = 1"),
        ({"seed": -1}, "seed = -1; allowed are whole numbers from 0"),
        ({"seed": 1, "families": "clocks"}, "families = 'clocks'; give a list"),
        ({"clocks": {"walk": 1.0}}, "outside clocks: unknown 'walk'"),
        ({"clocks": {"walk_us": -1.0}}, "clocks: walk_us = -1.0; allowed are 0..1000"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(table: dict[str, object], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        options_from({"outside": table}).scene()


def test_a_range_without_a_source_or_the_wrong_way_round_is_refused() -> None:
    with pytest.raises(ValueError, match="no source"):
        Range(0.0, 1.0, " ")
    with pytest.raises(ValueError, match="the lower end comes first"):
        Range(1.0, 0.0, "somebody")
