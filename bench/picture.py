"""Owns the pictures of benchmarks: horizontal bars on a logarithmic axis, drawn with OpenCV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, ROW_PX, LABEL_PX, MARGIN_PX = 1100, 34, 300, 24
INK, BAR, FAINT = (40, 40, 40), (170, 120, 40), (225, 225, 225)
FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_bars(path: Path, panels: Sequence[tuple[str, Mapping[str, float]]]) -> None:
    """Write a PNG: each panel a title and its bars, all on one scale of powers of ten."""
    values = [value for _, bars in panels for value in bars.values()]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    rows = sum(len(bars) + 2 for _, bars in panels) + 1
    image = np.full((rows * ROW_PX + MARGIN_PX, WIDTH_PX, 3), 255, np.uint8)
    span_px = WIDTH_PX - LABEL_PX - 4 * MARGIN_PX

    def x_of(value: float) -> int:
        return LABEL_PX + int(span_px * (math.log10(value) - low) / (high - low))

    for power in range(low, high + 1):
        x = x_of(10.0**power)
        cv2.line(image, (x, MARGIN_PX), (x, rows * ROW_PX - ROW_PX // 2), FAINT, 1)
        write(image, f"{10**power:g}", (x - 12, rows * ROW_PX + 8))
    y = MARGIN_PX
    for title, bars in panels:
        y += ROW_PX
        write(image, title, (MARGIN_PX, y - 8), 0.6)
        for name, value in bars.items():
            write(image, name, (MARGIN_PX, y + ROW_PX - 12))
            cv2.rectangle(image, (LABEL_PX, y + 6), (x_of(value), y + ROW_PX - 6), BAR, -1)
            write(image, f"{value:.3g}", (x_of(value) + 6, y + ROW_PX - 12))
            y += ROW_PX
        y += ROW_PX
    cv2.imwrite(str(path), image)


def write(image: NDArray[np.uint8], text: str, at: tuple[int, int], size: float = 0.5) -> None:
    """Text with its base line at ``at``."""
    cv2.putText(image, text, at, FONT, size, INK, 1, cv2.LINE_AA)
