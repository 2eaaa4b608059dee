"""Owns the two laser pointers: which light their beams put on the surface that a camera sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw_sim.geometry import GREY, Geometry, Pose
from hw_sim.objects.shapes import march_all
from hw_sim.optics.trace import pixels_of
from hw_sim.truth import Laser

Array = NDArray[np.float64]

SIGMA_MM = 0.9
"""Half width of a beam (Gaussian sigma)."""
SAME_SURFACE_MM = 8.0
"""How much further than its axis a beam may reach within its width: the slope of the lit surface."""
WINDOW_MM = 12.0


def add_laser(
    electrons: NDArray[np.float32],
    peak_e: float,
    laser: Laser,
    eye: Array,
    rays: Array,
    pose: Pose,
    geometry: Geometry,
    attenuation_per_m: float,
) -> None:
    """Add the dot of one beam to a camera's mean electrons (h, w) in place.

    ``peak_e`` is what a white surface perpendicular to the beam gives in its middle in clear water. The beam leaves its
    own window perpendicularly, so it goes straight; every pixel near the dot is lit by its distance from the beam, so the
    dot is as oblique as the surface, and hidden where the camera sees something nearer.
    """
    origin, direction = np.array(laser.origin_mm), np.array(laser.direction)
    beam = np.concatenate([pose.R.T @ (origin - pose.t), pose.R.T @ direction])[None]
    reach = np.empty(1)
    march_all(pose.kind, pose.sizes, beam, reach)
    reach_mm = float(reach[0])
    spot = np.empty((1, 2))
    pixels_of(eye, (origin + reach_mm * direction)[None], spot)
    if not np.isfinite(spot).all():
        return
    u, v = (float(x) for x in spot[0])
    h, w = electrons.shape
    half = max(3, round(WINDOW_MM / 0.16 * w / 1600.0))
    x0, x1 = max(0, round(u) - half), min(w, round(u) + half + 1)
    y0, y1 = max(0, round(v) - half), min(h, round(v) + half + 1)
    if x0 >= x1 or y0 >= y1:
        return
    part = (slice(y0, y1), slice(x0, x1))
    points = rays[part][..., :3] + rays[part][..., 3:] * geometry.distance_mm[part][..., None]
    along_mm = (points - origin) @ direction
    off_mm2 = np.sum((points - origin) ** 2, axis=-1) - along_mm**2
    lit = np.exp(-off_mm2 / (2.0 * SIGMA_MM**2)) * np.exp(-attenuation_per_m / 1000.0 * along_mm)
    lit = np.where(np.abs(along_mm - reach_mm) < SAME_SURFACE_MM, lit, 0.0)
    electrons[part] += (peak_e * geometry.pixels[part][..., GREY] * lit).astype(np.float32)
