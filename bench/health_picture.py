"""Picture of calibration health: the four patterns as maps, and a trend with a knock; drawn with OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.health import LIMIT, HealthTrend
from appliance.measure.calibration.gaps import MODES, GapModes

MAP_PX, GAP_PX, TOP_PX, PLOT_PX, LEFT_PX = (240, 180), 16, 44, 150, 150
INK, FAINT, RED = (40, 40, 40), (225, 225, 225), (50, 50, 210)
COLOURS = ((170, 120, 40), (60, 140, 60), (40, 110, 220), (150, 60, 150))
FONT = cv2.FONT_HERSHEY_SIMPLEX
Image = NDArray[np.uint8]


def draw_health(path: Path, modes: GapModes, trend: HealthTrend) -> None:
    """Write a PNG: above the patterns (red up, blue down), below amplitudes and sum of the trend's scans."""
    width = len(MODES) * (MAP_PX[0] + GAP_PX) + GAP_PX
    image: Image = np.full((TOP_PX + MAP_PX[1] + 3 * (PLOT_PX + TOP_PX) + 30, width, 3), 255, np.uint8)
    for k, name in enumerate(MODES):
        x = GAP_PX + k * (MAP_PX[0] + GAP_PX)
        image[TOP_PX : TOP_PX + MAP_PX[1], x : x + MAP_PX[0]] = _map(modes, k)
        _write(image, name, (x, TOP_PX - 12), 0.6)
    points = trend.points
    top = 2 * TOP_PX + MAP_PX[1]
    height = [[p.amplitudes_um[k] for p in points] for k in range(len(MODES))]
    sigma = float(np.median([p.sigma_um for p in points]))
    _plot(image, top, f"amplitudes, um, of {len(points)} scans (band: normal)", height, MODES, (-sigma, sigma))
    top += PLOT_PX + TOP_PX
    _plot(image, top, "score, standard deviations (2 is usual)", [[p.score for p in points]], ("",), (0.0, 2.0))
    top += PLOT_PX + TOP_PX
    _plot(image, top, f"sum; the limit is {LIMIT:g}", [[p.total for p in points]], ("",), (0.0, LIMIT), limit=3 * LIMIT)
    cv2.imwrite(str(path), image)


def _map(modes: GapModes, k: int) -> Image:
    """Return the map of a pattern at the middle depth, over the left image, where both cameras see it."""
    left, right = modes.field_px
    third = slice(len(left) // 3, 2 * len(left) // 3)
    values = modes.at(left[third], right[third])[:, k]
    scale = MAP_PX[0] / modes.size_px[0]
    x, y = left[third].T * scale
    terms = np.stack([x**0, x, y, x * y, x * x, y * y], -1)
    fit, *_ = np.linalg.lstsq(terms, values, rcond=None)
    v, u = np.mgrid[0 : MAP_PX[1], 0 : MAP_PX[0]].astype(float)
    surface = np.stack([u**0, u, v, u * v, u * u, v * v], -1) @ fit
    strength = np.clip(np.abs(surface) / 2.5, 0.0, 1.0)[..., None]
    colour = np.where(surface[..., None] > 0.0, np.array([60.0, 60.0, 210.0]), np.array([200.0, 110.0, 40.0]))
    return np.asarray(255.0 + strength * (colour - 255.0), np.uint8)


def _plot(
    image: Image,
    top: int,
    title: str,
    lines: list[list[float]],
    names: tuple[str, ...],
    band: tuple[float, float],
    limit: float | None = None,
) -> None:
    low = min(min(min(line) for line in lines), band[0])
    high = min(max(max(max(line) for line in lines), band[1]), limit or np.inf) * 1.05
    span = image.shape[1] - LEFT_PX - GAP_PX

    def at(value: float) -> int:
        return int(top + PLOT_PX * (high - min(value, high)) / (high - low))

    cv2.rectangle(image, (LEFT_PX, at(band[1])), (LEFT_PX + span, at(band[0])), FAINT, -1)
    cv2.line(image, (LEFT_PX, at(0.0)), (LEFT_PX + span, at(0.0)), INK, 1)
    _write(image, title, (LEFT_PX, top - 8), 0.5)
    for value in (low, high):
        _write(image, f"{value:.1f}", (LEFT_PX - 52, at(value) + 5), 0.45)
    for line, name, colour in zip(lines, names, COLOURS, strict=False):
        across = LEFT_PX + np.linspace(10, span - 10, len(line))
        places = np.stack([across, [at(v) for v in line]], -1).astype(np.int32)
        cv2.polylines(image, [places.reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA)
        for x, y in places:
            cv2.circle(image, (int(x), int(y)), 3, colour, -1, cv2.LINE_AA)
        if name:
            row = names.index(name)
            _write(image, name, (12, top + 24 + 26 * row), 0.5, colour)


def _write(
    image: Image, text: str, position_px: tuple[int, int], size: float, colour: tuple[int, int, int] = INK
) -> None:
    cv2.putText(image, text, position_px, FONT, size, colour, 1, cv2.LINE_AA)
