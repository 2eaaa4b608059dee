"""Rings in the live images where the laser dots will appear; the diver aims the rings at the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.reach import Place, Track
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Canvas

_RING_PX, _RIM_PX = 22.0, 3.0
_END_PX = 6.0
_NOTHING = theme.INK.faded(0.0)


def draw_marks(
    canvas: Canvas,
    tracks: Sequence[Track],
    pixels: NDArray[np.uint8],
    left: float,
    top: float,
    width: float,
    height: float,
    is_measured: bool,
) -> None:
    """Draw a ring for each dot at the working distance, and two points for the ends of the working volume.

    ``pixels`` (h, w) is the image in the middle of the box, as large as fits; ``is_measured``: a dot was found, so that
    the marks need not attract attention.
    """
    shape = pixels.shape[1] / pixels.shape[0]
    shown_width, shown_height = min(width, height * shape), min(height, width / shape)
    left, top = left + (width - shown_width) / 2, top + (height - shown_height) / 2
    colour = theme.WHITE if is_measured else theme.YELLOW

    def dot(position: Place, size: float, fill: theme.Colour, rim: theme.Colour | None = None) -> None:
        x, y = left + position[0] * shown_width, top + position[1] * shown_height
        edge = None if rim is None else (rim, _RIM_PX)
        canvas.box(x - size / 2, y - size / 2, size, size, fill, size / 2, edge)

    for track in tracks:
        for end in (track.near, track.far):
            # Each mark has a dark rim, since the live image behind it may be white or black.
            dot(end, _END_PX + 2 * 2.0, theme.INK)
            dot(end, _END_PX, colour)
        dot(track.middle, _RING_PX + 2.0, _NOTHING, theme.INK)
        dot(track.middle, _RING_PX, _NOTHING, colour)
