"""Owns the pictures that the projector plays: drawn for one fringe period, and anew when the diver chooses another."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.config import Rig
from appliance.instrument import live_light_of
from appliance.patterns.draw import draw_sequence
from appliance.patterns.response import Response
from appliance.patterns.sequence import PatternSequence, build_sequence
from drivers.api import Projector


class Patterns:
    """The sequence in use and its pictures. For the thread that owns GL."""

    def __init__(self, gl: moderngl.Context, rig: Rig, period_px: int, response: Response | None) -> None:
        self._gl, self._rig, self._response = gl, rig, response
        self._pictures: list[NDArray[np.uint8]] = []
        self.sequence = self.use(period_px)

    def use(self, period_px: int) -> PatternSequence:
        """Draw the sequence of another period. A projector that is open has to be loaded again."""
        self.sequence = build_sequence(period_px, self._rig.projector.width_px, self._rig.projector.height_px)
        self._pictures = draw_sequence(self._gl, self.sequence, self._response)
        return self.sequence

    def load(self, projector: Projector) -> None:
        """Into its scan-out memory, with a dark picture behind the last pattern, which is shown, and the live views' light
        behind that. Raises DeviceError."""
        dark = np.zeros((self.sequence.height_px, self.sequence.width_px), np.uint8)
        projector.load([*self._pictures, dark, live_light_of(self._rig)])
        projector.show(len(self._pictures))
