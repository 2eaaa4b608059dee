"""The simulated world: the devices and their connections, the scene, and the images of the cameras.

It is also the back door for tests and the training simulator; ``docs/protocols/world.md`` is its manual.
"""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw_sim import registry
from hw_sim.devices.board import Board, Shot
from hw_sim.devices.cable import Cable
from hw_sim.devices.card import Card
from hw_sim.devices.head import Flip, Output
from hw_sim.devices.keypad import Keypad
from hw_sim.devices.shutter import Exposure, Latent
from hw_sim.devices.u3v_camera import U3vCamera
from hw_sim.faults import Fault, FaultBook
from hw_sim.heat import Housing, Powers
from hw_sim.in_dive import NOTICED_K, REFERENCE_C, in_dive
from hw_sim.light.daylight import Daylight
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.objects.motion import Motion, swayed_s
from hw_sim.optics.beamer import Beamer, ProjectorTruth, ShownFrame, Signal, slices_of
from hw_sim.optics.projector import response
from hw_sim.options import OptionError, WorldOptions, options_from
from hw_sim.punctuality import Punctuality
from hw_sim.rendering.exposure_worker import ExposureWorker, PendingImage
from hw_sim.rendering.frame_cache import FrameCache
from hw_sim.rendering.render import LightSlice, Renderer, Surface, TrueView
from hw_sim.scene import Scene
from hw_sim.timing.calendar import Calendar
from hw_sim.timing.world_thread import WorldThread
from hw_sim.timing.world_time import START_NS, WorldTime
from hw_sim.truth import SETS, TrueRig, draw_truth, in_air, load_truth, with_flaws, with_glass
from hw_sim.water.drift import Drift
from hw_sim.water.medium import Water

__all__ = ["World", "WorldOptions"]

LOG = logging.getLogger(__name__)
SIDES = ("left", "right")
SERIALS = {"left": "KF-CAM-L", "right": "KF-CAM-R"}
HUMIDITY_PERCENT, SUPPLY_V = 38.0, 12.1
SERIES_APART_S = 101.0037
"""Time between sequences by the clock of daylight, so that a sequence's light does not depend on the host's speed."""
WARM_UP_EVERY_S = 0.5
LIT_DN = 8.0
"""Least mean code that is scanned out for the projector's lamp to be on."""
KEPT_INTERVALS = 12
"""Longest exposure, in vertical blanks, during which the projector may change."""


@dataclass(slots=True)
class _Interval:
    """The time from one vertical blank to the next."""

    begin_ns: int
    light: NDArray[np.uint8] | None = None
    """Copied on demand."""
    signal: Signal | None = None
    """The same of all channels, unless the projector shows green immediately."""
    dark: bool = False
    """The projector's lamp was off."""


class World:
    """The simulated world. A context manager: inside it, time passes.

    With a ``cable``, a computer outside drives the projector instead of the simulated graphics card.

    Raises OptionError for options that do not fit. A failure of the world itself is raised at its end.
    """

    def __init__(self, options: WorldOptions | None = None, cable: Cable | None = None) -> None:
        self.options = options or WorldOptions()
        o = self.options
        if cable is not None and o.pace != "realtime":
            raise OptionError(f"pace '{o.pace}' with a computer outside; its clock is the real one: choose realtime")
        self.cable = cable
        scene, beamer = o.scene(), o.beamer()
        self._beamer = None if beamer.usual else beamer
        if cable is not None and self._beamer is not None:
            raise OptionError(
                f"projector '{beamer.kind}' with a computer outside, whose cable has green only; leave it out"
            )
        self._beamer_truth = ProjectorTruth(beamer, 1e6 / o.refresh_hz, response(scene.imaging.response))
        self._rig = _true_rig(o, scene)
        self._scene = scene
        self._warm_k = scene.water.temperature_c - REFERENCE_C
        self.truth = self._rig_of_today()
        """The rig as it is now: knocks, heat and depth are part of it."""
        self._renderer_lock = threading.Lock()
        self._made_renderer: Renderer | None = None
        self._frame_cache = FrameCache() if o.stills else None
        self.time = WorldTime(o.idle_speed, round(1e9 / o.refresh_hz))
        self.calendar = Calendar(self.time.now_ns, o.date)
        self.faults = FaultBook(self.time.now_ns, self.time.at, self._broken_or_repaired)
        self._exposure_worker = ExposureWorker(self.time, SIDES, self._failed)
        self._failure: BaseException | None = None
        self._housing = Housing(scene.water.temperature_c, o.medium)
        self._warmed_ns = START_NS
        with self.time.condition:
            self.card = Card(self.time.condition.notify_all, o.refresh_hz, projector_px=o.drawing().projector_px)
            self.board = Board(
                *(self.time, self.faults, self._fire, self._sensor, o.seed),
                period_ns=self.time.period_ns if cable is None else cable.period_ns,
                clocks=scene.outside.clocks,
            )
            self.keypad = Keypad(self.time, self.faults, o.seed)
            self.cameras = {side: self._camera(side) for side in SIDES}
            self.board.vsync(self.time.blank_ns)  # the console has been on the projector since boot
        self._intervals: deque[_Interval] = deque([_Interval(START_NS)], maxlen=_most_intervals(self._beamer))
        self._shown_before: NDArray[np.uint8] | Signal | None = None
        self._late_flip: Flip | None = None
        self.punctuality = Punctuality()
        """Delays of the host, and of the world."""
        self._latest: dict[str, PendingImage] = {}
        self._recorded: dict[str, PendingImage] = {}
        """The last image of a sequence that each camera took."""
        self._seen: dict[str, NDArray[np.uint8]] = {}
        self._first_pulse_ns: dict[int, int] = {}
        self._world_thread = WorldThread(self.time, self, self._blank, o.pace, o.idle_speed)

    def __enter__(self) -> World:
        with self.time.condition:
            for sentence in self.options.faults:
                self.faults.add(sentence)
        # After the faults, of which one may be refused, and before the first blank: a registered world is running.
        registry.register(self.options.world, self)
        self._world_thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        registry.unregister(self.options.world, self)
        with self.time.condition:
            self.time.close()
        self._world_thread.wait_until_ended()
        self._exposure_worker.close()
        failure = self._failure or self._world_thread.failure
        if failure is not None and error is None:
            raise failure

    # ------------------------------------------------------------------------------------------ back door

    @property
    def time_ns(self) -> int:
        """World time."""
        return self.time.now_ns()

    @property
    def scene(self) -> Scene:
        """The scene before the instrument."""
        return self._scene

    @property
    def _renderer(self) -> Renderer:
        """Make the renderer with the first image, since it takes a while."""
        with self._renderer_lock:
            if self._made_renderer is None:
                self._made_renderer = Renderer(self.truth, self._scene)
            return self._made_renderer

    def press(self, key: str, hold_s: float = 0.15) -> None:
        """Press a key (``scan back up down``) now, for ``hold_s``; returns at once. Raises ValueError."""
        with self.time.condition:
            self.keypad.press(key, hold_s)

    def touch(self, key: str, at_ns: int = 0) -> None:
        """Press a key until ``let_go``, from world time ``at_ns`` on, or now if that is past. Raises ValueError."""
        with self.time.condition:
            self.keypad.touch(key, at_ns)

    def let_go(self, key: str, at_ns: int = 0) -> None:
        """Release it, at ``at_ns`` or now. Raises ValueError."""
        with self.time.condition:
            self.keypad.let_go(key, at_ns)

    def set_object(self, name: str, pose: Sequence[float] | None = None) -> None:
        """Put another object before the instrument, at its usual pose or at [x, y, z, rx_deg, ry_deg, rz_deg]."""
        x, y, z, rx, ry, rz = pose or (0.0,) * 6
        self.set_scene(replace(self.scene, object=name, pose=None if pose is None else (x, y, z, rx, ry, rz)))

    def knock(self, shift: MountShift) -> None:
        """Shift a camera in its mount, permanently; the next image shows it."""
        with self._renderer_lock:
            self._rig = with_mount_shifted(self._rig, shift)
            self._change_truth()

    def _rig_of_today(self) -> TrueRig:
        mounts = self._scene.outside.mounts
        return self._rig if mounts is None else in_dive(self._rig, mounts, self._warm_k)

    def _change_truth(self) -> None:
        """Use the present rig for the next images. The caller holds the renderer's lock."""
        self.truth = self._rig_of_today()
        if self._made_renderer is not None:
            self._made_renderer = Renderer(self.truth, self._scene)
            self._frame_cache = FrameCache() if self._frame_cache is not None else None

    def _drift_with_heat(self) -> None:
        """Let the mounts follow the case's temperature, but not within a sequence: a second is too short."""
        warm_k = self._housing.temperature_c("TCASE") - REFERENCE_C
        if self._scene.outside.mounts is None or abs(warm_k - self._warm_k) < NOTICED_K or self.recording:
            return
        with self._renderer_lock:
            self._warm_k = warm_k
            self._change_truth()

    def set_motion(self, motion: Motion) -> None:
        """Change the motion of the hands during sequences: time 0 is the first pulse, live images are at rest."""
        self.set_scene(replace(self.scene, motion=motion))

    def set_daylight(self, daylight: Daylight) -> None:
        """Change the ambient light, from the next image on."""
        self.set_scene(replace(self.scene, daylight=daylight))

    def set_drift(self, drift: Drift) -> None:
        """Change the specks and fish in the water, from the next image on."""
        self.set_scene(replace(self.scene, drift=drift))

    def set_water(self, water: Water) -> None:
        """Change attenuation and scattering of the water, from the next image on; its index does not change."""
        self.set_scene(replace(self.scene, water=water))

    def set_caps(self, *sides: str) -> None:
        """Put caps on the lenses of the cameras ``sides`` (``left``, ``right``), and remove all others.

        From the next image on. Raises ValueError.
        """
        self.set_scene(replace(self.scene, capped=frozenset(sides)))

    def set_projector(self, beamer: Beamer) -> None:
        """Change the settings of the projector's electronics, from the next blank on.

        Raises OptionError if a computer outside drives it.
        """
        if self.cable is not None:
            raise OptionError(
                f"projector '{beamer.kind}' with a computer outside, whose cable has green only; leave it as it is"
            )
        with self.time.condition:
            self._beamer = None if beamer.usual else beamer
            self._beamer_truth = replace(self._beamer_truth, beamer=beamer)
            # Earlier images are stored in another form; one black blank replaces them.
            self._intervals = deque([_Interval(self._intervals[-1].begin_ns)], maxlen=_most_intervals(self._beamer))
            self._shown_before = None

    def set_pace(self, pace: str) -> None:
        """Change the pace of world time: ``realtime``, ``attended`` or ``lockstep``. Raises OptionError."""
        self.options = replace(self.options, pace=pace)
        with self.time.condition:
            self._world_thread.set_pace(pace)

    def set_scene(self, scene: Scene) -> None:
        """Change the scene, from the next image on. The refractive index does not change."""
        with self._renderer_lock:
            self._scene = scene
            if self._made_renderer is not None:
                self._made_renderer.scene = scene

    def fault(self, sentence: str) -> Fault:
        """Inject a fault. Raises FaultSyntaxError."""
        with self.time.condition:
            return self.faults.add(sentence)

    @property
    def broken(self) -> tuple[str, ...]:
        """The sentences of all faults, present and future."""
        with self.time.condition:
            return self.faults.sentences

    @property
    def recording(self) -> bool:
        """True if a sequence is armed, or its images are still being made."""
        with self.time.condition:
            return self.armed is not None or self.developing

    def mend(self, component: str, verb: str) -> None:
        """Repair one fault, such as ``laser.left`` ``off``. Raises FaultSyntaxError if there is no such fault."""
        with self.time.condition:
            self.faults.mend(component, verb)

    def clear_faults(self) -> None:
        """Repair all faults."""
        with self.time.condition:
            self.faults.clear()

    def scanned_out(self, head: str) -> NDArray[np.uint8]:
        """Return the image that a head scans out.

        ``projector``: (768, 1024) uint8 that lights the scene now (with a latency of the projector, the image of so
        many blanks ago; green alone, where it lights the raster); ``display``: (h, w, 3) uint8 RGB.
        """
        with self.time.condition:
            match head:
                case "projector":
                    return self._light(self._intervals[-1]).copy()
                case "display":
                    return self.card.displayed()
                case _:
                    raise ValueError(f"head '{head}'; allowed are projector, display")

    def seen(self, side: str) -> NDArray[np.uint8] | None:
        """Return the last image (h, w) uint8 of a camera (``left``, ``right``), read-only; ``None``: no image yet."""
        with self.time.condition:
            return self._seen.get(side)

    @property
    def projector_truth(self) -> ProjectorTruth:
        """The true values for a measurement of the projector."""
        return self._beamer_truth

    @property
    def surface(self) -> Surface:
        """The true surface at rest, as at a sequence's first pulse."""
        return self._renderer.surface(0.0)

    def view(self, camera: str) -> TrueView:
        """Return the ground truth of a camera's image at rest, as at a sequence's first pulse."""
        return self._renderer.view(camera, 0.0)

    # ------------------------------------------------------------------------------------------ recording

    @property
    def armed(self) -> int | None:
        """Number of the sequence that the board is firing."""
        return self.board.armed

    @property
    def host_ready(self) -> bool:
        """True if the host has its next pattern ready and reads its cameras."""
        return self.card.flip_pending(Output.PROJECTOR) and all(camera.room for camera in self.cameras.values())

    @property
    def developing(self) -> bool:
        """True if images of a sequence are still being made."""
        return any(not image.ready for image in self._recorded.values())

    # ------------------------------------------------------------------------------------------ what happens

    def _blank(self, time_ns: int) -> None:
        if self.cable is not None and not self.cable.syncs(time_ns):
            self._warm_up(time_ns)
            return
        before = self._intervals[-1]
        wrong = self.faults.active("projector", "wrong") is not None
        # Light that an exposure still needs must be copied before the flip overwrites it.
        if self._beamer is not None:
            self._hold(before)  # the projector may show it later
        elif wrong or any(camera.shutter.exposing_until_ns > time_ns for camera in self.cameras.values()):
            self._light(before)
        frame = self.board.upcoming_frame()
        if frame is not None:
            self.faults.reach(frame, time_ns)
            wrong = self.faults.active("projector", "wrong") is not None
        self._shown_before = self._scanned() if wrong else None
        waiting = (self.card.pending(Output.PROJECTOR), self.card.pending(Output.DISPLAY))
        self.punctuality.blank(self.time.blank_late_ns, frame is not None, *waiting)
        self.card.vblank(time_ns, Output.PROJECTOR if self._flip_is_late(frame) else None)
        if self.cable is not None:
            self.cable.vblank(time_ns)
        self._intervals.append(_Interval(time_ns))
        self._warm_up(time_ns)
        if self._driven:
            self.board.vsync(time_ns)
        else:
            self.board.no_vsync(time_ns)

    def _flip_is_late(self, frame: int | None) -> bool:
        """Return True if the projector's pending flip misses this blank; each flip does so once at most."""
        flip = self.card.pending(Output.PROJECTOR)
        if flip is None or flip is self._late_flip or not self.faults.strike("projector", "delayed", frame=frame):
            return False
        self._late_flip = flip
        return True

    def _light(self, interval: _Interval) -> NDArray[np.uint8]:
        """Return the codes (768, 1024) that light the scene during the present interval: those of green."""
        if interval.light is None:
            dark = self.faults.active("projector", "off") is not None
            if self._beamer is None:
                shown = np.asarray(self._scanned() if self._shown_before is None else self._shown_before)
            else:
                self._hold(interval)
                number = len(self._intervals) - 1 - self._beamer.latency
                signal = self._intervals[number].signal if number >= 0 else None
                shown = (
                    np.zeros(self.card.projector_px[::-1], np.uint8) if signal is None else self._beamer.lights(signal)
                )
            interval.light = np.zeros_like(shown) if dark else shown
        return interval.light

    def _hold(self, interval: _Interval) -> None:
        """Copy the scanned-out image of the present interval, for the projector to show it later."""
        if interval.signal is None:
            shown = self._scanned() if self._shown_before is None else self._shown_before
            assert isinstance(shown, tuple)
            interval.signal = shown
            interval.dark = self.faults.active("projector", "off") is not None

    def _scanned(self) -> NDArray[np.uint8] | Signal:
        """Return the signal on the cable: green, or all channels if the projector uses them."""
        return self._projected() if self._beamer is None else self.card.projected_colours()

    @property
    def _driven(self) -> bool:
        """True if the projector gets a signal."""
        return self.card.crtc(Output.PROJECTOR) is not None if self.cable is None else self.cable.driven

    def _projected(self) -> NDArray[np.uint8]:
        """Return the codes (768, 1024) at the projector's input."""
        return self.card.projected() if self.cable is None else self.cable.projected()

    def _fire(self, time_ns: int, width_ns: int, shot: Shot) -> None:
        if shot.count is not None and shot.series not in self._first_pulse_ns:
            self._first_pulse_ns = {shot.series: time_ns}
        for camera in self.cameras.values():
            camera.line0(time_ns, width_ns, shot)

    def _camera(self, side: str) -> U3vCamera:
        o = self.options
        return U3vCamera(
            *(f"camera.{side}", o.serials.get(side, SERIALS[side]), (o.width_px, o.height_px), self.time, self.faults),
            expose=lambda exposure: self._expose(side, exposure),
            temperature_c=lambda: self._housing.temperature_c("camera"),
            seed=o.seed,
            power_on=o.power_on(side),
            clocks=self._scene.outside.clocks,
        )

    def _expose(self, side: str, exposure: Exposure) -> Latent | None:
        """Begin the image of an exposure that has ended: all its light is known by now."""
        latest = self._latest.get(side)
        live = exposure.shot.count is None
        if live and self.options.pace == "attended" and latest is not None and not latest.ready:
            return latest  # a live image that comes minutes late is useless
        end_ns = exposure.start_ns + exposure.duration_ns
        slices = self._slices(exposure.start_ns, end_ns)
        clock_s = (exposure.start_ns - START_NS + exposure.duration_ns / 2) / 1e9
        moment_s = swayed_s(self._scene.motion, clock_s) if live else 0.0
        if not live:
            first_ns = self._first_pulse_ns.get(exposure.shot.series, exposure.start_ns)
            moment_s = (exposure.start_ns - first_ns + exposure.duration_ns / 2) / 1e9
            # Frames of a sequence use its own clock, so that a slow host gets the same images as a fast one.
            clock_s = moment_s + SERIES_APART_S * exposure.shot.series
        seed, lasers = self._noise_seed(side, exposure.shot), self.board.lasers_on
        exposure_s, gain_db = exposure.duration_ns / 1e9, exposure.gain_db
        frame = exposure.shot.frame
        pending = self._exposure_worker.make(
            side,
            lambda: self._image(side, slices, moment_s, exposure_s, gain_db, lasers, seed, clock_s, frame),
        )
        if pending is not None:
            self._latest[side] = pending
            if not live:
                self._recorded[side] = pending
            pending.when_ready(lambda: self._seen.update({side: pending.image}))
        return pending

    def _slices(self, start_ns: int, end_ns: int) -> Sequence[LightSlice]:
        """Return the slices of light of an exposure that has ended, from its start on."""
        frame_s = self.time.period_ns / 1e9
        if self._beamer is not None:
            self._hold(self._intervals[-1])
            frames = [ShownFrame(i.begin_ns, i.signal, i.dark) for i in self._intervals if i.signal is not None]
            return slices_of(self._beamer, frames, start_ns, end_ns, frame_s)
        slices, until_ns = [], end_ns
        self._light(self._intervals[-1])
        # From the end of the exposure backwards: each interval lights the part of it that it overlaps.
        for interval in reversed(self._intervals):
            begin_ns = max(interval.begin_ns, start_ns)
            if until_ns > begin_ns and interval.light is not None:
                since_s = (begin_ns - interval.begin_ns) / 1e9
                slices.append(LightSlice(interval.light, (until_ns - begin_ns) / 1e9, since_s, frame_s))
            until_ns = min(until_ns, interval.begin_ns)
        return slices[::-1]

    def _image(
        self,
        side: str,
        slices: Sequence[LightSlice],
        moment_s: float,
        exposure_s: float,
        gain_db: float,
        lasers: tuple[bool, bool],
        seed: int,
        clock_s: float,
        frame: int | None,
    ) -> NDArray[np.uint8]:
        """Render one image or, if it was rendered before, repeat it. Called without the lock."""
        renderer = self._renderer

        def render() -> NDArray[np.uint8]:
            return renderer.expose(side, slices, moment_s, exposure_s, gain_db, lasers, seed, clock_s)

        # In a scene that moves or whose light changes, no frame is equal to another.
        if self._frame_cache is None or not self._scene.still:
            return render()
        key = self._frame_cache.key(side, repr(self._scene), slices, exposure_s, gain_db, lasers, frame)
        return self._frame_cache.get(key, render)

    def _noise_seed(self, side: str, shot: Shot) -> int:
        """Return a seed that is the same for the same frame of the same sequence, independent of the host's speed."""
        key = f"{self.options.seed} {side} {shot.series} {shot.index}".encode()
        return int.from_bytes(hashlib.blake2b(key, digest_size=4).digest(), "little")

    def _broken_or_repaired(self, time_ns: int) -> None:
        for camera in self.cameras.values():
            camera.refresh(time_ns)
        self.board.refresh(time_ns)
        self.keypad.refresh(time_ns)
        self.card.plug(self.faults.active("graphics", "off") is None)
        self.time.condition.notify_all()

    def _failed(self, error: BaseException) -> None:
        LOG.error("the world ends: %s", error)
        self._failure = error
        self.time.close()

    # ------------------------------------------------------------------------------------------ sensors

    def _warm_up(self, time_ns: int) -> None:
        """Warm the housing by the power since the last call."""
        passed_s = (time_ns - self._warmed_ns) / 1e9
        if passed_s < WARM_UP_EVERY_S:
            return
        self._warmed_ns = time_ns
        shines = self.board.armed is not None or bool(self._light(self._intervals[-1])[::64, ::64].mean() > LIT_DN)
        streaming = any(camera.acquiring for camera in self.cameras.values())
        # The water may have been changed: its temperature matters here, although the refractive index does not change.
        self._housing.outside_c = self._scene.water.temperature_c
        self._housing.advance(passed_s, Powers(shines, streaming, any(self.board.lasers_on)))
        self._drift_with_heat()

    def _sensor(self, name: str) -> str:
        """Return a sensor's value as the board prints it; ``-`` if it does not answer."""
        if name == "LEAK":
            return "1" if self.faults.active("leak", "wrong") else "0"
        if self.faults.active(f"sensor.{name}", "off"):
            return "-"
        wrong = self.faults.active(f"sensor.{name}", "wrong")
        if wrong is not None:
            return f"{wrong.amount:.1f}"
        match name:
            case "HUM":
                return f"{HUMIDITY_PERCENT:.1f}"
            case "SUPPLY":
                return f"{SUPPLY_V:.2f}"
            case _:
                return f"{self._housing.temperature_c(name):.1f}"


def _most_intervals(beamer: Beamer | None) -> int:
    return KEPT_INTERVALS + (0 if beamer is None else beamer.latency + 1)


def true_rig(options: Mapping[str, Any]) -> TrueRig:
    """Return the true rig of a world with ``options`` (``[rig.wires_options]``).

    Raises OptionError.
    """
    parsed = options_from(options)
    return _true_rig(parsed, parsed.scene())


def _true_rig(o: WorldOptions, scene: Scene) -> TrueRig:
    n_water = scene.index
    wet = (
        draw_truth(o.truth, o.seed, o.width_px, o.height_px, n_water, o.drawing())
        if o.truth in SETS
        else _stored_truth(Path(o.truth), n_water)
    )
    # Lens flaws and plate forms are part of the rig, in water and in air.
    wet = with_flaws(wet, scene.outside)
    wet = with_glass(wet, scene.glass_more)
    return in_air(wet) if o.medium == "air" else wet


def _stored_truth(path: Path, n_water: float) -> TrueRig:
    try:
        return load_truth(path, n_water)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OptionError(
            f"truth {path}: cannot be read as a true rig ({type(error).__name__}: {error}); "
            f"allowed are {', '.join(SETS)}, or a file as save_truth writes it"
        ) from error
