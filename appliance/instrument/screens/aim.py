"""The screen of AIM: both live images, the distance, and the numbers.

draw_aim         the screen
draw_gauge       the distance: advice, scale, mm, and the surface as seen from above (``tilt_icon``)
draw_guidance    the way to the next view: an arrow at the border of the left image, and text at its lower edge
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.alerts import Severity
from appliance.instrument.machine.leading import GuidanceText, Leader, leader, passing
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.ranging.reach import Reach
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.frame import alert_text, alerts_top, draw_title, room_between
from appliance.instrument.screens.laser_marks import draw_marks
from appliance.instrument.screens.review import number_or_dash
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, REGULAR, TITLE
from appliance.instrument.screens.views import AimView, Gauge
from appliance.measure import FaultCode, Move, WorkingVolume

SCALE_PX = (208.0, 492.0)
"""Left and right end of the scale."""
_BEYOND_MM = 60.0
"""Length by which the scale exceeds both ends of the standard housing's volume."""
ADVICE = {
    Reach.CLOSER: (Text.CLOSER, theme.YELLOW),
    Reach.OK: (Text.OK, theme.GREEN),
    Reach.BACK: (Text.BACK, theme.YELLOW),
    Reach.UNKNOWN: (Text.NO_DOTS, theme.YELLOW),
}
_ICON_PX = 46
_ICON_DETAIL = 4


def draw_gauge(canvas: Canvas, gauge: Gauge | None, middle: float, right_colour: theme.Colour = theme.GREEN) -> None:
    """Draw a row of 54 px around ``middle``: advice, scale, mm, and the tilt of the surface from above.

    ``right_colour``: of a distance within the limits.
    """
    left, right = SCALE_PX
    word = None if gauge is None else gauge.word
    colour = theme.MUTED if word is None else right_colour if word is Reach.OK else ADVICE[word][1]
    if word is Reach.UNKNOWN:
        canvas.write(
            Text.DOT_ON_IT,
            ((left + right) / 2, middle + 10),
            CAPTION + 2,
            BOLD,
            theme.YELLOW,
            Align.CENTRE,
            right - left,
        )
    else:
        # Without a dot the scale has no mark; an instruction takes its place.
        _scale(canvas, word, middle, WorkingVolume() if gauge is None else gauge.volume, right_colour)
    distance_mm = None if gauge is None else gauge.distance_mm
    if word is not None:
        canvas.write(ADVICE[word][0], (16, middle + 13), TITLE - 4, BLACK, colour, max_width=left - 32)
    if gauge is not None and distance_mm is not None:
        low, high = _ends_mm(gauge.volume)
        # Clamped to the scale, unlike the number beside it: the mark shows the way back.
        mark_x = left + (min(max(distance_mm, low), high) - low) / (high - low) * (right - left)
        canvas.box(mark_x - 11, middle - 25, 22, 50, theme.INK, 11)
        canvas.box(mark_x - 7, middle - 21, 14, 42, theme.WHITE if word is Reach.OK else theme.YELLOW, 7)
    ink = theme.WHITE if word in (None, Reach.OK) else theme.YELLOW
    number = "—" if distance_mm is None else f"{distance_mm:.0f}"
    unit_px = canvas.write("mm", (660, middle + 12), CAPTION, BOLD, theme.MUTED, Align.RIGHT)
    canvas.write(number, (654 - unit_px, middle + 12), TITLE, BLACK, ink, Align.RIGHT)
    tilt_deg = None if gauge is None else gauge.tilt_deg
    tilt = None if tilt_deg is None else round(tilt_deg)
    canvas.image("tilt", tilt_icon(tilt), 676, middle - _ICON_PX / 2, _ICON_PX, _ICON_PX)
    canvas.write(
        "—" if tilt is None else f"{abs(tilt)}°", (canvas.width - 14, middle + 12), BODY, BOLD, theme.WHITE, Align.RIGHT
    )


def _ends_mm(volume: WorkingVolume) -> tuple[float, float]:
    """Return the distances at the left and the right end of the scale."""
    beyond_mm = volume.scaled(_BEYOND_MM)
    return volume.nearest_mm - beyond_mm, volume.farthest_mm + beyond_mm


def _scale(
    canvas: Canvas, word: Reach | None, middle: float, volume: WorkingVolume, right_colour: theme.Colour
) -> None:
    """Draw the scale: its bright part is the working volume, hollow while the object is not in it."""
    left, right = SCALE_PX
    low, high = _ends_mm(volume)
    per_mm = (right - left) / (high - low)
    canvas.box(left, middle - 4, right - left, 8, theme.LINE, 4)
    inside = word is Reach.OK
    x, width = left + (volume.nearest_mm - low) * per_mm, (volume.farthest_mm - volume.nearest_mm) * per_mm
    canvas.box(
        x,
        middle - 13,
        width,
        26,
        right_colour if inside else theme.INK,
        8,
        (right_colour if inside else theme.MUTED, 3),
    )
    canvas.box(left + (volume.working_mm - low) * per_mm - 2, middle - 13, 4, 26, theme.INK if inside else theme.MUTED)


# By integer degrees, so that an icon is drawn again only if it looks different.
@lru_cache(maxsize=8)
def tilt_icon(tilt_deg: int | None) -> NDArray[np.uint8]:
    """Return (h, w) uint8: the instrument below and the tilted surface above, seen from above."""
    size = _ICON_PX * _ICON_DETAIL
    picture = np.full((size, size), round(255 * theme.INK.green), np.uint8)
    middle, soft, bright = size // 2, 110, 240
    cv2.line(picture, (middle, size - 1), (middle, middle), (soft,), 2 * _ICON_DETAIL)
    if tilt_deg is not None:
        angle = math.radians(tilt_deg)
        reach = 0.46 * size
        # Farther is upwards: a positive tilt lifts the right end.
        ends = [
            (round(middle + side * reach * math.cos(angle)), round(0.36 * size - side * reach * math.sin(angle)))
            for side in (-1, 1)
        ]
        cv2.line(picture, ends[0], ends[1], (bright,), 5 * _ICON_DETAIL, cv2.LINE_AA)
    foot = np.array([[middle - 40, size - 1], [middle + 40, size - 1], [middle, size - 46]], np.int32)
    cv2.fillConvexPoly(picture, foot, (soft,), cv2.LINE_AA)
    return picture


WORDS_PX = BODY + 4
PLATE_PX, SMALL_PLATE_PX = 54.0, 42.0
_BOTH_PX = 220.0
"""Height of an image from which it has space for both plates."""
_ARROW_PX, _RIM_PX = 96.0, 5.0
_FROM_BORDER_PX = 54.0
"""Distance of the arrow's middle from the border of its area: its tip stays inside."""
_PLATES_PX = 56.0
"""Height of the plates along the image's upper edge."""


def draw_guidance(canvas: Canvas, guidance: GuidanceText, left: float, top: float, width: float, height: float) -> None:
    """Draw the guidance on the image at this place of the screen."""
    # Shape and text distinguish the cases, not only colour: no arrow, an arrow, or one that points back.
    ground, ink = {
        Move.GO_BACK: (theme.YELLOW, theme.INK),
        Move.SCAN_NOW: (theme.GREEN, theme.INK),
        Move.GO_ON: (theme.INK, theme.WHITE),
        None: (theme.INK, theme.WHITE),
    }[guidance.move]
    bottom, tall = top + height - 10, height > _BOTH_PX
    for label, size, plate in (
        (guidance.instruction, WORDS_PX, PLATE_PX),
        (guidance.overlap, CAPTION + 2, SMALL_PLATE_PX),
    ):
        # If there is space for one plate only, it is the instruction.
        if label is None or (size != WORDS_PX and guidance.instruction is not None and not tall):
            continue
        text = label
        wide = canvas.measure(text, size, BLACK) + 28
        canvas.box(left + 10, bottom - plate, wide, plate, ground, 10)
        canvas.write(text, (left + 10 + wide / 2, bottom - 0.26 * plate), size, BLACK, ink, Align.CENTRE)
        bottom -= plate + 2
    if guidance.toward is None:
        return
    # Between the text and the plates above, at the border that it points to.
    room = bottom - top - _PLATES_PX
    reach_x, reach_y, free_y = width / 2 - _FROM_BORDER_PX, height / 2 - _FROM_BORDER_PX, room / 2 - _FROM_BORDER_PX
    along = min(reach_x / max(abs(guidance.toward[0]), 1e-6), reach_y / max(abs(guidance.toward[1]), 1e-6))
    # Horizontally as far as the image goes; vertically only between the plates.
    x = left + width / 2 + along * guidance.toward[0]
    y = top + _PLATES_PX + room / 2 + min(max(along * guidance.toward[1], -free_y), free_y) * (free_y > 0.0)
    colour = theme.YELLOW if guidance.move is Move.GO_BACK else theme.WHITE
    canvas.arrow(x, y, _ARROW_PX, guidance.toward, colour, theme.INK, _RIM_PX)


LIVE_PX = (398.0, 298.5)
"""Nearly a quarter of the cameras' 1600 × 1200."""
GAUGE_MIDDLE_PX = 90.0
_TOP_PX = 119.0
_PLATE_PX = 42.0
_ABOUT_HEAT = (FaultCode.WARM, FaultCode.HOT, FaultCode.TOO_HOT, FaultCode.TEMPERATURE_UNKNOWN)


def draw_aim(canvas: Canvas, view: AimView, time_s: float) -> None:
    _title(canvas, view)
    # Green is for the leading part: beside a fault, a right distance is only a number.
    calm = _leads(view) in (Leader.OVERLAP, Leader.SCREEN) and view.scan_allowed
    draw_gauge(canvas, view.gauge, GAUGE_MIDDLE_PX, theme.GREEN if calm else theme.WHITE)
    width, room = LIVE_PX[0], alerts_top(canvas, view.alerts) - _TOP_PX
    # Images shrink for an alert, and are never covered: aiming goes on under a warning.
    height = min(LIVE_PX[1], room)
    top = _TOP_PX + (room - height) / 2
    right = canvas.width - width
    _live(canvas, "left", view.left, 0, top, height)
    _live(canvas, "right", view.right, right, top, height)
    if view.marks is not None:
        is_measured = view.gauge is not None and view.gauge.distance_mm is not None
        for pixels, tracks, left in ((view.left, view.marks.left, 0.0), (view.right, view.marks.right, right)):
            if pixels is not None:
                draw_marks(canvas, tracks, pixels, left, top, width, height, is_measured)
    _plate(canvas, "L", 10, top + 10)
    _plate(canvas, "R", right + 10, top + 10)
    if view.exposure is not None:
        _plate(canvas, view.exposure, 62, top + 10)
    if view.guidance is not None:
        draw_guidance(canvas, view.guidance, 0, top, width, height)
    elif view.overlap is not None:
        # Only without guidance: two percentages at once would be confused.
        ground, ink = (theme.YELLOW, theme.INK) if _leads(view) is Leader.OVERLAP else (theme.INK, theme.WHITE)
        _plate(canvas, view.overlap.label, 10, top + height - _PLATE_PX - 10, ground, ink)
    bottom = top + height - _PLATE_PX - 10
    # Without the camera, the text about its loss has the space.
    if view.water is not None and view.right is not None:
        _plate(canvas, view.water, right + 10, bottom)
    if view.object is not None and view.right is not None:
        above = bottom if view.water is None else bottom - _PLATE_PX - 2
        _plate(canvas, (Text.OBJECT, str(view.object)), right + 10, above)
    _temperature(canvas, view, top + 10)
    _numbers(canvas, view)


def _leads(view: AimView) -> Leader:
    return leader(view.alerts, view.overlap, Reach.UNKNOWN if view.gauge is None else view.gauge.word)


def _title(canvas: Canvas, view: AimView) -> None:
    """Draw READY, or the cause for which a scan would fail; no title if an alert or the distance leads."""
    leads, passing_alert = _leads(view), passing(view.alerts)
    if not view.scan_allowed:
        draw_title(canvas, Text.NOT_READY, view.keys, theme.YELLOW)
    elif leads is Leader.PASSING and passing_alert is not None:
        draw_title(canvas, alert_text(passing_alert, canvas.language)[0], view.keys, theme.YELLOW)
    elif leads in (Leader.OVERLAP, Leader.SCREEN):
        draw_title(canvas, Text.READY, view.keys)


def _live(
    canvas: Canvas,
    side: str,
    pixels: NDArray[np.uint8] | None,
    left: float,
    top: float,
    height: float,
) -> None:
    """Draw a camera's image (h, w) into its half of the screen, or a text if there is none."""
    width = LIVE_PX[0]
    if pixels is not None:
        canvas.image(side, pixels, left, top, width, height)
        return
    name = Text.LEFT_CAMERA if side == "left" else Text.RIGHT_CAMERA
    canvas.box(left, top, width, height, theme.DEEP, 10, (theme.YELLOW, 4))
    middle, level = left + width / 2, top + 0.5 * (height + _PLATE_PX + 10)
    canvas.write(name, (middle, level - 6), TITLE - 6, BOLD, theme.WHITE, Align.CENTRE)
    canvas.write(Text.NO_IMAGE, (middle, level + 36), TITLE, BLACK, theme.YELLOW, Align.CENTRE)


def _plate(
    canvas: Canvas,
    text: Label,
    x: float,
    top: float,
    ground: theme.Colour = theme.INK,
    ink: theme.Colour = theme.WHITE,
    align: Align = Align.LEFT,
) -> None:
    """Write text on an opaque ground, readable over any image."""
    # At least square, for L and R.
    width = max(_PLATE_PX, canvas.measure(text, CAPTION + 2, BLACK) + 20)
    left = x - align.value * width
    canvas.box(left, top, width, _PLATE_PX, ground, 10)
    canvas.write(text, (left + width / 2, top + 31), CAPTION + 2, BLACK, ink, Align.CENTRE)


def _temperature(canvas: Canvas, view: AimView, top: float) -> None:
    """Draw the housing's temperature in the colour of its band: white, yellow, or white on red."""
    # The colour follows from the alerts, so that number and warning never disagree.
    band = max((alert.severity for alert in view.alerts if alert.code in _ABOUT_HEAT), default=Severity.INFO)
    ground, ink = {
        Severity.INFO: (theme.INK, theme.WHITE),
        Severity.WARNING: (theme.YELLOW, theme.INK),
        Severity.CRITICAL: (theme.BLOOD, theme.WHITE),
    }[band]
    # With its name, since beside the water it would be taken for the water's.
    text = (Text.HOUSING, f"{number_or_dash(view.temperature_c, '{:.0f}')} °C")
    _plate(canvas, text, canvas.width - 10, top, ground, ink, Align.RIGHT)


def _numbers(canvas: Canvas, view: AimView) -> None:
    """Draw the number of scans, and of those that still fit, between the lower labels."""
    left, right = room_between(canvas, view.keys, bottom=True)
    cells = (
        (str(view.scans_taken), Text.TAKEN),
        ("—" if view.scans_left is None else str(view.scans_left), Text.LEFT_OVER),
    )
    gap, space = 28.0, 7.0
    size = TITLE - 2
    # German labels and a count like 98765 leave too little space for the larger type.
    total = sum(canvas.measure(n, size, BLACK) + space + canvas.measure(u, CAPTION, REGULAR) for n, u in cells) + gap
    if total > right - left:
        size, gap = BODY, 16.0
        total = (
            sum(canvas.measure(n, size, BLACK) + space + canvas.measure(u, CAPTION, REGULAR) for n, u in cells) + gap
        )
    x, baseline = (left + right - total) / 2, canvas.height - 16
    for number, unit in cells:
        x += canvas.write(number, (x, baseline), size, BLACK) + space
        x += canvas.write(unit, (x, baseline), CAPTION, REGULAR, theme.MUTED) + gap
