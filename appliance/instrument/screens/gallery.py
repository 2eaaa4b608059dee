"""Owns the screen of one scan on the disk: its stored picture, and what was said of it."""

from __future__ import annotations

from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.leading import Leader, leader
from appliance.instrument.machine.words import Language, Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.column import (
    LEFT_PX,
    RIGHT_MARGIN_PX,
    VERDICT_PX,
    draw_figures,
    draw_verdict,
    figures,
)
from appliance.instrument.screens.frame import alerts_top, draw_title, room_between
from appliance.instrument.screens.texts import to_the_minute
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.instrument.screens.views import GalleryView
from appliance.measure import FaultCode

_TOP_PX = 66.0


def draw_gallery(canvas: Canvas, view: GalleryView, language: Language) -> None:
    bottom = alerts_top(canvas, view.alerts)
    if view.count == 0:
        draw_title(canvas, Text.GALLERY.in_language(language), view.keys, language)
        said = Text.NO_SCANS.in_language(language)
        middle = (BAR_PX + bottom) / 2 + 18
        canvas.words(said, (canvas.width / 2, middle), HEADLINE, BLACK, theme.MUTED, Align.CENTRE, canvas.width - 80)
        return
    draw_title(canvas, f"{view.index + 1}/{view.count}", view.keys, language)
    # SCAN means nothing here: its place is free.
    canvas.words(view.scan_id, (canvas.width - RIGHT_MARGIN_PX, 42), BODY + 2, BOLD, theme.MUTED, Align.RIGHT)
    width, height = LEFT_PX - 32, bottom - _TOP_PX - 6
    if view.preview is not None:
        canvas.image("gallery", view.preview, 16, _TOP_PX, width, height)
    else:
        canvas.box(16, _TOP_PX, width, height, theme.DEEP, 10)
        said = Text.NO_PICTURE.in_language(language)
        middle = _TOP_PX + height / 2 + 14
        canvas.words(said, (16 + width / 2, middle), TITLE, BOLD, theme.MUTED, Align.CENTRE, width - 40)
    _column(canvas, view, bottom, language)
    left, right = room_between(canvas, view.keys, language, bottom=True)
    said = f"{Text.DATE.in_language(language)} ?" if view.taken is None else to_the_minute(view.taken)
    canvas.words(
        said, ((left + right) / 2, canvas.height - 20), CAPTION, REGULAR, theme.MUTED, Align.CENTRE, right - left
    )


def _column(canvas: Canvas, view: GalleryView, bottom: float, language: Language) -> None:
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    top = _TOP_PX
    below = top + VERDICT_PX
    if view.damaged:
        canvas.box(left, top, right - left, VERDICT_PX, theme.YELLOW, 5)
        said = Text.DAMAGED.in_language(language)
        canvas.words(said, (left + 16, top + 45), TITLE - 2, BLACK, theme.INK, max_width=right - left - 24)
    elif view.grade is not None:
        led = leader(view.alerts) is not Leader.SCREEN
        below = draw_verdict(canvas, view.grade, view.lengths_doubtful, top, language, led=led)
    if view.corrected and not view.damaged:
        said = RULES[FaultCode.COMPENSATED].headline.in_language(language)
        canvas.words(said, (left, below + 22), CAPTION, BOLD, theme.MUTED, max_width=right - left)
        below += 26
    rows = figures(view.points, view.coverage_percent, view.noise_mm, view.distance_mm)
    draw_figures(canvas, rows, below + 4, bottom, language)
