"""Owns where the pictures lie and how each is drawn."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.machine.alerts import Alert
from appliance.machine.words import Language
from appliance.screens import theme
from appliance.screens.canvas import Canvas
from appliance.screens.frame import alerts_top, draw_alerts
from appliance.screens.painter import Painter
from tests.appliance.screens.golden.scenes import ALERTS, SCENES

FOLDER = Path(__file__).parent
SIZE_PX = (800, 480)


@dataclass(frozen=True, slots=True)
class Golden:
    """One picture, by its name in ``SCENES`` or ``ALERTS``."""

    name: str
    language: Language
    alert: bool

    @property
    def path(self) -> Path:
        return FOLDER / f"{'alert-' if self.alert else ''}{self.name}.{self.language.value}.png"


EVERY = (
    *(Golden(name, language, False) for language in Language for name in SCENES),
    *(Golden(name, language, True) for language in Language for name in ALERTS),
)


class Studio:
    """Draws any of them, with one painter for all."""

    def __init__(self, context: moderngl.Context, painter: Painter, canvas: Canvas) -> None:
        self._context = context
        self.painter = painter
        self.canvas = canvas

    def draw(self, golden: Golden) -> NDArray[np.uint8]:
        """(h, w, 3) uint8 RGB, a copy."""
        if golden.alert:
            return self._band(ALERTS[golden.name], golden.language)
        self.painter.language = golden.language
        scene = SCENES[golden.name]
        return self.painter.draw(scene.view, scene.time_s).copy()

    def _band(self, alert: Alert, language: Language) -> NDArray[np.uint8]:
        """The part of the screen that an alert takes: the same on every screen."""
        with self._context:
            self.canvas.begin(theme.INK)
            draw_alerts(self.canvas, (alert,), language, 0.0)
            top = round(alerts_top(self.canvas, (alert,)))
            return self.canvas.finish()[top : SIZE_PX[1] - theme.BAR_PX].copy()


@contextmanager
def studio(context: moderngl.Context) -> Iterator[Studio]:
    """Raises what a painter raises."""
    with Painter(context, SIZE_PX) as painter:
        with context:
            canvas = Canvas(context, SIZE_PX)
        try:
            yield Studio(context, painter, canvas)
        finally:
            with context:
                canvas.close()
