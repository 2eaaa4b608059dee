"""Picture of ranging: error over distance, a mark per scene by object, a panel per water."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.ranging.scenes import OBJECTS, WATERS

WIDTH_PX, PANEL_PX, LEFT_PX, TOP_PX = 1200, 260, 90, 40
NEAR_MM, FAR_MM, MOST_MM = 350.0, 620.0, 4.0
INK, FAINT, BAND = (40, 40, 40), (225, 225, 225), (235, 245, 232)
MARKS = ((170, 120, 40), (40, 110, 220), (60, 150, 60), (150, 60, 150), (40, 40, 200), (130, 130, 20), (90, 90, 90))
"""A colour per object; blue, green, red."""
FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a PNG."""
    image = np.full((TOP_PX + len(WATERS) * PANEL_PX + 60, WIDTH_PX, 3), 255, np.uint8)
    for k, water in enumerate(WATERS):
        _panel(image, TOP_PX + k * PANEL_PX, water, [row for row in rows if row["water"] == water])
    x = LEFT_PX
    for name, colour in zip(OBJECTS, MARKS, strict=True):
        cv2.circle(image, (x, image.shape[0] - 22), 5, colour, -1, cv2.LINE_AA)
        cv2.putText(image, name, (x + 12, image.shape[0] - 17), FONT, 0.5, INK, 1, cv2.LINE_AA)
        x += 140
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path} cannot be written")


def _panel(image: NDArray[np.uint8], top: int, water: str, rows: Sequence[dict[str, Any]]) -> None:
    right, height = WIDTH_PX - 30, PANEL_PX - 50

    def at(distance_mm: float, error_mm: float) -> tuple[int, int]:
        x = LEFT_PX + (distance_mm - NEAR_MM) / (FAR_MM - NEAR_MM) * (right - LEFT_PX)
        inside = min(max(error_mm, -MOST_MM), MOST_MM)
        return round(x), round(top + height / 2 - inside / MOST_MM * height / 2)

    cv2.rectangle(image, at(NEAR_MM, 2.0), at(FAR_MM, -2.0), BAND, -1)
    for error in (-4.0, -2.0, 0.0, 2.0, 4.0):
        cv2.line(image, at(NEAR_MM, error), at(FAR_MM, error), FAINT, 1)
        cv2.putText(image, f"{error:+g}", (LEFT_PX - 42, at(NEAR_MM, error)[1] + 5), FONT, 0.45, INK, 1, cv2.LINE_AA)
    for distance in range(350, 621, 50):
        x, y = at(float(distance), -MOST_MM)
        cv2.line(image, (x, top), (x, y), FAINT, 1)
        cv2.putText(image, f"{distance}", (x - 14, y + 18), FONT, 0.45, INK, 1, cv2.LINE_AA)
    cv2.putText(
        image, f"error in mm against distance in mm, {water}", (LEFT_PX, top - 8), FONT, 0.5, INK, 1, cv2.LINE_AA
    )
    colours = dict(zip(OBJECTS, MARKS, strict=True))
    for row in rows:
        if row["error_mm"] is not None and row["true_mm"] is not None:
            cv2.circle(image, at(row["true_mm"], row["error_mm"]), 4, colours[row["object"]], -1, cv2.LINE_AA)
