"""What the diver reads about how much of a scan the one before has seen, and for how long."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.machine import events as on
from appliance.machine.overlaps import overlap_said
from appliance.machine.states import Machine, State
from appliance.machine.words import english
from appliance.scan.overlap import NO_OVERLAP, UNKNOWN, Overlap
from drivers.api import Key
from tests.appliance.machine.walks import WAYS, aim, reviewing, run


def of_object(machine: Machine, number: int | None = 3) -> Machine:
    return replace(machine, choices=replace(machine.choices, object=number, objects=number or 0))


def said(machine: Machine) -> str | None:
    found = overlap_said(machine)
    return None if found is None else english(found.words)


@pytest.mark.parametrize(
    ("overlap", "words", "warns", "alone"),
    [
        (Overlap(0.623), "OVERLAP 62 %", False, "OVERLAP 62 %"),
        (Overlap(0.12), "OVERLAP 12 %", True, "OVERLAP 12 %"),
        (Overlap(0.05), "NO OVERLAP: GO BACK", True, None),
        (NO_OVERLAP, "NO OVERLAP: GO BACK", True, None),
        (UNKNOWN, "OVERLAP NOT SURE", False, None),
    ],
)
def test_the_overlap_is_said_in_words_and_a_lack_of_it_only_of_an_object(
    overlap: Overlap, words: str, warns: bool, alone: str | None
) -> None:
    machine = run(of_object(reviewing()), on.OverlapTold(1, overlap))
    found = overlap_said(machine)
    assert found is not None
    assert (english(found.words), found.warns) == (words, warns)
    assert said(run(of_object(reviewing(), None), on.OverlapTold(1, overlap))) == alone, (
        "scans of nothing in particular"
    )


def test_nothing_is_said_before_it_is_known_and_of_another_scan() -> None:
    machine = of_object(reviewing())
    assert said(machine) is None
    assert said(run(machine, on.OverlapTold(7, NO_OVERLAP))) is None


def test_who_keeps_a_scan_at_once_reads_it_while_aiming_until_the_next_scan() -> None:
    machine = run(of_object(reviewing()), on.KeyPressed(Key.SCAN), on.RawStored(1), on.Saved(1, "000001"))
    assert machine.state is State.AIM
    machine = run(machine, on.OverlapTold(1, NO_OVERLAP))
    assert said(machine) == "NO OVERLAP: GO BACK"
    armed = run(machine, on.KeyPressed(Key.SCAN))
    assert armed.state is State.ARMED
    assert said(armed) is None
    assert said(run(armed, on.OverlapTold(1, Overlap(0.5)))) is None, "too late"


def test_a_scan_that_is_rejected_leaves_nothing_to_read() -> None:
    machine = run(of_object(reviewing()), on.OverlapTold(1, NO_OVERLAP), on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK))
    assert machine.state is State.AIM
    assert said(machine) is None
    assert said(run(machine, on.OverlapTold(1, NO_OVERLAP))) is None


def test_another_object_begins_without_what_was_said_of_the_last() -> None:
    kept = run(
        of_object(reviewing()), on.ObjectsCounted(3), on.KeyPressed(Key.SCAN), on.RawStored(1), on.Saved(1, "000001")
    )
    machine = run(kept, on.OverlapTold(1, Overlap(0.1)))
    assert said(machine) == "OVERLAP 10 %"
    to_object = (Key.UP, *(Key.DOWN,) * 4, Key.SCAN, Key.UP, Key.SCAN)
    machine = run(machine, *(on.KeyPressed(key) for key in to_object))
    assert machine.choices.object == 4
    assert said(machine) is None


def test_an_overlap_leads_nowhere() -> None:
    for way in WAYS.values():
        before = way()
        after = run(before, on.OverlapTold(before.captures, NO_OVERLAP))
        assert after.state is before.state
    assert run(aim(), on.OverlapTold(0, NO_OVERLAP)).overlap is None
