"""Owns how the way to the next view is drawn on the left live picture: an arrow at its border, and words at its lower edge."""

from __future__ import annotations

from appliance.machine.guiding import GuidanceSaid
from appliance.machine.words import Language
from appliance.scan.guidance import Move
from appliance.screens import theme
from appliance.screens.canvas import Align, Canvas
from appliance.screens.texts import worded
from appliance.screens.theme import BLACK, BODY

WORDS_PX = BODY + 4
PLATE_PX = 54.0
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
    }[said.move]
    words = worded(said.words, language)
    plate = canvas.measure(words, WORDS_PX, BLACK) + 28
    bottom = top + height - 10
    canvas.box(left + 10, bottom - PLATE_PX, plate, PLATE_PX, ground, 10)
    canvas.words(words, left + 10 + plate / 2, bottom - 15, WORDS_PX, BLACK, ink, Align.CENTRE)
    if said.toward is None:
        return
    # Between the words and the plates above, at the border that it points to.
    room = height - PLATE_PX - 10 - _PLATES_PX
    reach_x, reach_y = width / 2 - _FROM_BORDER_PX, max(room / 2 - _FROM_BORDER_PX, 0.0)
    along = min(reach_x / max(abs(said.toward[0]), 1e-6), reach_y / max(abs(said.toward[1]), 1e-6))
    # Where the room is low a steep arrow still goes to its side.
    x = left + width / 2 + max(along, reach_y) * said.toward[0]
    y = top + _PLATES_PX + room / 2 + along * said.toward[1]
    colour = theme.YELLOW if said.move is Move.GO_BACK else theme.WHITE
    canvas.arrow(x, y, _ARROW_PX, said.toward, colour, theme.INK, _RIM_PX)
