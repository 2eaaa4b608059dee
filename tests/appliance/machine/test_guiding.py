"""What the diver reads of the place that is aimed at, and how soon it is gone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.machine import events as on
from appliance.machine.guiding import GuidanceSaid, guidance_said
from appliance.machine.states import Machine, State
from appliance.machine.words import Language
from appliance.ranging.reach import Reach
from appliance.scan.guidance import LOST, Guidance
from appliance.scan.overlap import Overlap
from appliance.screens.texts import worded
from drivers.api import Key
from tests.appliance.machine.walks import WAYS, aim, run

SECOND_NS = 1_000_000_000
TAKEN_NS = 50 * SECOND_NS
LEFT = (-1.0, 0.0)


def aiming(object_number: int | None = 3) -> Machine:
    machine = run(aim(), on.Tick(TAKEN_NS))
    return replace(machine, choices=replace(machine.choices, object=object_number, objects=3))


def said(machine: Machine) -> str | None:
    found = guidance_said(machine)
    return None if found is None else found.whole


def parts(found: GuidanceSaid, language: Language = Language.ENGLISH) -> list[str]:
    return [worded(label, language) for label in (found.overlap, found.words) if label is not None]


@pytest.mark.parametrize(
    ("guidance", "words", "german"),
    [
        (Guidance(Overlap(0.238), LEFT), "OVERLAP 25 %: GO BACK", "ÜBERLAPP 25 % UMKEHREN"),
        (Guidance(Overlap(0.52)), "OVERLAP 50 %: SCAN NOW", "ÜBERLAPP 50 % SCANNEN"),
        (Guidance(Overlap(0.83), LEFT), "OVERLAP 85 %: GO ON", "ÜBERLAPP 85 % WEITER"),
        (LOST, "GO BACK", "UMKEHREN"),
    ],
)
def test_the_overlap_is_said_in_steps_with_the_move_and_its_arrow(guidance: Guidance, words: str, german: str) -> None:
    machine = run(aiming(), on.Guided(guidance, TAKEN_NS))
    found = guidance_said(machine)
    assert found is not None
    assert (said(machine), found.toward) == (words, guidance.toward)
    assert " ".join(parts(found, Language.GERMAN)) == german


@pytest.mark.parametrize("reach", [Reach.CLOSER, Reach.BACK])
def test_nobody_is_told_to_scan_where_the_distance_is_wrong(reach: Reach) -> None:
    machine = run(aiming(), on.Guided(Guidance(Overlap(0.5)), TAKEN_NS))
    assert said(replace(machine, reach=Reach.OK)) == "OVERLAP 50 %: SCAN NOW"
    outside = guidance_said(replace(machine, reach=reach))
    assert outside is not None
    assert (outside.words, outside.move, outside.toward) == (None, None, None), "the distance leads, without a colour"
    assert parts(outside) == ["OVERLAP 50 %"]


def test_what_is_older_than_a_second_and_a_half_is_not_said_any_more() -> None:
    machine = run(aiming(), on.Guided(LOST, TAKEN_NS), on.Tick(TAKEN_NS + 14 * SECOND_NS // 10))
    assert said(machine) == "GO BACK"
    assert said(run(machine, on.Tick(TAKEN_NS + 16 * SECOND_NS // 10))) is None
    late = run(aiming(), on.Tick(TAKEN_NS + 2 * SECOND_NS))
    assert said(run(late, on.Guided(LOST, TAKEN_NS))) is None, "the picture's age counts, not the answer's"


def test_a_picture_that_tells_nothing_leaves_the_one_before_to_its_age() -> None:
    machine = run(aiming(), on.Guided(LOST, TAKEN_NS), on.Guided(None, TAKEN_NS + SECOND_NS))
    assert said(machine) == "GO BACK"
    assert said(run(machine, on.Tick(TAKEN_NS + 16 * SECOND_NS // 10))) is None


def test_a_scan_that_begins_takes_it_away_for_good() -> None:
    machine = run(aiming(), on.Guided(LOST, TAKEN_NS), on.KeyPressed(Key.SCAN))
    assert machine.state is State.ARMED
    assert said(machine) is None
    assert said(run(machine, on.Guided(LOST, TAKEN_NS))) is None, "too late"


def test_without_an_object_and_in_the_menu_nothing_is_said() -> None:
    assert said(run(aiming(None), on.Guided(LOST, TAKEN_NS))) is None
    menu = run(aiming(), on.Guided(LOST, TAKEN_NS), on.KeyPressed(Key.UP))
    assert menu.state is State.MENU
    assert said(menu) is None


def test_guidance_leads_nowhere() -> None:
    for way in WAYS.values():
        before = way()
        assert run(before, on.Guided(LOST, before.now_ns)).state is before.state
