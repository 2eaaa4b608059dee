"""Owns the screen after a scan: the cloud, the verdict in a word, and the numbers behind it."""

from __future__ import annotations

from appliance.instrument.machine.leading import Leader, leader
from appliance.instrument.machine.words import Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.cloud import CloudPainter
from appliance.instrument.screens.column import Figure, draw_figures, draw_verdict, figures, known
from appliance.instrument.screens.frame import alerts_top, draw_title, room_between
from appliance.instrument.screens.theme import BAR_PX, BOLD, CAPTION, REGULAR, TITLE
from appliance.instrument.screens.views import ReviewView

CLOUD_PX = 512.0
"""Width of the cloud's part of the screen; it is as high as the screen."""
_VERDICT_TOP_PX = 66.0
_LEGEND_PX = 120.0


def draw_review(cloud: CloudPainter, canvas: Canvas, view: ReviewView, time_s: float) -> None:
    # Near is bright.
    cloud.show(view.points_mm, view.values, bright_is_high=False)
    bottom = alerts_top(canvas, view.alerts)
    if cloud.empty:
        middle = (BAR_PX + bottom) / 2 + 14
        canvas.words(Text.NO_POINTS, (CLOUD_PX / 2, middle), TITLE, BOLD, theme.MUTED, Align.CENTRE, CLOUD_PX - 40)
    else:
        low = canvas.height - BAR_PX + 8 if not view.alerts else bottom
        room = canvas.pixels(0, BAR_PX - 14, CLOUD_PX, low - BAR_PX + 14)
        cloud.draw(canvas.framebuffer, room, time_s, view.turn)
        _legend(canvas, cloud.range, view)
    if view.coarse:
        # More is to come, in the place of the title.
        draw_title(canvas, Text.COARSE, view.keys, theme.MUTED)
    elif view.next_scan is not None:
        said = (Text.NEXT_SCAN, view.next_scan)
        draw_title(canvas, said, view.keys)
    elif view.overlap is not None:
        # Yellow only where nothing else is to be done first.
        leads = leader(view.alerts, view.overlap) is Leader.OVERLAP
        colour = theme.YELLOW if leads else theme.MUTED if view.overlap.warns else theme.WHITE
        draw_title(canvas, view.overlap.words, view.keys, colour)
    led = leader(view.alerts, view.overlap) is not Leader.SCREEN
    top = draw_verdict(canvas, view.grade, view.lengths_doubtful, _VERDICT_TOP_PX, led=led) + 4
    rows = figures(view.points, view.coverage_percent, view.noise_mm, view.distance_mm)
    time = Figure(Text.TIME, known(view.duration_s, "{:.1f}"), "s")
    draw_figures(canvas, (*rows[:3], time, rows[3]), top, bottom)


def _legend(canvas: Canvas, span: tuple[float, float], view: ReviewView) -> None:
    """Draw what the colours mean: a bar with the values of its two ends in mm, the bright end first, between the lower
    labels."""
    unit = "mm"
    low, high = (f"{value:.0f}" for value in span)
    left, right = room_between(canvas, view.keys, bottom=True)
    high_px, unit_px = canvas.measure(high, CAPTION, BOLD), canvas.measure(unit, CAPTION, REGULAR)
    # Both ends' numbers first, the bar gets what is left: colours without values would say nothing.
    bar_px = min(_LEGEND_PX, right - left - canvas.measure(low, CAPTION, BOLD) - high_px - unit_px - 22)
    baseline = canvas.height - 20
    if bar_px < 40:
        return
    canvas.box(left - 8, canvas.height - 54, right - left + 16, 54, theme.INK)
    total = canvas.measure(low, CAPTION, BOLD) + 8 + bar_px + 8 + high_px + 6 + unit_px
    x = (left + right - total) / 2
    x += canvas.words(low, (x, baseline), CAPTION, BOLD) + 8
    canvas.colours(x, baseline - 17, bar_px, 16)
    x += bar_px + 8
    x += canvas.words(high, (x, baseline), CAPTION, BOLD) + 6
    canvas.words(unit, (x, baseline), CAPTION, REGULAR, theme.MUTED)
