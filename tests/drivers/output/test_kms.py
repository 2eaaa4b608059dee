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
from tests.drivers.output.kernel import Kernel, KernelWires, Plug, mode, plugged, refusing

CARD, OTHER = "/dev/dri/card0", "/dev/dri/card1"
PROJECTOR = OutputSpec(OutputKind.KMS, CARD, "HDMI-A-1", 128, 96, 60.0)
DISPLAY = OutputSpec(OutputKind.KMS, CARD, "DP-1", 80, 48, 60.0)
PROJECTOR_CRTC, DISPLAY_CRTC = 40, 50


def two_heads(**more: Any) -> Kernel:
    hdmi = Plug(1, 11, 1, [mode(1920, 1080), mode(128, 96), mode(128, 96, 75.0)])
    return plugged(hdmi, Plug(2, 10, 1, [mode(80, 48)]), **more)


def one_head(width: int, height: int) -> Kernel:
    return plugged(Plug(1, 11, 1, [mode(width, height)], possible_crtcs=0b1), crtc_ids=[40])


def outputs_on(
    *kernels: Kernel | Exception, projector: OutputSpec = PROJECTOR, display: OutputSpec = DISPLAY
) -> Outputs:
    return Outputs(projector, display, KernelWires({CARD: [*kernels]}))  # type: ignore[arg-type]


@contextmanager
def opened(kernel: Kernel) -> Iterator[tuple[PatternProjector[Any], PictureDisplay[Any]]]:
    with outputs_on(kernel) as outputs:
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
    assert (kernel.lit, kernel.fbs, kernel.dumb, kernel.closed) == ({}, {}, {}, True)


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
    with opened(two_heads(counts_blanks=False, throttles=throttles)) as (projector, _):
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
    with outputs_on(kernel) as outputs:
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


def test_a_pulled_card_is_gone_one_that_talks_nonsense_refused_and_closing_does_not_fail() -> None:
    for change, kind, said in (
        ({"pulled": True}, DeviceGone, r"page flip failed .*No such device"),
        ({"events": b"nonsense"}, DeviceRefused, r"display: .*DRM event"),
    ):
        kernel = two_heads()
        with opened(kernel) as (_, display):
            vars(kernel).update(change)
            with pytest.raises(kind, match=said):
                display.present(picture(0), 0.1)
            kernel.events = b""
        assert kernel.closed


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"master": False}, "owns the screens"),
        ({"dumb_buffers": 0}, "dumb buffers"),
        ({"monotonic": 0}, "monotonic"),
        ({"before": {0xA6: refusing()}}, "^projector: .*HDMI-A-1"),
    ],
)
def test_a_card_that_cannot_serve_is_refused_with_the_reason(changes: dict[str, object], said: str) -> None:
    kernel = two_heads(**changes)
    with pytest.raises(DeviceRefused, match=said), opened(kernel):
        pass
    assert kernel.dumb == {}


@pytest.mark.parametrize(
    ("changes", "details"),
    [
        ({}, {"Broadcast RGB": "Full", "dithering mode": "off", "gamma": "linear"}),
        ({"before": {0xAB: refusing()}}, {"property 7": "refused (it cannot be done)", "dithering mode": "off", "gamma": "linear"}),
        ({"before": {0xA5: refusing()}}, {"Broadcast RGB": "Full", "dithering mode": "off", "gamma": "unknown (it cannot be done)"}),
        ({"gamma_size": 1}, {"Broadcast RGB": "Full", "dithering mode": "off", "gamma": "no table"}),
        ({"gamma_size": 2}, {"Broadcast RGB": "Full", "dithering mode": "off", "gamma": "linear"}),
    ],
)  # fmt: skip
def test_full_range_and_linear_gamma_are_set_where_the_driver_lets_us_and_else_it_is_told(
    changes: dict[str, Any], details: dict[str, str]
) -> None:
    kernel = two_heads(**changes)
    kernel.properties = {
        7: ("Broadcast RGB", 8, {"Automatic": 0, "Full": 1, "Limited 16:235": 2}),
        8: ("EDID", 16, {}),
        9: ("dithering mode", 8, {"auto": 0, "off": 4}),
        10: ("underscan", 8, {"on": 1}),  # has not what is wanted: left as it is
    }
    kernel.plugs[1].properties = {7: 0, 8: 55, 9: 4, 10: 1}
    with opened(kernel) as (projector, _):
        assert projector.health().details == details
    assert kernel.calls.count(0xAB) == 1  # what is right already is left alone
    assert kernel.plugs[1].properties == {7: int("Broadcast RGB" in details), 8: 55, 9: 4, 10: 1}
    if details["gamma"] == "linear":
        ramp = kernel.gamma[PROJECTOR_CRTC]
        assert (len(ramp), ramp[0], ramp[-1]) == (kernel.gamma_size, 0, 65535)
        assert kernel.gamma_size == 2 or ramp[128] == 128 * 257


@pytest.mark.parametrize("missing", [{"card": None}, {"connector": None}], ids=["card", "connector"])
def test_a_screen_without_card_or_connector_is_refused_with_what_to_set(missing: dict[str, None]) -> None:
    outputs = outputs_on(two_heads(), projector=replace(PROJECTOR, **missing))  # type: ignore[arg-type]
    with outputs, pytest.raises(DeviceRefused, match=r"projector: .*\[projector\]"):
        outputs.open_projector()


def test_outputs_open_whatever_happened_before_or_stands_beside_them_in_the_rig_file() -> None:
    with opened(two_heads(unnoticed={1, 2})) as (projector, display):  # cables are found by looking at the wire
        assert (projector.size_px, display.size_px) == ((128, 96), (80, 48))
    # A card that is gone at the very first opening, before anything is lit on it, is opened once more.
    with outputs_on(CardGone(CARD, "is gone", "Restart the instrument"), two_heads()) as outputs:
        assert outputs.open_display().size_px == (80, 48)
    # A window needs no CRTC: card and connector mean nothing for it, or a monitor.
    window = replace(DISPLAY, kind=OutputKind.WINDOW, connector="HDMI-A-1")
    with outputs_on(one_head(128, 96), display=window) as outputs:
        assert outputs.open_projector().size_px == (128, 96)


def test_the_display_opens_while_the_projector_is_unplugged_and_keeps_its_crtc_free() -> None:
    kernel = two_heads()
    kernel.plugs[1].connected = False
    kernel.plugs[1].possible_crtcs = 0b01  # the projector can only use the first
    with outputs_on(kernel) as outputs:
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
    kernel = two_heads(crtc_ids=[40, 50, 60, 70])
    kernel.plugs[1].possible_crtcs, kernel.plugs[2].possible_crtcs = 0b1000, 0b0001
    with opened(kernel):
        assert set(kernel.lit) == {70, 40}


def test_heads_on_cards_of_their_own_need_no_crtc_of_the_other_and_do_not_go_with_its_card() -> None:
    first, second, again = one_head(128, 96), one_head(80, 48), one_head(128, 96)
    wires = KernelWires({CARD: [first, again], OTHER: [second]})
    with Outputs(PROJECTOR, replace(DISPLAY, card=OTHER, connector="HDMI-A-1"), wires) as outputs:  # type: ignore[arg-type]
        outputs.open_projector()
        screen = outputs.open_display()
        first.pulled = True
        outputs.open_projector()
        assert wires.opened == [CARD, OTHER, CARD]
        screen.present(picture(7), 0.5)
        assert green(second, 40) == 7
        assert not second.closed


def test_reopening_after_the_card_was_away_opens_its_node_anew() -> None:
    before, after = two_heads(), two_heads(crtc_ids=[140, 150])  # a driver that was loaded anew counts on
    with outputs_on(before, after) as outputs:
        outputs.open_display()
        outputs.open_projector()  # what is lit on the old node is given up with it
        before.pulled = True
        outputs.open_display().present(picture(7), 0.5)
        assert green(after, 150) == 7
    assert before.closed
