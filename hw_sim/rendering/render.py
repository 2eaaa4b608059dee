"""The renderer: light through the scene onto the sensor, one frame at a time.

The geometry is traced once per pose (``stage``). A frame then samples the projected light, adds ambient light, lasers
and backscatter, is blurred by the lens, and is read out by the sensor. For moving hands an exposure is the mean of as
many instants as its motion blur needs (``stage.instants``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.latest import Latest
from hw_sim.light.lasers import add_laser
from hw_sim.light.uneven import UnevenLight
from hw_sim.objects.print import Ink
from hw_sim.optics.beamer import BeamerSlice, beamed_between
from hw_sim.optics.camera_traits import CameraTraits
from hw_sim.optics.geometry import GREY, LIT, MIDDLE_MM, Geometry, Pose
from hw_sim.optics.light_engine import FRAME_S, SOFTEST_PX, LightEngine, flashed_between
from hw_sim.optics.projector import FAR_MM, SPREAD_FAR_PX, LightSlice, collect, light_between, response, soften
from hw_sim.optics.view import Surface, TrueView
from hw_sim.rendering.sensor import FULL_WELL_E, Sensor
from hw_sim.rendering.sensor_of_traits import SensorOfTraits
from hw_sim.rendering.stage import CAMERAS, MOST_INSTANTS, Stage, instants
from hw_sim.scene import RESPONSES, Scene
from hw_sim.truth import TrueRig
from hw_sim.water.backscatter import Backscatter
from hw_sim.water.drift import Drift, Swarm
from hw_sim.water.fish import before
from hw_sim.water.medium import Water
from hw_sim.water.particles import Particles
from hw_sim.water.specks import scatter
from hw_sim.water.spread import ForwardSpread
from hw_sim.water.veil import Veil

__all__ = ["LightSlice", "Renderer", "Surface", "TrueView"]

Picture = NDArray[np.float32]
"""Mean electrons of each pixel, (h, w)."""

_CLEAR = math.exp(2.0 * MIDDLE_MM / 1000.0 * Water().attenuation_per_m)
"""Brightness of the middle of the volume in clear water over that in the default water."""
WHITE_E_PER_S = FULL_WELL_E * 210.0 / 255.0 / 0.012 / 0.6 * _CLEAR
"""Electrons per second from white light on a white surface facing the rig in the middle of the volume, in clear water:
210 DN in 12 ms from an albedo of 0.6 in the default water."""
LASER_E_PER_S = 3.0e6 * _CLEAR
"""The same in the middle of a laser's dot."""
LENS_BLUR_PX, LEAST_BLUR_PX = 0.55, 0.4
"""Gaussian sigma of the lens in px of 1600, and its least value in binned images, that of the pixel."""
DEFOCUS_FAR_PX = 0.46
"""A lens of 11.5 mm at f/8, focused on the middle of the volume, adds this ``FAR_MM`` of water away from it: a disc of
1.44 mm · 11.5 mm · 90 mm / (405 mm · 495 mm) = 7.4 µm (lengths in water divided by its index), a quarter of it as sigma."""
HIDDEN = 0.25
"""Least covered share of a hidden pixel."""
CAMERA_PX_MM, PROJECTOR_PX_MM = 0.160, 0.255
"""Sizes of a camera px (of 1600) and of a projector px in the middle of the volume."""


class Renderer:
    """Renders one rig's cameras. ``expose`` may run in two threads at once.

    The refractive index is that of ``truth``; the scene's water gives attenuation, backscatter and blur.
    """

    def __init__(self, truth: TrueRig, scene: Scene, ink: Ink | None = None) -> None:
        """``ink``: print of the board, by default that of ``board_print``."""
        self.truth = truth
        self._ink = ink
        self._scene = scene
        self._stage = Stage(truth, scene.outside.projector, scene.outside.surfaces, ink)
        self._responses = {kind: response(kind) for kind in RESPONSES}
        self._backscatters: dict[str, Latest[float, Backscatter]] = {camera: Latest() for camera in CAMERAS}
        self._veils: dict[str, Latest[tuple[object, ...], Veil]] = {camera: Latest() for camera in CAMERAS}
        self._spreads: Latest[tuple[object, ...], ForwardSpread] = Latest()
        self._uneven = UnevenLight()
        self._swarms: Latest[Drift, Swarm] = Latest()
        self._sensors: dict[str, Latest[bool, Sensor]] = {camera: Latest() for camera in CAMERAS}
        self._sensors_of_traits: dict[str, Latest[tuple[bool, CameraTraits], SensorOfTraits]] = {
            camera: Latest() for camera in CAMERAS
        }

    @property
    def scene(self) -> Scene:
        """The present scene; setting it takes effect with the next exposure."""
        return self._scene

    @scene.setter
    def scene(self, scene: Scene) -> None:
        before, now = self._scene.outside, scene.outside
        if (now.projector, now.surfaces) != (before.projector, before.surfaces):
            self._stage = Stage(self.truth, now.projector, now.surfaces, self._ink)
            self._veils = {camera: Latest() for camera in CAMERAS}
            self._backscatters = {camera: Latest() for camera in CAMERAS}
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
        clock_s: float | None = None,
    ) -> NDArray[np.uint8]:
        """Render one frame (h, w) uint8 of ``left`` or ``right``.

        ``time_s`` is the middle of the exposure; the hands move from time 0 on, and are at rest for all of an exposure
        with ``time_s`` ≤ 0. ``slices`` follow each other from the exposure's start; what they do not cover is dark.
        ``noise_seed`` makes the noise of each frame its own. ``clock_s`` is the middle of the exposure by the clock that
        daylight goes by, whether the hands move or not; ``None``: as ``time_s``.
        """
        electrons = self.light(camera, slices, time_s, exposure_s, lasers, clock_s)
        return self.read_out(camera, electrons, exposure_s, gain_db, noise_seed)

    def light(
        self,
        camera: str,
        slices: Sequence[LightSlice],
        time_s: float,
        exposure_s: float,
        lasers: tuple[bool, bool],
        clock_s: float | None = None,
    ) -> Picture:
        """Return the light (h, w) float32 of an exposure on the sensor, in electrons; arguments as of ``expose``."""
        clock_s = time_s if clock_s is None else clock_s
        scene = self._scene
        eye = self.truth.eye(camera)
        if camera in scene.capped:
            return np.zeros((eye.height_px, eye.width_px), np.float32)
        # Motion blur: the exposure is the mean of a few instants, each with the light that fell in its share of the time.
        count = self._instants(camera, scene, time_s, exposure_s)
        at_rest = not scene.moves or time_s <= 0.0
        electrons = np.zeros((eye.height_px, eye.width_px), np.float32)
        for k in range(count):
            begin_s, end_s = exposure_s * k / count, exposure_s * (k + 1) / count
            at_s = time_s if at_rest or count == 1 else time_s + 0.5 * (begin_s + end_s - exposure_s)
            light = self._light(
                scene, tuple(slices), begin_s, end_s, time_s - 0.5 * exposure_s, clock_s - 0.5 * exposure_s
            )
            by_clock_s = clock_s + 0.5 * (begin_s + end_s - exposure_s)
            self._add_instant(camera, scene, at_s, by_clock_s, light, end_s - begin_s, lasers, electrons)
        # Order as in the instrument: lens and water, defocus, fog on the port (so soft that its order does not matter),
        # sensor.
        image = self._blurred(camera, scene, electrons)
        if scene.imaging.camera_defocus:
            image = self._defocused(camera, scene, image, time_s)
        image = scene.fog.over(camera, image)
        traits = scene.outside.cameras
        return image if traits is None else traits.through_lens(image)

    def read_out(
        self, camera: str, electrons: Picture, exposure_s: float, gain_db: float, noise_seed: int
    ) -> NDArray[np.uint8]:
        """Return the frame (h, w) uint8 for the ``light`` of an exposure.

        The same light may be read out with the scene's noise and without it.
        """
        scene = self._scene
        traits = scene.outside.cameras
        if traits is not None:
            return self._sensor_of_traits(camera, scene, traits).read_out(electrons, gain_db, noise_seed, exposure_s)
        return self._sensor(camera, scene).read_out(electrons, gain_db, noise_seed)

    def surface(self, time_s: float) -> Surface:
        """Return the true surface at ``time_s``."""
        return Surface(self._stage.pose(self._scene, time_s))

    def view(self, camera: str, time_s: float) -> TrueView:
        """Return the ground truth of ``camera``'s image at ``time_s``."""
        scene = self._scene
        return self._stage.view(camera, scene, self._stage.pose(scene, time_s))

    def hidden_by_drift(
        self, camera: str, time_s: float, clock_s: float | None = None, exposure_s: float = 0.0
    ) -> NDArray[np.bool_]:
        """Return (h, w) bool: a speck or fish hides the object from ``camera``, or a fish its light.

        ``time_s``: middle of the exposure by the hands' clock, ``clock_s`` by the water's (``None``: the same).
        """
        scene, clock_s = self._scene, time_s if clock_s is None else clock_s
        pose = self._stage.pose(scene, time_s)
        free, met = (
            self._stage.geometry(camera, scene, pose),
            self._geometry(camera, scene, pose, clock_s, is_lit=True),
        )
        nearer = np.nan_to_num(met.distance_mm, nan=np.inf) < np.nan_to_num(free.distance_mm, nan=np.inf)
        hidden = nearer | ((free.pixels[..., LIT] > 0.0) & (met.pixels[..., LIT] <= 0.0))
        if scene.drift.specks:
            covered = np.zeros(hidden.shape, np.float32)
            nothing = np.zeros_like(covered)
            self._scatter(camera, scene, pose, clock_s, exposure_s, met, None, 0.0, nothing, covered)
            hidden |= covered > HIDDEN
        return np.asarray(hidden)

    def _instants(self, camera: str, scene: Scene, time_s: float, exposure_s: float) -> int:
        """Return the number of rendered instants of the exposure; fish always need all."""
        if scene.drift.fish:
            return MOST_INSTANTS
        if not scene.moves or time_s <= 0.0:
            return 1
        begin, end = (self._stage.pose(scene, time_s + part * exposure_s) for part in (-0.5, 0.5))
        return instants(begin, end, CAMERA_PX_MM / self._scale(camera))

    def _light(
        self,
        scene: Scene,
        slices: tuple[LightSlice, ...],
        begin_s: float,
        end_s: float,
        lit_for_s: float,
        clock_s: float,
    ) -> Picture | None:
        """Return the projector's light between two times of an exposure that began at ``clock_s``, in s of white."""
        response, engine = self._responses[scene.imaging.response], scene.outside.projector
        # Both cameras see the same frame: its number follows from the clock, not from the camera.
        frame, seed = round(clock_s / FRAME_S), self.truth.seed
        beamed = [part for part in slices if isinstance(part, BeamerSlice)]
        if beamed:
            lamp = engine or LightEngine()
            return beamed_between(
                beamed,
                begin_s,
                end_s,
                response,
                lamp,
                lambda k, at_s: lamp.brightness(frame + k, lit_for_s + at_s, seed),
            )
        if engine is None:
            return light_between(slices, begin_s, end_s, response)
        return flashed_between(engine, slices, begin_s, end_s, response, frame, lit_for_s, seed)

    def _add_instant(
        self,
        camera: str,
        scene: Scene,
        time_s: float,
        clock_s: float,
        light: Picture | None,
        duration_s: float,
        lasers: tuple[bool, bool],
        electrons: Picture,
    ) -> None:
        """Add the light of ``duration_s`` with the scene at ``time_s`` of the hands.

        ``light``: projector light in this time, in seconds of white; ``None``: it is off.
        """
        pose = self._stage.pose(scene, time_s)
        geometry = self._geometry(camera, scene, pose, clock_s, is_lit=light is not None)
        particles = scene.outside.backscatter
        apart = scene.drift.specks or particles is not None
        total, electrons = electrons, np.zeros_like(electrons) if apart else electrons
        veil = None
        daylight, white_e = scene.daylight, WHITE_E_PER_S * duration_s
        # Ambient light is in units of the projector's white in the middle of the volume.
        ambient = np.float32(white_e * scene.ambient * daylight.flicker(clock_s, duration_s))
        softened = None
        if light is None:
            electrons += ambient * geometry.pixels[..., GREY]
        else:
            if particles is None:
                scattered = self._backscatter(camera, scene).seen(light, geometry.distance_mm)
            else:
                scattered = self._veil(camera, scene, particles).seen(light, geometry.distance_mm)
                light = self._spread(scene, particles).light(light)
            # In units of the light of a surface of albedo 0.6 in the middle (water.medium.Water.backscatter).
            scattered *= np.float32(WHITE_E_PER_S * 0.6 * scene.water.backscatter)
            if particles is not None:
                # Backscatter has other paths to the camera: it is added after the spread of the farther light.
                veil, scattered = scattered, np.zeros_like(scattered)
            coat = scene.outside.surfaces
            if coat is not None:
                if coat.bounce > 0.0:
                    fallen = self._stage.bounce(scene, coat).seen(light, geometry)
                    electrons += np.float32(WHITE_E_PER_S * coat.bounce) * fallen
                light = coat.spread_below(light)
            softest_px = SPREAD_FAR_PX if scene.outside.projector is None else SOFTEST_PX
            spread_px = softest_px if scene.imaging.projector_defocus else 0.0
            softened = soften(light, _water_blur_mm(scene) / PROJECTOR_PX_MM, spread_px)
            collect(geometry.pixels, softened, np.float32(WHITE_E_PER_S), ambient, scattered, electrons)
        if not daylight.even:
            self._uneven.add(
                daylight, clock_s, duration_s, float(ambient), white_e,
                self._stage.rays(camera), geometry, pose, self._stage.pose(scene, 0.0), electrons,
            )  # fmt: skip
        for number, (on, laser) in enumerate(zip(lasers, self.truth.lasers, strict=True)):
            if on:
                # Speckle differs between lasers and between cameras, but not between frames of a scene at rest.
                grain = 4 * self.truth.seed + 2 * number + CAMERAS.index(camera) if scene.noise else None
                add_laser(
                    electrons, LASER_E_PER_S * duration_s, laser, self._stage.eyes[camera], self._stage.rays(camera),
                    pose, geometry, scene.water, grain,
                )  # fmt: skip
        if particles is not None:
            electrons = self._spread(scene, particles).picture(electrons)
            if veil is not None:
                electrons += veil
        if scene.drift.specks:
            self._scatter(camera, scene, pose, clock_s, duration_s, geometry, softened, float(ambient), electrons, None)
        if apart:
            total += electrons

    def _geometry(self, camera: str, scene: Scene, pose: Pose, clock_s: float, is_lit: bool) -> Geometry:
        """Return the camera's geometry, including fish."""
        geometry = self._stage.geometry(camera, scene, pose, is_lit)
        if not scene.drift.fish:
            return geometry
        school = self._swarm(scene).school(clock_s, pose, self._stage.pose(scene, 0.0))
        return before(
            self._stage.rays(camera), geometry, school, self._stage.lamp, scene.water.attenuation_per_m, is_lit
        )  # fmt: skip

    def _scatter(
        self,
        camera: str,
        scene: Scene,
        pose: Pose,
        clock_s: float,
        duration_s: float,
        geometry: Geometry,
        softened: Picture | None,
        ambient_e: float,
        electrons: Picture,
        covered: Picture | None,
    ) -> None:
        """Draw snow and bubbles over ``electrons``."""
        stage = self._stage
        specks = self._swarm(scene).specks(clock_s, pose, stage.pose(scene, 0.0))
        scatter(
            electrons, covered, specks, duration_s, stage.eyes[camera], stage.table(camera), stage.rays(camera),
            geometry, stage.lamp, None if softened is None else stage.shadows(pose), softened,
            WHITE_E_PER_S, ambient_e, scene.water.attenuation_per_m,
        )  # fmt: skip

    def _swarm(self, scene: Scene) -> Swarm:
        return self._swarms.get(scene.drift, lambda: Swarm(scene.drift))

    def _blurred(self, camera: str, scene: Scene, electrons: Picture) -> Picture:
        """Return the image blurred by the lens, and by the water."""
        scale = self._scale(camera)
        lens_px = max(LENS_BLUR_PX * scale, LEAST_BLUR_PX)
        # Blurs of independent causes add as variances.
        sigma_px = math.hypot(lens_px, _water_blur_mm(scene) / CAMERA_PX_MM * scale)
        return np.asarray(cv2.GaussianBlur(electrons, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)

    def _defocused(self, camera: str, scene: Scene, image: Picture, time_s: float) -> Picture:
        """Return the image blurred away from the focus.

        Variance grows with the square of the distance; background behind an edge is blurred by its own distance.
        """
        away = self._stage.geometry(camera, scene, self._stage.pose(scene, time_s)).distance_mm - MIDDLE_MM
        share = np.nan_to_num(np.minimum((away / FAR_MM) ** 2, 1.0)).astype(np.float32)
        sigma_px = DEFOCUS_FAR_PX * self._scale(camera)
        soft = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(image + share * (soft - image), np.float32)

    def _scale(self, camera: str) -> float:
        return self.truth.eye(camera).width_px / 1600.0

    def _backscatter(self, camera: str, scene: Scene) -> Backscatter:
        per_m = scene.water.attenuation_per_m
        return self._backscatters[camera].get(
            per_m, lambda: Backscatter(self._stage.rays(camera), self._stage.lamp, per_m)
        )  # fmt: skip

    def _veil(self, camera: str, scene: Scene, particles: Particles) -> Veil:
        per_m, defocus = scene.water.attenuation_per_m, scene.imaging.projector_defocus
        return self._veils[camera].get(
            (per_m, particles, defocus),
            lambda: Veil(self._stage.rays(camera), self._stage.lamp, particles, per_m, defocus),
        )

    def _spread(self, scene: Scene, particles: Particles) -> ForwardSpread:
        per_m = scene.water.attenuation_per_m
        return self._spreads.get((per_m, particles), lambda: ForwardSpread(particles, per_m))

    def _sensor(self, camera: str, scene: Scene) -> Sensor:
        eye = self.truth.eye(camera)
        seed = 2 * self.truth.seed + CAMERAS.index(camera)
        return self._sensors[camera].get(
            scene.noise, lambda: Sensor(eye.width_px, eye.height_px, seed, scene.noise)
        )  # fmt: skip

    def _sensor_of_traits(self, camera: str, scene: Scene, traits: CameraTraits) -> SensorOfTraits:
        eye = self.truth.eye(camera)
        seed = 2 * self.truth.seed + CAMERAS.index(camera)
        return self._sensors_of_traits[camera].get(
            (scene.noise, traits), lambda: SensorOfTraits(eye.width_px, eye.height_px, seed, scene.noise, traits)
        )


def _water_blur_mm(scene: Scene) -> float:
    """Return the Gaussian sigma of forward scatter on one path, mm in the middle of the volume.

    It is 0 if ``ForwardSpread`` does it instead.
    """
    if scene.outside.backscatter is not None:
        return 0.0
    return scene.water.blur_px_per_m * CAMERA_PX_MM * MIDDLE_MM / 1000.0
