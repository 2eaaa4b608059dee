"""Owns the screen of one scan on the disk: its stored picture, and what was said of it."""

from __future__ import annotations

from datetime import datetime, timedelta

from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.leading import Leader, leader
from appliance.instrument.machine.words import Text
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
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.instrument.screens.views import GalleryView, StoredScan
from appliance.measure import FaultCode

_TOP_PX = 66.0


def draw_gallery(canvas: Canvas, view: GalleryView, time_s: float) -> None:
    bottom = alerts_top(canvas, view.alerts)
    scan = view.scan
    if scan is None:
        draw_title(canvas, Text.GALLERY, view.keys)
        said = Text.NO_SCANS
        middle = (BAR_PX + bottom) / 2 + 18
        canvas.words(said, (canvas.width / 2, middle), HEADLINE, BLACK, theme.MUTED, Align.CENTRE, canvas.width - 80)
        return
    draw_title(canvas, f"{view.index + 1}/{view.count}", view.keys)
    # SCAN means nothing here: its place is free.
    canvas.words(scan.scan_id, (canvas.width - RIGHT_MARGIN_PX, 42), BODY + 2, BOLD, theme.MUTED, Align.RIGHT)
    width, height = LEFT_PX - 32, bottom - _TOP_PX - 6
    if scan.preview is not None:
        canvas.image("gallery", scan.preview, 16, _TOP_PX, width, height)
    else:
        canvas.box(16, _TOP_PX, width, height, theme.DEEP, 10)
        said = Text.NO_PICTURE
        middle = _TOP_PX + height / 2 + 14
        canvas.words(said, (16 + width / 2, middle), TITLE, BOLD, theme.MUTED, Align.CENTRE, width - 40)
    _column(canvas, scan, leader(view.alerts) is not Leader.SCREEN, bottom)
    left, right = room_between(canvas, view.keys, bottom=True)
    canvas.words(
        (Text.DATE, "?") if scan.taken is None else to_the_minute(scan.taken),
        ((left + right) / 2, canvas.height - 20),
        CAPTION,
        REGULAR,
        theme.MUTED,
        Align.CENTRE,
        right - left,
    )


def to_the_minute(time: str) -> str:
    """Return an ISO time as people read it: 2026-11-26T20:55:56+00:00 → 2026-11-26 20:55 UTC; what is none, as it is."""
    try:
        at = datetime.fromisoformat(time)
    except ValueError:
        return time
    return f"{at:%Y-%m-%d %H:%M}" + (" UTC" if at.utcoffset() == timedelta(0) else "")


def _column(canvas: Canvas, scan: StoredScan, led: bool, bottom: float) -> None:
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    top = _TOP_PX
    below = top + VERDICT_PX
    if scan.damaged:
        canvas.box(left, top, right - left, VERDICT_PX, theme.YELLOW, 5)
        canvas.words(Text.DAMAGED, (left + 16, top + 45), TITLE - 2, BLACK, theme.INK, max_width=right - left - 24)
    elif scan.grade is not None:
        below = draw_verdict(canvas, scan.grade, scan.lengths_doubtful, top, led=led)
    if scan.corrected and not scan.damaged:
        canvas.words(
            RULES[FaultCode.COMPENSATED].headline,
            (left, below + 22),
            CAPTION,
            BOLD,
            theme.MUTED,
            max_width=right - left,
        )
        below += 26
    rows = figures(scan.points, scan.coverage_percent, scan.noise_mm, scan.distance_mm)
    draw_figures(canvas, rows, below + 4, bottom)
