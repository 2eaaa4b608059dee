"""Screens that show a scan: the review after a capture, and the gallery of scans on the disk.

    draw_review                  the cloud, the grade as one word, and the figures
    draw_gallery                 the stored preview of one scan, its grade and its figures
    draw_verdict, draw_figures   the right column of both; if there is little space, the last figures are left out

``number_or_dash`` and ``short_count`` format numbers for other screens, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.leading import Leader, leader
from appliance.instrument.machine.words import Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.cloud import CloudPainter
from appliance.instrument.screens.frame import alerts_top, draw_title, room_between
from appliance.instrument.screens.theme import BAR_PX, BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.instrument.screens.views import GalleryView, ReviewView, StoredScan
from appliance.measure import FaultCode, Grade

GRADES = {
    Grade.GOOD: (Text.GOOD, theme.GREEN),
    Grade.USABLE: (Text.USABLE, theme.YELLOW),
    Grade.BAD: (Text.BAD, theme.YELLOW),
}
LEFT_PX, RIGHT_MARGIN_PX = 520.0, 14.0
VERDICT_PX, DOUBTFUL_PX = 64.0, 70.0
_LEAST_PITCH_PX, _MOST_PITCH_PX = 27.0, 52.0


@dataclass(frozen=True, slots=True)
class Figure:
    """One line of the column."""

    name: Text
    value: str
    unit: str = ""


def figures(
    points: int | None, coverage_percent: float | None, noise_mm: float | None, distance_mm: float | None
) -> tuple[Figure, ...]:
    """Return the lines for a scan, the most important first; a dash for ``None``."""
    return (
        Figure(Text.COVERAGE, number_or_dash(coverage_percent, "{:.0f}"), "%"),
        _noise(noise_mm),
        Figure(Text.DISTANCE, number_or_dash(distance_mm, "{:.0f}"), "mm"),
        Figure(Text.POINTS, "—" if points is None else short_count(points)),
    )


def _noise(noise_mm: float | None) -> Figure:
    """Return the line of the noise: in µm below 1 mm, in mm from there on."""
    if noise_mm is not None and noise_mm >= 1.0:
        return Figure(Text.NOISE, f"{noise_mm:.1f}", "mm")
    return Figure(Text.NOISE, number_or_dash(None if noise_mm is None else 1000.0 * noise_mm, "{:.0f}"), "µm")


def number_or_dash(value: float | None, pattern: str) -> str:
    """Return a number, or a dash if it is not known."""
    return "—" if value is None else pattern.format(value)


def short_count(number: int) -> str:
    """Return a count in at most four digits: 950, 18.3 k, 1.31 M."""
    if number < 1000:
        return str(number)
    # From here on, three digits would round up to 1000 k.
    if number < 999_500:
        return f"{number / 1e3:.3g} k"
    return f"{number / 1e6:.3g} M"


def draw_verdict(canvas: Canvas, grade: Grade, doubtful: bool, top: float, *, led: bool = False) -> float:
    """Draw the grade as a word beside its colour, a bad one on a coloured ground; return the lower end.

    ``doubtful``: lengths are unreliable. Then the grade has a second line, on the ground of a warning. ``led``: another
    message leads, and a good grade has no colour.
    """
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    word, colour = GRADES[grade]
    if led and grade is Grade.GOOD:
        colour = theme.MUTED
    # A good grade beside unreliable lengths would mislead; a bad one needs no second reason.
    if doubtful and grade is not Grade.BAD:
        canvas.box(left, top, right - left, DOUBTFUL_PX, theme.YELLOW, 5)
        for text, baseline, size, weight in (
            (word, top + 36, TITLE - 2, BLACK),
            (Text.LENGTHS_DOUBTFUL, top + 62, CAPTION, BOLD),
        ):
            canvas.write(text, (left + 10, baseline), size, weight, theme.INK, max_width=right - left - 16)
        return top + DOUBTFUL_PX
    bad = grade is Grade.BAD
    canvas.box(left, top, right - left if bad else 10, VERDICT_PX, colour, 5)
    ink = theme.INK if bad else theme.WHITE
    canvas.write(word, (left + 24, top + 49), HEADLINE - 6, BLACK, ink, max_width=right - left - 32)
    return top + VERDICT_PX


def draw_figures(canvas: Canvas, rows: Sequence[Figure], top: float, bottom: float) -> None:
    """Draw as many of the rows, from the first, as fit between ``top`` and ``bottom``."""
    # The most important rows come first, so that an alert takes the space of the last ones.
    fit = min(len(rows), int((bottom - top) / _LEAST_PITCH_PX))
    if fit < 1:
        return
    pitch = min(_MOST_PITCH_PX, (bottom - top) / fit)
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    size = BODY + 2 if pitch > 44 else BODY if pitch > 34 else CAPTION + 2
    for number, row in enumerate(rows[:fit]):
        baseline = top + pitch * (number + 1) - 0.26 * pitch
        unit_px = canvas.write(row.unit, (right, baseline), CAPTION, REGULAR, theme.MUTED, Align.RIGHT)
        value_right = right - unit_px - (6 if row.unit else 0)
        name, value = row.name, row.value
        room = value_right - left - 6 - canvas.measure(name, CAPTION, REGULAR)
        canvas.write(value, (value_right, baseline), size, BOLD, theme.WHITE, Align.RIGHT, room)
        canvas.write(name, (left, baseline), CAPTION, REGULAR, theme.MUTED)


_TOP_PX = 66.0


def draw_gallery(canvas: Canvas, view: GalleryView, time_s: float) -> None:
    bottom = alerts_top(canvas, view.alerts)
    scan = view.scan
    if scan is None:
        draw_title(canvas, Text.GALLERY, view.keys)
        text = Text.NO_SCANS
        middle = (BAR_PX + bottom) / 2 + 18
        canvas.write(text, (canvas.width / 2, middle), HEADLINE, BLACK, theme.MUTED, Align.CENTRE, canvas.width - 80)
        return
    draw_title(canvas, f"{view.index + 1}/{view.count}", view.keys)
    # SCAN has no label here: its place is free.
    canvas.write(scan.scan_id, (canvas.width - RIGHT_MARGIN_PX, 42), BODY + 2, BOLD, theme.MUTED, Align.RIGHT)
    width, height = LEFT_PX - 32, bottom - _TOP_PX - 6
    if scan.preview is not None:
        canvas.image("gallery", scan.preview, 16, _TOP_PX, width, height)
    else:
        canvas.box(16, _TOP_PX, width, height, theme.DEEP, 10)
        text = Text.NO_PICTURE
        middle = _TOP_PX + height / 2 + 14
        canvas.write(text, (16 + width / 2, middle), TITLE, BOLD, theme.MUTED, Align.CENTRE, width - 40)
    _column(canvas, scan, leader(view.alerts) is not Leader.SCREEN, bottom)
    left, right = room_between(canvas, view.keys, bottom=True)
    canvas.write(
        (Text.DATE, "?") if scan.captured_at is None else to_the_minute(scan.captured_at),
        ((left + right) / 2, canvas.height - 20),
        CAPTION,
        REGULAR,
        theme.MUTED,
        Align.CENTRE,
        right - left,
    )


def to_the_minute(time: str) -> str:
    """Return an ISO time in a readable form: 2026-11-26T20:55:56+00:00 → 2026-11-26 20:55 UTC.

    Any other text is returned unchanged.
    """
    try:
        moment = datetime.fromisoformat(time)
    except ValueError:
        return time
    return f"{moment:%Y-%m-%d %H:%M}" + (" UTC" if moment.utcoffset() == timedelta(0) else "")


def _column(canvas: Canvas, scan: StoredScan, led: bool, bottom: float) -> None:
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    top = _TOP_PX
    below = top + VERDICT_PX
    if scan.damaged:
        canvas.box(left, top, right - left, VERDICT_PX, theme.YELLOW, 5)
        canvas.write(Text.DAMAGED, (left + 16, top + 45), TITLE - 2, BLACK, theme.INK, max_width=right - left - 24)
    elif scan.grade is not None:
        below = draw_verdict(canvas, scan.grade, scan.lengths_doubtful, top, led=led)
    if scan.corrected and not scan.damaged:
        canvas.write(
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
        canvas.write(Text.NO_POINTS, (CLOUD_PX / 2, middle), TITLE, BOLD, theme.MUTED, Align.CENTRE, CLOUD_PX - 40)
    else:
        low = canvas.height - BAR_PX + 8 if not view.alerts else bottom
        room = canvas.pixels(0, BAR_PX - 14, CLOUD_PX, low - BAR_PX + 14)
        cloud.draw(canvas.framebuffer, room, time_s, view.turn_steps)
        _legend(canvas, cloud.range, view)
    if view.coarse:
        # The title says that the full cloud is still to come.
        draw_title(canvas, Text.COARSE, view.keys, theme.MUTED)
    elif view.next_scan is not None:
        text = (Text.NEXT_SCAN, view.next_scan)
        draw_title(canvas, text, view.keys)
    elif view.overlap is not None:
        # Yellow only if no other remedy comes first.
        leads = leader(view.alerts, view.overlap) is Leader.OVERLAP
        colour = theme.YELLOW if leads else theme.MUTED if view.overlap.warns else theme.WHITE
        draw_title(canvas, view.overlap.label, view.keys, colour)
    led = leader(view.alerts, view.overlap) is not Leader.SCREEN
    top = draw_verdict(canvas, view.grade, view.lengths_doubtful, _VERDICT_TOP_PX, led=led) + 4
    rows = figures(view.points, view.coverage_percent, view.noise_mm, view.distance_mm)
    time = Figure(Text.TIME, number_or_dash(view.duration_s, "{:.1f}"), "s")
    draw_figures(canvas, (*rows[:3], time, rows[3]), top, bottom)


def _legend(canvas: Canvas, span: tuple[float, float], view: ReviewView) -> None:
    """Draw the legend of the colours: a bar with the values of its ends in mm, the bright end first."""
    unit = "mm"
    low, high = (f"{value:.0f}" for value in span)
    left, right = room_between(canvas, view.keys, bottom=True)
    high_px, unit_px = canvas.measure(high, CAPTION, BOLD), canvas.measure(unit, CAPTION, REGULAR)
    # The numbers have priority over the bar: colours without values have no meaning.
    bar_px = min(_LEGEND_PX, right - left - canvas.measure(low, CAPTION, BOLD) - high_px - unit_px - 22)
    baseline = canvas.height - 20
    if bar_px < 40:
        return
    canvas.box(left - 8, canvas.height - 54, right - left + 16, 54, theme.INK)
    total = canvas.measure(low, CAPTION, BOLD) + 8 + bar_px + 8 + high_px + 6 + unit_px
    x = (left + right - total) / 2
    x += canvas.write(low, (x, baseline), CAPTION, BOLD) + 8
    canvas.colours(x, baseline - 17, bar_px, 16)
    x += bar_px + 8
    x += canvas.write(high, (x, baseline), CAPTION, BOLD) + 6
    canvas.write(unit, (x, baseline), CAPTION, REGULAR, theme.MUTED)
