"""Owns the picture of a distance: how far the object is, how it is turned, and in a word what to do about it."""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine.words import Language, Text
from appliance.instrument.ranging.reach import Reach
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.theme import BLACK, BODY, BOLD, CAPTION, TITLE
from appliance.instrument.screens.views import Gauge
from appliance.measure import WorkingVolume

SCALE_PX = (208.0, 492.0)
"""Left and right end of the scale."""
_BEYOND_MM = 60.0
"""Length by which the scale goes on to both sides of the standard housing's volume."""
ADVICE = {
    Reach.CLOSER: (Text.CLOSER, theme.YELLOW),
    Reach.OK: (Text.OK, theme.GREEN),
    Reach.BACK: (Text.BACK, theme.YELLOW),
    Reach.UNKNOWN: (Text.NO_DOTS, theme.YELLOW),
}
_ICON_PX = 46
_ICON_DETAIL = 4


def draw_gauge(
    canvas: Canvas, gauge: Gauge | None, middle: float, language: Language, right_colour: theme.Colour = theme.GREEN
) -> None:
    """Draw a row of 54 px around ``middle``: word, scale, mm, and the surface as seen from above with its tilt. ``right_colour``: of a
    distance that is right."""
    left, right = SCALE_PX
    word = None if gauge is None else gauge.word
    colour = theme.MUTED if word is None else right_colour if word is Reach.OK else ADVICE[word][1]
    if word is Reach.UNKNOWN:
        hint = Text.DOT_ON_IT.in_language(language)
        canvas.words(hint, (left + right) / 2, middle + 10, CAPTION + 2, BOLD, theme.YELLOW, Align.CENTRE, right - left)
    else:
        # Without a dot the scale has no mark: its place is used to say what makes one.
        _scale(canvas, word, middle, WorkingVolume() if gauge is None else gauge.volume, right_colour)
    distance_mm = None if gauge is None else gauge.distance_mm
    if word is not None:
        said = ADVICE[word][0].in_language(language)
        canvas.words(said, 16, middle + 13, TITLE - 4, BLACK, colour, max_width=left - 32)
    if gauge is not None and distance_mm is not None:
        low, high = _ends_mm(gauge.volume)
        # Held at the end of the scale, while the number beside it goes on: the mark shows the way back.
        at = left + (min(max(distance_mm, low), high) - low) / (high - low) * (right - left)
        canvas.box(at - 11, middle - 25, 22, 50, theme.INK, 11)
        canvas.box(at - 7, middle - 21, 14, 42, theme.WHITE if word is Reach.OK else theme.YELLOW, 7)
    ink = theme.WHITE if word in (None, Reach.OK) else theme.YELLOW
    number = "—" if distance_mm is None else f"{distance_mm:.0f}"
    unit_px = canvas.words("mm", 660, middle + 12, CAPTION, BOLD, theme.MUTED, Align.RIGHT)
    canvas.words(number, 654 - unit_px, middle + 12, TITLE, BLACK, ink, Align.RIGHT)
    tilt_deg = None if gauge is None else gauge.tilt_deg
    tilt = None if tilt_deg is None else round(tilt_deg)
    canvas.image("tilt", tilt_icon(tilt), 676, middle - _ICON_PX / 2, _ICON_PX, _ICON_PX)
    said = "—" if tilt is None else f"{abs(tilt)}°"
    canvas.words(said, canvas.width - 14, middle + 12, BODY, BOLD, theme.WHITE, Align.RIGHT)


def _ends_mm(volume: WorkingVolume) -> tuple[float, float]:
    """Return the distances at the left and the right end of the scale."""
    beyond_mm = volume.scaled(_BEYOND_MM)
    return volume.nearest_mm - beyond_mm, volume.farthest_mm + beyond_mm


def _scale(
    canvas: Canvas, word: Reach | None, middle: float, volume: WorkingVolume, right_colour: theme.Colour
) -> None:
    """Draw the scale: its bright part is the measuring volume, hollow while the object is not in it."""
    left, right = SCALE_PX
    low, high = _ends_mm(volume)
    per_mm = (right - left) / (high - low)
    canvas.box(left, middle - 4, right - left, 8, theme.LINE, 4)
    inside = word is Reach.OK
    x, width = left + (volume.nearest_mm - low) * per_mm, (volume.farthest_mm - volume.nearest_mm) * per_mm
    canvas.box(
        x, middle - 13, width, 26, right_colour if inside else theme.INK, 8, right_colour if inside else theme.MUTED, 3
    )
    canvas.box(left + (volume.working_mm - low) * per_mm - 2, middle - 13, 4, 26, theme.INK if inside else theme.MUTED)


# By whole degrees, so that an icon is drawn anew only where it would look different.
@lru_cache(maxsize=8)
def tilt_icon(tilt_deg: int | None) -> NDArray[np.uint8]:
    """Return (h, w) uint8: the instrument below, the surface above, seen from above; turned as it is in the water."""
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
