"""Pictures in a window of any shape: whole, centred, undistorted, each in its own column."""

from __future__ import annotations

import pytest

from hw_sim.window.panes import LAYOUTS, fit
from hw_sim.window.pictures import ROOMS


@pytest.mark.parametrize(
    ("picture", "window", "box"),
    [
        ((800, 480), (800, 480), (0, 0, 800, 480)),
        ((1024, 768), (512, 384), (0, 0, 512, 384)),
        ((800, 480), (1600, 500), (383, 0, 833, 500)),
        ((800, 480), (400, 900), (0, 330, 400, 240)),
    ],
)
def test_one_picture(picture: tuple[int, int], window: tuple[int, int], box: tuple[int, int, int, int]) -> None:
    assert fit(picture, window, 0, 1) == box


@pytest.mark.parametrize("window", [(800, 300), (1280, 300), (300, 700), (801, 299)])
def test_two_pictures_do_not_touch_each_others_half(window: tuple[int, int]) -> None:
    (l0, b0, w0, h0), (l1, b1, w1, h1) = (fit((400, 300), window, k, 2) for k in (0, 1))
    assert (w0, h0, b0) == (w1, h1, b1)
    assert l0 >= 0
    assert l0 + w0 <= l1 + 1
    assert l1 + w1 <= window[0] + 1
    assert w0 / h0 == pytest.approx(4 / 3, rel=0.01)


def test_a_window_without_size_is_survived() -> None:
    assert fit((800, 480), (0, 0), 0, 1)[2:] == (1, 1)


def test_every_picture_is_shown_once_and_the_display_pixel_by_pixel() -> None:
    shown = [name for layout in LAYOUTS for name in layout.pictures]
    assert sorted(shown) == sorted(ROOMS)
    (display,) = [layout for layout in LAYOUTS if "display" in layout.pictures]
    assert display.size_px == (ROOMS["display"].width_px, ROOMS["display"].height_px)
