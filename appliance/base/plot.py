"""Owns the drawings of pages: curves, how often which value occurs, bars, colour scales. PNG in memory, or SVG."""

from __future__ import annotations

import html
from collections.abc import Container, Mapping, Sequence
from enum import Enum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, HEIGHT_PX = 900, 340
_LEFT, _RIGHT, _TOP, _FOOT = 70, 20, 30, 44
_INK, _LINE = (51, 39, 28), (229, 221, 213)
_COLOURS = ((158, 105, 17), (30, 38, 179), (82, 127, 26), (0, 106, 178), (120, 60, 120), (90, 90, 90))
TICKS = 5
BARS = 61
_WIDE, _HIGH, _BASE, _LINE_PX = 640, 240, 200, 17
_MUTED = "#5b6b7b"


class ColourScale(Enum):
    """Colours 0..255 from the lowest value to the highest, evenly apart."""

    SEQUENTIAL = (68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)
    """Viridis, by S. van der Walt and N. Smith: even steps, also in grey and for those who see no red or green."""
    DIVERGING = (33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)
    """Blue to red through white, after C. Brewer's RdBu: negative, none, positive."""
    GREYS = (20, 20, 20), (250, 250, 250)

    def of(self, values: NDArray[Any], low: float, high: float) -> NDArray[np.float32]:
        """Return the colour of each of the values (n,), the first one at ``low`` and the last at ``high``: (n, 3)
        float32, 0..255; light grey for NaN."""
        scale = np.asarray(self.value, np.float32)
        part = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0) * (len(scale) - 1)
        known = np.isfinite(part)
        place = np.where(known, part, 0.0)
        k = np.minimum(place.astype(np.int64), len(scale) - 2)
        rest = (place - k)[:, None].astype(np.float32)
        between = scale[k] * (1 - rest) + scale[k + 1] * rest
        return np.asarray(np.where(known[:, None], between, np.float32(200)), np.float32)

    @property
    def stops(self) -> list[tuple[float, str]]:
        """Share of the way from the lowest value to the highest, and colour as HTML writes it, of each colour."""
        return [(k / (len(self.value) - 1), _hex(colour)) for k, colour in enumerate(self.value)]


def draw_curves(
    drawn: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]],
    across: str,
    upwards: str,
    marks: Sequence[float] = (),
) -> bytes:
    """Draw curves (x, y) by name into axes that hold all of them, with upright lines at ``marks``; return a PNG."""
    image = np.full((HEIGHT_PX, WIDTH_PX, 3), 255, np.uint8)
    xs = np.concatenate([x for x, _ in drawn.values()])
    ys = np.concatenate([y for _, y in drawn.values()])
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
    # Names stand in the upper corner that the curves leave free.
    middle = low[0] + 0.5 * span[0]
    rises = ys[xs >= middle].max(initial=low[1]) > ys[xs < middle].max(initial=low[1])
    names_px = _LEFT + 10 if rises else WIDTH_PX - 210
    for k, (name, (x_values, y_values)) in enumerate(drawn.items()):
        colour = _COLOURS[k % len(_COLOURS)]
        cv2.polylines(image, [place(x_values, y_values)], False, colour, 2, cv2.LINE_AA)
        _write(image, name, (names_px, _TOP + 16 * (k + 1)), colour)
    _write(image, across, (WIDTH_PX // 2 - 60, HEIGHT_PX - 8))
    _write(image, upwards, (8, 12))
    return png(image)


def png(image: NDArray[np.uint8]) -> bytes:
    """Return an image (h, w) grey or (h, w, 3) BGR as PNG. Raises ValueError for what is none."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not done:
        raise ValueError(f"a picture of {image.shape} could not be encoded as PNG")
    return bytes(data)


def histogram(
    values: NDArray[Any],
    low: float,
    high: float,
    what: str,
    marks: Sequence[float] = (),
    mean: float | None = None,
) -> str:
    """Draw how many of the values (n,) lie where between ``low`` and ``high``, in colours from blue over white to red;
    the outermost bars hold what lies farther out, NaN is left out. ``what``: the words below the axis. ``marks``:
    upright lines; ``mean``: a triangle below the axis. Returns a whole ``svg`` element."""
    counts, edges = np.histogram(np.clip(values[np.isfinite(values)], low, high), BARS, (low, high))
    most = max(1, int(counts.max()))
    wide = (_WIDE - 40) / BARS

    def x(value: float) -> float:
        return 20 + (value - low) / (high - low) * (_WIDE - 40)

    drawn = []
    colours = ColourScale.DIVERGING.of(0.5 * (edges[1:] + edges[:-1]), low, high).tolist()
    for edge, count, colour in zip(edges, counts, colours, strict=False):
        tall = (_BASE - 16) * int(count) / most
        drawn.append(
            f'<rect x="{x(float(edge)):.1f}" y="{_BASE - tall:.1f}" width="{wide - 1:.1f}" height="{tall:.1f}" '
            f'fill="{_hex(colour)}" stroke="{_MUTED}" stroke-width=".4"/>'
        )
    drawn += [
        f'<line x1="{x(mark):.1f}" x2="{x(mark):.1f}" y1="8" y2="{_BASE}" stroke="#b3261e" stroke-dasharray="5 4"/>'
        for mark in marks
    ]
    if mean is not None and low < mean < high:
        drawn.append(f'<path d="M{x(mean):.1f} {_BASE} l-6 10 h12 z" fill="#1c2733"/>')
    ticks = "".join(
        f'<text x="{x(value):.1f}" y="{_BASE + 20}" text-anchor="middle">{number_text(value)}</text>'
        for value in (low, low / 2, 0.0, high / 2, high)
    )
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDE} {_HIGH}" role="img" aria-label="Histogram: {what}">{"".join(drawn)}'
        f'<line x1="20" x2="{_WIDE - 20}" y1="{_BASE}" y2="{_BASE}" stroke="{_MUTED}"/>'
        f'<g font-size="14" fill="{_MUTED}">{ticks}<text x="{_WIDE / 2}" y="{_HIGH - 4}" text-anchor="middle">{what}'
        "</text></g></svg>"
    )


def bars(shares: Mapping[str, float], marked: Container[str] = ()) -> str:
    """Draw a bar for each name, full for a share of 1; those of ``marked`` in red. Returns a whole ``svg`` element."""
    parts = []
    for k, (name, share) in enumerate(shares.items()):
        y = 4 + k * _LINE_PX
        parts += [f'<text x="2" y="{y + 12}">{html.escape(name)}</text>'] + [
            f'<rect x="260" y="{y + 2}" width="{200 * part:.1f}" height="{_LINE_PX - 5}" fill="{colour}"/>'
            for part, colour in ((1.0, "#ddd"), (share, "#b2182b" if name in marked else "#2166ac"))
        ]
    return (
        f'<svg width="480" viewBox="0 0 480 {_LINE_PX * len(shares) + 8}" font-size="12" role="img" '
        f'aria-label="Bars">{"".join(parts)}</svg>'
    )


def _hex(colour: Sequence[float]) -> str:
    return "#" + "".join(f"{round(part):02x}" for part in colour)


def minus(text: str) -> str:
    """Return a number in digits with a minus sign as long as a plus."""
    return text.replace("-", "−")


def number_text(value: float) -> str:
    """Return a number as an axis has it: whole from 20 on, else to a tenth."""
    return minus(f"{value:.0f}" if abs(value) >= 20 or value == 0 else f"{value:.1f}")


def _write(image: NDArray[np.uint8], text: str, at: tuple[int, int], colour: tuple[int, int, int] = _INK) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
