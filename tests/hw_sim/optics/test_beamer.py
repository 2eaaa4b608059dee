"""The electronics of real projectors: windows of light, bit planes, latency, rasters, and what measuring them would have to find."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hw_sim.optics.beamer import Beamer, ProjectorTruth, ShownFrame, slices_of
from hw_sim.optics.projector import response

FRAME_US = 50_000.0 / 3.0
FRAME_NS = 16_666_667


def truth(**given: Any) -> ProjectorTruth:
    return ProjectorTruth(Beamer(**given), FRAME_US, response("linear"))


def picture(code: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.full((768, 1024), code, np.uint8)


def test_video_shows_colours_in_turn_and_green_for_45_percent() -> None:
    windows = truth(kind="video").windows_us
    assert [w.channel for w in windows] == list("GRGB")
    green_us = sum(w.end_us - w.begin_us for w in windows if w.channel == "G")
    assert green_us / FRAME_US == pytest.approx(0.45)
    ends = [windows[0].begin_us - 100.0, *(w.end_us for w in windows)]
    assert all(w.begin_us > end for w, end in zip(windows, ends, strict=False)), "dark between, and late"
    assert windows[-1].end_us < FRAME_US + 120.0
    bits, flash_ends = Beamer("video").pieces()
    assert np.diff(flash_ends, prepend=0.0).max() == pytest.approx(64.0 / 1023.0), (
        "no flash is longer: colours do not flicker"
    )
    assert [int((bits == bit).sum()) for bit in range(10)] == [1] * 7 + [2, 4, 8]
    once = truth(kind="video", order="RGB").windows_us
    assert once[1].end_us - once[1].begin_us == pytest.approx(0.45 * FRAME_US)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("first", [0, 1, 2])
def test_whole_sub_frames_of_equal_channels_are_exact_and_parts_are_not(count: int, first: int) -> None:
    pattern = truth(kind="pattern")
    begin_us = pattern.windows_us[first].begin_us
    exposure_us = count * FRAME_US / 3.0
    assert pattern.residual(begin_us, exposure_us) < 1e-4 or first + count > 3
    assert pattern.linear(begin_us, exposure_us) == (first + count <= 3)
    assert not pattern.linear(begin_us, exposure_us - 0.4 * FRAME_US / 3.0), "a part of a sub-frame weighs bits wrongly"
    if first + count > 3:
        assert pattern.foreign(begin_us, exposure_us) > 0.2, "the rest is of the next picture"


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_an_exposure_sees_the_frames_that_light_while_it_lasts(latency: int) -> None:
    beamer = Beamer("pattern", latency_blanks=latency, late_us=200.0)
    frames = [ShownFrame(k * FRAME_NS, (picture(10 * k + 5),) * 3) for k in range(6)]
    start_ns, end_ns = 4 * FRAME_NS + 100_000, 5 * FRAME_NS + 5_000_000
    slices = slices_of(beamer, frames, start_ns, end_ns, FRAME_NS / 1e9)
    shown = [int(part.image[0, 0]) for part in slices]
    assert shown == [10 * (k - latency) + 5 for k in (3, 4, 5)]
    durations_us = [part.duration_s * 1e6 for part in slices]
    assert durations_us == pytest.approx([100.0, FRAME_US, 4800.0], abs=0.01)
    assert [part.since_blank_s * 1e6 for part in slices] == pytest.approx([FRAME_US - 100.0, 0.0, 0.0], abs=0.01)
    early = slices_of(beamer, frames[:1], -3 * FRAME_NS, 1_000_000, FRAME_NS / 1e9)
    assert sum(part.duration_s for part in early) == pytest.approx(0.051, abs=1e-6)
    assert not early[0].image.any(), "dark before the world began"


def test_turned_and_scaled_pictures_light_elsewhere() -> None:
    codes = np.zeros((768, 1024), np.uint8)
    codes[100, 30] = 255
    for mirrored, upside_down, row, column in (
        (True, False, 100, 1023 - 30),
        (False, True, 767 - 100, 30),
        (True, True, 667, 993),
    ):
        lit = Beamer(mirrored=mirrored, upside_down=upside_down).lights((codes, codes, codes))
        assert divmod(int(lit.argmax()), 1024) == (row, column)
        assert lit.max() == 255
    checker = (np.indices((768, 1024)).sum(axis=0) % 2 * 255).astype(np.uint8)
    through = Beamer(scaled=(912, 1140)).lights((checker, checker, checker)).astype(float)
    assert through.std() < 0.6 * checker.astype(float).std(), "a checker of single pixels greys"
    wide = np.tile((np.arange(1024) // 32 % 2 * 255).astype(np.uint8), (768, 1))
    through = Beamer(scaled=(912, 1140)).lights((wide, wide, wide)).astype(float)
    assert np.abs(through - wide).mean() < 6.0, "stripes of 32 px stay where they are"
    assert np.abs(np.roll(through, 32, axis=1) - wide).mean() > 200.0
