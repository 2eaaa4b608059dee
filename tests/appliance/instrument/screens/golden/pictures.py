"""Owns where the golden pictures lie, how each is drawn, and when two pictures are the same to an eye."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from appliance.instrument.machine.words import Language
from appliance.instrument.screens import theme
from appliance.instrument.screens.canvas import Canvas
from appliance.instrument.screens.frame import alerts_top, draw_alerts
from appliance.instrument.screens.painter import Painter
from tests.appliance.instrument.screens.golden.scenes import ALERTS, SCENES

FOLDER = Path(__file__).parent
SIZE_PX = (800, 480)
COMMAND = "./dev run python -m tests.appliance.instrument.screens.golden"
FINE_PX, COARSE_PX = 3.0, 12.0
"""Blurs under which pictures are compared: about the width of a letter's stroke, and of a line of text."""
SHRINK = 4
"""Before the coarse blur, which it saves time to make on a smaller picture."""
FINE, COARSE = 62.0, 22.0
"""Largest differences, of 255, that another rasteriser of fonts or another GL may make under each."""
Picture = NDArray[np.uint8]
"""(h, w, 3) RGB."""


class Golden(NamedTuple):
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


def write(path: Path, picture: Picture) -> None:
    """Write a small file, with 256 colours."""
    reduced = Image.fromarray(picture).quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(path, optimize=True)


def read(path: Path) -> Picture:
    """Read a picture. Raises ValueError for a file that is none."""
    picture = cv2.imread(str(path))
    if picture is None:
        raise ValueError(f"{path} cannot be read; draw it again: {COMMAND}")
    return np.ascontiguousarray(picture[:, :, ::-1], np.uint8)


class Difference(NamedTuple):
    """Largest differences of two pictures under each blur, in levels of 255."""

    fine: float
    coarse: float
    at: tuple[int, int]
    """Column and row of the largest fine one."""

    @property
    def same(self) -> bool:
        return self.fine <= FINE and self.coarse <= COARSE


def compare(one: Picture, other: Picture) -> Difference:
    """Compare two pictures: the edge of a letter may lie otherwise by a pixel, things may not."""
    assert one.shape == other.shape
    away = one.astype(np.float32) - other.astype(np.float32)
    small = cv2.resize(away, None, fx=1 / SHRINK, fy=1 / SHRINK, interpolation=cv2.INTER_AREA)
    fine = np.abs(cv2.GaussianBlur(away, (0, 0), FINE_PX)).max(axis=2)
    coarse = np.abs(cv2.GaussianBlur(small, (0, 0), COARSE_PX / SHRINK))
    row, column = np.unravel_index(int(fine.argmax()), fine.shape)
    return Difference(float(fine.max()), float(coarse.max()), (int(column), int(row)))


class Studio:
    def __init__(self, context: moderngl.Context, painter: Painter, canvas: Canvas) -> None:
        self._context, self.painter, self._canvas = context, painter, canvas

    def draw(self, golden: Golden) -> Picture:
        """Return a copy: a screen, or the band that an alert takes on any of them."""
        if not golden.alert:
            self.painter.language = golden.language
            scene = SCENES[golden.name]
            return self.painter.draw(scene.view, scene.time_s).copy()
        alert = ALERTS[golden.name]
        with self._context:
            self._canvas.begin(theme.INK)
            self._canvas.language = golden.language
            draw_alerts(self._canvas, (alert,), 0.0)
            top = round(alerts_top(self._canvas, (alert,)))
            return self._canvas.finish()[top : SIZE_PX[1] - theme.BAR_PX].copy()


@contextmanager
def studio(context: moderngl.Context) -> Iterator[Studio]:
    with Painter(context, SIZE_PX) as painter:
        with context:
            canvas = Canvas(context, SIZE_PX)
        try:
            yield Studio(context, painter, canvas)
        finally:
            with context:
                canvas.close()
