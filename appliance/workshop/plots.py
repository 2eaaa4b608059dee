"""Owns what steps put on the page: curves, photographs as PNG in memory, and tables with a column each for what is
compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, HEIGHT_PX = 900, 340
_LEFT, _RIGHT, _TOP, _FOOT = 70, 20, 16, 44
_INK, _LINE = (51, 39, 28), (229, 221, 213)
_COLOURS = ((158, 105, 17), (30, 38, 179), (82, 127, 26), (0, 106, 178), (120, 60, 120), (90, 90, 90))
TICKS = 5


def plot(
    curves: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]],
    across: str,
    upwards: str,
    marks: Sequence[float] = (),
) -> bytes:
    """Draw curves (x, y) by name into axes that hold all of them, with upright lines at ``marks``; return a PNG."""
    image = np.full((HEIGHT_PX, WIDTH_PX, 3), 255, np.uint8)
    xs = np.concatenate([x for x, _ in curves.values()])
    ys = np.concatenate([y for _, y in curves.values()])
    low = np.array([xs.min(), min(0.0, float(ys.min()))])
    # A flat curve has no height of its own: without a least span, its noise would fill the picture.
    span = np.maximum(np.array([xs.max(), ys.max()]) - low, 1e-9)

    def place(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int32]:
        u = _LEFT + (x - low[0]) / span[0] * (WIDTH_PX - _LEFT - _RIGHT)
        v = HEIGHT_PX - _FOOT - (y - low[1]) / span[1] * (HEIGHT_PX - _FOOT - _TOP)
        return np.asarray(np.rint(np.stack([u, v], axis=1)), np.int32)

    for k in range(TICKS + 1):
        x, y = low + span * k / TICKS
        (u, _), (_, v) = place(np.array([x, low[0]]), np.array([low[1], y])).tolist()
        cv2.line(image, (u, _TOP), (u, HEIGHT_PX - _FOOT), _LINE, 1)
        cv2.line(image, (_LEFT, v), (WIDTH_PX - _RIGHT, v), _LINE, 1)
        _write(image, f"{x:.4g}", (u - 14, HEIGHT_PX - _FOOT + 16))
        _write(image, f"{y:.3g}", (8, v + 4))
    for mark in marks:
        # Limits stand out by being the only lines in red.
        ends = place(np.array([mark, mark]), np.array([low[1], low[1] + span[1]])).tolist()
        cv2.line(image, tuple(ends[0]), tuple(ends[1]), (30, 38, 179), 1)
    for k, (name, (x_values, y_values)) in enumerate(curves.items()):
        colour = _COLOURS[k % len(_COLOURS)]
        cv2.polylines(image, [place(x_values, y_values)], False, colour, 2, cv2.LINE_AA)
        _write(image, name, (WIDTH_PX - 210, _TOP + 16 * (k + 1)), colour)
    _write(image, across, (WIDTH_PX // 2 - 60, HEIGHT_PX - 8))
    _write(image, upwards, (8, 12))
    return png(image)


def png(image: NDArray[np.uint8]) -> bytes:
    """Return an image (h, w) grey or (h, w, 3) BGR as PNG. Raises ValueError for what is none."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not done:
        raise ValueError(f"a picture of {image.shape} could not be encoded as PNG")
    return bytes(data)


def side_by_side(name: str, columns: Mapping[str, Mapping[str, str]]) -> tuple[Mapping[str, object], ...]:
    """Return the rows of a table with one column for each of ``columns``, and every key that one of them has under
    ``name``."""
    keys = dict.fromkeys(key for column in columns.values() for key in column)
    return tuple({name: key, **{title: column.get(key) for title, column in columns.items()}} for key in keys)


def _write(image: NDArray[np.uint8], text: str, at: tuple[int, int], colour: tuple[int, int, int] = _INK) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
