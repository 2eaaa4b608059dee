"""The stage: the geometry of rig and scene at a moment, traced once for each camera and pose.

The cameras' rays belong to the rig and never change; the object's pose relative to the rig does.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hw_sim.latest import Latest
from hw_sim.objects.finish import Finish
from hw_sim.objects.motion import object_pose
from hw_sim.objects.print import Ink, board_print
from hw_sim.objects.shapes import NAMES, RADIUS, SIZES, VARIED
from hw_sim.objects.texture import NAMES as TEXTURES
from hw_sim.objects.texture import noise_lattice
from hw_sim.optics.bounce import Bounce
from hw_sim.optics.geometry import LIT, SOFT, Geometry, Lamp, P, Pose, Q, lamp_of, shadows, trace
from hw_sim.optics.gloss import finish
from hw_sim.optics.light_engine import LightEngine
from hw_sim.optics.shadow import MARGIN_PX, STEP_PX
from hw_sim.optics.table import fit_table
from hw_sim.optics.trace import HEIGHT, WATER, WIDTH, rays_of_image
from hw_sim.optics.view import TrueView, true_view
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig

Array = NDArray[np.float64]

CAMERAS = ("left", "right")
SMEAR_PX = 1.0
"""Largest motion of the image between two instants of an exposure (as long as MOST_INSTANTS suffice)."""
MOST_INSTANTS = 4
"""Largest number of instants whose mean is a moving image."""


class Stage:
    """One rig before the present scene. All methods may be called by several threads at once."""

    def __init__(
        self, truth: TrueRig, engine: LightEngine | None = None, coat: Finish | None = None, ink: Ink | None = None
    ) -> None:
        """``ink``: print of the board, by default that of ``board_print``."""
        self.eyes = {name: truth.eye(name).packed(truth.n_water) for name in (*CAMERAS, "projector")}
        """Packed as in ``optics.trace``."""
        self._engine, self._coat = engine, coat
        self.lamp: Lamp = lamp_of(self.eyes["projector"], engine)
        self._shapes_px = {name: (truth.eye(name).height_px, truth.eye(name).width_px) for name in CAMERAS}
        self._sizes = truth.artefacts.sizes()
        self._lattice = noise_lattice()
        self._ink = board_print() if ink is None else ink
        self._rays: Latest[str, Array] = Latest(keep=len(CAMERAS))
        self._tables: Latest[str, Array] = Latest(keep=len(CAMERAS))
        self._geometries: dict[str, Latest[tuple[object, ...], Geometry]] = {name: Latest() for name in CAMERAS}
        self._unlit: dict[str, Latest[tuple[object, ...], Geometry]] = {name: Latest() for name in CAMERAS}
        # The cameras' threads need the same shadows, but one may be an exposure behind.
        self._shadows: Latest[bytes, NDArray[np.float32]] = Latest(keep=MOST_INSTANTS)
        self._bounces: Latest[tuple[object, ...], Bounce] = Latest()

    def pose(self, scene: Scene, time_s: float) -> Pose:
        """Return the object's pose in the rig frame at ``time_s``; before time 0 the hands are at rest."""
        at_s, sizes = max(time_s, 0.0), self._sizes
        R, t = object_pose(scene.start_pose, scene.motion, at_s)
        if scene.outside.hands is not None:
            R, t = scene.outside.hands.seen(R, t, at_s)
        if scene.outside.soft is not None:
            sizes = scene.outside.soft.waving(sizes, at_s)
        kind = NAMES[scene.object]
        return Pose(kind if sizes.size == SIZES else kind + VARIED, sizes, R, t)

    def rays(self, camera: str) -> Array:
        """Return the exact water rays (h, w, 6) float64 of a camera's pixels: point on the port, mm, and direction.

        Rig frame; the directions are unit vectors.
        """

        def compute() -> Array:
            rays = np.empty((*self._shapes_px[camera], 6))
            rays_of_image(self.eyes[camera], rays)
            return rays

        return self._rays.get(camera, compute)

    def geometry(self, camera: str, scene: Scene, pose: Pose, is_lit: bool = True) -> Geometry:
        """Return the geometry of ``camera`` for the scene's object at ``pose``.

        Without ``is_lit`` it is for a dark projector: half the work. The latest of each camera is cached: 53 MB.
        """
        texture, per_m = TEXTURES[scene.texture], scene.water.attenuation_per_m

        def compute() -> Geometry:
            first = self.shadows(pose) if is_lit else None
            met = trace(self.rays(camera), pose, first, self.lamp, texture, self._lattice, self._ink, per_m)
            if self._engine is not None and is_lit:
                self._soften(self._engine, self.rays(camera), met)
            if self._coat is not None:
                finish(met, self.rays(camera), pose, self.lamp, self._coat, per_m)
            return met

        cache = self._geometries if is_lit else self._unlit
        return cache[camera].get((texture, per_m, pose.key), compute)

    def bounce(self, scene: Scene, coat: Finish) -> Bounce:
        """Return the interreflection of the scene's object at time 0; motion within a sequence is negligible for it."""
        texture, per_m, pose = TEXTURES[scene.texture], scene.water.attenuation_per_m, self.pose(scene, 0.0)
        return self._bounces.get(
            (texture, per_m, pose.key, coat.whiter),
            lambda: Bounce(pose, self.lamp, self.shadows(pose), texture, self._lattice, coat.whiter, per_m),
        )

    def _soften(self, engine: LightEngine, rays: Array, geometry: Geometry) -> None:
        """Set the softness of the engine's light at each illuminated point."""
        illuminated, eye = geometry.pixels[..., LIT] > 0.0, self.eyes["projector"]
        uv = geometry.pixels[illuminated][:, [P, Q]].astype(np.float64)
        points = rays[illuminated][:, :3] + rays[illuminated][:, 3:] * geometry.distance_mm[illuminated][:, None]
        a, b = np.clip(uv[:, 0], 0.0, eye[WIDTH] - 1.0), np.clip(uv[:, 1], 0.0, eye[HEIGHT] - 1.0)
        starts = self.lamp.window[_nearest(b), _nearest(a), :3]
        way_mm = np.linalg.norm(points - starts, axis=1)
        spread = engine.index_spread(float(eye[WATER]))
        size = float(eye[WIDTH]), float(eye[HEIGHT])
        geometry.pixels[illuminated, SOFT] = engine.softness(uv, way_mm, self.lamp.depth_mm, size, spread)

    def view(self, camera: str, scene: Scene, pose: Pose) -> TrueView:
        """Return the ground truth of ``camera``'s image."""
        second = "right" if camera == "left" else "left"
        geometry = self.geometry(camera, scene, pose)
        return true_view(self.rays(camera), geometry, pose, self.lamp, self.eyes[second], self.table(second))

    def table(self, camera: str) -> Array:
        """Return the table for fast projection into a camera: see ``optics.table``."""
        return self._tables.get(camera, lambda: fit_table(self.eyes[camera]))

    def shadows(self, pose: Pose) -> NDArray[np.float32]:
        """Return the lengths of the projector's light at ``pose``: see ``geometry.shadows``."""
        return self._shadows.get(pose.key, lambda: shadows(pose, self.lamp))


def _nearest(coordinate: Array) -> NDArray[np.int64]:
    """Return the rows or columns of the lamp's rays next to pattern coordinates."""
    return ((coordinate + MARGIN_PX) / STEP_PX + 0.5).astype(np.int64)


def instants(begin: Pose, end: Pose, pixel_mm: float) -> int:
    """Return the number of instants, 1..MOST_INSTANTS, of an exposure between these poses of the object.

    The motion is measured at the object's widest part, across the line of sight: along it the image hardly moves.
    ``pixel_mm`` is the size of a camera pixel on the object.
    """
    reach_mm = 0.7 * float(RADIUS[begin.kind])
    places = reach_mm * np.array([[0.0, 0.0, 0.0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    moved_mm = np.linalg.norm((places @ begin.R.T + begin.t - places @ end.R.T - end.t)[:, :2], axis=1).max()
    return min(MOST_INSTANTS, max(1, math.ceil(float(moved_mm) / pixel_mm / SMEAR_PX)))
