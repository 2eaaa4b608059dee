"""Owns the screen of one scan on the disk: its stored picture, and what was said of it."""

from __future__ import annotations

from appliance.screens import theme
from appliance.screens.aim import dash_or
from appliance.screens.canvas import Align, Canvas
from appliance.screens.review import GRADES, many
from appliance.screens.texts import Language, Text
from appliance.screens.theme import BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.screens.views import GalleryView

PREVIEW_BOX = (16.0, 70.0, 516.0, 340.0)
"""Left, top, width, height of the stored picture."""
_COLUMN_PX = 548.0


def draw_gallery(canvas: Canvas, view: GalleryView, language: Language) -> None:
    middle = canvas.width / 2
    if view.count == 0:
        canvas.words(Text.GALLERY.in_language(language), middle, 44, TITLE, BLACK, align=Align.CENTRE)
        canvas.words(
            Text.NO_SCANS.in_language(language), middle, canvas.height / 2 + 18, HEADLINE, BLACK, theme.MUTED,
            Align.CENTRE, canvas.width - 80,
        )  # fmt: skip
        return
    canvas.words(f"{view.index + 1}/{view.count}", middle, 44, TITLE, BLACK, align=Align.CENTRE)
    left, top, width, height = PREVIEW_BOX
    canvas.box(left, top, width, height, theme.DEEP, 10)
    if view.preview is not None:
        canvas.image("gallery", view.preview, left, top, width, height)
    else:
        canvas.words(
            Text.NO_PICTURE.in_language(language), left + width / 2, top + height / 2, TITLE, BOLD, theme.MUTED,
            Align.CENTRE, width,
        )  # fmt: skip
    _column(canvas, view, language)


def _column(canvas: Canvas, view: GalleryView, language: Language) -> None:
    left, right = _COLUMN_PX, canvas.width - 18
    canvas.words(view.scan_id, left, 104, BODY + 2, BOLD, max_width=right - left)
    if view.damaged:
        canvas.box(left, 118, right - left, 52, theme.YELLOW, 8)
        canvas.words(Text.DAMAGED.in_language(language), left + 12, 156, BODY + 2, BLACK, theme.INK)
    elif view.grade is not None:
        word, colour = GRADES[view.grade]
        canvas.box(left, 120, 10, 50, colour, 5)
        canvas.words(word.in_language(language), left + 24, 160, TITLE, BLACK, max_width=right - left - 24)
    rows = (
        (Text.POINTS, "—" if view.points is None else many(view.points), ""),
        (Text.COVERAGE, dash_or(view.coverage_percent, "{:.0f}"), "%"),
        (Text.NOISE, dash_or(None if view.noise_mm is None else 1000.0 * view.noise_mm, "{:.0f}"), "µm"),
        (Text.DISTANCE, dash_or(view.distance_mm, "{:.0f}"), "mm"),
    )
    for number, (name, value, unit) in enumerate(rows):
        baseline = 214 + 46 * number
        unit_px = canvas.words(unit, right, baseline, CAPTION, REGULAR, theme.MUTED, Align.RIGHT)
        value_right = right - unit_px - (6 if unit else 0)
        value_px = canvas.words(value, value_right, baseline, BODY + 2, BOLD, theme.WHITE, Align.RIGHT)
        room = value_right - value_px - left - 6
        canvas.words(name.in_language(language), left, baseline, CAPTION, REGULAR, theme.MUTED, max_width=room)
    canvas.words(view.taken or "—", left, 400, CAPTION, REGULAR, theme.MUTED, max_width=right - left)
