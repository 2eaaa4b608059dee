"""Owns how the way to the next view is drawn on the left live picture: an arrow at its border, and words at its lower edge."""

from __future__ import annotations

from appliance.instrument.machine.guiding import GuidanceSaid
from appliance.instrument.machine.words import Language
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Align, Canvas
from appliance.instrument.screens.texts import worded
from appliance.instrument.screens.theme import BLACK, BODY, CAPTION
from appliance.measure import Move

WORDS_PX = BODY + 4
PLATE_PX, SMALL_PLATE_PX = 54.0, 42.0
_BOTH_PX = 220.0
"""Height of a picture from which on both plates have room on it."""
_ARROW_PX, _RIM_PX = 96.0, 5.0
_FROM_BORDER_PX = 54.0
"""Distance of the arrow's middle from the border of its room: its tip stays inside."""
_PLATES_PX = 56.0
"""Height of what is written along the picture's upper edge."""


def draw_guidance(
    canvas: Canvas, said: GuidanceSaid, left: float, top: float, width: float, height: float, language: Language
) -> None:
    """Draw on the picture that has this place on the screen."""
    # Shape tells as well as colour: no arrow, one, or the other way, and words of their own.
    ground, ink = {
        Move.GO_BACK: (theme.YELLOW, theme.INK),
        Move.SCAN_NOW: (theme.GREEN, theme.INK),
        Move.GO_ON: (theme.INK, theme.WHITE),
        None: (theme.INK, theme.WHITE),
    }[said.move]
    bottom, tall = top + height - 10, height > _BOTH_PX
    for label, size, plate in ((said.words, WORDS_PX, PLATE_PX), (said.overlap, CAPTION + 2, SMALL_PLATE_PX)):
        # What to do stays where there is no room for how much.
        if label is None or (size != WORDS_PX and said.words is not None and not tall):
            continue
        words = worded(label, language)
        wide = canvas.measure(words, size, BLACK) + 28
        canvas.box(left + 10, bottom - plate, wide, plate, ground, 10)
        canvas.words(words, left + 10 + wide / 2, bottom - 0.26 * plate, size, BLACK, ink, Align.CENTRE)
        bottom -= plate + 2
    if said.toward is None:
        return
    # Between the words and the plates above, at the border that it points to.
    room = bottom - top - _PLATES_PX
    reach_x, reach_y, free_y = width / 2 - _FROM_BORDER_PX, height / 2 - _FROM_BORDER_PX, room / 2 - _FROM_BORDER_PX
    along = min(reach_x / max(abs(said.toward[0]), 1e-6), reach_y / max(abs(said.toward[1]), 1e-6))
    # To the side it points to, as far as the whole picture has room; up and down, only between the plates.
    x = left + width / 2 + along * said.toward[0]
    y = top + _PLATES_PX + room / 2 + min(max(along * said.toward[1], -free_y), free_y) * (free_y > 0.0)
    colour = theme.YELLOW if said.move is Move.GO_BACK else theme.WHITE
    canvas.arrow(x, y, _ARROW_PX, said.toward, colour, theme.INK, _RIM_PX)
