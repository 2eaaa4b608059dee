"""Owns the screen after a scan: the cloud, the verdict in a word, and the numbers behind it."""

from __future__ import annotations

from appliance.screens import theme
from appliance.screens.aim import dash_or
from appliance.screens.canvas import Align, Canvas
from appliance.screens.cloud import CloudPainter
from appliance.screens.texts import Language, Text
from appliance.screens.theme import BLACK, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.screens.views import Grade, PointValue, ReviewView

CLOUD_BOX = (0.0, 0.0, 536.0, 480.0)
"""Left, top, width, height of the cloud on the screen."""
_COLUMN_PX = 542.0
_LEGEND_LEFT_PX, _LEGEND_PX = 210.0, 458.0
GRADES = {
    Grade.GOOD: (Text.GOOD, theme.GREEN),
    Grade.USABLE: (Text.USABLE, theme.YELLOW),
    Grade.BAD: (Text.BAD, theme.YELLOW),
}


def draw_review(canvas: Canvas, cloud: CloudPainter, view: ReviewView, language: Language, time_s: float) -> None:
    # Near is bright, little noise is bright: what the diver wants more of stands out.
    cloud.show(view.points_mm, view.values, bright_is_high=False)
    left, top, width, height = CLOUD_BOX
    if cloud.empty:
        canvas.words(
            Text.NO_POINTS.in_language(language), left + width / 2, top + height / 2, TITLE, BOLD, theme.MUTED,
            Align.CENTRE,
        )  # fmt: skip
    else:
        cloud.draw(canvas.framebuffer, canvas.pixels(left, top, width, height)[:2], time_s, view.turn)
        _legend(canvas, cloud.range, view.value)
    if view.coarse:
        canvas.words(
            Text.COARSE.in_language(language), left + width / 2, 34, CAPTION, REGULAR, theme.MUTED, Align.CENTRE
        )
    _verdict(canvas, view, language)


def _verdict(canvas: Canvas, view: ReviewView, language: Language) -> None:
    left, right = _COLUMN_PX, canvas.width - 18
    word, colour = GRADES[view.grade]
    word = view.word or word
    bad = view.grade is Grade.BAD
    canvas.box(left, 72, right - left if bad else 10, 66, colour, 5)
    ink = theme.INK if bad else theme.WHITE
    canvas.words(word.in_language(language), left + 26, 124, HEADLINE, BLACK, ink, max_width=right - left - 40)
    rows = (
        (Text.POINTS, many(view.points), ""),
        (Text.COVERAGE, dash_or(view.coverage_percent, "{:.0f}"), "%"),
        (Text.NOISE, dash_or(None if view.noise_mm is None else 1000.0 * view.noise_mm, "{:.0f}"), "µm"),
        (Text.DISTANCE, dash_or(view.distance_mm, "{:.0f}"), "mm"),
        (Text.TIME, dash_or(view.duration_s, "{:.1f}"), "s"),
    )
    for number, (name, value, unit) in enumerate(rows):
        baseline = 192 + 52 * number
        unit_px = canvas.words(unit, right, baseline, CAPTION, REGULAR, theme.MUTED, Align.RIGHT)
        value_right = right - unit_px - (6 if unit else 0)
        value_px = canvas.words(value, value_right, baseline, TITLE - 4, BOLD, theme.WHITE, Align.RIGHT)
        room = value_right - value_px - left - 6
        canvas.words(name.in_language(language), left, baseline, CAPTION - 2, REGULAR, theme.MUTED, max_width=room)


def _legend(canvas: Canvas, span: tuple[float, float], value: PointValue) -> None:
    """What the colours mean: a bar with the values of its two ends, the bright end first."""
    match value:
        case PointValue.DEPTH:
            factor, unit = 1.0, "mm"
        case PointValue.NOISE:
            factor, unit = 1000.0, "µm"
    low, high = (f"{factor * v:.0f}" for v in span)
    x = _LEGEND_LEFT_PX + canvas.words(low, _LEGEND_LEFT_PX, _LEGEND_PX, CAPTION, BOLD) + 8
    canvas.colours(x, _LEGEND_PX - 17, 150, 16)
    x += 158
    x += canvas.words(high, x, _LEGEND_PX, CAPTION, BOLD) + 6
    canvas.words(unit, x, _LEGEND_PX, CAPTION, REGULAR, theme.MUTED)


def many(number: int) -> str:
    """A count in at most four figures: 950, 18.3 k, 1.31 M."""
    if number < 1000:
        return str(number)
    if number < 1_000_000:
        return f"{number / 1e3:.3g} k"
    return f"{number / 1e6:.3g} M"
