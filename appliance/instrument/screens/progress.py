"""Owns the screens that wait: recording, checking, computing, saving, switching off."""

from __future__ import annotations

from appliance.instrument.machine.states import State
from appliance.instrument.machine.words import Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alert_colours, alerts_top, words_of
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, HEADLINE, HUGE, TITLE
from appliance.instrument.screens.views import (
    ProgressView,
    SavingView,
    ShutdownView,
    View,
)

_FRINGE_SPEED = 1.6
_WATER_PX = 150.0
_EDGE_PX = 60.0


_SAID = {
    State.ARMED: (Text.GET_READY, Text.LASERS_OFF),
    State.CAPTURE: (Text.HOLD_STILL, Text.LIGHT_IS_ON),
    State.CHECK: (Text.CHECKING, Text.MAY_MOVE),
    State.RECONSTRUCT: (Text.COMPUTING, Text.MAY_MOVE),
}
"""Word and sentence on the way of a scan."""


def draw_progress(canvas: Canvas, view: ProgressView, time_s: float) -> None:
    if view.state is State.RECONSTRUCT and not view.alerts:
        canvas.water(0, 0, canvas.width, _WATER_PX, 4.0 * _FRINGE_SPEED * time_s)
    word_at, line_at, more_at = _places(canvas, view)
    word, sentence = _SAID[view.state]
    _word(canvas, word, word_at)
    canvas.words(sentence, (canvas.width / 2, line_at), BODY + 2, BOLD, align=Align.CENTRE, max_width=canvas.width - 60)
    if view.computes:
        _waiting(canvas, more_at, time_s)


def draw_saving(canvas: Canvas, view: SavingView, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    middle = canvas.width / 2
    if view.saved:
        top, bottom = word_at - 92, more_at + 14
        canvas.box(middle - 340, top, 680, bottom - top, theme.DEEP, 36, (theme.GREEN, 8))
    _word(canvas, Text.SAVED if view.saved else Text.SAVING, word_at, 600)
    canvas.words(view.scan_id, (middle, line_at), TITLE, BOLD, align=Align.CENTRE, max_width=600)
    if view.saved:
        canvas.words(Text.SAFE_ON_DISK, (middle, more_at - 8), BODY, BOLD, theme.GREEN, Align.CENTRE, 620)
    else:
        _waiting(canvas, more_at, time_s)


def draw_shutdown(canvas: Canvas, view: ShutdownView, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    _word(canvas, Text.POWERING_OFF, word_at)
    middle = canvas.width / 2
    if view.saving:
        canvas.words(
            f"{canvas.said(Text.SAVING)}: {canvas.said(Text.WAIT_FOR_DARK)}",
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
        headline, _ = words_of(view.reason, canvas.language)
        canvas.words(headline, (middle, more_at + 13), HEADLINE - 4, BLACK, ink, Align.CENTRE, canvas.width - 180)


def _places(canvas: Canvas, view: View) -> tuple[float, float, float]:
    """Return the baselines of the word, of the sentence below it and of what comes below that, closer where there is
    an alert."""
    top, bottom = float(BAR_PX), alerts_top(canvas, view.alerts)
    room = bottom - top
    return top + 0.44 * room, top + 0.44 * room + min(66.0, 0.25 * room), top + 0.44 * room + min(146.0, 0.5 * room)


def _word(canvas: Canvas, text: Text, baseline: float, room: float | None = None) -> None:
    canvas.words(
        text, (canvas.width / 2, baseline), HUGE, BLACK, align=Align.CENTRE, max_width=room or canvas.width - 60
    )


def _waiting(canvas: Canvas, bottom: float, time_s: float) -> None:
    """Draw something that moves, without pretending to a length: nobody knows how long it takes."""
    left, width, height = _EDGE_PX, canvas.width - 2 * _EDGE_PX, 34.0
    canvas.box(left, bottom - height, width, height, theme.PANEL, 17)
    swing = 1.0 - abs(2.0 * (0.4 * time_s % 1.0) - 1.0)
    canvas.box(left + (width - 160) * swing, bottom - height, 160, height, theme.AQUA, 17)
