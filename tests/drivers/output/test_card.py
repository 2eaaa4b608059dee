"""A card's calls: what it says is read whole while something is plugged in, and nothing is waited for or kept in vain."""

from __future__ import annotations

import errno
from typing import Any

import pytest

from drivers.output.card import Card
from tests.drivers.output.kernel import GetConnector, Kernel, Plug, VblankEvent, mode, plugged, refusing

ASKED = 0xA7


def one_plug(**more: Any) -> Kernel:
    return plugged(Plug(1, 11, 1, [mode(128, 96)], properties={7: 1}), **more)


GROWN: dict[str, Any] = {"modes": [mode(128, 96), mode(64, 48), mode(32, 24)], "properties": {7: 1, 8: 2, 9: 3}}


@pytest.mark.parametrize(("grows", "questions"), [(None, 2), ("modes", 3), ("properties", 3)])
def test_a_connector_that_grows_between_two_questions_is_asked_once_more_and_not_for_ever(
    grows: str | None, questions: int
) -> None:
    kernel = one_plug()
    plug = kernel.plugs[1]

    def at_the_second_question(_: bytearray) -> None:
        if grows is not None and kernel.calls.count(ASKED) == 2:
            setattr(plug, grows, GROWN[grows])

    kernel.before[ASKED] = at_the_second_question
    found = Card(kernel, kernel.time).connector(1)
    assert [(one.width_px, one.height_px) for one in found.modes] == [(m.hdisplay, m.vdisplay) for m in plug.modes]
    assert found.properties == plug.properties
    assert kernel.calls.count(ASKED) == questions
    kernel.before[ASKED] = lambda _: plug.modes.append(mode(64, 48))
    with pytest.raises(OSError, match="connector 1 kept changing through 4 reads"):
        Card(kernel, kernel.time).connector(1)


@pytest.mark.parametrize(("probe", "room"), [(True, 0), (False, 1)])
def test_only_a_question_with_room_for_no_mode_makes_the_driver_look_at_the_wire(probe: bool, room: int) -> None:
    """Slow, so not done at every question; and no field says that there is room where there is none."""
    asked: list[Any] = []
    kernel = one_plug(before={ASKED: lambda buffer: asked.append(GetConnector.from_buffer_copy(buffer))})
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


@pytest.mark.parametrize(("reason", "tries"), [(errno.EINTR, 16), (errno.EAGAIN, 16), (errno.EINVAL, 1)])
def test_a_call_that_a_signal_broke_off_is_made_again_up_to_sixteen_times(reason: int, tries: int) -> None:
    kernel = one_plug(before={0x0C: refusing(reason, tries - 1)})
    assert Card(kernel, kernel.time).capability(6) == 1
    kernel = one_plug(before={0x0C: refusing(reason, tries)})
    with pytest.raises(OSError, match="it cannot be done"):
        Card(kernel, kernel.time).capability(6)
    assert len(kernel.calls) == tries


@pytest.mark.parametrize("times", [0, 1, 2, 7, 8])
def test_lists_that_grow_while_they_are_read_are_read_again_up_to_four_times(times: int) -> None:
    kernel = plugged(Plug(1, 11, 1), crtc_ids=[40, 50, 60])

    def one_more(_: bytearray) -> None:
        if len(kernel.calls) <= times:
            number = len(kernel.plugs) + 1
            kernel.plugs[number] = Plug(number, 11, number)

    kernel.before[0xA0] = one_more
    card = Card(kernel, kernel.time)
    if times == 8:
        with pytest.raises(OSError, match="4 reads") as error:
            card.scan()
        assert error.value.errno == errno.EAGAIN
        return
    card.scan()
    assert card.crtcs == tuple(kernel.crtc_ids)
    assert [one.name for one in card.connectors()] == [f"HDMI-A-{k}" for k in range(1, len(kernel.plugs) + 1)]
    assert len(kernel.calls) - len(kernel.plugs) * 2 == 2 * (1 + times // 2), "two questions a try"


def flipping() -> tuple[Kernel, Card, int]:
    """A card, and a flip that was submitted on it."""
    kernel = one_plug()
    card = Card(kernel, kernel.time)
    card.scan()
    buffer = card.create_buffer(128, 96)
    card.light(40, 1, card.connector(1).modes[0], buffer)
    return kernel, card, card.submit_flip(40, buffer)


@pytest.mark.parametrize("others", [False, True])
@pytest.mark.parametrize("timeout_s", [0.0, 1.0])
def test_a_flip_is_waited_for_as_long_as_was_said_whatever_else_is_reported(timeout_s: float, others: bool) -> None:
    """Reports of flips that nobody awaits come at every blank, as they do after a head was closed and opened again."""
    kernel, card, token = flipping()
    kernel.mute = True

    def report_another(kernel: Kernel) -> None:
        if others:
            kernel.events += bytes(VblankEvent(2, 32, 12345, 1, 2, 3, 40))

    kernel.on_blank = report_another
    begun_ns = kernel.time.ns
    assert card.wait_flip(token, timeout_s) is None
    waited_s = (kernel.time.ns - begun_ns) * 1e-9
    assert timeout_s - 0.001 <= waited_s <= timeout_s + 0.001
    assert card._arrived == {}, "and what nobody awaits is not kept"


def test_a_flip_that_comes_after_its_time_can_still_be_waited_for() -> None:
    kernel, card, token = flipping()
    kernel.mute = True
    assert card.wait_flip(token, 0.1) is None
    kernel.mute = False
    done = card.wait_flip(token, 0.1)
    assert done is not None
    assert (done.token, done.raw_sequence) == (token, kernel.blank)
    assert (card._awaited, card._arrived) == (set(), {})

    token = card.submit_flip(40, card.create_buffer(128, 96))
    assert kernel.wait_readable(1.0)
    now_ns = kernel.time.ns
    assert card.wait_flip(token, 0.0) is not None
    assert kernel.time.ns == now_ns, "a report that lies there is found without waiting"


def test_of_a_flip_that_was_refused_or_forgotten_no_report_is_kept() -> None:
    kernel, card, token = flipping()
    buffer = card.create_buffer(128, 96)
    kernel.busy = 1
    with pytest.raises(OSError, match="busy"):
        card.submit_flip(40, buffer)
    assert card._awaited == {token}
    card.forget_flip(token)
    other = card.submit_flip(50, buffer)
    assert card.wait_flip(other, 1.0) is not None
    assert (card._awaited, card._arrived) == (set(), {})
    card.forget_flip(other)  # once more harms nobody

    token = card.submit_flip(40, buffer)
    assert card.wait_flip(card.submit_flip(50, buffer), 1.0) is not None
    assert set(card._arrived) == {token}, "for another thread"
    card.forget_flip(token)
    assert (card._awaited, card._arrived) == (set(), {})


@pytest.mark.parametrize("without", [0xB3, 0xAE], ids=["addresses", "formats"])
def test_a_buffer_that_cannot_be_mapped_or_scanned_out_is_given_back(without: int) -> None:
    kernel = one_plug(before={without: refusing()})
    with pytest.raises(OSError, match="it cannot be done"):
        Card(kernel, kernel.time).create_buffer(128, 96)
    assert (kernel.dumb, kernel.fbs) == ({}, {}), "neither its memory nor its name for scan-out"
