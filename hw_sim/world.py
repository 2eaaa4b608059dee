"""Owns the one truth behind the wires: time, hands, object, water, light, temperatures, and what is scanned out.

A single thread, ``sim-world``, moves the world from vertical blank to vertical blank. At each blank the card latches the
flips that wait, the board sees the projector's vertical sync and fires its pulses, and both cameras expose what the
projector then really shows. Frames are rendered by two pool threads and delivered at the first blank after their
exposure has ended.
"""

from __future__ import annotations

import itertools
import threading
import time as real_time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from hw_sim import registry
from hw_sim.devices.board import TriggerBoard
from hw_sim.devices.card import DisplayCard
from hw_sim.devices.keypad import KeyPad
from hw_sim.devices.u3v_camera import Exposure, U3vCamera
from hw_sim.faults import Fault, FaultBook
from hw_sim.motion import Motion
from hw_sim.options import Pose, WorldOptions
from hw_sim.pace import BLANK_NS, WorldTime
from hw_sim.render import LightSlice, Renderer, Surface, TrueView
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth

SIDES = ("left", "right")
PATIENCE_S = 5.0
"""Real time for which an armed board makes the world wait for the host's next flip."""
RENDER_TIMEOUT_S = 120.0
JOIN_TIMEOUT_S = 10.0
HISTORY = 8


@dataclass(slots=True)
class _Shot:
    """One exposure on its way from the pulse to the camera's memory."""

    side: str
    exposure: Exposure
    frame: int | None
    moment_s: float
    seed: int
    image: Future[NDArray[np.uint8]] | None = None

    @property
    def end_ns(self) -> int:
        return self.exposure.start_ns + int(self.exposure.exposure_s * 1e9)


class World:
    """The simulated world. A context manager: inside it, time passes. ``docs/protocols/world.md`` is its manual."""

    def __init__(self, options: WorldOptions | None = None) -> None:
        self.options = options or WorldOptions()
        o = self.options
        scene = o.scene()
        self.time = WorldTime()
        self.faults = FaultBook(self.time.now_ns)
        self.truth: TrueRig = draw_truth(o.truth, o.seed, o.width_px, o.height_px, scene.water.index)
        self.cameras = {
            side: U3vCamera(side, f"KF-CAM-{side[0].upper()}", o.width_px, o.height_px, self.time, self.faults, o.seed)
            for side in SIDES
        }
        self.board = TriggerBoard(self.time, self.faults, o.seed)
        self.keypad = KeyPad(self.time, self.faults, o.seed)
        self.card = DisplayCard(self.time, self.faults, display_size=(o.display_width_px, o.display_height_px))
        for sentence in o.faults:
            self.faults.add(sentence)
        self._renderer = Renderer(self.truth, scene)
        self._pool = ThreadPoolExecutor(2, "sim-render")
        self._shots: deque[_Shot] = deque()
        self._light: deque[tuple[int, NDArray[np.uint8]]] = deque(maxlen=HISTORY)
        self._exposures = 0
        self._sequence_start_ns: int | None = None
        self._impatient = False
        self._last_real_ns = real_time.monotonic_ns()
        self._delayed: NDArray[np.uint8] | None = None
        self._thread = threading.Thread(target=self._run, name="sim-world", daemon=True)
        self.error: BaseException | None = None
        """What stopped the world, if anything did."""

    def __enter__(self) -> World:
        registry.register(self.options.world, self)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self.time.condition:
            self.time.closed = True
            self.time.condition.notify_all()
        self._thread.join(JOIN_TIMEOUT_S)
        self._pool.shutdown(wait=True, cancel_futures=True)
        registry.unregister(self.options.world, self)
        if self.error is not None and error is None:
            raise self.error

    # ------------------------------------------------------------------------------------------ back door

    @property
    def time_ns(self) -> int:
        """World time."""
        return self.time.now_ns()

    @property
    def scene(self) -> Scene:
        return self._renderer.scene

    def press(self, key: str, hold_s: float = 0.15) -> None:
        """Press a key (``scan back up down``) now; returns at once."""
        with self.time.condition:
            self.keypad.press(key, hold_s)
            self.time.condition.notify_all()

    def set_object(self, name: str, pose: Pose | Sequence[float] | None = None) -> None:
        """Put another object before the instrument."""
        six = None if pose is None else (pose[0], pose[1], pose[2], pose[3], pose[4], pose[5])
        self._renderer.scene = replace(self.scene, object=name, pose=six)

    def set_scene(self, scene: Scene) -> None:
        """Change object, light, water's dimness or hands. The refractive index stays that of the start."""
        self._renderer.scene = scene

    def set_motion(self, motion: Motion) -> None:
        """How the hands move during sequences; time 0 is a sequence's first pulse, live views are at rest."""
        self._renderer.scene = replace(self.scene, motion=motion)

    def fault(self, sentence: str) -> Fault:
        """Break something. Raises FaultSyntaxError."""
        with self.time.condition:
            fault = self.faults.add(sentence)
            self.time.condition.notify_all()
        return fault

    def clear_faults(self) -> None:
        """Repair everything."""
        with self.time.condition:
            self.faults.clear()
            self.time.condition.notify_all()

    def scanned_out(self, head: str) -> NDArray[np.uint8]:
        """What a head shows now: ``projector`` (768, 1024) green, ``display`` (h, w, 3) RGB."""
        with self.time.condition:
            return self.card.scanned_out(head).copy()

    @property
    def surface(self) -> Surface:
        """The true surface at rest."""
        return self._renderer.surface(0.0)

    def view(self, camera: str) -> TrueView:
        """What a camera truly sees, at rest."""
        return self._renderer.view(camera, 0.0)

    # ------------------------------------------------------------------------------------------ time

    def _run(self) -> None:
        try:
            while self._gate():
                self._deliver()
                self._blank()
        except BaseException as error:
            with self.time.condition:
                self.error = error
                self.time.closed = True
                self.time.condition.notify_all()

    def _gate(self) -> bool:
        """Wait until the next blank may happen; False when the world ends."""
        speed = 1.0 if self.options.pace == "realtime" else self.options.idle_speed
        waiting_since = real_time.monotonic_ns()
        due_ns = self._last_real_ns + int(BLANK_NS / speed)
        with self.time.condition:
            while not self.time.closed:
                now_ns = real_time.monotonic_ns()
                armed = self.options.pace == "lockstep" and self.board.armed_left > 0
                if not armed:
                    self._impatient = False
                if armed and not self._impatient:
                    if self.card.flip_pending("projector") and all(c.room > 0 for c in self.cameras.values()):
                        break
                    self._impatient = now_ns - waiting_since > PATIENCE_S * 1e9
                elif now_ns >= due_ns:
                    break
                left_s = (due_ns - now_ns) / 1e9
                self.time.condition.wait(0.001 if armed else min(max(left_s, 0.0005), 0.02))
            self._last_real_ns = real_time.monotonic_ns()
            return not self.time.closed

    def _deliver(self) -> None:
        """Hand over the frames whose exposure ended before the coming blank."""
        coming_ns = self.time.blank_ns + BLANK_NS
        while self._shots and self._shots[0].end_ns <= coming_ns:
            shot = self._shots.popleft()
            if shot.image is None:
                shot.image = self._render(shot)
            image = shot.image.result(RENDER_TIMEOUT_S)
            with self.time.condition:
                self.cameras[shot.side].deliver(shot.exposure, image, shot.frame)
                self.time.condition.notify_all()

    def _blank(self) -> None:
        with self.time.condition:
            if self.board.armed_left > 0 and self.board.armed_left == self.board.sequence_length:
                self.card.begin_sequence(self.board.armed_next)
                for camera in self.cameras.values():
                    camera.sequence_length = self.board.sequence_length
            speed = 1.0 if self.options.pace == "realtime" else self.options.idle_speed
            time_ns = self.time.blank(speed)
            self.card.vblank(time_ns)
            self._light.append((time_ns, self._projected()))
            self.board.tick()
            self.keypad.tick()
            pulses = self.board.vsync(time_ns) if self.card.video_running("projector") else []
            for pulse in pulses:
                if pulse.frame == 0:
                    self._sequence_start_ns = pulse.time_ns
                for side, camera in self.cameras.items():
                    late = self.faults.active(f"camera.{side}", "delayed", frame=pulse.frame)
                    start_ns = pulse.time_ns + int((late.amount or 1.0) * 1e6 if late else 0)
                    exposure = camera.trigger(start_ns)
                    if exposure is not None:
                        self._shots.append(self._shot(side, exposure, pulse.frame))
            self.time.condition.notify_all()
        for shot in self._shots:
            if shot.image is None and shot.end_ns <= time_ns + BLANK_NS:
                shot.image = self._render(shot)

    def _shot(self, side: str, exposure: Exposure, frame: int | None) -> _Shot:
        self._exposures += 1
        moment_s = 0.0
        if frame is not None and self._sequence_start_ns is not None:
            moment_s = (exposure.start_ns - self._sequence_start_ns) / 1e9 + 0.5 * exposure.exposure_s
        return _Shot(side, exposure, frame, moment_s, self.options.seed * 1_000_003 + self._exposures)

    def _projected(self) -> NDArray[np.uint8]:
        image = self.card.scanned_out("projector")
        if self.faults.active("projector", "off"):
            return np.zeros_like(image)
        if self.faults.active("projector", "wrong"):
            delayed, self._delayed = self._delayed, image
            return image if delayed is None else delayed
        return image

    def _render(self, shot: _Shot) -> Future[NDArray[np.uint8]]:
        e = shot.exposure
        slices: list[LightSlice] = []
        history = [*self._light, (self.time.blank_ns + 10 * BLANK_NS, self._light[-1][1])]
        for (begin_ns, image), (end_ns, _) in itertools.pairwise(history):
            overlap_ns = min(end_ns, shot.end_ns) - max(begin_ns, e.start_ns)
            if overlap_ns > 0:
                slices.append(LightSlice(image, overlap_ns / 1e9))
        return self._pool.submit(
            self._renderer.expose,
            shot.side,
            slices,
            shot.moment_s,
            e.exposure_s,
            e.gain_db,
            self.board.lasers,
            shot.seed,
        )
