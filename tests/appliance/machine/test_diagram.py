"""The page of states says what the machine does."""

from __future__ import annotations

from appliance.machine.states import State
from tests.appliance.machine.diagram import PAGE, edges, page


def test_the_page_of_states_has_not_drifted() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), (
        "make it again: ./dev run python -m tests.appliance.machine.diagram"
    )


def test_every_state_but_the_end_can_be_left_and_all_but_the_start_entered() -> None:
    found = edges()
    assert {source for source, _ in found} == set(State) - {State.SHUTDOWN}
    assert {target for _, target in found} == set(State) - {State.BOOT}
