"""Owns something to look at: a shell half sunk in sand, as two cameras see it and as a cloud; made of formulas alone."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.reach import Marks, Track
from appliance.instrument.screens.theme import colour_table

MIDDLE_MM = 505.0
_HALF_MM = (100.0, 78.0)
_LIGHT = np.array([-0.5, -0.62, -0.6])


def _height_mm(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth along z in mm over x and y in mm: ribbed shell over rippled sand."""
    sand = MIDDLE_MM + 22.0 + 0.12 * y + 2.2 * np.sin(0.16 * x + 0.05 * y + 0.8 * np.sin(0.03 * y))
    u, v = (x + 4.0) / 74.0, (y + 2.0) / 60.0
    angle, radius = np.arctan2(u, 1.15 - v), np.hypot(u, 1.15 - v)
    dome = np.sqrt(np.clip(1.0 - (u / (0.45 + 0.55 * np.clip(radius, 0, 1.6) / 1.6)) ** 2 - v**2, 0.0, None))
    ribs = 1.0 + 0.055 * np.cos(26.0 * angle) * np.clip(radius, 0.0, 1.2)
    growth = 1.0 + 0.012 * np.cos(34.0 * radius)
    return np.asarray(np.minimum(sand, MIDDLE_MM + 24.0 - 58.0 * dome * ribs * growth), np.float64)


def _grid(columns: int, rows: int, shift_mm: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.meshgrid(np.linspace(-_HALF_MM[0], _HALF_MM[0], columns), np.linspace(-_HALF_MM[1], _HALF_MM[1], rows))
    return 1.25 * x + shift_mm, 1.25 * y


def marks() -> Marks:
    """Where both dots of ``live`` are seen: the rings a little behind the dots, as of an object that is 503 mm away."""

    def track(u: float, towards: float) -> Track:
        return Track((u + 0.045 * towards, 0.531), (u - 0.004 * towards, 0.531), (u - 0.04 * towards, 0.531))

    return Marks(tuple(track(u, 1.0) for u in (0.408, 0.672)), tuple(track(u, -1.0) for u in (0.336, 0.6)))


@cache
def live(right: bool) -> NDArray[np.uint8]:
    """(300, 400) uint8: what a camera sees, with both laser dots."""
    x, y = _grid(400, 300, 9.0 if right else -9.0)
    z = _height_mm(x, y)
    down, across = np.gradient(z, 1.25 * 2 * _HALF_MM[1] / 300, 1.25 * 2 * _HALF_MM[0] / 400)
    length = np.sqrt(across**2 + down**2 + 1.0)
    light = np.clip((across * _LIGHT[0] + down * _LIGHT[1] - _LIGHT[2]) / length, 0.0, None)
    falloff = np.exp(-0.5 * ((x / 120.0) ** 2 + (y / 100.0) ** 2))
    grey = 18.0 + 175.0 * light * falloff * (0.8 + 0.2 * np.cos(0.9 * x) * np.cos(1.1 * y) * (z > MIDDLE_MM + 12))
    for dot_x in (-32.0, 34.0):
        grey += 230.0 * np.exp(-((x - dot_x) ** 2 + (y - 6.0) ** 2) / 5.0)
    return np.asarray(np.clip(grey, 0, 255), np.uint8)


@cache
def cloud() -> NDArray[np.float32]:
    """(n, 3) float32 mm: the shell as scanned, without the part that its own shadow hides."""
    x, y = _grid(190, 148)
    z = _height_mm(x, y)
    down, across = np.gradient(z, 1.25 * 2 * _HALF_MM[1] / 148, 1.25 * 2 * _HALF_MM[0] / 190)
    seen = (np.hypot(across, down) < 2.2) & (np.hypot(x / 122.0, y / 96.0) < 1.0)
    return np.ascontiguousarray(np.stack([x[seen], y[seen], z[seen]], axis=1), np.float32)


@cache
def preview() -> NDArray[np.uint8]:
    """(380, 520, 3) uint8 RGB: the cloud's stored picture."""
    x, y = _grid(520, 380)
    z = _height_mm(x, y)
    down, across = np.gradient(z, 0.5)
    light = 0.5 + 0.5 * np.clip(
        (across * _LIGHT[0] + down * _LIGHT[1] - _LIGHT[2]) / np.sqrt(across**2 + down**2 + 1.0), 0.0, 1.0
    )
    level = np.clip((z.max() - z) / (z.max() - z.min()), 0.0, 1.0)
    picture = colour_table()[(255 * level).astype(np.uint8)] * light[:, :, np.newaxis]
    return np.where((np.hypot(x / 122.0, y / 96.0) < 1.0)[:, :, np.newaxis], picture, 8).astype(np.uint8)
