"""Projector and display on a card: what lights the scene, when, and what is said when it cannot."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.api import CardGone, DeviceGone, DeviceRefused, Flip
from drivers.output.display import PictureDisplay
from drivers.output.outputs import Outputs, open_outputs
from drivers.output.projector import PatternProjector
from drivers.output.spec import OutputKind, OutputSpec
from tests.drivers.output.kernel import Kernel, KernelWires, Plug, mode

CARD = "/dev/dri/card0"
PROJECTOR = OutputSpec(OutputKind.KMS, CARD, "HDMI-A-1", 128, 96, 60.0)
DISPLAY = OutputSpec(OutputKind.KMS, CARD, "DP-1", 80, 48, 60.0)
PROJECTOR_CRTC, DISPLAY_CRTC = 40, 50


def two_heads(**changes: object) -> Kernel:
    hdmi = Plug(1, 11, 1, [mode(1920, 1080), mode(128, 96), mode(128, 96, 75.0)])
    dp = Plug(2, 10, 1, [mode(80, 48)])
    kernel = Kernel([hdmi, dp])
    for name, value in changes.items():
        setattr(kernel, name, value)
    return kernel


@contextmanager
def opened(kernel: Kernel) -> Iterator[tuple[PatternProjector[Any], PictureDisplay[Any]]]:
    with Outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as outputs:  # type: ignore[arg-type]
        yield outputs.open_projector(), outputs.open_display()


def frames(number: int) -> list[np.ndarray]:
    """Frames whose code is their number + 1."""
    return [np.full((96, 128), index + 1, np.uint8) for index in range(number)]


def blank_of(flip: Flip) -> int:
    """The number of the vertical blank at which the frame appeared."""
    assert flip.sequence is not None
    return flip.sequence


def from_blank(ahead: int) -> Callable[[Flip], int | None]:
    def start(flip: Flip) -> int | None:
        return blank_of(flip) + ahead

    return start


def never() -> bool:
    return False


# ----------------------------------------------------------------------------------------- light


def test_both_heads_light_up_black_on_different_crtcs() -> None:
    kernel = two_heads()
    with open_outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as (projector, display):  # type: ignore[arg-type]
        assert (projector.size_px, display.size_px) == ((128, 96), (80, 48))
        assert kernel.picture(PROJECTOR_CRTC).shape == (96, 128, 4)
        assert kernel.picture(DISPLAY_CRTC).shape == (48, 80, 4)
        assert not kernel.picture(PROJECTOR_CRTC)[:, :, :3].any()
        assert not kernel.picture(DISPLAY_CRTC)[:, :, :3].any()


def test_a_frame_is_green_light_only() -> None:
    kernel = two_heads()
    rng = np.random.default_rng(3)
    pattern = rng.integers(0, 256, (96, 128), dtype=np.uint8)
    with opened(kernel) as (projector, _):
        projector.load([pattern])
        flip = projector.show(0)
        lit = kernel.picture(PROJECTOR_CRTC)
    np.testing.assert_array_equal(lit[:, :, 1], pattern)
    assert not lit[:, :, [0, 2]].any()
    assert (flip.index, flip.sequence) == (0, kernel.blank)
    assert abs(flip.time_ns - kernel.time.ns) < 2000  # the kernel reports µs


def test_a_presented_picture_has_its_colours_in_place_whatever_the_pitch() -> None:
    kernel = two_heads(pitch_align=1000)
    picture = np.random.default_rng(4).integers(0, 256, (48, 80, 3), dtype=np.uint8)
    with opened(kernel) as (_, display):
        flip = display.present(picture, 0.5)
        np.testing.assert_array_equal(kernel.picture(DISPLAY_CRTC)[:, :, 2::-1], picture)
    assert flip.index == -1


def test_the_picture_on_the_screen_is_not_touched_while_the_next_is_copied() -> None:
    kernel = two_heads()
    with opened(kernel) as (_, display):
        display.present(np.full((48, 80, 3), 10, np.uint8), 0.5)
        shown_before_flip: list[int] = []
        kernel.on_blank = lambda k: shown_before_flip.append(int(k.picture(DISPLAY_CRTC)[0, 0, 0]))
        display.present(np.full((48, 80, 3), 20, np.uint8), 0.5)
        display.present(np.full((48, 80, 3), 30, np.uint8), 0.5)
    assert shown_before_flip[:2] == [10, 20]


def test_loading_shows_black_so_that_no_frame_changes_while_it_is_lit() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(2))
        projector.show(1)
        projector.load(frames(1))
        assert not kernel.picture(PROJECTOR_CRTC)[:, :, 1].any()
        with pytest.raises(IndexError, match="projector frame 1; 1 are loaded"):
            projector.show(1)


@pytest.mark.parametrize("bad", [np.zeros((128, 96), np.uint8), np.zeros((96, 128), np.uint16)])
def test_a_frame_that_does_not_fit_is_named(bad: np.ndarray) -> None:
    with (
        opened(two_heads()) as (projector, _),
        pytest.raises(ValueError, match=r"projector frame 1 is .*; it must be \(96, 128\) uint8"),
    ):
        projector.load([frames(1)[0], bad])


def test_closing_darkens_and_gives_everything_back() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, display):
        projector.load(frames(5))
        display.present(np.zeros((48, 80, 3), np.uint8), 0.5)
    assert kernel.lit == {}
    assert kernel.fbs == {}
    assert kernel.dumb == {}
    assert kernel.closed


# ---------------------------------------------------------------------------------------- playing


def test_every_frame_is_lit_for_exactly_one_blank_from_the_agreed_one_on() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(6))
        lit: dict[int, int] = {}
        kernel.on_blank = lambda k: lit.update({k.blank - 1: int(k.picture(PROJECTOR_CRTC)[0, 0, 1])})
        flips = projector.play([2, 3, 4], 0, from_blank(5), never)
        first = blank_of(flips[0])
        projector.show(0)
    assert [flip.index for flip in flips] == [2, 3, 4]
    assert [flip.sequence for flip in flips] == [first, first + 1, first + 2]
    assert [lit[first + k] for k in range(-1, 4)] == [1, 3, 4, 5, 1]


def test_a_missed_blank_is_in_the_flips_and_ends_the_play() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(6))
        idle_flips = 1 + 3 - 1  # the flip that start sees, and those until the agreed blank
        kernel.late[kernel.flips + idle_flips + 2] = 1
        flips = projector.play([1, 2, 3, 4, 5], 0, from_blank(3), never)
        assert int(kernel.picture(PROJECTOR_CRTC)[0, 0, 1]) == 1
    steps = np.diff([flip.sequence for flip in flips])
    assert [flip.index for flip in flips] == [1, 2, 3]
    assert list(steps) == [1, 2]


@pytest.mark.parametrize(("ahead", "late_blanks"), [(0, 0), (3, 6)])
def test_a_start_that_is_past_or_missed_is_one_late_flip(ahead: int, late_blanks: int) -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(3))
        kernel.late[kernel.flips + 1] = late_blanks
        agreed: list[int] = []

        def start(flip: Flip) -> int:
            agreed.append(blank_of(flip) + ahead)
            return agreed[0]

        flips = projector.play([1, 2], 0, start, never)
    assert [flip.index for flip in flips] == [1]
    assert blank_of(flips[0]) > agreed[0]


def test_an_abort_ends_within_one_blank_on_idle() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(6))
        asked = iter([False] * 4 + [True] * 100)
        flips = projector.play([1, 2, 3, 4, 5], 0, from_blank(3), lambda: next(asked))
        assert [flip.index for flip in flips] == [1, 2]
        assert int(kernel.picture(PROJECTOR_CRTC)[0, 0, 1]) == 1


def test_a_start_that_fails_leaves_idle_on_the_screen() -> None:
    kernel = two_heads()

    def start(flip: Flip) -> int:
        raise DeviceGone("board", "silent", "Check it")

    with opened(kernel) as (projector, _):
        projector.load(frames(3))
        projector.show(2)
        with pytest.raises(DeviceGone, match="board"):
            projector.play([1], 0, start, never)
        assert int(kernel.picture(PROJECTOR_CRTC)[0, 0, 1]) == 1


# -------------------------------------------------------------------------- hardware that is less


def test_without_a_blank_counter_the_sequence_is_unknown_and_time_stamps_tell_lateness() -> None:
    kernel = two_heads(counts_blanks=False)
    with opened(kernel) as (projector, _):
        projector.load(frames(6))
        asked: list[Flip] = []
        flips = projector.play([1, 2, 3], 0, asked.append, never)
        assert asked[0].sequence is None
        assert [flip.sequence for flip in flips] == [None, None, None]
        steps = np.diff([flip.time_ns for flip in flips])
        assert np.allclose(steps, kernel.PERIOD_NS, atol=2000)

        kernel.late[kernel.flips + 3 + 1] = 1  # three flips to learn that nothing counts
        assert [flip.index for flip in projector.play([1, 2, 3], 0, asked.append, never)] == [1, 2]


def test_a_card_that_does_not_throttle_still_plays_one_frame_per_period() -> None:
    kernel = two_heads(counts_blanks=False, throttles=False)
    with opened(kernel) as (projector, _):
        projector.load(frames(8))
        flips = projector.play([1, 2, 3, 4, 5, 6, 7], 0, lambda flip: None, never)
        assert projector.health().details["flips"] == "not throttled by the hardware"
    steps_ms = np.diff([flip.time_ns for flip in flips]) / 1e6
    assert len(flips) == 7
    assert np.allclose(steps_ms, 16.7, atol=0.5)


def test_busy_is_waited_out_but_not_for_ever() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(1))
        kernel.busy = 3
        assert projector.show(0).index == 0
        kernel.busy = 1000
        begun_ns = kernel.time.ns
        with pytest.raises(DeviceRefused, match="busy with an earlier flip after 20 tries"):
            projector.show(0)
        assert (kernel.time.ns - begun_ns) * 1e-9 == pytest.approx(0.019), "a pause of 1 ms between two tries"
        kernel.busy = 0


def test_a_flip_that_timed_out_is_awaited_before_the_next() -> None:
    kernel = two_heads()
    picture = np.full((48, 80, 3), 9, np.uint8)
    with opened(kernel) as (_, display):
        kernel.mute = True
        with pytest.raises(DeviceGone, match=r"no vertical blank within 0.1 s on DP-1"):
            display.present(picture, 0.1)
        kernel.mute = False
        before = kernel.calls.count(0xB0)
        display.present(picture, 0.5)
        assert kernel.calls.count(0xB0) == before + 1  # and was not refused as busy
        assert kernel.picture(DISPLAY_CRTC)[0, 0, 0] == 9


def test_a_pulled_cable_is_gone_and_says_which() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, display):
        projector.load(frames(2))
        kernel.plugs[1].connected = False
        with pytest.raises(DeviceGone, match="projector: HDMI-A-1 was unplugged"):
            projector.play([1], 0, from_blank(3), never)
        display.present(np.zeros((48, 80, 3), np.uint8), 0.5)  # the other one goes on


def test_a_pulled_cable_is_noticed_while_presenting() -> None:
    kernel = two_heads()
    with opened(kernel) as (_, display):
        kernel.plugs[2].connected = False

        def present_for_1500_ms() -> None:
            for _ in range(90):
                display.present(np.zeros((48, 80, 3), np.uint8), 0.5)

        begun = kernel.flips
        with pytest.raises(DeviceGone, match="display: DP-1 was unplugged"):
            present_for_1500_ms()
        assert kernel.flips - begun <= 60, "within a second"


def test_a_pulled_card_is_gone_and_closing_does_not_fail() -> None:
    kernel = two_heads()
    with opened(kernel) as (_, display):
        kernel.pulled = True
        with pytest.raises(DeviceGone, match="No such device"):
            display.present(np.zeros((48, 80, 3), np.uint8), 0.5)
    assert kernel.closed


# ---------------------------------------------------------------------------------------- opening


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"master": False}, "Another program owns the screens"),
        ({"dumb_buffers": 0}, "the card has no dumb buffers"),
        ({"monotonic": 0}, "monotonic"),
    ],
)
def test_a_card_that_cannot_serve_is_refused_with_the_reason(changes: dict[str, object], said: str) -> None:
    kernel = two_heads(**changes)
    with pytest.raises(DeviceRefused, match=said), opened(kernel):
        pass
    assert kernel.dumb == {}


def test_full_range_and_linear_gamma_are_set_where_the_driver_lets_us() -> None:
    kernel = two_heads()
    kernel.properties = {
        7: ("Broadcast RGB", 8, {"Automatic": 0, "Full": 1, "Limited 16:235": 2}),
        8: ("EDID", 16, {}),
        9: ("dithering mode", 8, {"auto": 0, "off": 4}),
    }
    kernel.properties[10] = ("underscan", 8, {"on": 1})  # has not what is wanted: left as it is
    kernel.plugs[1].properties = {7: 0, 8: 55, 9: 4, 10: 1}
    with opened(kernel) as (projector, _):
        assert kernel.plugs[1].properties == {7: 1, 8: 55, 9: 4, 10: 1}
        assert kernel.calls.count(0xAB) == 1  # what is right already is left alone
        ramp = kernel.gamma[PROJECTOR_CRTC]
        assert (ramp[0], ramp[128], ramp[255]) == (0, 128 * 257, 65535)
        assert projector.health().details == {"Broadcast RGB": "Full", "dithering mode": "off", "gamma": "linear"}


class Stubborn(Kernel):
    def _set_property(self, prop: Any) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")


class Fixed(Kernel):
    def _set_gamma(self, lut: Any) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")


@pytest.mark.parametrize(
    ("make", "details"),
    [
        (Stubborn, {"property 7": "refused (Invalid argument)", "gamma": "linear"}),
        (Fixed, {"Broadcast RGB": "Full", "gamma": "unknown (Function not implemented)"}),
    ],
)
def test_an_output_whose_driver_refuses_property_or_gamma_is_an_output_and_says_so(
    make: type[Kernel], details: dict[str, str]
) -> None:
    kernel = make([*two_heads().plugs.values()])
    kernel.properties = {7: ("Broadcast RGB", 8, {"Automatic": 0, "Full": 1})}
    kernel.plugs[1].properties = {7: 0}
    with opened(kernel) as (projector, _):
        assert projector.health().details == details


@pytest.mark.parametrize("missing", [{"card": None}, {"connector": None}], ids=["card", "connector"])
def test_a_screen_without_card_or_connector_is_refused_with_what_to_set(missing: dict[str, None]) -> None:
    wires = KernelWires({CARD: [two_heads()]})
    with Outputs(replace(PROJECTOR, **missing), DISPLAY, wires) as outputs:  # type: ignore[arg-type]
        with pytest.raises(DeviceRefused, match="projector: kind kms needs card and connector") as refused:
            outputs.open_projector()
        assert "Set both under [projector]" in str(refused.value)
    assert wires.opened == []


def test_who_asks_in_vain_which_crtc_can_drive_an_output_is_named() -> None:
    """The other output's connector is asked as well; what fails is the opening of this one."""

    class Broken(Kernel):
        def _encoder(self, enc: Any) -> None:
            raise OSError(errno.EINVAL, "Invalid argument")

    kernel = Broken([*two_heads().plugs.values()])
    with (
        Outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as outputs,  # type: ignore[arg-type]
        pytest.raises(DeviceRefused, match=r"^display: asking which CRTC can drive HDMI-A-1 failed"),
    ):
        outputs.open_display()


def test_a_card_that_is_gone_at_the_very_first_opening_is_opened_once_more() -> None:
    """Nothing is lit on it and no node is kept of it yet."""

    class Late(KernelWires):
        def open_card(self, path: str) -> Kernel:
            if not self.opened:
                self.opened.append(path)
                raise CardGone(path, "is gone", "Restart the instrument")
            return super().open_card(path)

    wires = Late({CARD: [two_heads()]})
    with Outputs(PROJECTOR, DISPLAY, wires) as outputs:  # type: ignore[arg-type]
        assert outputs.open_display().size_px == (80, 48)
    assert wires.opened == [CARD, CARD]


def test_a_cable_that_was_plugged_in_while_nobody_looked_is_found_by_looking_at_the_wire() -> None:
    kernel = two_heads(unnoticed={1, 2})
    with opened(kernel) as (projector, display):
        assert (projector.size_px, display.size_px) == ((128, 96), (80, 48))


def test_a_flip_that_does_not_come_since_the_cable_is_out_says_so() -> None:
    kernel = two_heads()
    with opened(kernel) as (_, display):
        kernel.mute, kernel.plugs[2].connected = True, False
        with pytest.raises(DeviceGone, match="display: DP-1 was unplugged"):
            display.present(np.zeros((48, 80, 3), np.uint8), 0.1)


def test_reports_that_are_no_reports_are_told_as_the_drivers_fault() -> None:
    kernel = two_heads()
    with opened(kernel) as (_, display):
        kernel.events = b"nonsense"
        with pytest.raises(DeviceRefused, match=r"display: waiting for a vertical blank failed \(DRM event says"):
            display.present(np.zeros((48, 80, 3), np.uint8), 0.1)
        kernel.events = b""


def test_an_output_that_is_opened_again_awaits_no_flip_of_before() -> None:
    kernel = two_heads()
    with Outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as outputs:  # type: ignore[arg-type]
        display = outputs.open_display()
        kernel.mute = True
        with pytest.raises(DeviceGone, match="no vertical blank"):
            display.present(np.zeros((48, 80, 3), np.uint8), 0.1)
        kernel.mute = False
        outputs.open_display()
        assert outputs._cards[CARD]._awaited == set()


def test_a_window_needs_no_crtc_whatever_stands_beside_it_in_the_rig_file() -> None:
    """Card and connector mean nothing for a window, or a monitor."""
    window = replace(DISPLAY, kind=OutputKind.WINDOW, connector="HDMI-A-1")
    kernel = Kernel([Plug(1, 11, 1, [mode(128, 96)], possible_crtcs=0b1)], crtcs=1)
    with Outputs(PROJECTOR, window, KernelWires({CARD: [kernel]})) as outputs:  # type: ignore[arg-type]
        assert outputs.open_projector().size_px == (128, 96)


def test_the_display_opens_while_the_projector_is_unplugged_and_keeps_its_crtc_free() -> None:
    kernel = two_heads()
    kernel.plugs[1].connected = False
    kernel.plugs[1].possible_crtcs = 0b01  # the projector can only use the first
    with Outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as outputs:  # type: ignore[arg-type]
        with pytest.raises(DeviceGone, match="projector: nothing is plugged into HDMI-A-1"):
            outputs.open_projector()
        display = outputs.open_display()
        display.present(np.full((48, 80, 3), 7, np.uint8), 0.5)
        kernel.plugs[1].connected = True
        projector = outputs.open_projector()
        projector.load(frames(1))
        projector.show(0)
        assert kernel.picture(PROJECTOR_CRTC)[0, 0, 1] == 1
        assert kernel.picture(DISPLAY_CRTC)[0, 0, 1] == 7


def test_two_heads_on_one_crtc_are_refused_with_the_reason() -> None:
    kernel = two_heads()
    kernel.plugs[1].possible_crtcs = kernel.plugs[2].possible_crtcs = 0b10
    with pytest.raises(DeviceRefused, match="no CRTC of its own for every output"), opened(kernel):
        pass


def test_a_card_with_more_crtcs_than_connectors_lends_the_one_that_reaches() -> None:
    hdmi = Plug(1, 11, 1, [mode(128, 96)], possible_crtcs=0b1000)
    kernel = Kernel([hdmi, Plug(2, 10, 1, [mode(80, 48)], possible_crtcs=0b0001)], crtcs=4)
    with opened(kernel) as (projector, _):
        projector.load(frames(1))
        projector.show(0)
        assert kernel.picture(kernel.crtc_ids[3])[0, 0, 1] == 1


@pytest.mark.parametrize(("size", "told"), [(0, "no table"), (1, "no table"), (2, "linear"), (256, "linear")])
def test_the_smallest_table_of_gamma_has_two_entries(size: int, told: str) -> None:
    kernel = two_heads(gamma_size=size)
    with opened(kernel) as (projector, _):
        assert projector.health().details["gamma"] == told
        if told == "linear":
            ramp = kernel.gamma[PROJECTOR_CRTC]
            assert (len(ramp), ramp[0], ramp[-1]) == (size, 0, 65535)


def test_heads_on_cards_of_their_own_need_no_crtc_of_the_other_and_do_not_go_with_its_card() -> None:
    other = "/dev/dri/card1"
    display = replace(DISPLAY, card=other, connector="HDMI-A-1")

    def single(*modes: tuple[int, int]) -> Kernel:
        plug = Plug(1, 11, 1, [mode(*size) for size in modes], possible_crtcs=0b1)
        return Kernel([plug], crtcs=1)

    first, second, again = single((128, 96)), single((80, 48)), single((128, 96))
    wires = KernelWires({CARD: [first, again], other: [second]})
    with Outputs(PROJECTOR, display, wires) as outputs:  # type: ignore[arg-type]
        outputs.open_projector()
        screen = outputs.open_display()
        first.pulled = True
        outputs.open_projector()
        assert wires.opened == [CARD, other, CARD]
        screen.present(np.full((48, 80, 3), 7, np.uint8), 0.5)
        assert second.picture(40)[0, 0, 0] == 7
        assert not second.closed


def test_loading_takes_one_buffer_per_frame_and_keeps_them_for_the_next_load() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        empty = len(kernel.dumb)
        projector.load(frames(5))
        assert len(kernel.dumb) == empty + 5
        projector.load(frames(3))
        assert len(kernel.dumb) == empty + 5
        with pytest.raises(IndexError):
            projector.show(3)


def test_reopening_after_the_card_was_away_opens_its_node_anew() -> None:
    before, after = two_heads(), two_heads(crtc_ids=[140, 150])  # a driver that was loaded anew counts on
    wires = KernelWires({CARD: [before, after]})
    with Outputs(PROJECTOR, DISPLAY, wires) as outputs:  # type: ignore[arg-type]
        outputs.open_display()
        outputs.open_projector()  # what is lit on the old node is given up with it
        before.pulled = True
        display = outputs.open_display()
        display.present(np.full((48, 80, 3), 7, np.uint8), 0.5)
        assert after.picture(150)[0, 0, 0] == 7
    assert wires.opened == [CARD, CARD]
    assert before.closed


# ---------------------------------------------------------------------------------- two threads


def test_two_threads_on_one_card_each_get_their_own_reports() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, display):
        projector.load(frames(24))
        picture = np.full((48, 80, 3), 5, np.uint8)
        presented: list[Flip] = []
        stop = threading.Event()

        def present() -> None:
            while not stop.is_set():
                presented.append(display.present(picture, 5.0))

        screen = threading.Thread(target=present)
        screen.start()
        flips = projector.play(list(range(24)), 0, lambda flip: None, never)
        stop.set()
        screen.join(10.0)
        assert not screen.is_alive()
    assert {flip.index for flip in presented} <= {-1}
    assert flips
    assert [flip.index for flip in flips] == list(range(len(flips)))
    times = [flip.time_ns for flip in flips]
    assert times == sorted(times)
