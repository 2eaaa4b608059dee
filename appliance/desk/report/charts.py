"""Owns the drawings of a report besides the surface: how often which deviation occurs, colour bars, and the net of the
scans. SVG."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

import numpy as np

from appliance.desk.report.content import ReportNominal, ReportPair, ReportScan, ReportVerdict
from appliance.desk.report.shown import Colouring

BARS = 61
_WIDTH, _HEIGHT, _BASE = 640, 240, 200
INK, MUTED, LINE = "#1c2733", "#5b6b7b", "#d5dde5"
VERDICT_COLOURS = {
    ReportVerdict.GOOD: "#1a7f52",
    ReportVerdict.DOUBTFUL: "#b26a00",
    ReportVerdict.UNCHECKED: "#b26a00",
    ReportVerdict.REFUSED: "#b3261e",
}


def hex_of(colour: Sequence[float]) -> str:
    """Return a colour of three numbers 0..255 as HTML writes it."""
    return "#" + "".join(f"{round(part):02x}" for part in colour)


def colour_bar(one: Colouring) -> str:
    """Return the scale of a colouring with its ends and middle; empty for a plain picture."""
    if one.name == "Picture":
        return ""
    stops = "".join(
        f'<stop offset="{k / (len(one.colours) - 1):.3f}" stop-color="{hex_of(colour)}"/>'
        for k, colour in enumerate(one.colours)
    )
    name = f"bar-{one.name.lower()}"
    ticks = "".join(
        f'<text x="{10 + 400 * part:.0f}" y="40" text-anchor="{anchor}">{html.escape(_number(one.low + part * (one.high - one.low)))}</text>'
        for part, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end"))
    )
    unit = f" in {one.unit}" if one.unit else ""
    return (
        f'<svg class="bar" viewBox="0 0 620 48" role="img" aria-label="{one.name}{unit}"><defs><linearGradient id="{name}">{stops}'
        f'</linearGradient></defs><rect x="10" y="6" width="400" height="16" rx="3" fill="url(#{name})"/>'
        f'<g font-size="15" fill="{MUTED}">{ticks}<text x="424" y="20" fill="{INK}">{one.name}{html.escape(unit)}</text></g></svg>'
    )


def histogram(nominal: ReportNominal, colouring: Colouring) -> str:
    """Return how many points have which deviation, in the colours of the map; the outermost bars hold what lies farther
    out."""
    deviation = nominal.deviation.deviation_mm
    near = 1000.0 * deviation[np.isfinite(deviation)]
    low, high = colouring.low, colouring.high
    counts, edges = np.histogram(np.clip(near, low, high), BARS, (low, high))
    most = max(1, int(counts.max()))
    scale = np.asarray(colouring.colours, float)
    wide = (_WIDTH - 40) / BARS

    def x(value: float) -> float:
        return 20 + (value - low) / (high - low) * (_WIDTH - 40)

    drawn = []
    for k, count in enumerate(counts):
        place = (k + 0.5) / BARS * (len(scale) - 1)
        first = min(int(place), len(scale) - 2)
        colour = scale[first] + (place - first) * (scale[first + 1] - scale[first])
        tall = (_BASE - 16) * int(count) / most
        drawn.append(
            f'<rect x="{x(float(edges[k])):.1f}" y="{_BASE - tall:.1f}" width="{wide - 1:.1f}" height="{tall:.1f}" fill="{hex_of(colour)}" '
            f'stroke="{MUTED}" stroke-width=".4"/>'
        )
    ticks = "".join(
        f'<text x="{x(value):.1f}" y="{_BASE + 20}" text-anchor="middle">{_number(value)}</text>'
        for value in (low, low / 2, 0.0, high / 2, high)
    )
    marks = ""
    if nominal.tolerance_mm is not None:
        for value in (-1000.0 * nominal.tolerance_mm, 1000.0 * nominal.tolerance_mm):
            marks += f'<line x1="{x(value):.1f}" x2="{x(value):.1f}" y1="8" y2="{_BASE}" stroke="#b3261e" stroke-dasharray="5 4"/>'
    mean = nominal.deviation.summary.mean_mm
    if mean is not None and low < 1000.0 * mean < high:
        at = x(1000.0 * mean)
        marks += f'<path d="M{at:.1f} {_BASE} l-6 10 h12 z" fill="{INK}"/>'
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="Histogram of the deviations">{"".join(drawn)}'
        f'<line x1="20" x2="{_WIDTH - 20}" y1="{_BASE}" y2="{_BASE}" stroke="{MUTED}"/>{marks}'
        f'<g font-size="14" fill="{MUTED}">{ticks}<text x="{_WIDTH / 2}" y="{_HEIGHT - 4}" text-anchor="middle">deviation in µm, positive '
        "outside</text></g></svg>"
    )


def net(scans: Sequence[ReportScan], pairs: Sequence[ReportPair]) -> str:
    """Return where the scans were taken from and which pairs hold them together; empty where fewer than two have a
    place."""
    placed = {scan.name: scan for scan in scans if scan.position_mm is not None}
    if len(placed) < 2:
        return ""
    places = np.array([scan.position_mm for scan in placed.values()], float)
    centred = places - places.mean(axis=0)
    # The plane in which the places differ most: the two first right singular vectors.
    flat = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    if flat.shape[1] < 2:
        flat = np.column_stack([flat, np.zeros(len(flat))])
    reach = np.maximum(np.abs(flat).max(axis=0), 1e-6)
    scale = min(270.0 / reach[0], 110.0 / reach[1])
    at = {name: (320 + scale * p[0], 140 + scale * p[1]) for name, p in zip(placed, flat, strict=True)}
    lines = []
    for pair in sorted(pairs, key=lambda one: one.verdict is not ReportVerdict.REFUSED):
        if pair.first in at and pair.second in at:
            (x1, y1), (x2, y2) = at[pair.first], at[pair.second]
            dash = ' stroke-dasharray="4 4"' if pair.verdict is ReportVerdict.REFUSED else ""
            thick = 1.0 + 3.0 * math.sqrt((pair.overlap_percent or 0.0) / 100.0)
            lines.append(
                f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{VERDICT_COLOURS[pair.verdict]}" '
                f'stroke-opacity=".7" stroke-width="{thick:.1f}"{dash}/>'
            )
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="13" fill="#fff" stroke="{VERDICT_COLOURS[placed[name].verdict]}" stroke-width="2.5"/>'
        f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle">{html.escape(_short(name))}</text>'
        for name, (x, y) in at.items()
    )
    return (
        '<svg class="chart net" viewBox="0 0 640 280" role="img" aria-label="Places of the scans and the pairs between them">'
        f'{"".join(lines)}<g font-size="11" fill="{INK}">{dots}</g></svg>'
    )


def _short(name: str) -> str:
    """Return a name that fits into a dot: a scan's number without its zeros."""
    return (name.lstrip("0") or "0")[-4:]


def minus(text: str) -> str:
    """Return a number in digits with a minus sign as long as a plus."""
    return text.replace("-", "−")


def _number(value: float) -> str:
    return minus(f"{value:.0f}" if abs(value) >= 20 or value == 0 else f"{value:.1f}")
