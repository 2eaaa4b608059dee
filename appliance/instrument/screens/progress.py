"""Owns the screens that wait: recording, checking, computing, saving, switching off."""

from __future__ import annotations

from appliance.instrument.machine.words import Language, Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alert_colours, alerts_top, words_of
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, HEADLINE, HUGE, TITLE
from appliance.instrument.screens.views import (
    ArmedView,
    CaptureView,
    CheckView,
    ReconstructView,
    SavingView,
    ShutdownView,
    View,
)

_FRINGE_SPEED = 1.6
_WATER_PX = 150.0
_EDGE_PX = 60.0


def draw_armed(canvas: Canvas, view: ArmedView, language: Language) -> None:
    word_at, line_at, _ = _places(canvas, view)
    _word(canvas, Text.GET_READY, word_at, language)
    _sentence(canvas, Text.LASERS_OFF, line_at, language)


def draw_capture(canvas: Canvas, view: CaptureView, language: Language) -> None:
    word_at, line_at, _ = _places(canvas, view)
    _word(canvas, Text.HOLD_STILL, word_at, language)
    _sentence(canvas, Text.LIGHT_IS_ON, line_at, language)


def draw_check(canvas: Canvas, view: CheckView, language: Language, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    _word(canvas, Text.CHECKING, word_at, language)
    _sentence(canvas, Text.MAY_MOVE, line_at, language)
    _waiting(canvas, more_at, time_s)


def draw_reconstruct(canvas: Canvas, view: ReconstructView, language: Language, time_s: float) -> None:
    if not view.alerts:
        canvas.water(0, 0, canvas.width, _WATER_PX, 4.0 * _FRINGE_SPEED * time_s)
    word_at, line_at, more_at = _places(canvas, view)
    _word(canvas, Text.COMPUTING, word_at, language)
    _sentence(canvas, Text.MAY_MOVE, line_at, language)
    _waiting(canvas, more_at, time_s)


def draw_saving(canvas: Canvas, view: SavingView, language: Language, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    middle = canvas.width / 2
    if view.saved:
        top, bottom = word_at - 92, more_at + 14
        canvas.box(middle - 340, top, 680, bottom - top, theme.DEEP, 36, (theme.GREEN, 8))
    _word(canvas, Text.SAVED if view.saved else Text.SAVING, word_at, language, 600)
    canvas.words(view.scan_id, (middle, line_at), TITLE, BOLD, align=Align.CENTRE, max_width=600)
    if view.saved:
        said = Text.SAFE_ON_DISK.in_language(language)
        canvas.words(said, (middle, more_at - 8), BODY, BOLD, theme.GREEN, Align.CENTRE, 620)
    else:
        _waiting(canvas, more_at, time_s)


def draw_shutdown(canvas: Canvas, view: ShutdownView, language: Language, time_s: float) -> None:
    word_at, line_at, more_at = _places(canvas, view)
    _word(canvas, Text.POWERING_OFF, word_at, language)
    middle = canvas.width / 2
    if view.saving:
        said = f"{Text.SAVING.in_language(language)}: {Text.WAIT_FOR_DARK.in_language(language)}"
        canvas.words(said, (middle, line_at), BODY, BLACK, theme.YELLOW, Align.CENTRE, canvas.width - 40)
    if view.reason is not None:
        ground, ink, edge = alert_colours(view.reason.severity, time_s)
        canvas.box(_EDGE_PX, more_at - 50, canvas.width - 2 * _EDGE_PX, 90, ground, 24, (edge, 7))
        headline, _ = words_of(view.reason, language)
        canvas.words(headline, (middle, more_at + 13), HEADLINE - 4, BLACK, ink, Align.CENTRE, canvas.width - 180)


def _places(canvas: Canvas, view: View) -> tuple[float, float, float]:
    """Return the baselines of the word, of the sentence below it and of what comes below that, closer where there is
    an alert."""
    top, bottom = float(BAR_PX), alerts_top(canvas, view.alerts)
    room = bottom - top
    return top + 0.44 * room, top + 0.44 * room + min(66.0, 0.25 * room), top + 0.44 * room + min(146.0, 0.5 * room)


def _word(canvas: Canvas, text: Text, baseline: float, language: Language, room: float | None = None) -> None:
    words = text.in_language(language)
    canvas.words(
        words, (canvas.width / 2, baseline), HUGE, BLACK, align=Align.CENTRE, max_width=room or canvas.width - 60
    )


def _sentence(canvas: Canvas, text: Text, baseline: float, language: Language) -> None:
    words = text.in_language(language)
    canvas.words(words, (canvas.width / 2, baseline), BODY + 2, BOLD, align=Align.CENTRE, max_width=canvas.width - 60)


def _waiting(canvas: Canvas, bottom: float, time_s: float) -> None:
    """Draw something that moves, without pretending to a length: nobody knows how long it takes."""
    left, width, height = _EDGE_PX, canvas.width - 2 * _EDGE_PX, 34.0
    canvas.box(left, bottom - height, width, height, theme.PANEL, 17)
    swing = 1.0 - abs(2.0 * (0.4 * time_s % 1.0) - 1.0)
    canvas.box(left + (width - 160) * swing, bottom - height, 160, height, theme.AQUA, 17)
