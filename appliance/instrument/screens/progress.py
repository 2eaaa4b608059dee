"""Screens without a live image or a cloud: waiting, and those without light.

draw_progress, draw_saving, draw_shutdown    recording, checking, computing, saving, switching off
draw_cooling, draw_safe                      the pause to cool down, and the end of light after a leak
"""

from __future__ import annotations

import math

from appliance.instrument.machine.states import State
from appliance.instrument.machine.words import Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alert_colours, alert_text, alerts_top, draw_title
from appliance.instrument.screens.review import number_or_dash
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, HEADLINE, HUGE, TITLE
from appliance.instrument.screens.views import CoolingView, ProgressView, SafeView, SavingView, ShutdownView, View

_FRINGE_SPEED = 1.6
_WATER_PX = 150.0
_EDGE_PX = 60.0


_STAGES = {
    State.ARMED: (Text.GET_READY, Text.LASERS_OFF),
    State.CAPTURE: (Text.HOLD_STILL, Text.LIGHT_IS_ON),
    State.CHECK: (Text.CHECKING, Text.MAY_MOVE),
    State.RECONSTRUCT: (Text.COMPUTING, Text.MAY_MOVE),
}
"""Headline and sentence for each stage of a scan."""


def draw_progress(canvas: Canvas, view: ProgressView, time_s: float) -> None:
    if view.state is State.RECONSTRUCT and not view.alerts:
        canvas.water(0, 0, canvas.width, _WATER_PX, 4.0 * _FRINGE_SPEED * time_s)
    word_at, line_at, more_at = _places(canvas, view)
    word, sentence = _STAGES[view.state]
    _word(canvas, word, word_at)
    canvas.write(sentence, (canvas.width / 2, line_at), BODY + 2, BOLD, align=Align.CENTRE, max_width=canvas.width - 60)
    if view.computes:
        _waiting(canvas, more_at, time_s)


def draw_saving(canvas: Canvas, view: SavingView, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    middle = canvas.width / 2
    if view.saved:
        top, bottom = word_at - 92, more_at + 14
        canvas.box(middle - 340, top, 680, bottom - top, theme.DEEP, 36, (theme.GREEN, 8))
    _word(canvas, Text.SAVED if view.saved else Text.SAVING, word_at, 600)
    canvas.write(view.scan_id, (middle, line_at), TITLE, BOLD, align=Align.CENTRE, max_width=600)
    if view.saved:
        canvas.write(Text.SAFE_ON_DISK, (middle, more_at - 8), BODY, BOLD, theme.GREEN, Align.CENTRE, 620)
    else:
        _waiting(canvas, more_at, time_s)


def draw_shutdown(canvas: Canvas, view: ShutdownView, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    _word(canvas, Text.POWERING_OFF, word_at)
    middle = canvas.width / 2
    if view.saving:
        canvas.write(
            f"{canvas.translate(Text.SAVING)}: {canvas.translate(Text.WAIT_FOR_DARK)}",
            (middle, line_at),
            BODY,
            BLACK,
            theme.YELLOW,
            Align.CENTRE,
            canvas.width - 40,
        )
    if view.reason is not None:
        ground, ink, edge = alert_colours(view.reason.severity, time_s)
        canvas.box(_EDGE_PX, more_at - 50, canvas.width - 2 * _EDGE_PX, 90, ground, 24, (edge, 7))
        headline, _ = alert_text(view.reason, canvas.language)
        canvas.write(headline, (middle, more_at + 13), HEADLINE - 4, BLACK, ink, Align.CENTRE, canvas.width - 180)


def _places(canvas: Canvas, view: View) -> tuple[float, float, float]:
    """Return the baselines of headline, sentence and the part below, closer together beside an alert."""
    top, bottom = float(BAR_PX), alerts_top(canvas, view.alerts)
    room = bottom - top
    return top + 0.44 * room, top + 0.44 * room + min(66.0, 0.25 * room), top + 0.44 * room + min(146.0, 0.5 * room)


def _word(canvas: Canvas, text: Text, baseline: float, room: float | None = None) -> None:
    canvas.write(
        text, (canvas.width / 2, baseline), HUGE, BLACK, align=Align.CENTRE, max_width=room or canvas.width - 60
    )


def _waiting(canvas: Canvas, bottom: float, time_s: float) -> None:
    """Draw an animated bar without a length, since the duration is not known."""
    left, width, height = _EDGE_PX, canvas.width - 2 * _EDGE_PX, 34.0
    canvas.box(left, bottom - height, width, height, theme.PANEL, 17)
    swing = 1.0 - abs(2.0 * (0.4 * time_s % 1.0) - 1.0)
    canvas.box(left + (width - 160) * swing, bottom - height, 160, height, theme.AQUA, 17)


HOTTER_C = 15.0
"""Range of the bar above the limit, in degrees Celsius."""


def draw_cooling(canvas: Canvas, view: CoolingView, time_s: float) -> None:
    draw_title(canvas, Text.COOLING, view.keys, theme.YELLOW)
    top, bottom = float(BAR_PX), alerts_top(canvas, view.alerts)
    room = bottom - top
    high = room > 200
    number = number_or_dash(view.temperature_c, "{:.0f}") + " °C"
    x = 40.0
    baseline = top + room * (0.36 if high else 0.52)
    canvas.write(
        number,
        (x, baseline),
        round(min(HUGE + 16.0, 0.38 * room)) if high else HUGE,
        BLACK,
        theme.YELLOW,
        max_width=360,
    )
    until = (Text.UNTIL, f"{view.limit_c:.0f} °C")
    right = canvas.width - 40
    canvas.write(until, (right, baseline - 52), BODY + 2, BOLD, theme.WHITE, Align.RIGHT, 370)
    if view.remaining_s is not None:
        canvas.write(
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
        canvas.write(
            Text.NO_LIGHT, (middle, top + room * 0.86), TITLE - 4, BLACK, theme.WHITE, Align.CENTRE, canvas.width - 80
        )


def _thermometer(canvas: Canvas, view: CoolingView, left: float, right: float, top: float) -> None:
    """Draw the temperature as a bar that shrinks towards the limit on the left."""
    canvas.box(left, top, right - left, 34, theme.PANEL, 17)
    if view.temperature_c is not None:
        part = min(1.0, max(0.0, (view.temperature_c - view.limit_c) / HOTTER_C))
        canvas.box(left, top, 34 + (right - left - 34) * part, 34, theme.YELLOW, 17)
    canvas.box(left - 3, top - 8, 6, 50, theme.GREEN, 3)


def minutes(duration_s: float) -> str:
    """Return a duration in minutes and seconds, rounded up to ten seconds, since it is an estimate."""
    seconds = 10 * math.ceil(max(0.0, duration_s) / 10)
    return f"{seconds // 60}:{seconds % 60:02d} min"


def draw_safe(canvas: Canvas, view: SafeView, time_s: float) -> None:
    ground, ink, edge = alert_colours(view.alert.severity, time_s)
    middle, top = canvas.width / 2, float(BAR_PX)
    bottom = alerts_top(canvas, view.alerts)
    height = bottom - top - (96 if not view.alerts else 62)
    canvas.box(0, top, canvas.width, height, ground, edge=(edge, 12))
    headline, to_do = alert_text(view.alert, canvas.language)
    canvas.write(
        headline,
        (middle, top + 0.56 * height),
        HUGE + 20 if not view.alerts else HUGE - 10,
        BLACK,
        ink,
        Align.CENTRE,
        canvas.width - 70,
    )
    canvas.write(to_do, (middle, top + 0.84 * height), TITLE, BOLD, ink, Align.CENTRE, canvas.width - 60)
    text, colour = (Text.ALL_SAVED, theme.GREEN) if view.saved else (Text.SAVING, theme.YELLOW)
    baseline = bottom - (34 if not view.alerts else 18)
    canvas.write(text, (middle, baseline), HEADLINE - 10, BLACK, colour, Align.CENTRE, canvas.width - 60)
