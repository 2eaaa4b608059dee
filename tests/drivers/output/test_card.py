"""What a card says about its connectors is read whole, also while something is being plugged in."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.output.card import Card
from tests.drivers.output.kernel import GetConnector, Kernel, Plug, mode

ASKED = 0xA7


class Changing(Kernel):
    """Its first connector changes at one of the questions about it."""

    def __init__(self, change: Callable[[Plug], None], at_question: int) -> None:
        super().__init__([Plug(1, 11, 1, [mode(128, 96)], properties={7: 1})])
        self._change, self._at, self._questions = change, at_question, 0

    def _connector(self, con: GetConnector) -> None:
        self._questions += 1
        if self._questions == self._at:
            self._change(self.plugs[1])
        super()._connector(con)


def more_modes(plug: Plug) -> None:
    plug.modes = [mode(128, 96), mode(64, 48), mode(32, 24)]


def more_properties(plug: Plug) -> None:
    plug.properties = {7: 1, 8: 2, 9: 3}


def nothing(plug: Plug) -> None:
    pass


@pytest.mark.parametrize(("change", "questions"), [(nothing, 2), (more_modes, 3), (more_properties, 3)])
def test_a_connector_that_grows_between_two_questions_is_asked_once_more(
    change: Callable[[Plug], None], questions: int
) -> None:
    kernel = Changing(change, 2)
    found = Card(kernel, kernel.time).connector(1)
    plug = kernel.plugs[1]
    assert [(one.width_px, one.height_px) for one in found.modes] == [(m.hdisplay, m.vdisplay) for m in plug.modes]
    assert found.properties == plug.properties
    assert kernel.calls.count(ASKED) == questions


def test_a_connector_that_never_stops_growing_is_given_up() -> None:
    kernel = Changing(nothing, 0)

    def grow(con: GetConnector) -> None:
        kernel.plugs[1].modes.append(mode(64, 48))
        Kernel._connector(kernel, con)

    kernel._connector = grow  # type: ignore[method-assign]
    with pytest.raises(OSError, match="connector 1 kept changing through 4 reads"):
        Card(kernel, kernel.time).connector(1)


@pytest.mark.parametrize(("probe", "room"), [(True, 0), (False, 1)])
def test_only_a_question_with_room_for_no_mode_makes_the_driver_look_at_the_wire(probe: bool, room: int) -> None:
    """Slow, so not done at every question; and no field says that there is room where there is none."""
    kernel = Changing(nothing, 0)
    asked: list[GetConnector] = []

    def note(con: GetConnector) -> None:
        asked.append(GetConnector.from_buffer_copy(con))
        Kernel._connector(kernel, con)

    kernel._connector = note  # type: ignore[method-assign]
    card = Card(kernel, kernel.time)
    assert card.connector(1, probe=probe).connected
    assert card.is_connected(1)
    first, whole, again = asked
    assert (first.modes, bool(first.modes_ptr)) == (room, room > 0)
    assert (again.modes, bool(again.modes_ptr)) == (1, True)
    for question in (first, again):
        assert (question.props, question.encoders) == (0, 0)
        assert (question.props_ptr, question.values_ptr, question.encoders_ptr) == (0, 0, 0)
    assert (whole.modes, whole.props, whole.encoders) == (1, 1, 1)
