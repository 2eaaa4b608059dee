"""Drawings for pages: curves, histograms, bars and colour scales, as PNG in memory or SVG."""

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
    """Colours 0..255 from the lowest value to the highest, equally spaced."""

    SEQUENTIAL = (68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)
    """Viridis, by S. van der Walt and N. Smith: even steps, also in grey and for readers who see no red or green."""
    DIVERGING = (33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)
    """Blue to red through white, after C. Brewer's RdBu: negative, none, positive."""
    GREYS = (20, 20, 20), (250, 250, 250)

    def of(self, values: NDArray[Any], low: float, high: float) -> NDArray[np.float32]:
        """Return the colours of ``values`` (n,) as (n, 3) float32, 0..255; light grey for NaN.

        ``low`` has the first colour of the scale, ``high`` the last.
        """
        scale = np.asarray(self.value, np.float32)
        scaled = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0) * (len(scale) - 1)
        is_finite = np.isfinite(scaled)
        position = np.where(is_finite, scaled, 0.0)
        k = np.minimum(position.astype(np.int64), len(scale) - 2)
        weight = (position - k)[:, None].astype(np.float32)
        between = scale[k] * (1 - weight) + scale[k + 1] * weight
        return np.asarray(np.where(is_finite[:, None], between, np.float32(200)), np.float32)

    @property
    def stops(self) -> list[tuple[float, str]]:
        """Share of the range from lowest to highest value, and colour as HTML writes it, of each colour."""
        return [(k / (len(self.value) - 1), _hex(colour)) for k, colour in enumerate(self.value)]


def draw_curves(
    curves: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]],
    across: str,
    upwards: str,
    marks: Sequence[float] = (),
) -> bytes:
    """Draw curves (x, y) by name into axes that hold all of them; return a PNG.

    ``marks``: positions of upright lines.
    """
    image = np.full((HEIGHT_PX, WIDTH_PX, 3), 255, np.uint8)
    xs = np.concatenate([x for x, _ in curves.values()])
    ys = np.concatenate([y for _, y in curves.values()])
    low = np.array([xs.min(), min(0.0, float(ys.min()))])
    # The span must not be zero: a flat curve has no height.
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
        # Limits are the only lines in red.
        ends = place(np.array([mark, mark]), np.array([low[1], low[1] + span[1]])).tolist()
        cv2.line(image, tuple(ends[0]), tuple(ends[1]), (30, 38, 179), 1)
    # Names go to the upper corner that the curves leave free.
    middle = low[0] + 0.5 * span[0]
    rises = ys[xs >= middle].max(initial=low[1]) > ys[xs < middle].max(initial=low[1])
    names_px = _LEFT + 10 if rises else WIDTH_PX - 210
    for k, (name, (x_values, y_values)) in enumerate(curves.items()):
        colour = _COLOURS[k % len(_COLOURS)]
        cv2.polylines(image, [place(x_values, y_values)], False, colour, 2, cv2.LINE_AA)
        _write(image, name, (names_px, _TOP + 16 * (k + 1)), colour)
    _write(image, across, (WIDTH_PX // 2 - 60, HEIGHT_PX - 8))
    _write(image, upwards, (8, 12))
    return png(image)


def png(image: NDArray[np.uint8]) -> bytes:
    """Return an image (h, w) grey or (h, w, 3) BGR as PNG. Raises ValueError if it cannot be encoded."""
    is_encoded, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not is_encoded:
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
    """Draw a histogram of ``values`` (n,) between ``low`` and ``high``, as a complete ``svg`` element.

    Colours go from blue over white to red. The outermost bars include the values beyond them; NaN is left out.
    ``what``: the text below the axis; ``marks``: upright lines; ``mean``: a triangle below the axis.
    """
    counts, edges = np.histogram(np.clip(values[np.isfinite(values)], low, high), BARS, (low, high))
    largest_count = max(1, int(counts.max()))
    width = (_WIDE - 40) / BARS

    def x(value: float) -> float:
        return 20 + (value - low) / (high - low) * (_WIDE - 40)

    shapes = []
    colours = ColourScale.DIVERGING.of(0.5 * (edges[1:] + edges[:-1]), low, high).tolist()
    for edge, count, colour in zip(edges, counts, colours, strict=False):
        height = (_BASE - 16) * int(count) / largest_count
        shapes.append(
            f'<rect x="{x(float(edge)):.1f}" y="{_BASE - height:.1f}" width="{width - 1:.1f}" height="{height:.1f}" '
            f'fill="{_hex(colour)}" stroke="{_MUTED}" stroke-width=".4"/>'
        )
    shapes += [
        f'<line x1="{x(mark):.1f}" x2="{x(mark):.1f}" y1="8" y2="{_BASE}" stroke="#b3261e" stroke-dasharray="5 4"/>'
        for mark in marks
    ]
    if mean is not None and low < mean < high:
        shapes.append(f'<path d="M{x(mean):.1f} {_BASE} l-6 10 h12 z" fill="#1c2733"/>')
    ticks = "".join(
        f'<text x="{x(value):.1f}" y="{_BASE + 20}" text-anchor="middle">{number_text(value)}</text>'
        for value in (low, low / 2, 0.0, high / 2, high)
    )
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDE} {_HIGH}" role="img" aria-label="Histogram: {what}">{"".join(shapes)}'
        f'<line x1="20" x2="{_WIDE - 20}" y1="{_BASE}" y2="{_BASE}" stroke="{_MUTED}"/>'
        f'<g font-size="14" fill="{_MUTED}">{ticks}<text x="{_WIDE / 2}" y="{_HIGH - 4}" text-anchor="middle">{what}'
        "</text></g></svg>"
    )


def bars(shares: Mapping[str, float], marked: Container[str] = ()) -> str:
    """Draw a bar for each name, full for a share of 1, as a complete ``svg`` element.

    Those of ``marked`` are red.
    """
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


def _write(
    image: NDArray[np.uint8], text: str, origin_px: tuple[int, int], colour: tuple[int, int, int] = _INK
) -> None:
    cv2.putText(image, text, origin_px, cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
