"""Owns the screen on which the diver chooses the place: both live pictures, the distance, what is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.capture.ranging import FARTHEST_MM, NEAREST_MM, Reach
from appliance.screens import theme
from appliance.screens.canvas import Align, Canvas
from appliance.screens.texts import Language, Text
from appliance.screens.theme import BLACK, BOLD, CAPTION, REGULAR, TITLE
from appliance.screens.views import AimView, Gauge

ADVICE = {
    Reach.CLOSER: Text.CLOSER,
    Reach.OK: Text.OK,
    Reach.BACK: Text.BACK,
    Reach.UNKNOWN: Text.NO_DOTS,
}
GAUGE_MM = (380.0, 620.0)
_GAUGE_PX = (196.0, 604.0)
_TOP_PX, _IMAGE_PX = 64.0, (400.0, 300.0)
"""A quarter of the cameras' 1600 × 1200: reduced by whole pixels."""


def draw_aim(canvas: Canvas, view: AimView, language: Language) -> None:
    ready = Text.READY if view.scan_allowed else Text.NOT_READY
    canvas.words(
        ready.in_language(language), canvas.width / 2, 44, TITLE, BLACK,
        theme.WHITE if view.scan_allowed else theme.YELLOW, Align.CENTRE,
    )  # fmt: skip
    width, height = _IMAGE_PX
    _live(canvas, "left", view.left, 0, language)
    _live(canvas, "right", view.right, canvas.width - width, language)
    canvas.box((canvas.width - 6) / 2, _TOP_PX, 6, height, theme.INK)
    if view.exposure is not None:
        _exposure(canvas, view.exposure)
    _gauge(canvas, view.gauge, _TOP_PX + height + 30, language)
    _numbers(canvas, view, language)
    if view.just_saved is not None:
        _saved(canvas, view.just_saved, language)


def dash_or(value: float | None, pattern: str) -> str:
    """A number, or a dash where it is not known."""
    return "—" if value is None else pattern.format(value)


def _live(canvas: Canvas, side: str, pixels: NDArray[np.uint8] | None, left: float, language: Language) -> None:
    width, height = _IMAGE_PX
    if pixels is not None:
        canvas.image(side, pixels, left, _TOP_PX, width, height)
        canvas.box(left + 10, _TOP_PX + 10, 38, 38, theme.INK.faded(0.65), 10)
        canvas.words(side[0].upper(), left + 29, _TOP_PX + 38, CAPTION + 2, BLACK, theme.WHITE, Align.CENTRE)
        return
    name = Text.LEFT_CAMERA if side == "left" else Text.RIGHT_CAMERA
    canvas.box(left, _TOP_PX, width, height, theme.DEEP, 10, theme.YELLOW, 4)
    middle = left + width / 2
    canvas.words(name.in_language(language), middle, _TOP_PX + 138, TITLE - 6, BOLD, theme.WHITE, Align.CENTRE)
    canvas.words(Text.NO_IMAGE.in_language(language), middle, _TOP_PX + 186, TITLE, BLACK, theme.YELLOW, Align.CENTRE)


def _exposure(canvas: Canvas, exposure: str) -> None:
    """In the corner of the pictures that are taken with it."""
    width = canvas.measure(exposure, CAPTION, BOLD) + 24
    canvas.box(58, _TOP_PX + 10, width, 38, theme.INK.faded(0.65), 10)
    canvas.words(exposure, 58 + width / 2, _TOP_PX + 37, CAPTION, BOLD, theme.WHITE, Align.CENTRE)


def _gauge(canvas: Canvas, gauge: Gauge | None, middle: float, language: Language) -> None:
    """Where the object is, on a scale whose bright part is the measuring volume; and which way to go."""
    low, high = GAUGE_MM
    left, right = _GAUGE_PX
    distance_mm = None if gauge is None else gauge.distance_mm

    def at(mm: float) -> float:
        return left + (min(max(mm, low), high) - low) / (high - low) * (right - left)

    canvas.box(left, middle - 5, right - left, 10, theme.LINE, 5)
    good = gauge is not None and gauge.word is Reach.OK
    canvas.box(
        at(NEAREST_MM), middle - 9, at(FARTHEST_MM) - at(NEAREST_MM), 18, theme.GREEN if good else theme.MUTED, 9
    )
    canvas.box(at(500.0) - 2, middle - 9, 4, 18, theme.INK)
    colour = theme.WHITE if gauge is None or good else theme.YELLOW
    if distance_mm is not None:
        canvas.box(at(distance_mm) - 10, middle - 22, 20, 44, theme.INK, 10)
        canvas.box(at(distance_mm) - 7, middle - 19, 14, 38, colour, 7)
    if gauge is not None:
        word = ADVICE[gauge.word].in_language(language)
        canvas.words(word, left - 16, middle + 12, theme.BODY + 2, BLACK, colour, Align.RIGHT, 172)
    canvas.words(
        dash_or(distance_mm, "{:.0f}") + " mm", canvas.width - 16, middle + 13, TITLE - 4, BOLD, colour, Align.RIGHT
    )


def _numbers(canvas: Canvas, view: AimView, language: Language) -> None:
    cells = (
        (str(view.scans_taken), Text.TAKEN.in_language(language)),
        ("—" if view.scans_left is None else str(view.scans_left), Text.LEFT_OVER.in_language(language)),
        (dash_or(view.temperature_c, "{:.0f}"), "°C"),
    )
    sizes = [
        (canvas.measure(number, TITLE - 4, BOLD), canvas.measure(unit, CAPTION, REGULAR)) for number, unit in cells
    ]
    gap, space = 26.0, 6.0
    # Centred between the labels: the lower left key has none on this screen as a rule, the lower right has.
    total = sum(a + space + b for a, b in sizes) + gap * (len(cells) - 1)
    x, baseline = (canvas.width - theme.LABEL_MAX_PX - total) / 2 + 60, canvas.height - 18
    for (number, unit), (number_px, unit_px) in zip(cells, sizes, strict=True):
        canvas.words(number, x, baseline, TITLE - 4, BOLD)
        canvas.words(unit, x + number_px + space, baseline, CAPTION, REGULAR, theme.MUTED)
        x += number_px + space + unit_px + gap


def _saved(canvas: Canvas, scan_id: str, language: Language) -> None:
    words = f"{Text.SAVED.in_language(language)} {scan_id}"
    width = canvas.measure(words, TITLE, BLACK) + 64
    left, top = (canvas.width - width) / 2, _TOP_PX + _IMAGE_PX[1] - 84
    canvas.box(left, top, width, 66, theme.INK, 33, theme.GREEN, 5)
    canvas.words(words, canvas.width / 2, top + 47, TITLE, BLACK, theme.WHITE, Align.CENTRE)
