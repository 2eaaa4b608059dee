"""Owns the numbers that a scan is judged by, as a column: name, value, unit, and which are left out where room is
short."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from appliance.instrument.machine.words import Text
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, HEADLINE, REGULAR, TITLE
from appliance.measure import Grade

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
    """Return the lines that are shown of every scan, the most telling first; a dash stands for ``None``."""
    return (
        Figure(Text.COVERAGE, known(coverage_percent, "{:.0f}"), "%"),
        _noise(noise_mm),
        Figure(Text.DISTANCE, known(distance_mm, "{:.0f}"), "mm"),
        Figure(Text.POINTS, "—" if points is None else many(points)),
    )


def _noise(noise_mm: float | None) -> Figure:
    """Return the line of the noise: in µm below 1 mm, in mm from there on."""
    if noise_mm is not None and noise_mm >= 1.0:
        return Figure(Text.NOISE, f"{noise_mm:.1f}", "mm")
    return Figure(Text.NOISE, known(None if noise_mm is None else 1000.0 * noise_mm, "{:.0f}"), "µm")


def known(value: float | None, pattern: str) -> str:
    """Return a number, or a dash where it is not known."""
    return "—" if value is None else pattern.format(value)


def many(number: int) -> str:
    """Return a count in at most four figures: 950, 18.3 k, 1.31 M."""
    if number < 1000:
        return str(number)
    # Where three figures would round up to 1000 k.
    if number < 999_500:
        return f"{number / 1e3:.3g} k"
    return f"{number / 1e6:.3g} M"


def draw_verdict(canvas: Canvas, grade: Grade, doubtful: bool, top: float, *, led: bool = False) -> float:
    """Draw the verdict as a word beside the colour of its grade, a bad one on a ground of that colour. Returns its
    lower end.

    ``doubtful``: lengths are not to be trusted. Then no word stands alone, and the ground is that of a warning.
    ``led``: another message leads, and a good grade has no colour.
    """
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    word, colour = GRADES[grade]
    if led and grade is Grade.GOOD:
        colour = theme.MUTED
    # A good grade beside lengths that nobody trusts would be believed; a bad one needs no second reason.
    if doubtful and grade is not Grade.BAD:
        canvas.box(left, top, right - left, DOUBTFUL_PX, theme.YELLOW, 5)
        for said, baseline, size, weight in (
            (word, top + 36, TITLE - 2, BLACK),
            (Text.LENGTHS_DOUBTFUL, top + 62, CAPTION, BOLD),
        ):
            canvas.words(said, (left + 10, baseline), size, weight, theme.INK, max_width=right - left - 16)
        return top + DOUBTFUL_PX
    bad = grade is Grade.BAD
    canvas.box(left, top, right - left if bad else 10, VERDICT_PX, colour, 5)
    ink = theme.INK if bad else theme.WHITE
    canvas.words(word, (left + 24, top + 49), HEADLINE - 6, BLACK, ink, max_width=right - left - 32)
    return top + VERDICT_PX


def draw_figures(canvas: Canvas, rows: Sequence[Figure], top: float, bottom: float) -> None:
    """Draw as many of the rows, from the first, as fit between ``top`` and ``bottom``."""
    # The rows come with the most telling first, so that an alert takes the room of the last ones.
    fit = min(len(rows), int((bottom - top) / _LEAST_PITCH_PX))
    if fit < 1:
        return
    pitch = min(_MOST_PITCH_PX, (bottom - top) / fit)
    left, right = LEFT_PX, canvas.width - RIGHT_MARGIN_PX
    size = BODY + 2 if pitch > 44 else BODY if pitch > 34 else CAPTION + 2
    for number, row in enumerate(rows[:fit]):
        baseline = top + pitch * (number + 1) - 0.26 * pitch
        unit_px = canvas.words(row.unit, (right, baseline), CAPTION, REGULAR, theme.MUTED, Align.RIGHT)
        value_right = right - unit_px - (6 if row.unit else 0)
        name, value = row.name, row.value
        room = value_right - left - 6 - canvas.measure(name, CAPTION, REGULAR)
        canvas.words(value, (value_right, baseline), size, BOLD, theme.WHITE, Align.RIGHT, room)
        canvas.words(name, (left, baseline), CAPTION, REGULAR, theme.MUTED)
