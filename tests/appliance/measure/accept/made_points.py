"""Points whose truth is known exactly, as a cloud that artefacts are looked for in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CENTRE = np.array([20.0, -15.0, 510.0])
OTHER = CENTRE + np.array([-120.0, 60.0, 30.0])
LENGTH_MM = float(np.linalg.norm(OTHER - CENTRE))
RADIUS_MM = 15.0


@dataclass(frozen=True)
class Points:
    points_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    pixel: NDArray[np.uint32]

    @classmethod
    def of(cls, points: Array, sigma_mm: float = 0.03) -> Points:
        n = len(points)
        return cls(points.astype(np.float32), np.full(n, sigma_mm, np.float32), np.arange(n, dtype=np.uint32) + 7)


def cap(centre: Array, half_angle_deg: float, step_mm: float, sigma_mm: float, rng: np.random.Generator) -> Array:
    """What a camera sees of a ball within a cone of normals: exact rays, errors of depth."""
    x, y = np.meshgrid(np.arange(-17.0, 17.0, step_mm), np.arange(-17.0, 17.0, step_mm))
    at = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) + centre
    view = at / np.linalg.norm(at, axis=1)[:, None]
    towards = view @ centre
    square = towards**2 - centre @ centre + RADIUS_MM**2
    view, towards, root = view[square > 0], towards[square > 0], np.sqrt(square[square > 0])
    steep = root / RADIUS_MM > np.cos(np.radians(half_angle_deg))
    depth = (towards - root)[steep] + rng.normal(0.0, sigma_mm, int(steep.sum()))
    return np.asarray(view[steep] * depth[:, None])


def board(bow_mm: float, sigma_mm: float, n: int = 40000) -> Array:
    """A board tilted by 0.2 mm/mm: bowl-shaped by ``bow_mm``, noisy."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-100, 100, n), rng.uniform(-80, 80, n)
    return np.column_stack([x, y, 520.0 + 0.2 * x + bow_mm * (x / 100.0) ** 2 + rng.normal(0.0, sigma_mm, n)])
