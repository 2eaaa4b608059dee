"""Owns what the cameras see: light through the scene onto the sensor, one frame at a time.

For a scene at rest all geometry is computed once per camera; a frame then only samples the projected light, adds
ambient light, lasers and the water's veil, blurs with the lens, and is read out by the sensor. For moving hands the
geometry follows, and an exposure is the mean of as many instants as its motion blur needs.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.geometry import GREY, MIDDLE_MM, Geometry, Lamp, Pose, shadows, trace
from hw_sim.lasers import add_laser
from hw_sim.motion import object_pose
from hw_sim.objects.shapes import NAMES, RADIUS
from hw_sim.objects.texture import NAMES as TEXTURES
from hw_sim.objects.texture import noise_lattice
from hw_sim.optics.table import fit_table
from hw_sim.optics.trace import (
    DISTANCE,
    GLASS,
    HEIGHT,
    INNER,
    ROTATION,
    THICKNESS,
    WATER,
    WIDTH,
    rays_of,
    rays_of_image,
)
from hw_sim.projector import LightSlice, collect, light_between, response, soften
from hw_sim.scene import Scene
from hw_sim.sensor import FULL_WELL_E, Sensor
from hw_sim.shadow import map_pixels
from hw_sim.surface import Surface
from hw_sim.truth import TrueRig
from hw_sim.veil import Veil
from hw_sim.view import TrueView, true_view
from hw_sim.water import Water

__all__ = ["LightSlice", "Renderer", "Surface", "TrueView"]

Array = NDArray[np.float64]

CAMERAS = ("left", "right")
_CLEAR = math.exp(2.0 * MIDDLE_MM / 1000.0 * Water().attenuation_per_m)
WHITE_E_PER_S = FULL_WELL_E * 210.0 / 255.0 / 0.012 / 0.6 * _CLEAR
"""Electrons per second from white light on a white surface facing the rig in the middle of the volume, in clear water:
210 DN in 12 ms from an albedo of 0.6 in the default water."""
LENS_BLUR_PX, LEAST_BLUR_PX = 0.55, 0.4
"""Gaussian sigma of the lens in px of 1600; and what remains of it in binned images: the pixel itself."""
LASER_E_PER_S = 3.0e6 * _CLEAR
OBJECT_PX_MM, PROJECTOR_PX_MM = 0.160, 0.255
"""Sizes of a camera px (of 1600) and of a projector px in the middle of the volume."""
SMEAR_PX = 1.0
"""Motion of the picture between two instants of one exposure, at most (as long as MOST_INSTANTS suffice)."""
MOST_INSTANTS = 4


class Renderer:
    """Renders one rig's cameras. ``expose`` may run in two threads at once.

    The refractive index is that of ``truth``; the scene's water gives attenuation, veil and blur.
    """

    def __init__(self, truth: TrueRig, scene: Scene) -> None:
        self.truth = truth
        self._eyes = {name: truth.eye(name).packed(truth.n_water) for name in (*CAMERAS, "projector")}
        self._lamp = _lamp(self._eyes["projector"])
        self._sizes = truth.artefacts.sizes()
        self._response = response()
        self._lattice = noise_lattice()
        self._lock = threading.Lock()
        self._rays: dict[str, Array] = {}
        self._veils: dict[tuple[str, float], Veil] = {}
        self._sensors: dict[tuple[str, bool], Sensor] = {}
        self._cache: dict[str, tuple[bytes, Geometry]] = {}
        self._shadow_lock = threading.Lock()
        self._shadow: tuple[bytes, NDArray[np.float32]] | None = None
        self._scene = scene

    @property
    def scene(self) -> Scene:
        """What is looked at; setting it takes effect with the next exposure."""
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        self._scene = scene

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
        """One frame (h, w) uint8 of ``left`` or ``right``.

        ``time_s`` is the middle of the exposure; the hands move from time 0 on, and are at rest for all of an exposure
        with ``time_s`` ≤ 0. ``slices`` follow each other from the exposure's start; what they do not cover is dark.
        ``noise_seed`` makes the noise of each frame its own.
        """
        scene = self._scene
        count = self._instants(camera, scene, time_s, exposure_s)
        eye = self.truth.eye(camera)
        electrons = np.zeros((eye.height_px, eye.width_px), np.float32)
        for k in range(count):
            begin_s, end_s = exposure_s * k / count, exposure_s * (k + 1) / count
            at_s = time_s if count == 1 else time_s + 0.5 * (begin_s + end_s - exposure_s)
            self._add_instant(camera, scene, at_s, tuple(slices), begin_s, end_s, lasers, electrons)
        scale = eye.width_px / 1600.0
        sigma = max(LENS_BLUR_PX * scale, LEAST_BLUR_PX)
        sigma = math.hypot(sigma, scene.water.blur_px_per_m * MIDDLE_MM / 1000.0 * scale)
        electrons = np.asarray(cv2.GaussianBlur(electrons, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE), np.float32)
        return self._sensor(camera, scene.noise).read_out(electrons, gain_db, noise_seed)

    def surface(self, time_s: float) -> Surface:
        """The true surface at ``time_s``."""
        return Surface(self._pose(self._scene, time_s))

    def view(self, camera: str, time_s: float) -> TrueView:
        """What ``camera`` truly sees at ``time_s``."""
        scene = self._scene
        other = "right" if camera == "left" else "left"
        pose = self._pose(scene, time_s)
        geometry = self._geometry(camera, scene, pose)
        return true_view(
            self._camera_rays(camera), geometry, pose, self._lamp, self._eyes[other], fit_table(self._eyes[other])
        )  # fmt: skip

    def _add_instant(
        self,
        camera: str,
        scene: Scene,
        time_s: float,
        slices: tuple[LightSlice, ...],
        begin_s: float,
        end_s: float,
        lasers: tuple[bool, bool],
        electrons: NDArray[np.float32],
    ) -> None:
        pose = self._pose(scene, time_s)
        geometry = self._geometry(camera, scene, pose)
        duration_s = end_s - begin_s
        water = scene.water
        light = light_between(slices, begin_s, end_s, self._response)
        ambient = np.float32(WHITE_E_PER_S * scene.ambient * duration_s)
        if light is None:
            electrons += ambient * geometry.pixels[..., GREY]
        else:
            blur_px = water.blur_px_per_m * MIDDLE_MM / 1000.0 * OBJECT_PX_MM / PROJECTOR_PX_MM
            veil = self._veil(camera, water.attenuation_per_m).seen(light, geometry.distance_mm)
            veil *= np.float32(WHITE_E_PER_S * 0.6 * water.backscatter)
            collect(geometry.pixels, soften(light, blur_px), np.float32(WHITE_E_PER_S), ambient, veil, electrons)
        for on, laser in zip(lasers, self.truth.lasers, strict=True):
            if on:
                add_laser(
                    electrons, LASER_E_PER_S * duration_s, laser, self._eyes[camera], self._camera_rays(camera),
                    pose, geometry, water.attenuation_per_m,
                )  # fmt: skip

    def _pose(self, scene: Scene, time_s: float) -> Pose:
        R, t = object_pose(scene.start_pose, scene.motion, max(time_s, 0.0))
        return Pose(NAMES[scene.object], self._sizes, R, t)

    def _instants(self, camera: str, scene: Scene, time_s: float, exposure_s: float) -> int:
        """How many instants of an exposure are needed, so that the picture moves little between them."""
        if scene.motion.still or time_s <= 0.0:
            return 1
        a, b = (self._pose(scene, time_s + part * exposure_s) for part in (-0.5, 0.5))
        reach_mm = 0.7 * float(RADIUS[a.kind])
        corners = reach_mm * np.array([[0.0, 0.0, 0.0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
        moved_mm = np.linalg.norm((corners @ a.R.T + a.t - corners @ b.R.T - b.t)[:, :2], axis=1).max()
        smear_px = float(moved_mm) / OBJECT_PX_MM * self.truth.eye(camera).width_px / 1600.0
        return min(MOST_INSTANTS, max(1, math.ceil(smear_px / SMEAR_PX)))

    def _geometry(self, camera: str, scene: Scene, pose: Pose) -> Geometry:
        key = repr((scene.texture, scene.water.attenuation_per_m)).encode() + pose.key
        with self._lock:
            cached = self._cache.get(camera)
        if cached is not None and cached[0] == key:
            return cached[1]
        geometry = trace(
            self._camera_rays(camera), pose, self._shadows(pose), self._lamp, TEXTURES[scene.texture], self._lattice, scene.water.attenuation_per_m
        )  # fmt: skip
        with self._lock:
            self._cache[camera] = (key, geometry)
        return geometry

    def _shadows(self, pose: Pose) -> NDArray[np.float32]:
        """Both cameras need the same shadows: the first computes, the second waits for it."""
        with self._shadow_lock:
            if self._shadow is None or self._shadow[0] != pose.key:
                self._shadow = pose.key, shadows(pose, self._lamp)
            return self._shadow[1]

    def _camera_rays(self, camera: str) -> Array:
        with self._lock:
            rays = self._rays.get(camera)
        if rays is None:
            eye = self.truth.eye(camera)
            rays = np.empty((eye.height_px, eye.width_px, 6))
            rays_of_image(self._eyes[camera], rays)
            with self._lock:
                self._rays[camera] = rays
        return rays

    def _veil(self, camera: str, attenuation_per_m: float) -> Veil:
        with self._lock:
            veil = self._veils.get((camera, attenuation_per_m))
        if veil is None:
            veil = Veil(self._camera_rays(camera), self._lamp, attenuation_per_m)
            with self._lock:
                self._veils[camera, attenuation_per_m] = veil
        return veil

    def _sensor(self, camera: str, noise: bool) -> Sensor:
        with self._lock:
            sensor = self._sensors.get((camera, noise))
        if sensor is None:
            eye = self.truth.eye(camera)
            sensor = Sensor(eye.width_px, eye.height_px, 2 * self.truth.seed + CAMERAS.index(camera), noise)
            with self._lock:
                self._sensors[camera, noise] = sensor
        return sensor


def _lamp(eye: Array) -> Lamp:
    """The projector, from its packed eye."""
    at = map_pixels(int(eye[WIDTH]), int(eye[HEIGHT]))
    map_rays = np.empty((*at.shape[:2], 6))
    rays_of(eye, at.reshape(-1, 2), map_rays.reshape(-1, 6))
    axis = eye[ROTATION : ROTATION + 9].reshape(3, 3)[:, 2]
    window = np.concatenate([map_rays[..., :3], (map_rays[..., 3:] @ axis)[..., None] ** 4], -1).astype(np.float32)
    # Rays near the axis diverge from a point this far behind the outer face: depths count by the ratio of the indices.
    n_water, distance_mm, thickness_mm, glass = eye[WATER], eye[DISTANCE], eye[THICKNESS], eye[GLASS]
    depth_mm = n_water * (distance_mm + thickness_mm / glass) * float(eye[INNER + 2])
    return Lamp(eye, fit_table(eye), map_rays, window, depth_mm)
