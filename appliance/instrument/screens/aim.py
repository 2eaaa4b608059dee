"""Owns the screen on which the diver chooses the place: both live pictures, the distance, what is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.alerts import Severity
from appliance.instrument.machine.leading import Leader, leader, passing
from appliance.instrument.machine.words import Language, Text
from appliance.instrument.ranging.reach import Reach
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alerts_top, draw_title, room_between, words_of
from appliance.instrument.screens.gauge import draw_gauge
from appliance.instrument.screens.guidance import draw_guidance
from appliance.instrument.screens.marks import draw_marks
from appliance.instrument.screens.texts import numbered, worded
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, REGULAR, TITLE
from appliance.instrument.screens.views import AimView
from appliance.measure import FaultCode

LIVE_PX = (398.0, 298.5)
"""Nearly a quarter of the cameras' 1600 × 1200."""
GAUGE_MIDDLE_PX = 90.0
_TOP_PX = 119.0
_PLATE_PX = 42.0
_ABOUT_HEAT = (FaultCode.WARM, FaultCode.HOT, FaultCode.TOO_HOT, FaultCode.TEMPERATURE_UNKNOWN)


def draw_aim(canvas: Canvas, view: AimView, language: Language) -> None:
    _title(canvas, view, language)
    # Green is for what leads: where something else is wrong, a right distance is no more than a number.
    calm = _leads(view) in (Leader.OVERLAP, Leader.SCREEN) and view.scan_allowed
    draw_gauge(canvas, view.gauge, GAUGE_MIDDLE_PX, language, theme.GREEN if calm else theme.WHITE)
    width, room = LIVE_PX[0], alerts_top(canvas, view.alerts) - _TOP_PX
    # An alert takes its room from the pictures: they are never covered, since aiming goes on under a warning.
    height = min(LIVE_PX[1], room)
    top = _TOP_PX + (room - height) / 2
    right = canvas.width - width
    _live(canvas, "left", view.left, 0, top, height, language)
    _live(canvas, "right", view.right, right, top, height, language)
    if view.marks is not None:
        seen = view.gauge is not None and view.gauge.distance_mm is not None
        for pixels, tracks, left in ((view.left, view.marks.left, 0.0), (view.right, view.marks.right, right)):
            if pixels is not None:
                draw_marks(canvas, tracks, pixels, left, top, width, height, seen)
    _plate(canvas, "L", 10, top + 10)
    _plate(canvas, "R", right + 10, top + 10)
    if view.exposure is not None:
        _plate(canvas, numbered(view.exposure, language), 62, top + 10)
    if view.guidance is not None:
        draw_guidance(canvas, view.guidance, 0, top, width, height, language)
    elif view.overlap is not None:
        # Of the scan before; two percentages at once would be taken for each other.
        ground, ink = (theme.YELLOW, theme.INK) if _leads(view) is Leader.OVERLAP else (theme.INK, theme.WHITE)
        _plate(canvas, worded(view.overlap.words, language), 10, top + height - _PLATE_PX - 10, ground, ink)
    bottom = top + height - _PLATE_PX - 10
    # Where the camera is gone, the words that say so have the room.
    if view.water is not None and view.right is not None:
        _plate(canvas, worded(view.water, language), right + 10, bottom)
    if view.object is not None and view.right is not None:
        above = bottom if view.water is None else bottom - _PLATE_PX - 2
        _plate(canvas, f"{Text.OBJECT.in_language(language)} {view.object}", right + 10, above)
    _temperature(canvas, view, top + 10, language)
    _numbers(canvas, view, language)


def _leads(view: AimView) -> Leader:
    return leader(view.alerts, view.overlap, Reach.UNKNOWN if view.gauge is None else view.gauge.word)


def _title(canvas: Canvas, view: AimView, language: Language) -> None:
    """Draw READY, or what a scan would fail for now; nothing where an alert in full or the distance says what is to be done."""
    leads, told = _leads(view), passing(view.alerts)
    if not view.scan_allowed:
        draw_title(canvas, Text.NOT_READY.in_language(language), view.keys, language, theme.YELLOW)
    elif leads is Leader.PASSING and told is not None:
        draw_title(canvas, words_of(told, language)[0], view.keys, language, theme.YELLOW)
    elif leads in (Leader.OVERLAP, Leader.SCREEN):
        draw_title(canvas, Text.READY.in_language(language), view.keys, language)


def dash_or(value: float | None, pattern: str) -> str:
    """Return a number, or a dash where it is not known."""
    return "—" if value is None else pattern.format(value)


def _live(
    canvas: Canvas,
    side: str,
    pixels: NDArray[np.uint8] | None,
    left: float,
    top: float,
    height: float,
    language: Language,
) -> None:
    """Draw a camera's (h, w) picture into its half of the screen, as high as an alert leaves room for, or say that there is none."""
    width = LIVE_PX[0]
    if pixels is not None:
        canvas.image(side, pixels, left, top, width, height)
        return
    name = Text.LEFT_CAMERA if side == "left" else Text.RIGHT_CAMERA
    canvas.box(left, top, width, height, theme.DEEP, 10, theme.YELLOW, 4)
    middle, level = left + width / 2, top + 0.5 * (height + _PLATE_PX + 10)
    canvas.words(name.in_language(language), middle, level - 6, TITLE - 6, BOLD, theme.WHITE, Align.CENTRE)
    canvas.words(Text.NO_IMAGE.in_language(language), middle, level + 36, TITLE, BLACK, theme.YELLOW, Align.CENTRE)


def _plate(
    canvas: Canvas,
    words: str,
    x: float,
    top: float,
    ground: theme.Colour = theme.INK,
    ink: theme.Colour = theme.WHITE,
    align: Align = Align.LEFT,
) -> None:
    """Write words on a ground of their own: what is behind may be as bright as it likes."""
    # Never narrower than high: L and R stand in squares.
    width = max(_PLATE_PX, canvas.measure(words, CAPTION + 2, BLACK) + 20)
    left = x - align.value * width
    canvas.box(left, top, width, _PLATE_PX, ground, 10)
    canvas.words(words, left + width / 2, top + 31, CAPTION + 2, BLACK, ink, Align.CENTRE)


def _temperature(canvas: Canvas, view: AimView, top: float, language: Language) -> None:
    """Draw the housing's temperature in the colour of its band: white, yellow, or white on red."""
    # The colour comes from the alerts, not from limits of its own: number and warning can then never disagree.
    band = max((alert.severity for alert in view.alerts if alert.code in _ABOUT_HEAT), default=Severity.INFO)
    ground, ink = {
        Severity.INFO: (theme.INK, theme.WHITE),
        Severity.WARNING: (theme.YELLOW, theme.INK),
        Severity.CRITICAL: (theme.BLOOD, theme.WHITE),
    }[band]
    # Named: beside the water it would be read as the water's.
    said = f"{Text.HOUSING.in_language(language)} {dash_or(view.temperature_c, '{:.0f}')} °C"
    _plate(canvas, said, canvas.width - 10, top, ground, ink, Align.RIGHT)


def _numbers(canvas: Canvas, view: AimView, language: Language) -> None:
    """Draw how many scans there are, and for how many more there is room, between the lower labels."""
    left, right = room_between(canvas, view.keys, language, bottom=True)
    cells = (
        (str(view.scans_taken), Text.TAKEN.in_language(language)),
        ("—" if view.scans_left is None else str(view.scans_left), Text.LEFT_OVER.in_language(language)),
    )
    gap, space = 28.0, 7.0
    size = TITLE - 2
    # German labels and a count like 98765 leave too little room for the larger type.
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
