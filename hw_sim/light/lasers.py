"""The two laser pointers: the light of their beams on the surface and in the water.

A beam is narrow and straight (its port refracts it once, see ``truth``). On the surface it makes a dot: a Gaussian with
a faint wide foot and speckle. The water scatters a little of it back, single scattering: a streak from the port to the
dot.
"""

# Symbols in _streak:
#   o         from the beam's origin to the camera ray's; d the beam's unit direction; cosine, sine2 of the angle ψ between them
#   path, along   lengths along ray and beam to where they are nearest to each other; gap2 their squared distance there

from __future__ import annotations

import hashlib
import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.shapes import march_all
from hw_sim.optics.geometry import GREY, MIDDLE_MM, Geometry, Pose
from hw_sim.optics.trace import pixels_of
from hw_sim.truth import Laser
from hw_sim.water.medium import Water
from hw_sim.water.scattering import BACKSCATTER_ALBEDO, BACKSCATTER_MM

Array = NDArray[np.float64]

SIGMA_MM = 0.9
"""Half width of a beam (Gaussian sigma)."""
FOOT_SHARE, FOOT_SIGMA_MM = 0.01, 4.0
"""Light scattered by lens and port of the pointer: its share in the middle, and its width."""
SAME_SURFACE_MM = 8.0
"""Largest range of the lengths at which the beam's light ends on one surface without an edge."""
SHADOW_MM = 0.2
"""Largest distance from the end of the light, along the beam, of a place that it reaches."""
WINDOW_MM = 14.0
FAR_MM = 1000.0
"""Length to which a beam without a surface is followed."""
_RINGS_MM = tuple(SIGMA_MM * k for k in (1.0, 2.0, 3.0))
_AROUND = 12
"""Number of rays around the axis that determine where a beam's light ends, since an edge may cut a part of it."""
STREAK_MARGIN_MM = 4.0
LEAST_STREAK_E = 0.05


def add_laser(
    electrons: NDArray[np.float32],
    peak_e: float,
    laser: Laser,
    eye: Array,
    rays: Array,
    pose: Pose,
    geometry: Geometry,
    water: Water,
    grain_seed: int | None,
) -> None:
    """Add one beam to a camera's mean electrons (h, w) in place.

    ``peak_e``: electrons of a white surface perpendicular to the beam, in its middle, in clear water. The light of a
    pixel near the dot depends on its distance from the beam, so that the dot is as oblique as the surface, and hidden
    behind nearer surfaces. Light that passes an edge falls on the surface behind it, if there is one. ``grain_seed``:
    of the speckle, which belongs to the surface's place; ``None``: no speckle.
    """
    origin, direction = np.array(laser.origin_mm), np.array(laser.direction)
    starts = origin + _across(direction)
    reach_mm = _reach(starts, direction, pose)
    met = np.isfinite(reach_mm)
    if met.any():
        ends = starts[met] + reach_mm[met, None] * direction
        _add_dot(electrons, peak_e, origin, direction, ends, eye, rays, pose, geometry, water, grain_seed)
    _add_streak(electrons, peak_e, origin, direction, min(float(reach_mm[0]), FAR_MM), eye, rays, geometry, water)


def _across(direction: Array) -> Array:
    """Return offsets (n, 3) of the beam's axis, which is the first, and of rays around it, mm."""
    x = np.cross([0.0, 1.0, 0.0], direction)
    x /= np.linalg.norm(x)
    y = np.cross(direction, x)
    angles = 2.0 * math.pi * np.arange(_AROUND) / _AROUND
    ring = np.cos(angles)[:, None] * x + np.sin(angles)[:, None] * y
    return np.concatenate([np.zeros((1, 3)), *(radius * ring for radius in _RINGS_MM)])


def _reach(starts: Array, direction: Array, pose: Pose) -> Array:
    """Return the lengths (n,), mm, of the light from ``starts`` (n, 3) to the object; infinite if none."""
    beam = np.empty((len(starts), 6))
    beam[:, :3], beam[:, 3:] = (starts - pose.t) @ pose.R, direction @ pose.R
    reach_mm = np.empty(len(starts))
    march_all(pose.kind, pose.sizes, beam, reach_mm)
    return reach_mm


def _add_dot(
    electrons: NDArray[np.float32],
    peak_e: float,
    origin: Array,
    direction: Array,
    ends: Array,
    eye: Array,
    rays: Array,
    pose: Pose,
    geometry: Geometry,
    water: Water,
    grain_seed: int | None,
) -> None:
    """Add the light on the surface around ``ends`` (n, 3), mm, where rays of the beam end."""
    part = _around(eye, electrons.shape, ends, WINDOW_MM)
    if part is None:
        return
    points = rays[part][..., :3] + rays[part][..., 3:] * geometry.distance_mm[part][..., None]
    # A surface point by cylinder coordinates of the beam: along its axis, and off it squared.
    along_mm = (points - origin) @ direction
    off_mm2 = np.sum((points - origin) ** 2, axis=-1) - along_mm**2
    # Forward scatter on its path widens the beam; that on the path to the camera blurs the image.
    wide_mm2 = SIGMA_MM**2 + (water.blur_px_per_m * 0.16 * along_mm / 1000.0) ** 2
    # A wider Gaussian of the same power is dimmer in its middle by the ratio of the areas.
    light = SIGMA_MM**2 / wide_mm2 * np.exp(-off_mm2 / (2.0 * wide_mm2))
    light += FOOT_SHARE * np.exp(-off_mm2 / (2.0 * FOOT_SIGMA_MM**2))
    light *= np.exp(-water.attenuation_per_m / 1000.0 * along_mm)
    light[~(off_mm2 < WINDOW_MM**2)] = 0.0
    ends_mm = (ends - origin) @ direction
    # One smooth surface: cut by length. Otherwise test for each near point whether its light reaches it.
    if len(ends) == len(_across(direction)) and np.ptp(ends_mm) < SAME_SURFACE_MM:
        light[np.abs(along_mm - ends_mm[0]) > SAME_SURFACE_MM] = 0.0
    else:
        near = light > 0.0
        free_mm = _reach(points[near] - along_mm[near, None] * direction, direction, pose)
        light[near] = np.where(along_mm[near] < free_mm + SHADOW_MM, light[near], 0.0)
    if grain_seed is not None:
        # A camera px of 1600 is as large as one grain (1.22 λ N); a binned one holds as many as px are binned.
        grains = max(1.0, (1600.0 / electrons.shape[1]) ** 2)
        place = hashlib.blake2b(pose.key, digest_size=8).digest()
        rng = np.random.default_rng([grain_seed, int.from_bytes(place, "little")])
        light = light * rng.gamma(grains, 1.0 / grains, light.shape)
    electrons[part] += (peak_e * geometry.pixels[part][..., GREY] * light).astype(np.float32)


def _add_streak(
    electrons: NDArray[np.float32],
    peak_e: float,
    origin: Array,
    direction: Array,
    reach_mm: float,
    eye: Array,
    rays: Array,
    geometry: Geometry,
    water: Water,
) -> None:
    """Add the backscatter of the beam in the water, up to ``reach_mm``."""
    # Backscatter of a mm of water as the albedo of an equally bright surface; the angles are near 180°.
    albedo_per_mm = water.backscatter * BACKSCATTER_ALBEDO / BACKSCATTER_MM
    # At an angle of a tenth of a radian, the longest path through the beam: below the limit the streak is invisible.
    brightest_e = peak_e * albedo_per_mm * SIGMA_MM * math.sqrt(2.0 * math.pi) / 0.1
    if brightest_e < LEAST_STREAK_E:
        return
    path_points = origin + np.linspace(0.2 * MIDDLE_MM, reach_mm, 64)[:, None] * direction
    part = _around(eye, electrons.shape, path_points, STREAK_MARGIN_MM)
    if part is not None:
        _streak(
            rays[part], geometry.distance_mm[part], origin, direction, reach_mm, peak_e * albedo_per_mm,
            water.attenuation_per_m / 1000.0, electrons[part],
        )  # fmt: skip


def _around(eye: Array, shape: tuple[int, ...], points: Array, margin_mm: float) -> tuple[slice, slice] | None:
    """Return the part of an image with ``points`` (n, 3) and a margin; ``None``: they are outside."""
    pixels = np.empty((len(points), 2))
    pixels_of(eye, points, pixels)
    h, w = shape
    # 0.16 mm is a px of 1600 in the middle of the volume.
    margin = max(3, round(margin_mm / 0.16 * w / 1600.0))
    with np.errstate(invalid="ignore"):
        near = np.all((pixels > -margin) & (pixels < (w + margin, h + margin)), axis=1)
    if not near.any():
        return None
    (u0, v0), (u1, v1) = pixels[near].min(axis=0), pixels[near].max(axis=0)
    x0, x1 = max(0, round(u0) - margin), min(w, round(u1) + margin + 1)
    y0, y1 = max(0, round(v0) - margin), min(h, round(v1) + margin + 1)
    return (slice(y0, y1), slice(x0, x1)) if x0 < x1 and y0 < y1 else None


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _streak(
    rays: Array, ends: Array, origin: Array, direction: Array, reach_mm: float, back_e_per_mm: float, per_mm: float,
    electrons: NDArray[np.float32],
) -> None:  # fmt: skip
    """Add the light of the beam in the water along each ray (h, w, 6) to ``electrons`` (h, w).

    A ray that passes the beam at a distance d, at an angle ψ, crosses σ √(2π) / sin ψ · exp(−d²/2σ²) of its light.
    """
    dx, dy, dz = direction[0], direction[1], direction[2]
    for y in range(electrons.shape[0]):
        for x in range(electrons.shape[1]):
            ray = rays[y, x]
            ox, oy, oz = ray[0] - origin[0], ray[1] - origin[1], ray[2] - origin[2]
            cosine = ray[3] * dx + ray[4] * dy + ray[5] * dz
            sine2 = 1.0 - cosine * cosine
            if sine2 < 1e-4:
                continue
            p = ray[3] * ox + ray[4] * oy + ray[5] * oz
            q = dx * ox + dy * oy + dz * oz
            # Closest approach of two skew lines.
            path = (cosine * q - p) / sine2
            along = (q - cosine * p) / sine2
            if (
                path <= 0.0 or along <= 0.0 or along >= reach_mm or path > ends[y, x]
            ):  # not so where it meets nothing: NaN
                continue
            gx, gy, gz = (
                ox + path * ray[3] - along * dx,
                oy + path * ray[4] - along * dy,
                oz + path * ray[5] - along * dz,
            )
            gap2 = gx * gx + gy * gy + gz * gz
            if gap2 > 16.0 * SIGMA_MM * SIGMA_MM:
                continue
            crossed_mm = SIGMA_MM * math.sqrt(2.0 * math.pi / sine2) * math.exp(-gap2 / (2.0 * SIGMA_MM * SIGMA_MM))
            electrons[y, x] += np.float32(back_e_per_mm * crossed_mm * math.exp(-per_mm * (path + along)))
