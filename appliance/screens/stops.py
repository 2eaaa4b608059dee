"""Owns the screens on which nothing may shine: the pause to cool down, and the end of light after a leak."""

from __future__ import annotations

from appliance.screens import theme
from appliance.screens.aim import dash_or
from appliance.screens.canvas import Align, Canvas
from appliance.screens.frame import alert_colours, words_of
from appliance.screens.texts import Language, Text
from appliance.screens.theme import BLACK, BODY, BOLD, HEADLINE, HUGE, TITLE
from appliance.screens.views import CoolingView, SafeView


def draw_cooling(canvas: Canvas, view: CoolingView, language: Language) -> None:
    middle = canvas.width / 2
    canvas.words(Text.COOLING.in_language(language), middle, 46, TITLE, BLACK, align=Align.CENTRE)
    canvas.words(
        dash_or(view.temperature_c, "{:.0f}") + " °C", middle, 168, HUGE, BLACK, theme.YELLOW, Align.CENTRE, 700
    )
    canvas.words(
        f"{Text.UNTIL.in_language(language)} {view.limit_c:.0f} °C", middle, 222, BODY + 2, BOLD, align=Align.CENTRE
    )
    if view.remaining_s is not None:
        canvas.words(
            f"{Text.SOME_MORE.in_language(language)} {minutes(view.remaining_s)}", middle, 270, BODY + 2, BOLD,
            align=Align.CENTRE,
        )  # fmt: skip


def minutes(duration_s: float) -> str:
    """As a diver reads it: whole minutes and seconds, rounded up to ten seconds; an estimate is no stop-watch."""
    seconds = -(-max(0.0, duration_s) // 10) * 10
    return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"


def draw_safe(canvas: Canvas, view: SafeView, language: Language, time_s: float) -> None:
    ground, ink, edge = alert_colours(view.alert.severity, time_s)
    middle = canvas.width / 2
    canvas.box(0, 70, canvas.width, 250, ground, edge=edge, edge_width=10)
    headline, to_do = words_of(view.alert, language)
    canvas.words(headline, middle, 190, HUGE, BLACK, ink, Align.CENTRE, canvas.width - 60)
    canvas.words(to_do, middle, 262, TITLE, BOLD, ink, Align.CENTRE, canvas.width - 60)
    said = Text.ALL_SAVED if view.saved else Text.SAVING
    canvas.words(said.in_language(language), middle, 384, HEADLINE - 8, BLACK, theme.WHITE, Align.CENTRE, 760)
