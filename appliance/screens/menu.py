"""Owns the pages of the menu: rows to choose from, and what is chosen now."""

from __future__ import annotations

from appliance.screens import theme
from appliance.screens.canvas import Align, Canvas
from appliance.screens.texts import Language, worded
from appliance.screens.theme import BAR_PX, BLACK, BODY, BOLD, TITLE
from appliance.screens.views import MenuView

ROWS_SHOWN = 7
_ROW_PX, _LEFT_PX, _PAD_PX = 50.0, 40.0, 24.0


def draw_menu(canvas: Canvas, view: MenuView, language: Language) -> None:
    canvas.words(
        view.title.in_language(language), canvas.width / 2, 44, TITLE, BLACK, align=Align.CENTRE, max_width=400
    )
    first = first_shown(len(view.rows), view.selected)
    shown = view.rows[first : first + ROWS_SHOWN]
    top = BAR_PX + (canvas.height - 2 * BAR_PX - ROWS_SHOWN * _ROW_PX) / 2
    right = canvas.width - _LEFT_PX
    for place, row in enumerate(shown):
        selected = first + place == view.selected
        y = top + place * _ROW_PX
        if selected:
            canvas.box(_LEFT_PX, y, right - _LEFT_PX, _ROW_PX - 4, theme.WHITE, 12)
        ink = theme.INK if selected else theme.WHITE if row.allowed else theme.MUTED
        value = worded(row.value, language)
        if selected and view.changing:
            value = f"‹ {value} ›"
        value_px = canvas.words(value, right - _PAD_PX, y + 35, BODY, BOLD, ink, Align.RIGHT, 320)
        room = right - 2 * _PAD_PX - _LEFT_PX - value_px
        canvas.words(row.text.in_language(language), _LEFT_PX + _PAD_PX, y + 35, BODY + 2, BLACK, ink, max_width=room)


def first_shown(rows: int, selected: int) -> int:
    """The first row on the screen, such that the selected one is on it, in the middle where there are more."""
    return max(0, min(selected - ROWS_SHOWN // 2, rows - ROWS_SHOWN))
