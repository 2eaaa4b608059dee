"""Owns the drawings of a calibration's report: what is left over the image, how the cost fell, what was seen. SVG."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.water.artefact import Residuals
from appliance.measure import Estimate

Array = NDArray[np.float64]

WIDTH = 480
MARGIN = 40
CELLS = (20, 15)
FEWEST_IN_CELL = 3
ARROW = 0.9
"""Length of the longest usual arrow, in cells."""


def residual_svg(residuals: Residuals, size_px: tuple[int, int]) -> tuple[str, float]:
    """Return the mean residuals over cells of the left image as arrows, and the px that an arrow of one cell stands
    for."""
    width_px, height_px = size_px
    cell = width_px / CELLS[0]
    column = np.clip(residuals.left_px[:, 0] / width_px * CELLS[0], 0, CELLS[0] - 1).astype(np.intp)
    row = np.clip(residuals.left_px[:, 1] / height_px * CELLS[1], 0, CELLS[1] - 1).astype(np.intp)
    which = row * CELLS[0] + column
    count = np.bincount(which, minlength=CELLS[0] * CELLS[1])
    total = np.stack([np.bincount(which, m, minlength=count.size) for m in residuals.miss_px.T], -1)
    mean = total / np.maximum(count, 1)[:, None]
    shown = np.flatnonzero(count >= FEWEST_IN_CELL)
    longest = float(np.percentile(np.linalg.norm(mean[shown], axis=1), 95)) if shown.size else 0.0
    scale = ARROW * cell / max(longest, 1e-9)
    lines = []
    for k in shown:
        x, y = (k % CELLS[0] + 0.5) * cell, (k // CELLS[0] + 0.5) * height_px / CELLS[1]
        dx, dy = mean[k] * scale
        lines.append(
            f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{0.06 * cell:.0f}"/>'
            f'<line x1="{x:.0f}" y1="{y:.0f}" x2="{x + dx:.0f}" y2="{y + dy:.0f}"/>'
        )
    style = f'stroke="#222" stroke-width="{0.05 * cell:.1f}" fill="#222"'
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" viewBox="0 0 {width_px} {height_px}">'
        f"<g {style}>{''.join(lines)}</g></svg>"
    )
    return svg, longest / ARROW


def cost_svg(costs: tuple[float, ...]) -> str:
    """Return the cost before the first step and after each, on a logarithmic scale."""
    height = WIDTH // 2
    log = np.log10(np.maximum(costs, 1e-300))
    low, high = np.floor(log.min()), max(np.ceil(log.max()), np.floor(log.min()) + 1.0)
    x = MARGIN + np.arange(len(log)) * (WIDTH - 2 * MARGIN) / max(1, len(log) - 1)
    y = MARGIN / 2 + (high - log) / (high - low) * (height - 1.5 * MARGIN)
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3"/>' for a, b in zip(x, y, strict=True))
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    labels = [
        f'<text x="2" y="{MARGIN / 2 + 4:.0f}">1e{high:.0f}</text>',
        f'<text x="2" y="{height - MARGIN}">1e{low:.0f}</text>',
    ]
    labels += [f'<text x="{a - 4:.1f}" y="{height - 8}">{k}</text>' for k, a in enumerate(x)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" viewBox="0 0 {WIDTH} {height}" font-size="13">'
        f'<polyline points="{path}" fill="none" stroke="#2166ac" stroke-width="2"/>{dots}{"".join(labels)}</svg>'
    )


def seen_svg(estimates: tuple[Estimate, ...]) -> str:
    """Draw how far the recordings determined each parameter: a bar for each, full where nothing of the prior's width is
    left."""
    line = 17
    height = line * len(estimates) + 8
    parts = []
    for k, e in enumerate(estimates):
        y = 4 + k * line
        seen = float(np.clip(1.0 - e.sd / e.prior_sd, 0.0, 1.0))
        colour = "#b2182b" if e.at_prior else "#2166ac"
        parts.append(
            f'<text x="2" y="{y + 12}">{e.name}</text>'
            f'<rect x="260" y="{y + 2}" width="200" height="{line - 5}" fill="#ddd"/>'
            f'<rect x="260" y="{y + 2}" width="{200 * seen:.1f}" height="{line - 5}" fill="{colour}"/>'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" viewBox="0 0 {WIDTH} {height}" font-size="12">'
        f"{''.join(parts)}</svg>"
    )
