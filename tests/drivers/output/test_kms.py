"""Projector and display on a card: what lights the scene, when, and what is said when it cannot."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.api import CardGone, DeviceGone, DeviceRefused
from drivers.output.display import PictureDisplay
from drivers.output.outputs import Outputs, open_outputs
from drivers.output.projector import PatternProjector
from drivers.output.spec import OutputKind, OutputSpec
from tests.drivers.output.kernel import Kernel, KernelWires, Plug, mode, refusing

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


def never() -> bool:
    return False


def picture(value: int) -> np.ndarray:
    return np.full((48, 80, 3), value, np.uint8)


def green(kernel: Kernel, crtc: int) -> int:
    return int(kernel.picture(crtc)[0, 0, 1])


def test_each_output_has_its_colours_in_place_whatever_the_pitch_and_closing_gives_everything_back() -> None:
    kernel = two_heads(pitch_align=1000)
    rng = np.random.default_rng(3)
    pattern = rng.integers(0, 256, (96, 128), dtype=np.uint8)
    shown = rng.integers(0, 256, (48, 80, 3), dtype=np.uint8)
    with open_outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as (projector, display):  # type: ignore[arg-type]
        assert (projector.size_px, display.size_px) == ((128, 96), (80, 48))
        assert not kernel.picture(PROJECTOR_CRTC)[:, :, :3].any()
        assert not kernel.picture(DISPLAY_CRTC)[:, :, :3].any()
        projector.load([pattern])
        flip = projector.show(0)
        assert (flip.index, flip.sequence) == (0, kernel.blank)
        assert abs(flip.time_ns - kernel.time.ns) < 2000  # the kernel reports µs
        lit = kernel.picture(PROJECTOR_CRTC)
        np.testing.assert_array_equal(lit[:, :, 1], pattern)
        assert not lit[:, :, [0, 2]].any()
        assert display.present(shown, 0.5).index == -1
        np.testing.assert_array_equal(kernel.picture(DISPLAY_CRTC)[:, :, 2::-1], shown)
    assert (kernel.lit, kernel.fbs, kernel.dumb) == ({}, {}, {})
    assert kernel.closed


def test_loading_shows_black_takes_one_buffer_per_frame_and_keeps_them_for_the_next_load() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        empty = len(kernel.dumb)
        for number in (5, 3):
            projector.load(frames(number))
            assert not kernel.picture(PROJECTOR_CRTC)[:, :, 1].any(), "no frame changes while it is lit"
            assert len(kernel.dumb) == empty + 5
            projector.show(1)
        with pytest.raises(IndexError, match="projector frame 3; 3 are loaded"):
            projector.show(3)


@pytest.mark.parametrize("throttles", [True, False])
def test_a_card_that_does_not_count_or_throttle_plays_one_frame_per_period(throttles: bool) -> None:
    kernel = two_heads(counts_blanks=False, throttles=throttles)
    with opened(kernel) as (projector, _):
        projector.load(frames(8))
        flips = projector.play([1, 2, 3, 4, 5, 6, 7], 0, lambda flip: None, never)
        told = projector.health().details.get("flips")
    assert told == (None if throttles else "not throttled by the hardware")
    assert [flip.sequence for flip in flips] == [None] * 7
    assert np.allclose(np.diff([flip.time_ns for flip in flips]) / 1e6, 16.7, atol=0.5)


def test_busy_is_waited_out_but_not_for_ever() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, _):
        projector.load(frames(1))
        kernel.busy = 3
        assert projector.show(0).index == 0
        kernel.busy = 1000
        begun_ns = kernel.time.ns
        with pytest.raises(DeviceRefused, match="20 tries"):
            projector.show(0)
        assert (kernel.time.ns - begun_ns) * 1e-9 == pytest.approx(0.019), "a pause of 1 ms between two tries"
        kernel.busy = 0


def test_a_flip_that_timed_out_is_awaited_before_the_next_but_not_after_an_opening() -> None:
    kernel = two_heads()
    with Outputs(PROJECTOR, DISPLAY, KernelWires({CARD: [kernel]})) as outputs:  # type: ignore[arg-type]
        display = outputs.open_display()
        for next_is_opened in (False, True):
            kernel.mute = True
            with pytest.raises(DeviceGone, match=r"within 0.1 s on DP-1"):
                display.present(picture(5), 0.1)
            kernel.mute = False
            if next_is_opened:
                outputs.open_display()
                assert outputs._cards[CARD]._awaited == set()
            else:
                before = kernel.calls.count(0xB0)
                display.present(picture(9), 0.5)
                assert kernel.calls.count(0xB0) == before + 1  # and was not refused as busy
                assert green(kernel, DISPLAY_CRTC) == 9


def test_a_pulled_cable_is_gone_and_says_which_and_the_other_output_goes_on() -> None:
    kernel = two_heads()
    with opened(kernel) as (projector, display):
        projector.load(frames(2))
        kernel.plugs[1].connected = False
        with pytest.raises(DeviceGone, match="projector: HDMI-A-1 was unplugged"):
            projector.play([1], 0, lambda flip: None, never)
        display.present(picture(0), 0.5)
        kernel.plugs[2].connected = False
        begun = kernel.flips

        def present_for_1500_ms() -> None:
            for _ in range(90):
                display.present(picture(0), 0.5)

        with pytest.raises(DeviceGone, match="display: DP-1 was unplugged"):
            present_for_1500_ms()
        assert kernel.flips - begun <= 60, "within a second"
        kernel.mute = True
        with pytest.raises(DeviceGone, match="display: DP-1 was unplugged"):
            display.present(picture(0), 0.1)


def test_a_pulled_card_is_gone_and_closing_does_not_fail() -> None:
    kernel = two_heads()
    with opened(kernel) as (_, display):
        kernel.pulled = True
        with pytest.raises(DeviceGone, match=r"page flip failed .*No such device"):
            display.present(picture(0), 0.5)
    assert kernel.closed
    kernel = two_heads()
    with opened(kernel) as (_, display):
        kernel.events = b"nonsense"
        with pytest.raises(DeviceRefused, match=r"display: .*DRM event"):
            display.present(picture(0), 0.1)
        kernel.events = b""


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"master": False}, "owns the screens"), ({"dumb_buffers": 0}, "dumb buffers"), ({"monotonic": 0}, "monotonic")],
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
        10: ("underscan", 8, {"on": 1}),  # has not what is wanted: left as it is
    }
    kernel.plugs[1].properties = {7: 0, 8: 55, 9: 4, 10: 1}
    with opened(kernel) as (projector, _):
        assert kernel.plugs[1].properties == {7: 1, 8: 55, 9: 4, 10: 1}
        assert kernel.calls.count(0xAB) == 1  # what is right already is left alone
        ramp = kernel.gamma[PROJECTOR_CRTC]
        assert (ramp[0], ramp[128], ramp[255]) == (0, 128 * 257, 65535)
        assert projector.health().details == {"Broadcast RGB": "Full", "dithering mode": "off", "gamma": "linear"}


@pytest.mark.parametrize(("size", "told"), [(1, "no table"), (2, "linear")])
def test_the_smallest_table_of_gamma_has_two_entries(size: int, told: str) -> None:
    kernel = two_heads(gamma_size=size)
    with opened(kernel) as (projector, _):
        assert projector.health().details["gamma"] == told
    assert kernel.gamma.get(PROJECTOR_CRTC) == ([0, 65535] if told == "linear" else None)


@pytest.mark.parametrize(
    ("refuses", "details"),
    [
        (0xAB, {"property 7": "refused (it cannot be done)", "gamma": "linear"}),
        (0xA5, {"Broadcast RGB": "Full", "gamma": "unknown (it cannot be done)"}),
    ],
)
def test_an_output_whose_driver_refuses_property_or_gamma_is_an_output_and_says_so(
    refuses: int, details: dict[str, str]
) -> None:
    kernel = two_heads(before={refuses: refusing()}, properties={7: ("Broadcast RGB", 8, {"Automatic": 0, "Full": 1})})
    kernel.plugs[1].properties = {7: 0}
    with opened(kernel) as (projector, _):
        assert projector.health().details == details


def test_who_asks_in_vain_which_crtc_can_drive_an_output_is_named() -> None:
    """The other output's connector is asked as well; what fails is the opening of this one."""
    wires = KernelWires({CARD: [two_heads(before={0xA6: refusing()})]})
    with Outputs(PROJECTOR, DISPLAY, wires) as outputs, pytest.raises(DeviceRefused, match=r"^display: .*HDMI-A-1"):  # type: ignore[arg-type]
        outputs.open_display()


@pytest.mark.parametrize("missing", [{"card": None}, {"connector": None}], ids=["card", "connector"])
def test_a_screen_without_card_or_connector_is_refused_with_what_to_set(missing: dict[str, None]) -> None:
    wires = KernelWires({CARD: [two_heads()]})
    outputs = Outputs(replace(PROJECTOR, **missing), DISPLAY, wires)  # type: ignore[arg-type]
    with outputs, pytest.raises(DeviceRefused, match=r"projector: .*\[projector\]"):
        outputs.open_projector()
    assert wires.opened == []


def test_a_card_that_is_gone_at_the_very_first_opening_is_opened_once_more() -> None:
    """Nothing is lit on it and no node is kept of it yet."""

    wires = KernelWires({CARD: [CardGone(CARD, "is gone", "Restart the instrument"), two_heads()]})
    with Outputs(PROJECTOR, DISPLAY, wires) as outputs:  # type: ignore[arg-type]
        assert outputs.open_display().size_px == (80, 48)
    assert wires.opened == [CARD, CARD]


def test_a_cable_that_was_plugged_in_while_nobody_looked_is_found_by_looking_at_the_wire() -> None:
    with opened(two_heads(unnoticed={1, 2})) as (projector, display):
        assert (projector.size_px, display.size_px) == ((128, 96), (80, 48))


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
        with pytest.raises(DeviceGone, match=r"projector: .*HDMI-A-1"):
            outputs.open_projector()
        outputs.open_display().present(picture(7), 0.5)
        kernel.plugs[1].connected = True
        projector = outputs.open_projector()
        projector.load(frames(1))
        projector.show(0)
        assert (green(kernel, PROJECTOR_CRTC), green(kernel, DISPLAY_CRTC)) == (1, 7)


def test_two_heads_on_one_crtc_are_refused_and_of_more_the_one_that_reaches_is_lent() -> None:
    kernel = two_heads()
    kernel.plugs[1].possible_crtcs = kernel.plugs[2].possible_crtcs = 0b10
    with pytest.raises(DeviceRefused, match="CRTC"), opened(kernel):
        pass
    hdmi = Plug(1, 11, 1, [mode(128, 96)], possible_crtcs=0b1000)
    kernel = Kernel([hdmi, Plug(2, 10, 1, [mode(80, 48)], possible_crtcs=0b0001)], crtcs=4)
    with opened(kernel):
        assert set(kernel.lit) == {kernel.crtc_ids[3], kernel.crtc_ids[0]}


def test_heads_on_cards_of_their_own_need_no_crtc_of_the_other_and_do_not_go_with_its_card() -> None:
    other = "/dev/dri/card1"

    def single(width_px: int, height_px: int) -> Kernel:
        return Kernel([Plug(1, 11, 1, [mode(width_px, height_px)], possible_crtcs=0b1)], crtcs=1)

    first, second, again = single(128, 96), single(80, 48), single(128, 96)
    wires = KernelWires({CARD: [first, again], other: [second]})
    with Outputs(PROJECTOR, replace(DISPLAY, card=other, connector="HDMI-A-1"), wires) as outputs:  # type: ignore[arg-type]
        outputs.open_projector()
        screen = outputs.open_display()
        first.pulled = True
        outputs.open_projector()
        assert wires.opened == [CARD, other, CARD]
        screen.present(picture(7), 0.5)
        assert green(second, 40) == 7
        assert not second.closed


def test_reopening_after_the_card_was_away_opens_its_node_anew() -> None:
    before, after = two_heads(), two_heads(crtc_ids=[140, 150])  # a driver that was loaded anew counts on
    wires = KernelWires({CARD: [before, after]})
    with Outputs(PROJECTOR, DISPLAY, wires) as outputs:  # type: ignore[arg-type]
        outputs.open_display()
        outputs.open_projector()  # what is lit on the old node is given up with it
        before.pulled = True
        outputs.open_display().present(picture(7), 0.5)
        assert green(after, 150) == 7
    assert wires.opened == [CARD, CARD]
    assert before.closed
