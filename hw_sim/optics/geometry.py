"""The geometry of a scene at one pose: each camera pixel's ray, point and pattern coordinate.

Everything that depends on the pose alone is computed once (``Geometry``); a frame of a scene at rest then only samples
light.
"""

# Symbols in the kernels:
#   o, d      a camera ray in the object's frame; far its length to the surface, h the point met there, w the same in the rig's
#   n         unit normal at h; s where the projector's light leaves its port, v = s − h, length = |v|
#   u, v      pattern coordinate at which the projector sees w
#   per_mm    attenuation of the water; grey albedo times what the water leaves on the way to the camera

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.print import Ink, front_met, lean, printed
from hw_sim.objects.shapes import BOARD, VARIED, gradient, march
from hw_sim.objects.texture import albedo
from hw_sim.optics.light_engine import LightEngine
from hw_sim.optics.projector import FAR_MM, FOCUS_MM
from hw_sim.optics.shadow import BLOCK_PX, block_start, by_map, into, map_pixels, nearest, shaded, shadow_map
from hw_sim.optics.table import OUTSIDE, fit_table, look_up
from hw_sim.optics.trace import DISTANCE, FOCUS, GLASS, HEIGHT, INNER, ROTATION, THICKNESS, WATER, WIDTH, rays_of

Array = NDArray[np.float64]

P, Q, LIT, SOFT, GREY, CHANNELS = 0, 1, 2, 3, 4, 5
"""Channels of ``Geometry.pixels``: pattern coordinate; share of white projector light that reaches the camera (albedo,
angle, distance, port, water on both paths; 1 for a white surface facing the rig in the middle of a volume of perfectly
clear water); softness 0..1 of the projected light; and the share of ambient light (albedo, water on the way back)."""

MIDDLE_MM = 487.5
"""Path in water from a port to the middle of the volume."""


@dataclass(frozen=True, slots=True)
class Pose:
    """An object at a moment: p_rig = R p_object + t."""

    kind: int
    sizes: Array
    R: Array
    t: Array

    @property
    def key(self) -> bytes:
        """A key that is equal for equal geometry."""
        return bytes([self.kind]) + self.sizes.tobytes() + self.R.tobytes() + self.t.tobytes()


@dataclass(frozen=True, slots=True)
class Lamp:
    """The projector, ready for tracing."""

    eye: Array
    table: Array
    """See ``optics.table``."""
    map_rays: Array
    """Rays (rows, columns, 6) of the shadow map."""
    window: NDArray[np.float32]
    """(rows, columns, 4): where these rays leave the port (rig frame, mm; 0.02 mm apart per pixel), and their
    brightness (vignetting)."""
    depth_mm: float
    """Distance of the apparent source, seen from the water, behind the outer face of the port."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """One camera's view of one pose."""

    distance_mm: Array
    """(h, w) from the port along the ray to the surface; NaN without a surface."""
    pixels: NDArray[np.float32]
    """(h, w, CHANNELS)."""


def lamp_of(eye: Array, engine: LightEngine | None = None) -> Lamp:
    """Return the projector, from its eye packed as in ``optics.trace``; ``engine``: with its field of light."""
    map_uv = map_pixels(int(eye[WIDTH]), int(eye[HEIGHT]))
    map_rays = np.empty((*map_uv.shape[:2], 6))
    rays_of(eye, map_uv.reshape(-1, 2), map_rays.reshape(-1, 6))
    # Vignetting by the cos⁴ law, against the projector's optical axis.
    axis = eye[ROTATION : ROTATION + 9].reshape(3, 3)[:, 2]
    bright = (map_rays[..., 3:] @ axis)[..., None] ** 4
    if engine is not None and engine.hot_spot > 0.0:
        bright = engine.field(map_uv, eye[WIDTH], eye[HEIGHT])[..., None]
    # Rays near the axis diverge from a point this far behind the outer face: depths count by the ratio of the indices.
    n_water, distance_mm, thickness_mm, glass = eye[WATER], eye[DISTANCE], eye[THICKNESS], eye[GLASS]
    depth_mm = n_water * (distance_mm + thickness_mm / glass) * float(eye[INNER + 2])
    # A lamp with a nearer focus is weaker, so that white is equally bright in the middle of any volume.
    nearer = (MIDDLE_MM * float(eye[FOCUS]) / FOCUS_MM + depth_mm) / (MIDDLE_MM + depth_mm)
    window = np.concatenate([map_rays[..., :3], nearer * nearer * bright], -1).astype(np.float32)
    return Lamp(eye, fit_table(eye), map_rays, window, depth_mm)


def shadows(pose: Pose, lamp: Lamp) -> NDArray[np.float32]:
    """Return the map (rows, columns) float32 of the lengths, mm, of the projector's light (see ``shadow``)."""
    first = np.empty(lamp.map_rays.shape[:2], np.float32)
    shadow_map(pose.kind, pose.sizes, pose.R, pose.t, lamp.map_rays, first)
    return first


def trace(
    rays: Array,
    pose: Pose,
    first: NDArray[np.float32] | None,
    lamp: Lamp,
    texture: int,
    lattice: NDArray[np.float32],
    ink: Ink,
    attenuation_per_m: float,
) -> Geometry:
    """Trace the rays (h, w, 6) of a camera.

    ``first`` are the pose's shadows (``None``: the projector is dark, and only distance and ambient light are
    computed), ``lattice`` is the texture's, ``ink`` the print of the board, which has no other texture.
    """
    h, w = rays.shape[:2]
    is_lit = first is not None
    shade = np.empty((0, 0), np.float32) if first is None else first
    geometry = Geometry(np.empty((h, w)), np.empty((h, w, CHANNELS), np.float32))
    _trace(
        pose.kind, pose.sizes, pose.R, pose.t, is_lit, shade, texture, lattice, ink, attenuation_per_m / 1000.0, rays,
        lamp.eye, lamp.table, lamp.window, lamp.depth_mm, geometry.distance_mm, geometry.pixels,
    )  # fmt: skip
    return geometry


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _beside(R: Array, t: Array, sizes: Array, ray: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the offset, mm along x and y of the board, of a ray's intersection with a tangent plane."""
    rise_x, rise_y = lean(sizes, x, y)
    ox, oy, oz = into(R, ray[0] - t[0], ray[1] - t[1], ray[2] - t[2])
    dx, dy, dz = into(R, ray[3], ray[4], ray[5])
    s = (rise_x * (ox - x) + rise_y * (oy - y) - (oz - z)) / (dz - rise_x * dx - rise_y * dy)
    return ox + s * dx - x, oy + s * dy - y


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _trace(
    kind: int, sizes: Array, R: Array, t: Array, is_lit: bool, first: NDArray[np.float32], texture: int,
    lattice: NDArray[np.float32], ink: Ink, per_mm: float, rays: Array, lamp: Array, table: Array,
    window: NDArray[np.float32], depth_mm: float, distance: Array, pixels: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = distance.shape
    width, height = lamp[WIDTH], lamp[HEIGHT]
    for y0 in range(0, rows, BLOCK_PX):
        y1 = min(y0 + BLOCK_PX, rows)
        for x0 in range(0, columns, BLOCK_PX):
            x1 = min(x0 + BLOCK_PX, columns)
            start = block_start(kind, sizes, R, t, rays, y0, y1 - 1, x0, x1 - 1)
            for y in range(y0, y1):
                for x in range(x0, x1):
                    ray, out = rays[y, x], pixels[y, x]
                    distance[y, x] = math.nan
                    out[P], out[Q], out[LIT], out[SOFT], out[GREY] = OUTSIDE, OUTSIDE, 0.0, 0.0, 0.0
                    if math.isnan(start):
                        continue
                    ox, oy, oz = into(R, ray[0] - t[0], ray[1] - t[1], ray[2] - t[2])
                    dx, dy, dz = into(R, ray[3], ray[4], ray[5])
                    far = front_met(sizes, ox, oy, oz, dx, dy, dz) if kind % VARIED == BOARD else math.nan
                    print_seen = not math.isnan(far)
                    if not print_seen:
                        far = march(kind, sizes, ox, oy, oz, dx, dy, dz, start, 1e4)
                    if math.isnan(far):
                        continue
                    distance[y, x] = far
                    hx, hy, hz = ox + far * dx, oy + far * dy, oz + far * dz
                    if print_seen:
                        # The pixel's footprint on the board is spanned by its neighbours' intersections with the
                        # tangent plane.
                        beside = rays[y, x + 1 if x + 1 < columns else x - 1]
                        below = rays[y + 1 if y + 1 < rows else y - 1, x]
                        ax, ay = _beside(R, t, sizes, beside, hx, hy, hz)
                        bx, by = _beside(R, t, sizes, below, hx, hy, hz)
                        grey = printed(ink, sizes, hx, hy, ax, ay, bx, by)
                    else:
                        grey = albedo(texture, lattice, hx, hy, hz)
                    # Beer and Lambert on the way to the camera.
                    grey *= math.exp(-per_mm * far)
                    out[GREY] = grey
                    if not is_lit:
                        continue
                    wx, wy, wz = ray[0] + far * ray[3], ray[1] + far * ray[4], ray[2] + far * ray[5]
                    # The point's pattern coordinate; outside of the pattern (and a border for blur) there is no light.
                    u, v = look_up(lamp, table, wx, wy, wz)
                    if not (-2.0 < u < width + 1.0 and -2.0 < v < height + 1.0):
                        continue
                    out[P], out[Q] = u, v
                    origin = window[nearest(v), nearest(u)]
                    sx, sy, sz = into(R, origin[0] - t[0], origin[1] - t[1], origin[2] - t[2])
                    vx, vy, vz = sx - hx, sy - hy, sz - hz
                    length = math.sqrt(vx * vx + vy * vy + vz * vz)
                    # Lambert: irradiance by the cosine between the normal and the direction to the projector's port.
                    nx, ny, nz = gradient(kind, sizes, hx, hy, hz)
                    norm = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
                    nx, ny, nz = nx / norm, ny / norm, nz / norm
                    facing = (vx * nx + vy * ny + vz * nz) / length
                    if facing <= 0.0:
                        continue
                    # The map decides for most points; otherwise the point's ray towards the light is traced.
                    sure = by_map(first, u, v, length)
                    if sure < 0 or (sure == 0 and shaded(kind, sizes, hx, hy, hz, nx, ny, nz, sx, sy, sz)):
                        continue
                    # Inverse squares from the apparent source, 1 in the middle of the volume; vignetting; Beer and Lambert.
                    spread = (MIDDLE_MM + depth_mm) / (length + depth_mm)
                    out[LIT] = grey * facing * spread * spread * origin[3] * math.exp(-per_mm * length)
                    # Defocus like heat: softness is the square of the distance from the focus.
                    away = (wz - lamp[FOCUS]) / FAR_MM
                    out[SOFT] = min(away * away, 1.0)
