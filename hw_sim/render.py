"""Owns what the cameras see: every pixel's ray is followed to the object, and from there to the projector.

For a scene at rest all geometry is computed once per camera; a frame then only samples the projected light, adds
ambient light and the water's veil, blurs with the lens, and is read out by the sensor.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.motion import object_pose
from hw_sim.objects.shapes import NAMES, distances, gradient, march
from hw_sim.objects.texture import NAMES as TEXTURES
from hw_sim.objects.texture import albedo
from hw_sim.optics.projection import FastProjection, fit_projection, project_fast
from hw_sim.optics.trace import pixel_ray
from hw_sim.projector import FAR_MM, FOCUS_MM, light_fields, response
from hw_sim.scene import Scene
from hw_sim.sensor import FULL_WELL_E, Sensor
from hw_sim.truth import TrueRig

Array = NDArray[np.float64]

CAMERAS = ("left", "right")
WHITE_E_PER_S = FULL_WELL_E * 210.0 / 255.0 / 0.012 / 0.6
"""Electrons per second from white light on a surface of albedo 1, facing the rig in the middle of the volume."""
REFERENCE_DIM = math.exp(-0.4e-3 * 975.0)
"""How much of it clear lake water leaves on the way there and back, in which the exposure was chosen."""
LENS_BLUR_PX = 0.55
"""Gaussian sigma of the lens in px of 1600."""
LASER_E_PER_S = 3.0e6
LASER_SIGMA_MM = 0.9
SHADOW_OFFSET_MM = 0.02


@dataclass(frozen=True, slots=True)
class LightSlice:
    """What the projector showed for a part of an exposure."""

    image: NDArray[np.uint8]
    """(768, 1024) green codes as scanned out."""
    duration_s: float


@dataclass(frozen=True, slots=True)
class TrueView:
    """What one camera truly sees."""

    points_rig_mm: Array
    """(h, w, 3), NaN where no surface is hit."""
    projector_px: Array
    """(h, w, 2): projector pixel that lights the point (lit or not); NaN where no surface is hit."""
    seen_by_all: NDArray[np.bool_]
    """(h, w): the surface point is in the frame of both cameras and of the projector, occluded for none of them, and
    not looked at more obliquely than 75° by any."""


@dataclass(frozen=True, slots=True)
class _Geometry:
    """One camera's pixels at one pose of the object."""

    distance: NDArray[np.float64]
    p: NDArray[np.float32]
    q: NDArray[np.float32]
    lit: NDArray[np.float32]
    """Electrons per second for white light."""
    ambient: NDArray[np.float32]
    softness: NDArray[np.float32]


class Surface:
    """The true surface at a moment."""

    def __init__(self, kind: int, R: Array, t: Array) -> None:
        self._kind, self._R, self._t = kind, R, t

    def distance_mm(self, points_rig_mm: Array) -> Array:
        """Signed distances (n,) of points (n, 3) in the rig frame, outside positive."""
        local = np.ascontiguousarray((np.asarray(points_rig_mm, np.float64) - self._t) @ self._R)
        out = np.empty(len(local))
        distances(self._kind, local, out)
        return out


class Renderer:
    """Renders one rig's cameras. ``expose`` may run in two threads at once."""

    def __init__(self, truth: TrueRig, scene: Scene) -> None:
        self.truth = truth
        self._eyes = {name: truth.eye(name).packed(truth.n_water) for name in (*CAMERAS, "projector")}
        self._fast: dict[str, FastProjection] = {name: fit_projection(eye) for name, eye in self._eyes.items()}
        self._rays: dict[str, Array] = {}
        self._sensors: dict[str, Sensor] = {}
        self._cache: dict[str, tuple[bytes, _Geometry]] = {}
        self._response = response()
        self._lock = threading.Lock()
        self._scene: Scene = scene
        self.scene = scene

    @property
    def scene(self) -> Scene:
        """What is looked at; setting it takes effect with the next exposure."""
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self._scene = scene
        for index, name in enumerate(CAMERAS):
            sensor = self._sensors.get(name)
            if sensor is None or sensor.noise != scene.noise:
                eye = self.truth.eye(name)
                self._sensors[name] = Sensor(eye.width_px, eye.height_px, 2 * self.truth.seed + index, scene.noise)

    def expose(
        self,
        camera: str,
        slices: Sequence[LightSlice],
        time_s: float,
        exposure_s: float,
        gain_db: float,
        lasers: tuple[bool, bool],
        noise_seed: int,
    ) -> NDArray[np.uint8]:
        """One frame (h, w) uint8: light of ``slices`` during ``exposure_s``, the object where it is at ``time_s``."""
        scene = self._scene
        geometry = self._geometry(camera, scene, time_s)
        light = np.zeros(slices[0].image.shape if slices else (768, 1024), np.float32)
        for part in slices:
            light += np.float32(part.duration_s) * self._response[part.image]
        sharp, soft = light_fields(light)
        veil = WHITE_E_PER_S * 0.6 * scene.water.backscatter * float(light.mean())
        electrons = np.empty(geometry.p.shape, np.float32)
        _collect(
            geometry.p, geometry.q, geometry.lit, geometry.softness, geometry.ambient,
            exposure_s, sharp, soft, veil, electrons,
        )  # fmt: skip
        self._add_lasers(camera, scene, time_s, exposure_s, lasers, electrons)
        eye = self.truth.eye(camera)
        scale = eye.width_px / 1600.0
        sigma = math.hypot(max(LENS_BLUR_PX * scale, 0.4), scene.water.blur_px_per_m * 0.5 * scale)
        electrons = np.asarray(cv2.GaussianBlur(electrons, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE), np.float32)
        return self._sensors[camera].read_out(electrons, gain_db, noise_seed)

    def surface(self, time_s: float) -> Surface:
        """The true surface at ``time_s``."""
        R, t = object_pose(self._scene.start_pose, self._scene.motion, time_s)
        return Surface(NAMES[self._scene.object], R, t)

    def view(self, camera: str, time_s: float) -> TrueView:
        """What ``camera`` truly sees at ``time_s``."""
        scene = self._scene
        R, t = object_pose(scene.start_pose, scene.motion, time_s)
        rays = self._camera_rays(camera)
        geometry = self._geometry(camera, scene, time_s)
        h, w = geometry.p.shape
        points = rays[..., :3] + rays[..., 3:] * geometry.distance[..., None]
        other = "right" if camera == "left" else "left"
        seen = np.zeros((h, w), np.bool_)
        pixels = np.full((h, w, 2), np.nan)
        _visibility(
            NAMES[scene.object], R, t, points, rays, self._eyes[other], self._fast[other].coefficients,
            self._eyes["projector"], self._fast["projector"].coefficients, pixels, seen,
        )  # fmt: skip
        return TrueView(points, pixels, seen)

    def _camera_rays(self, camera: str) -> Array:
        with self._lock:
            rays = self._rays.get(camera)
        if rays is None:
            eye = self.truth.eye(camera)
            rays = np.empty((eye.height_px, eye.width_px, 6))
            _all_rays(self._eyes[camera], rays)
            with self._lock:
                self._rays[camera] = rays
        return rays

    def _geometry(self, camera: str, scene: Scene, time_s: float) -> _Geometry:
        R, t = object_pose(scene.start_pose, scene.motion, time_s)
        key = repr((scene.object, scene.texture, scene.water, scene.ambient)).encode() + R.tobytes() + t.tobytes()
        with self._lock:
            cached = self._cache.get(camera)
        if cached is not None and cached[0] == key:
            return cached[1]
        rays = self._camera_rays(camera)
        h, w = rays.shape[:2]
        geometry = _Geometry(np.empty((h, w)), *(np.empty((h, w), np.float32) for _ in range(5)))
        _trace_scene(
            NAMES[scene.object], TEXTURES[scene.texture], R, t, rays,
            self._eyes["projector"], self._fast["projector"].coefficients,
            scene.water.attenuation_per_m / 1000.0, scene.ambient,
            geometry.distance, geometry.p, geometry.q, geometry.lit, geometry.ambient, geometry.softness,
        )  # fmt: skip
        with self._lock:
            self._cache[camera] = (key, geometry)
        return geometry

    def _add_lasers(
        self,
        camera: str,
        scene: Scene,
        time_s: float,
        exposure_s: float,
        lasers: tuple[bool, bool],
        electrons: NDArray[np.float32],
    ) -> None:
        kind = NAMES[scene.object]
        R, t = object_pose(scene.start_pose, scene.motion, time_s)
        for on, laser in zip(lasers, self.truth.lasers, strict=True):
            if not on:
                continue
            origin, direction = (np.array(laser.origin_mm) - t) @ R, np.array(laser.direction) @ R
            far = _march(kind, origin, direction)
            if not math.isfinite(far):
                continue
            hit = origin + far * direction
            point = hit @ R.T + t
            eye = self._eyes[camera]
            u, v = project_fast(eye, self._fast[camera].coefficients, float(point[0]), float(point[1]), float(point[2]))
            h, w = electrons.shape
            if not (-20 < u < w + 20 and -20 < v < h + 20):
                continue
            ray = np.array(pixel_ray(eye, u, v))
            start, toward = (ray[:3] - t) @ R, ray[3:] @ R
            seen = _march(kind, start, toward)
            if abs(float(np.linalg.norm(start + seen * toward - hit))) > 0.5:
                continue  # the camera looks at something nearer
            sigma = LASER_SIGMA_MM / 0.16 * w / 1600.0
            y, x = np.mgrid[0:h, 0:w] if w < 200 else np.ogrid[0:h, 0:w]
            spot = np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * sigma**2))
            dim = math.exp(-scene.water.attenuation_per_m / 1000.0 * (far + seen))
            electrons += (
                LASER_E_PER_S
                * exposure_s
                * dim
                * albedo(TEXTURES[scene.texture], float(hit[0]), float(hit[1]), float(hit[2]))
                * spot
            ).astype(np.float32)


def _march(kind: int, origin: Array, direction: Array) -> float:
    ox, oy, oz = (float(c) for c in origin)
    dx, dy, dz = (float(c) for c in direction)
    return float(march(kind, ox, oy, oz, dx, dy, dz, 0.0, 2000.0))


@numba.njit(nogil=True, cache=True)
def _all_rays(eye: Array, out: Array) -> None:
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            a, b, c, d, e, f = pixel_ray(eye, float(x), float(y))
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = a, b, c
            out[y, x, 3], out[y, x, 4], out[y, x, 5] = d, e, f


@numba.njit(nogil=True, cache=True)
def _shadowed(
    kind: int, x: float, y: float, z: float, nx: float, ny: float, nz: float, ox: float, oy: float, oz: float
) -> bool:
    """Whether something lies between a surface point and an eye's window (object frame)."""
    x, y, z = x + 0.02 * nx, y + 0.02 * ny, z + 0.02 * nz
    dx, dy, dz = ox - x, oy - y, oz - z
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    hit = march(kind, x, y, z, dx / length, dy / length, dz / length, 0.05, length)
    return not math.isnan(hit)


@numba.njit(nogil=True, cache=True)
def _trace_scene(
    kind: int, texture: int, R: Array, t: Array, rays: Array, projector: Array, coefficients: Array,
    attenuation: float, ambient: float, distance: NDArray[np.float64], p: NDArray[np.float32],
    q: NDArray[np.float32], lit: NDArray[np.float32], base: NDArray[np.float32], softness: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = p.shape
    for y in range(rows):
        for x in range(columns):
            ox, oy, oz = rays[y, x, 0] - t[0], rays[y, x, 1] - t[1], rays[y, x, 2] - t[2]
            lx = R[0, 0] * ox + R[1, 0] * oy + R[2, 0] * oz
            ly = R[0, 1] * ox + R[1, 1] * oy + R[2, 1] * oz
            lz = R[0, 2] * ox + R[1, 2] * oy + R[2, 2] * oz
            dx, dy, dz = rays[y, x, 3], rays[y, x, 4], rays[y, x, 5]
            ex = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
            ey = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
            ez = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
            far = march(kind, lx, ly, lz, ex, ey, ez, 0.0, 2000.0)
            distance[y, x] = far
            p[y, x], q[y, x], lit[y, x], base[y, x], softness[y, x] = -1e6, -1e6, 0.0, 0.0, 0.0
            if math.isnan(far):
                continue
            hx, hy, hz = lx + far * ex, ly + far * ey, lz + far * ez
            gx, gy, gz = gradient(kind, hx, hy, hz)
            g = math.sqrt(gx * gx + gy * gy + gz * gz) + 1e-12
            gx, gy, gz = gx / g, gy / g, gz / g
            a = albedo(texture, hx, hy, hz)
            dim = math.exp(-attenuation * far)
            base[y, x] = WHITE_E_PER_S * a * ambient * dim
            wx = rays[y, x, 0] + far * dx
            wy = rays[y, x, 1] + far * dy
            wz = rays[y, x, 2] + far * dz
            u, v = project_fast(projector, coefficients, wx, wy, wz)
            if u < -0.5 or v < -0.5 or u > 1023.5 or v > 767.5:
                continue
            # The beam leaves the projector's window 35 mm in front of its lens; its apparent origin lies behind.
            bx, by, bz, cx, cy, cz = pixel_ray(projector, u, v)
            sx = R[0, 0] * (bx - t[0]) + R[1, 0] * (by - t[1]) + R[2, 0] * (bz - t[2])
            sy = R[0, 1] * (bx - t[0]) + R[1, 1] * (by - t[1]) + R[2, 1] * (bz - t[2])
            sz = R[0, 2] * (bx - t[0]) + R[1, 2] * (by - t[1]) + R[2, 2] * (bz - t[2])
            vx, vy, vz = sx - hx, sy - hy, sz - hz
            length = math.sqrt(vx * vx + vy * vy + vz * vz)
            facing = (vx * gx + vy * gy + vz * gz) / length
            if facing <= 0.0 or _shadowed(kind, hx, hy, hz, gx, gy, gz, sx, sy, sz):
                continue
            cosine = cz / math.sqrt(cx * cx + cy * cy + cz * cz)
            falloff = (487.5 / length) ** 2
            lit[y, x] = (
                WHITE_E_PER_S * a * facing * falloff * cosine**4 * dim * math.exp(-attenuation * length) / REFERENCE_DIM
            )
            p[y, x], q[y, x] = u, v
            away = (wz - FOCUS_MM) / FAR_MM
            softness[y, x] = min(away * away, 1.0)


@numba.njit(nogil=True, cache=True)
def _collect(
    p: NDArray[np.float32], q: NDArray[np.float32], lit: NDArray[np.float32], softness: NDArray[np.float32],
    base: NDArray[np.float32], exposure_s: float, sharp: NDArray[np.float32], soft: NDArray[np.float32],
    veil: float, electrons: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = p.shape
    height, width = sharp.shape
    for y in range(rows):
        for x in range(columns):
            value = base[y, x] * np.float32(exposure_s) + np.float32(veil)
            if lit[y, x] > 0.0:
                u = min(max(p[y, x], np.float32(0.0)), np.float32(width - 1.001))
                v = min(max(q[y, x], np.float32(0.0)), np.float32(height - 1.001))
                i, j = int(u), int(v)
                fu, fv = u - np.float32(i), v - np.float32(j)
                a = np.float32(1.0) - fu
                b = np.float32(1.0) - fv
                one = (sharp[j, i] * a + sharp[j, i + 1] * fu) * b + (
                    sharp[j + 1, i] * a + sharp[j + 1, i + 1] * fu
                ) * fv
                two = (soft[j, i] * a + soft[j, i + 1] * fu) * b + (soft[j + 1, i] * a + soft[j + 1, i + 1] * fu) * fv
                value += lit[y, x] * (one + softness[y, x] * (two - one))
            electrons[y, x] = value


@numba.njit(nogil=True, cache=True)
def _visibility(
    kind: int, R: Array, t: Array, points: Array, rays: Array, other: Array, other_fit: Array, projector: Array,
    projector_fit: Array, pixels: Array, seen: NDArray[np.bool_],
) -> None:  # fmt: skip
    limit = math.cos(math.radians(75.0))
    for y in range(points.shape[0]):
        for x in range(points.shape[1]):
            px, py, pz = points[y, x, 0], points[y, x, 1], points[y, x, 2]
            if math.isnan(px):
                continue
            u, v = project_fast(projector, projector_fit, px, py, pz)
            pixels[y, x, 0], pixels[y, x, 1] = u, v
            if u < 0.0 or v < 0.0 or u > 1023.0 or v > 767.0:
                continue
            a, b = project_fast(other, other_fit, px, py, pz)
            if a < 0.0 or b < 0.0 or a > other[31] - 1.0 or b > other[32] - 1.0:
                continue
            ox, oy, oz = px - t[0], py - t[1], pz - t[2]
            hx = R[0, 0] * ox + R[1, 0] * oy + R[2, 0] * oz
            hy = R[0, 1] * ox + R[1, 1] * oy + R[2, 1] * oz
            hz = R[0, 2] * ox + R[1, 2] * oy + R[2, 2] * oz
            gx, gy, gz = gradient(kind, hx, hy, hz)
            g = math.sqrt(gx * gx + gy * gy + gz * gz) + 1e-12
            gx, gy, gz = gx / g, gy / g, gz / g
            ok = True
            for which in range(3):
                if which == 0:
                    bx, by, bz = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
                elif which == 1:
                    bx, by, bz, _c, _d, _e = pixel_ray(other, a, b)
                else:
                    bx, by, bz, _c, _d, _e = pixel_ray(projector, u, v)
                ox, oy, oz = bx - t[0], by - t[1], bz - t[2]
                sx = R[0, 0] * ox + R[1, 0] * oy + R[2, 0] * oz
                sy = R[0, 1] * ox + R[1, 1] * oy + R[2, 1] * oz
                sz = R[0, 2] * ox + R[1, 2] * oy + R[2, 2] * oz
                vx, vy, vz = sx - hx, sy - hy, sz - hz
                length = math.sqrt(vx * vx + vy * vy + vz * vz)
                if (vx * gx + vy * gy + vz * gz) / length < limit:
                    ok = False
                    break
                if which > 0 and _shadowed(kind, hx, hy, hz, gx, gy, gz, sx, sy, sz):
                    ok = False
                    break
            seen[y, x] = ok
