"""Owns the screens on which nothing may shine: the pause to cool down, and the end of light after a leak."""

from __future__ import annotations

import math

from appliance.instrument.machine.words import Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.column import known
from appliance.instrument.screens.frame import alert_colours, alerts_top, draw_title, words_of
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, HEADLINE, HUGE, TITLE
from appliance.instrument.screens.views import CoolingView, SafeView

HOTTER_C = 15.0
"""Range of the bar above the limit, in degrees Celsius."""


def draw_cooling(canvas: Canvas, view: CoolingView, time_s: float) -> None:
    draw_title(canvas, Text.COOLING, view.keys, theme.YELLOW)
    top, bottom = float(BAR_PX), alerts_top(canvas, view.alerts)
    room = bottom - top
    high = room > 200
    number = known(view.temperature_c, "{:.0f}") + " °C"
    x = 40.0
    baseline = top + room * (0.36 if high else 0.52)
    canvas.words(
        number,
        (x, baseline),
        round(min(HUGE + 16.0, 0.38 * room)) if high else HUGE,
        BLACK,
        theme.YELLOW,
        max_width=360,
    )
    until = (Text.UNTIL, f"{view.limit_c:.0f} °C")
    right = canvas.width - 40
    canvas.words(until, (right, baseline - 52), BODY + 2, BOLD, theme.WHITE, Align.RIGHT, 370)
    if view.remaining_s is not None:
        canvas.words(
            (Text.SOME_MORE, minutes(view.remaining_s)),
            (right, baseline),
            BODY + 2,
            BOLD,
            theme.WHITE,
            Align.RIGHT,
            370,
        )
    _thermometer(canvas, view, 40, right, top + room * (0.56 if high else 0.72))
    if high:
        middle = canvas.width / 2
        canvas.words(
            Text.NO_LIGHT, (middle, top + room * 0.86), TITLE - 4, BLACK, theme.WHITE, Align.CENTRE, canvas.width - 80
        )


def _thermometer(canvas: Canvas, view: CoolingView, left: float, right: float, top: float) -> None:
    """Draw the temperature as a bar that begins at the limit (left, where it is ready again) and empties towards that
    mark."""
    canvas.box(left, top, right - left, 34, theme.PANEL, 17)
    if view.temperature_c is not None:
        part = min(1.0, max(0.0, (view.temperature_c - view.limit_c) / HOTTER_C))
        canvas.box(left, top, 34 + (right - left - 34) * part, 34, theme.YELLOW, 17)
    canvas.box(left - 3, top - 8, 6, 50, theme.GREEN, 3)


def minutes(duration_s: float) -> str:
    """Return a duration in minutes and seconds, rounded up to ten seconds: an estimate is no stop-watch."""
    seconds = 10 * math.ceil(max(0.0, duration_s) / 10)
    return f"{seconds // 60}:{seconds % 60:02d} min"


def draw_safe(canvas: Canvas, view: SafeView, time_s: float) -> None:
    ground, ink, edge = alert_colours(view.alert.severity, time_s)
    middle, top = canvas.width / 2, float(BAR_PX)
    bottom = alerts_top(canvas, view.alerts)
    height = bottom - top - (96 if not view.alerts else 62)
    canvas.box(0, top, canvas.width, height, ground, edge=(edge, 12))
    headline, to_do = words_of(view.alert, canvas.language)
    canvas.words(
        headline,
        (middle, top + 0.56 * height),
        HUGE + 20 if not view.alerts else HUGE - 10,
        BLACK,
        ink,
        Align.CENTRE,
        canvas.width - 70,
    )
    canvas.words(to_do, (middle, top + 0.84 * height), TITLE, BOLD, ink, Align.CENTRE, canvas.width - 60)
    said, colour = (Text.ALL_SAVED, theme.GREEN) if view.saved else (Text.SAVING, theme.YELLOW)
    baseline = bottom - (34 if not view.alerts else 18)
    canvas.words(said, (middle, baseline), HEADLINE - 10, BLACK, colour, Align.CENTRE, canvas.width - 60)
