"""Picture of an endurance run: delays of the flips after their blanks, and memory over scans; drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

WIDTH_PX, HEIGHT_PX, LEFT_PX, TOP_PX = 1000, 300, 90, 50
PERIOD_MS = 1000.0 / 60.0
INK, FAINT = (40, 40, 40), (225, 225, 225)
COLOURS = ((170, 120, 40), (60, 60, 200))
FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_run(path: Path, answers_us: Sequence[float], memory_mb: Mapping[str, Sequence[float]]) -> None:
    """Write a PNG: a histogram of ``answers_us`` (counts on a logarithmic axis, a mark at the next blank), and a line for each of ``memory_mb``."""
    image = np.full((2 * HEIGHT_PX + 3 * TOP_PX, WIDTH_PX, 3), 255, np.uint8)
    _histogram(image[: HEIGHT_PX + TOP_PX + 30], answers_us)
    _lines(image[HEIGHT_PX + TOP_PX + 30 :], memory_mb)
    cv2.imwrite(str(path), image)


def _histogram(image: np.ndarray, answers_us: Sequence[float]) -> None:
    longest_ms = max(20.0, max(answers_us) / 1e3)
    counts, edges = np.histogram(np.array(answers_us) / 1e3, bins=40, range=(0.0, longest_ms))
    tall = np.log10(1.0 + counts) / np.log10(1.0 + counts.max())
    step = (WIDTH_PX - 2 * LEFT_PX) / len(counts)
    for k, height in enumerate(tall):
        x = int(LEFT_PX + k * step)
        corner = (x, int(TOP_PX + HEIGHT_PX * (1.0 - height)))
        cv2.rectangle(image, corner, (int(x + step) - 2, TOP_PX + HEIGHT_PX), COLOURS[0], -1)
        if counts[k]:
            _write(image, str(counts[k]), (x, corner[1] - 5), 0.4)
    blank = int(LEFT_PX + len(counts) * step * PERIOD_MS / longest_ms)
    cv2.line(image, (blank, TOP_PX), (blank, TOP_PX + HEIGHT_PX), INK, 2)
    for share in (0, 20, 40):
        _write(image, f"{edges[share]:.0f}", (int(LEFT_PX + share * step) - 12, TOP_PX + HEIGHT_PX + 20))
    _write(
        image,
        f"From blank to the next flip, ms ({len(answers_us)} flips, counts logarithmic; the mark: too late)",
        (LEFT_PX, 26),
        0.6,
    )


def _lines(image: np.ndarray, memory_mb: Mapping[str, Sequence[float]]) -> None:
    top = 1.1 * max(max(line) for line in memory_mb.values())
    for share in (0.0, 0.5, 1.0):
        y = int(TOP_PX + HEIGHT_PX * (1.0 - share))
        cv2.line(image, (LEFT_PX, y), (WIDTH_PX - LEFT_PX, y), FAINT, 1)
        _write(image, f"{share * top:.0f}", (20, y + 5))
    for (name, line), colour in zip(memory_mb.items(), COLOURS, strict=False):
        across = LEFT_PX + np.linspace(0, WIDTH_PX - 2 * LEFT_PX, max(2, len(line)))[: len(line)]
        down = TOP_PX + HEIGHT_PX * (1.0 - np.asarray(line) / top)
        points = np.stack([across, down], -1).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(image, [points], False, colour, 2, cv2.LINE_AA)
        _write(image, name, (int(across[-1]) - 200, int(down[-1]) - 10))
    _write(image, "Own memory from scan to scan, MB", (LEFT_PX, 26), 0.6)


def _write(image: np.ndarray, text: str, position_px: tuple[int, int], size: float = 0.5) -> None:
    cv2.putText(image, text, position_px, FONT, size, INK, 1, cv2.LINE_AA)
