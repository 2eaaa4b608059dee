"""The world ``outside``: families are drawn independently of each other, from ranges with a source, or set by hand."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from hw_sim import workshop
from hw_sim.options import options_from
from hw_sim.outside import ALL, FAMILIES, Outside, draw_outside


@pytest.mark.parametrize("name", list(FAMILIES))
def test_switching_a_family_off_changes_no_other(name: str) -> None:
    everything = draw_outside(11, list(FAMILIES))
    assert draw_outside(11, [name]) == replace(Outside(), **{name: getattr(everything, name)})
    others = [other for other in FAMILIES if other != name]
    assert draw_outside(11, others) == replace(everything, **{name: None})
    assert draw_outside(11, [name]) == draw_outside(11, [name])
    assert draw_outside(11, [name]) != draw_outside(12, [name])


def numbers_of(value: object, place: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for name, part in value.items():
            yield from numbers_of(part, f"{place} {name}")
    elif isinstance(value, list | tuple):
        for number, part in enumerate(value):
            yield from numbers_of(part, f"{place} {number}")
    else:
        assert isinstance(value, int | float), place
        yield place, value


def test_a_seed_means_the_same_world_for_ever() -> None:
    """Published figures name seeds: a range that moves, or a draw in another order, would make them figures of another world."""
    written = json.loads(Path(__file__).with_name("world_of_seed_20221.json").read_text(encoding="utf-8"))
    drawn = {name: asdict(getattr(draw_outside(20221, [name]), name)) for name in FAMILIES}
    assert dict(numbers_of(drawn)) == pytest.approx(dict(numbers_of(written)), rel=1e-12)


def test_options_draw_the_set_and_take_strengths_by_hand() -> None:
    drawn = options_from({"outside": {"seed": 3}}).scene().outside
    assert drawn == draw_outside(3, ALL)
    assert options_from({"outside": {"seed": 3, "families": ["clocks"]}}).scene().outside == draw_outside(3, ["clocks"])
    by_hand = options_from({"outside": {"seed": 3, "clocks": {"walk_us": 7.0}}}).scene().outside
    assert drawn.clocks is not None
    assert by_hand == replace(drawn, clocks=replace(drawn.clocks, walk_us=7.0))
    alone = options_from({"outside": {"clocks": {"walk_us": 7.0}}}).scene().outside
    assert alone == Outside(clocks=FAMILIES["clocks"].kind(walk_us=7.0))


def test_the_page_says_which_ranges_are_estimates() -> None:
    tables = {name: sys.modules[family.kind.__module__].RANGES for name, family in FAMILIES.items()}
    tables["workshop"] = workshop.RANGES
    page = (Path(__file__).parents[2] / "docs/outside-world.md").read_text(encoding="utf-8")
    rows = [
        line.split("|")[1:-1] for line in page.partition("| family | from sources |")[2].splitlines()[2:] if "|" in line
    ]
    said = {cells[0].strip(" `"): [set(re.findall("`(.+?)`", cell)) for cell in cells[1:]] for cells in rows}
    for family, table in tables.items():
        marks = {name: r.source.partition(":")[0] for name, r in table.items()}
        estimated = {name for name, mark in marks.items() if mark == "estimate"}
        in_part = {name for name, mark in marks.items() if mark == "partly estimate"}
        assert said[family] == [marks.keys() - estimated - in_part, in_part, estimated], family
    assert said.keys() == tables.keys()
