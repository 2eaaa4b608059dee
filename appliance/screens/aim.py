"""Owns the screen on which the diver chooses the place: both live pictures, the distance, what is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.capture.fault import FaultCode
from appliance.machine.alerts import Severity
from appliance.screens import theme
from appliance.screens.canvas import Align, Canvas
from appliance.screens.frame import alerts_top, draw_title, room_between
from appliance.screens.gauge import draw_gauge
from appliance.screens.texts import Language, Text, worded
from appliance.screens.theme import BAR_PX, BLACK, BODY, BOLD, CAPTION, REGULAR, TITLE
from appliance.screens.views import AimView

LIVE_PX = (398.0, 298.5)
"""Nearly a quarter of the cameras' 1600 × 1200."""
GAUGE_MIDDLE_PX = 90.0
_TOP_PX = 119.0
_PLATE_PX = 42.0
_ABOUT_HEAT = (FaultCode.WARM, FaultCode.HOT, FaultCode.TOO_HOT, FaultCode.TEMPERATURE_UNKNOWN)


def draw_aim(canvas: Canvas, view: AimView, language: Language) -> None:
    title, colour = (
        (Text.NOT_READY, theme.YELLOW)
        if not view.scan_allowed
        else (Text.SURE, theme.YELLOW)
        if view.insist
        else (Text.READY, theme.WHITE)
    )
    draw_title(canvas, title.in_language(language), view.keys, language, colour)
    draw_gauge(canvas, view.gauge, GAUGE_MIDDLE_PX, language)
    width, height = LIVE_PX
    top = _TOP_PX + max(0.0, canvas.height - BAR_PX - _TOP_PX - height) / 2
    right = canvas.width - width
    _live(canvas, "left", view.left, 0, top, language)
    _live(canvas, "right", view.right, right, top, language)
    _plate(canvas, "L", 10, top + 10)
    _plate(canvas, "R", right + 10, top + 10)
    if view.exposure is not None:
        _plate(canvas, view.exposure, 62, top + 10)
    if view.water is not None:
        _plate(canvas, worded(view.water, language), right + 62, top + 10)
    _temperature(canvas, view, top + 10)
    _numbers(canvas, view, language)
    if view.just_saved is not None:
        _saved(canvas, view.just_saved, min(top + height, alerts_top(canvas, view.alerts)), language)


def dash_or(value: float | None, pattern: str) -> str:
    """A number, or a dash where it is not known."""
    return "—" if value is None else pattern.format(value)


def _live(
    canvas: Canvas, side: str, pixels: NDArray[np.uint8] | None, left: float, top: float, language: Language
) -> None:
    width, height = LIVE_PX
    if pixels is not None:
        canvas.image(side, pixels, left, top, width, height)
        return
    name = Text.LEFT_CAMERA if side == "left" else Text.RIGHT_CAMERA
    canvas.box(left, top, width, height, theme.DEEP, 10, theme.YELLOW, 4)
    middle = left + width / 2
    canvas.words(name.in_language(language), middle, top + 92, TITLE - 6, BOLD, theme.WHITE, Align.CENTRE)
    canvas.words(Text.NO_IMAGE.in_language(language), middle, top + 138, TITLE, BLACK, theme.YELLOW, Align.CENTRE)


def _plate(
    canvas: Canvas,
    words: str,
    x: float,
    top: float,
    ground: theme.Colour = theme.INK,
    ink: theme.Colour = theme.WHITE,
    align: Align = Align.LEFT,
) -> None:
    """Words on a ground of their own: what is behind may be as bright as it likes."""
    width = max(_PLATE_PX, canvas.measure(words, CAPTION + 2, BLACK) + 20)
    left = x - align.value * width
    canvas.box(left, top, width, _PLATE_PX, ground, 10)
    canvas.words(words, left + width / 2, top + 31, CAPTION + 2, BLACK, ink, Align.CENTRE)


def _temperature(canvas: Canvas, view: AimView, top: float) -> None:
    """In the colour of its band: white, yellow, or white on red."""
    band = max((alert.severity for alert in view.alerts if alert.code in _ABOUT_HEAT), default=Severity.INFO)
    ground, ink = {
        Severity.INFO: (theme.INK, theme.WHITE),
        Severity.WARNING: (theme.YELLOW, theme.INK),
        Severity.CRITICAL: (theme.BLOOD, theme.WHITE),
    }[band]
    _plate(canvas, dash_or(view.temperature_c, "{:.0f}") + " °C", canvas.width - 10, top, ground, ink, Align.RIGHT)


def _numbers(canvas: Canvas, view: AimView, language: Language) -> None:
    """Between the lower labels: how many scans there are, and for how many more there is room."""
    left, right = room_between(canvas, view.keys, language, bottom=True)
    cells = (
        (str(view.scans_taken), Text.TAKEN.in_language(language)),
        ("—" if view.scans_left is None else str(view.scans_left), Text.LEFT_OVER.in_language(language)),
    )
    gap, space = 28.0, 7.0
    size = TITLE - 2
    total = sum(canvas.measure(n, size, BLACK) + space + canvas.measure(u, CAPTION, REGULAR) for n, u in cells) + gap
    if total > right - left:
        size, gap = BODY, 16.0
        total = (
            sum(canvas.measure(n, size, BLACK) + space + canvas.measure(u, CAPTION, REGULAR) for n, u in cells) + gap
        )
    x, baseline = (left + right - total) / 2, canvas.height - 16
    for number, unit in cells:
        x += canvas.words(number, x, baseline, size, BLACK) + space
        x += canvas.words(unit, x, baseline, CAPTION, REGULAR, theme.MUTED) + gap


def _saved(canvas: Canvas, scan_id: str, bottom: float, language: Language) -> None:
    words = f"{Text.SAVED.in_language(language)} {scan_id}"
    width = canvas.measure(words, TITLE, BLACK) + 64
    left, top = (canvas.width - width) / 2, bottom - 84
    canvas.box(left, top, width, 66, theme.INK, 33, theme.GREEN, 5)
    canvas.words(words, canvas.width / 2, top + 47, TITLE, BLACK, theme.WHITE, Align.CENTRE)
