"""Pictures of benchmarks: horizontal bars on a logarithmic axis, drawn with OpenCV."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, ROW_PX, LABEL_PX, MARGIN_PX = 1200, 34, 330, 24
INK, BAR, LATE, FAINT = (40, 40, 40), (170, 120, 40), (40, 110, 220), (225, 225, 225)
"""Blue, green, red. A bar beyond its target is LATE."""
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Bar:
    """One value, with a whisker for its spread, a mark for its target and a remark."""

    name: str
    value: float
    spread: tuple[float, float] | None = None
    target: float | None = None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Panel:
    """Bars that belong together."""

    title: str
    bars: Sequence[Bar]


def draw(path: Path, panels: Sequence[Panel]) -> None:
    """Write a PNG: all bars on one scale of powers of ten. Values are positive."""
    values = [bar.value for panel in panels for bar in panel.bars]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    rows = sum(len(panel.bars) + 2 for panel in panels) + 1
    image = np.full((rows * ROW_PX + MARGIN_PX, WIDTH_PX, 3), 255, np.uint8)
    span_px = WIDTH_PX - LABEL_PX - 9 * MARGIN_PX

    def x_of(value: float) -> int:
        place = (math.log10(value) - low) / max(high - low, 1)
        return LABEL_PX + int(span_px * min(max(place, 0.0), 1.0))

    for power in range(low, high + 1):
        x = x_of(10.0**power)
        cv2.line(image, (x, MARGIN_PX), (x, rows * ROW_PX - ROW_PX // 2), FAINT, 1)
        write(image, f"{10**power:g}", (x - 12, rows * ROW_PX + 8))
    y = MARGIN_PX
    for panel in panels:
        y += ROW_PX
        cv2.rectangle(image, (0, y - ROW_PX + 6), (WIDTH_PX, y - 1), (255, 255, 255), -1)
        write(image, panel.title, (MARGIN_PX, y - 10), 0.6)
        for bar in panel.bars:
            draw_bar(image, bar, y, x_of)
            y += ROW_PX
        y += ROW_PX
    cv2.imwrite(str(path), image)


def draw_bar(image: NDArray[np.uint8], bar: Bar, y: int, x_of: Callable[[float], int]) -> None:
    """Draw one row, its top at ``y``."""
    middle, end = y + ROW_PX // 2, x_of(bar.value)
    late = bar.target is not None and bar.value > bar.target
    write(image, bar.name, (MARGIN_PX, y + ROW_PX - 12))
    cv2.rectangle(image, (LABEL_PX, y + 6), (end, y + ROW_PX - 6), LATE if late else BAR, -1)
    value_text = f"{bar.value:.0f}" if bar.value >= 100.0 else f"{bar.value:.3g}"
    if bar.spread is not None:
        first, last = (x_of(value) for value in bar.spread)
        cv2.line(image, (first, middle), (last, middle), INK, 2)
        end = max(end, last)
    if bar.target is not None:
        x = x_of(bar.target)
        cv2.line(image, (x, y + 1), (x, y + ROW_PX - 1), INK, 2)
        value_text += f"  (target {bar.target:.3g})"
        end = max(end, x)
    write(image, f"{value_text}  {bar.note}".rstrip(), (end + 8, y + ROW_PX - 12))


def write(image: NDArray[np.uint8], text: str, position_px: tuple[int, int], size: float = 0.5) -> None:
    """Draw text with its base line at ``position_px``."""
    cv2.putText(image, text, position_px, FONT, size, INK, 1, cv2.LINE_AA)
