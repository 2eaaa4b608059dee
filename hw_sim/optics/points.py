"""Owns the exact optics of single points, as NumPy calls: what a pixel looks along, and where a point is seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw_sim.optics.trace import pixels_of, rays_of
from hw_sim.truth import TrueRig

Array = NDArray[np.float64]


def ray(truth: TrueRig, eye: str, uv_px: ArrayLike) -> tuple[Array, Array]:
    """Rays in water of pixels (n, 2) of ``left``, ``right`` or ``projector``, float64.

    Returns the points (n, 3) where they leave the outer glass face, in mm, and their unit directions (n, 3), both in
    the rig frame. Exact vector Snell; raises KeyError for another eye.
    """
    uv = np.ascontiguousarray(np.reshape(np.asarray(uv_px, np.float64), (-1, 2)))
    out = np.empty((len(uv), 6))
    rays_of(truth.eye(eye).packed(truth.n_water), uv, out)
    return out[:, :3].copy(), out[:, 3:].copy()


def project(truth: TrueRig, eye: str, points_rig_mm: ArrayLike) -> Array:
    """Pixels (n, 2) float64 at which water points (n, 3) of the rig frame are seen: Newton on the exact ray, 1e-9 px.

    NaN for a point behind the window. Raises KeyError for an unknown eye.
    """
    points = np.ascontiguousarray(np.reshape(np.asarray(points_rig_mm, np.float64), (-1, 3)))
    out = np.empty((len(points), 2))
    pixels_of(truth.eye(eye).packed(truth.n_water), points, out)
    return out
