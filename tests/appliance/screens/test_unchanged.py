"""A screen is drawn anew as soon as anything on it is, and not before."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np

from appliance.machine.words import Language
from appliance.screens import theme
from appliance.screens.painter import Painter
from appliance.screens.unchanged import MOVES_HZ, FrugalPainter
from appliance.screens.views import AimView, AnyView
from tests.appliance.screens.test_screens import AIM, EVERY, GREY, LEAK, NEWS, REVIEW

SIZE_PX = (400, 240)


def drawn_anew(painter: FrugalPainter, view: AnyView, time_s: float) -> bool:
    """Whether ``draw`` drew: the picture that stands is spoilt before, and only drawing would mend it."""
    stands = painter.draw(AIM, 0.0)
    stands = painter.draw(view, 0.0)
    whole = stands.copy()
    stands[:] = 7
    again = painter.draw(view, time_s)
    anew = not (again == 7).all()
    if anew and time_s == 0.0:
        np.testing.assert_array_equal(again, whole)
    stands[:] = whole
    return anew


def test_what_has_not_changed_is_not_drawn_again(context: moderngl.Context) -> None:
    with FrugalPainter(context, SIZE_PX) as painter:
        assert not drawn_anew(painter, AIM, 0.0)
        assert not drawn_anew(painter, replace(AIM), 1000.0), "nothing on it moves by itself"
        assert not drawn_anew(painter, REVIEW, 0.9 / MOVES_HZ)
        assert drawn_anew(painter, REVIEW, 1.1 / MOVES_HZ), "the cloud turns"
        half_s = 0.5 / theme.FLASH_HZ
        flashing = replace(AIM, alerts=(LEAK,))
        assert not drawn_anew(painter, flashing, 0.9 * half_s)
        assert drawn_anew(painter, flashing, 1.1 * half_s), "a leak flashes"


def test_whatever_stood_there_before_the_picture_is_that_of_the_view(context: moderngl.Context) -> None:
    with FrugalPainter(context, SIZE_PX) as painter, Painter(context, SIZE_PX) as other:
        twice = [*EVERY, *reversed(EVERY), AIM, REVIEW]
        for view in twice:
            got = painter.draw(view, 0.3)
            other.draw(AimView(left=None, right=None, scans_taken=0, scans_left=None, temperature_c=None), 0.0)
            np.testing.assert_array_equal(got, other.draw(view, 0.3))


def test_each_thing_that_is_new_is_drawn(context: moderngl.Context) -> None:
    changes: list[AnyView] = [
        replace(AIM, left=GREY.copy()),  # another image, though it looks alike
        replace(AIM, right=None),
        replace(AIM, scans_taken=13),
        replace(AIM, temperature_c=None),
        replace(AIM, exposure="12 ms"),
        replace(AIM, object=3),
        replace(AIM, alerts=(NEWS,)),
        replace(AIM, keys={}),
    ]
    with FrugalPainter(context, SIZE_PX) as painter:
        for change in changes:
            stands = painter.draw(AIM, 0.0)
            stands[:] = 7
            assert not (painter.draw(change, 0.0) == 7).all(), change
        stands = painter.draw(AIM, 0.0)
        stands[:] = 7
        painter.language = Language.GERMAN
        assert not (painter.draw(AIM, 0.0) == 7).all(), "other words"


def test_after_a_preview_the_screen_is_drawn_again(context: moderngl.Context) -> None:
    with FrugalPainter(context, SIZE_PX) as painter:
        review = painter.draw(REVIEW, 0.0).copy()
        assert painter.preview() is not None
        np.testing.assert_array_equal(painter.draw(REVIEW, 0.0), review)
