"""The way through the scans on the disk, also while that changes under the diver's hands."""

from __future__ import annotations

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.gallery import may_move
from appliance.machine.states import Machine
from appliance.machine.step import step
from drivers.api import Key
from tests.appliance.machine.walks import after, aim, in_gallery, in_menu, run

UP, DOWN = on.KeyPressed(Key.UP), on.KeyPressed(Key.DOWN)


def looked_at(machine: Machine) -> str | None:
    assert machine.gallery is not None
    return machine.gallery.scan_id


def moves(machine: Machine) -> tuple[bool, bool]:
    return may_move(machine, Key.UP), may_move(machine, Key.DOWN)


def test_before_the_disk_has_told_there_is_nothing_to_look_at_and_nowhere_to_go() -> None:
    machine = run(aim(), DOWN)
    assert (looked_at(machine), moves(machine)) == (None, (False, False))
    assert after(machine, UP, DOWN) == (run(machine, UP, DOWN), [])


def test_from_the_newest_to_the_oldest_one_at_a_time() -> None:
    machine = in_gallery()
    assert (looked_at(machine), moves(machine)) == ("000003", (False, True))
    machine = run(machine, DOWN)
    assert (looked_at(machine), moves(machine)) == ("000002", (True, True))
    machine = run(machine, DOWN)
    assert (looked_at(machine), moves(machine)) == ("000001", (True, False))
    assert after(machine, DOWN)[1] == []
    assert looked_at(run(machine, UP)) == "000002"


def test_the_only_scan_has_no_neighbours() -> None:
    assert moves(run(aim(), DOWN, on.ScansListed(("000001",)))) == (False, False)


def test_a_scan_that_is_looked_at_stays_when_others_come_and_go() -> None:
    machine = run(in_gallery(), DOWN)
    machine, effects = after(machine, on.ScansListed(("000004", "000003", "000002")))
    assert (looked_at(machine), effects) == ("000002", [do.ShowGalleryScan("000002")])
    machine, effects = after(machine, on.ScansListed(("000004", "000003")))
    assert (looked_at(machine), effects) == ("000004", [do.ShowGalleryScan("000004")])
    machine, effects = after(machine, on.ScansListed(()))
    assert (looked_at(machine), effects) == (None, [])


def test_a_list_that_comes_after_the_gallery_was_left_changes_nothing() -> None:
    for machine in (aim(), in_menu(), run(in_gallery(), on.KeyPressed(Key.BACK))):
        assert step(machine, on.ScansListed(("000009",))) == (machine, ())
        assert moves(machine) == (False, False)
