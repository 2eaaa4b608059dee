"""Pages of the menu: rows to choose from, with their present values."""

from __future__ import annotations

from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alerts_top, draw_title
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, TITLE
from appliance.instrument.screens.views import MenuRow, MenuView

_ROW_PX, _LEFT_PX, _PAD_PX = 31.0, 24.0, 20.0
"""Least height of a row; with an alert all rows of a page stay on the screen, closer together."""
_TALL_ROW_PX = 62.0


def draw_menu(canvas: Canvas, view: MenuView, time_s: float) -> None:
    draw_title(canvas, view.title, view.keys)
    top, bottom = BAR_PX + 4, alerts_top(canvas, view.alerts) - 2
    # Rows move together before any is hidden: hidden rows are hard to find with cold hands.
    fit = int((bottom - top) / _ROW_PX)
    pitch = min(_TALL_ROW_PX, (bottom - top) / max(1, min(fit, len(view.rows))))
    first = first_shown(len(view.rows), view.selected, fit)
    for place, row in enumerate(view.rows[first : first + fit]):
        selected = first + place == view.selected
        _row(canvas, row, top + place * pitch, pitch, selected, selected and view.changing)
    # A stroke at the edge of the list shows that there are more rows.
    middle = canvas.width / 2
    for hidden, y in ((first > 0, top - 4), (first + fit < len(view.rows), bottom - 2)):
        if hidden:
            canvas.box(middle - 60, y, 120, 5, theme.AQUA, 2)


def _row(canvas: Canvas, row: MenuRow, top: float, height: float, selected: bool, changing: bool) -> None:
    left, right = _LEFT_PX, canvas.width - _LEFT_PX
    name, value_size = (BODY + 2, BODY) if height > 40 else (BODY - 2, BODY - 4)
    baseline = top + (height - 5) / 2 + 0.36 * (value_size if height > 40 else name)
    if selected:
        canvas.box(left, top, right - left, height - 5, theme.WHITE, 12)
    ink = theme.INK if selected else theme.WHITE
    value = row.value
    text = row.text
    room = right - left - 2 * _PAD_PX - 16 - canvas.measure(text, name, BLACK)
    if changing:
        # UP and DOWN change it: the marks are the same as beside the keys.
        large = TITLE - 6 if height > 40 else value_size
        # No larger than the value's own box.
        mark, lower = (TITLE + 8, 5.0) if height > 40 else (TITLE - 6, 2.0)
        width = min(room - 72, canvas.measure(value, large, BLACK)) + 112
        canvas.box(right - width, top, width, height - 5, theme.AQUA, 12)
        canvas.write("▲", (right - width + 8, baseline + lower), mark, BLACK, theme.INK)
        canvas.write("▼", (right - 8, baseline + lower), mark, BLACK, theme.INK, Align.RIGHT)
        canvas.write(value, (right - width / 2, baseline), large, BLACK, theme.INK, Align.CENTRE, width - 104)
        value_px = width
    else:
        value_px = canvas.write(value, (right - _PAD_PX, baseline), value_size, BOLD, ink, Align.RIGHT, room) + _PAD_PX
    name_px = right - value_px - 16 - left - _PAD_PX
    canvas.write(text, (left + _PAD_PX, baseline), name, BLACK, ink, max_width=name_px)


def first_shown(rows: int, selected: int, fit: int) -> int:
    """Return the first row on a screen of ``fit`` rows.

    The selected row is on it, in the middle if possible.
    """
    return max(0, min(selected - fit // 2, rows - fit))
