"""Still picture of a surface, for paper and for browsers without WebGL, with light and a scale."""

from __future__ import annotations

import base64
import html
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import ColourScale, png
from appliance.desk.report.content import Vector
from appliance.desk.report.drawn_surface import Colouring, DrawnSurface

WIDTH_PX, HEIGHT_PX = 1400, 900
_SCAN_PX = (480, 360)
_MARGIN = 0.06
_BAR_PX = 50
LEAST_PX = 450
_AMBIENT = 0.45


def view_direction(drawn: DrawnSurface, up: Vector) -> NDArray[np.float64]:
    """Return the unit vector to the viewer: along the mean normal, a little from above and from the side."""
    mean = np.nanmean(drawn.normals.astype(np.float64), axis=0)
    top = np.asarray(up, np.float64) / np.linalg.norm(up)
    # An object with normals in all directions is seen from the front.
    towards = mean if np.linalg.norm(mean) > 0.15 else np.array([0.0, 0.0, -1.0])
    towards = towards / np.linalg.norm(towards)
    side = np.cross(top, towards)
    if np.linalg.norm(side) < 0.1:
        side = np.cross([1.0, 0.0, 0.0], towards)
    eye = towards + 0.25 * top + 0.35 * side / np.linalg.norm(side)
    unit: NDArray[np.float64] = eye / np.linalg.norm(eye)
    return unit


def still(drawn: DrawnSurface, colouring: Colouring, up: Vector) -> str:
    """Return the picture as a complete ``svg`` element, with a bar of a round length."""
    towards = view_direction(drawn, up)
    right = np.cross(up, towards)
    right = right / np.linalg.norm(right)
    above = np.cross(towards, right)
    points = drawn.points_mm.astype(np.float64)
    u, v, depth = points @ right, points @ above, points @ towards
    width_mm, height_mm = (max(float(np.ptp(coordinate)), 1e-6) for coordinate in (u, v))
    px_per_mm = (1 - 2 * _MARGIN) * min(WIDTH_PX / width_mm, HEIGHT_PX / height_mm)
    column = WIDTH_PX / 2 + (u - (u.min() + u.max()) / 2) * px_per_mm
    row = HEIGHT_PX / 2 - (v - (v.min() + v.max()) / 2) * px_per_mm

    normal = np.nan_to_num(drawn.normals, nan=0.0)
    lamp = towards + 0.4 * above - 0.4 * right
    light = np.abs(normal @ (lamp / np.linalg.norm(lamp)))
    light[~np.isfinite(drawn.normals[:, 0])] = 0.7
    rgb = colouring.rgb() * (_AMBIENT + (1 - _AMBIENT) * light)[:, None]
    if drawn.faces is not None:
        image = _triangles(drawn.faces, column, row, depth, rgb)
    else:
        image = _splats(column, row, depth, rgb)
    data = png(image[:, :, ::-1])
    # Cut a low picture to its height, so that paper is not wasted.
    tall = min(HEIGHT_PX, max(LEAST_PX, height_mm * px_per_mm + 2 * _MARGIN * HEIGHT_PX + 2 * _BAR_PX))
    top = (HEIGHT_PX - tall) / 2
    foot = top + tall
    bar_mm = _round_length(0.22 * WIDTH_PX / px_per_mm)
    bar_px = bar_mm * px_per_mm
    return (
        f'<svg class="still" viewBox="0 {top:.0f} {WIDTH_PX} {tall:.0f}" role="img" aria-label="{html.escape(colouring.name)}">'
        f'<image width="{WIDTH_PX}" height="{HEIGHT_PX}" href="data:image/png;base64,{base64.b64encode(data).decode()}"/>'
        f'<g font-size="26" font-family="sans-serif" fill="#1c2733"><rect x="40" y="{foot - 40:.0f}" width="{bar_px:.1f}" height="7"/>'
        f'<text x="40" y="{foot - 52:.0f}">{bar_mm:g} mm</text></g></svg>'
    )


def picture_of_scan(points_mm: NDArray[np.float32], grey: NDArray[np.uint8]) -> bytes:
    """Return a PNG file of one scan's points (n, 3), n at least 1, as its left camera sees them.

    Colour is by depth, brightness by ``grey`` (n,).
    """
    points = points_mm.astype(np.float64)
    across, down = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    wide, high = (max(float(np.ptp(tangent)), 1e-6) for tangent in (across, down))
    px = (1 - 2 * _MARGIN) * min(_SCAN_PX[0] / wide, _SCAN_PX[1] / high)
    column = _SCAN_PX[0] / 2 + (across - (across.min() + across.max()) / 2) * px
    row = _SCAN_PX[1] / 2 + (down - (down.min() + down.max()) / 2) * px
    low, far = (float(value) for value in np.percentile(points[:, 2], (2, 98)))
    by_depth = ColourScale.SEQUENTIAL.of(points_mm[:, 2], low, max(far, low + 0.1))
    bright = np.clip(grey / max(float(np.percentile(grey, 98)), 1.0), 0.0, 1.0)
    image = _splats(column, row, -points[:, 2], by_depth * (_AMBIENT + (1 - _AMBIENT) * bright)[:, None], _SCAN_PX)
    return png(image[:, :, ::-1])


def _splats(
    column: NDArray[np.float64],
    row: NDArray[np.float64],
    depth: NDArray[np.float64],
    rgb: NDArray[np.float64],
    size_px: tuple[int, int] = (WIDTH_PX, HEIGHT_PX),
) -> NDArray[np.uint8]:
    """Draw points as squares, the nearer ones (of larger ``depth``) over the farther ones."""
    width, height = size_px
    # Squares as large as the distance of points, by the area that they cover, so that the surface is closed.
    covered = len(np.unique((row / 8).astype(np.int64) * 10_000 + (column / 8).astype(np.int64))) * 64.0
    half = int(np.clip(math.ceil(0.75 * math.sqrt(covered / len(column))), 1, 12))
    order = np.argsort(depth)
    image = np.full((height, width, 3), 255, np.uint8)
    nearest = np.full((height, width), -np.inf)
    x, y = np.rint(column[order]).astype(np.int64), np.rint(row[order]).astype(np.int64)
    near, colour = depth[order], np.clip(rgb[order], 0, 255).astype(np.uint8)
    for dy in range(-half, half + 1):
        for dx in range(-half, half + 1):
            i, j = np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)
            # Of several values for one pixel NumPy keeps the last, which is the nearest here.
            layer = np.full((height, width), -1, np.int64)
            layer[i, j] = np.arange(len(x))
            covered_points = layer[layer >= 0]
            where = np.nonzero(layer >= 0)
            better = near[covered_points] > nearest[where]
            pixels = (where[0][better], where[1][better])
            nearest[pixels], image[pixels] = near[covered_points[better]], colour[covered_points[better]]
    return image


def _triangles(
    faces: NDArray[np.int32],
    column: NDArray[np.float64],
    row: NDArray[np.float64],
    depth: NDArray[np.float64],
    rgb: NDArray[np.float64],
) -> NDArray[np.uint8]:
    """Draw triangles from the farthest to the nearest (M.

    Newell, R. Newell and T. Sancha, "A solution to the hidden surface problem", 1972).
    """
    image = np.full((HEIGHT_PX, WIDTH_PX, 3), 255, np.uint8)
    order = np.argsort(depth[faces].mean(axis=1))
    # Sixteenths of a pixel, as OpenCV draws with `shift`.
    places = np.rint(16 * np.stack([column, row], axis=1)[faces[order]]).astype(np.int32)
    colours = np.clip(rgb[faces[order]].mean(axis=1), 0, 255)
    for corners, colour in zip(places, colours.tolist(), strict=True):
        cv2.fillConvexPoly(image, corners, colour, cv2.LINE_8, 4)
    return image


def _round_length(max_mm: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of ten that is not above ``max_mm``."""
    power = 10.0 ** math.floor(math.log10(max_mm))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= max_mm)
