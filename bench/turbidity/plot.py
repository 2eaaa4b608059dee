"""Line plots: panels of named lines over a common kind of axis, drawn with OpenCV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

PANEL_PX, PLOT_PX, LEFT_PX, TOP_PX = (760, 430), (430, 330), 70, 50
INK, FAINT, WHITE = (40, 40, 40), (228, 228, 228), (255, 255, 255)
COLOURS = (
    (170, 120, 40),
    (60, 140, 60),
    (40, 110, 220),
    (150, 60, 150),
    (30, 30, 30),
    (160, 160, 0),
    (60, 60, 200),
    (130, 130, 130),
    (0, 150, 230),
)
FONT = cv2.FONT_HERSHEY_SIMPLEX
Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Line:
    """Points (x, y) in order, without those that are ``None``; ``bars`` are standard deviations of y."""

    name: str
    x: Sequence[float]
    y: Sequence[float | None]
    bars: Sequence[float | None] | None = None


@dataclass(frozen=True, slots=True)
class Panel:
    """Lines on axes with these marks; an axis of powers of ten where ``log``."""

    title: str
    lines: Sequence[Line]
    x_marks: Sequence[float]
    y_marks: Sequence[float]
    log_x: bool = False
    log_y: bool = False


def draw(path: Path, panels: Sequence[Panel]) -> None:
    """Write a PNG, two panels in a row."""
    rows = -(-len(panels) // 2)
    image: Image = np.full((rows * PANEL_PX[1], 2 * PANEL_PX[0], 3), 255, np.uint8)
    for k, panel in enumerate(panels):
        top, left = k // 2 * PANEL_PX[1], k % 2 * PANEL_PX[0]
        _panel(image[top : top + PANEL_PX[1], left : left + PANEL_PX[0]], panel)
    cv2.imwrite(str(path), image)


def place(value: float, marks: Sequence[float], log: bool) -> float:
    """Return the position of a value between the first mark (0) and the last (1), clipped to them."""
    low, high = marks[0], marks[-1]
    if log:
        value, low, high = math.log(max(value, 1e-12)), math.log(low), math.log(high)
    return min(max((value - low) / (high - low), 0.0), 1.0)


def _panel(image: Image, panel: Panel) -> None:
    def at(x: float, y: float) -> tuple[int, int]:
        across = place(x, panel.x_marks, panel.log_x)
        up = place(y, panel.y_marks, panel.log_y)
        return LEFT_PX + round(across * PLOT_PX[0]), TOP_PX + round((1.0 - up) * PLOT_PX[1])

    _write(image, panel.title, (LEFT_PX, TOP_PX - 18), 0.55)
    for mark in panel.x_marks:
        x, bottom = at(mark, panel.y_marks[0])
        cv2.line(image, (x, TOP_PX), (x, bottom), FAINT, 1)
        _write(image, f"{mark:g}", (x - 8, bottom + 20))
    for mark in panel.y_marks:
        left, y = at(panel.x_marks[0], mark)
        cv2.line(image, (left, y), (LEFT_PX + PLOT_PX[0], y), FAINT, 1)
        _write(image, f"{mark:g}", (8, y + 5))
    for k, line in enumerate(panel.lines):
        colour = COLOURS[k % len(COLOURS)]
        points = []
        bars = line.bars or [None] * len(line.x)
        for place_x, value, bar in zip(line.x, line.y, bars, strict=True):
            if value is None:
                continue
            points.append(at(place_x, value))
            cv2.circle(image, points[-1], 3, colour, -1, cv2.LINE_AA)
            if bar is not None:
                cv2.line(image, at(place_x, value - bar), at(place_x, value + bar), colour, 1, cv2.LINE_AA)
        cv2.polylines(image, [np.array(points, np.int32).reshape(-1, 1, 2)], False, colour, 2, cv2.LINE_AA)
        row = TOP_PX + 14 + 24 * k
        right = LEFT_PX + PLOT_PX[0] + 14
        cv2.line(image, (right, row), (right + 18, row), colour, 3)
        _write(image, line.name, (right + 24, row + 5), 0.42)


def _write(image: Image, text: str, position: tuple[int, int], size: float = 0.45) -> None:
    cv2.putText(image, text, position, FONT, size, INK, 1, cv2.LINE_AA)
