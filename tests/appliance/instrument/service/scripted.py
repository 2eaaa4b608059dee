"""An instrument whose devices follow a script, with everything of the service above them; no process for points can live."""

from __future__ import annotations

import multiprocessing.spawn
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.instrument.capture.grabber import Grabber, Timeouts
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Device
from appliance.instrument.service.aiming import AimingController
from appliance.instrument.service.calibrating import CalibrationController
from appliance.instrument.service.devices import Devices, DeviceSupervisor, KeyReader
from appliance.instrument.service.gallery import GalleryController
from appliance.instrument.service.parts import Parts
from appliance.instrument.service.ranging import RangingController
from appliance.instrument.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.instrument.service.settings import drawn_light_of
from appliance.instrument.service.transfer import TransferSwitch
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from drivers.api import Board, Camera, CameraSettings, DeviceGone, Display, Flip, KeyEvent, Keys, Projector, Wires
from drivers.native import MonotonicClock
from drivers.wall_clock import KernelCalendar
from tests.appliance.instrument.capture.test_course_of_a_scan import (
    HZ,
    SEQUENCE,
    Script,
    ScriptedBoard,
    ScriptedCamera,
    ScriptedProjector,
)


class LiveBoard(ScriptedBoard):
    """Fires without a sequence, too."""

    def live(self, every: int, delay_us: int, width_us: int) -> None:
        self._script.said.append(f"live every {every} delay {delay_us} width {width_us}")


class Lamp(ScriptedProjector):
    """Shows single pictures, too."""

    def load(self, frames: Sequence[NDArray[np.uint8]]) -> None:
        self._script.said.append(f"load {len(frames)}")

    def show(self, index: int) -> Flip:
        self._script.said.append(f"show {index}")
        return Flip(index, None, 0)


@dataclass
class KeyPad:
    waiting: list[KeyEvent] = field(default_factory=list)

    def next_event(self, timeout_s: float) -> KeyEvent | None:
        if self.waiting:
            return self.waiting.pop(0)
        MonotonicClock().sleep_s(min(timeout_s, 0.005))
        return None


@dataclass
class Screen:
    limits_s: list[float] = field(default_factory=list)
    there: bool = True

    @contextmanager
    def opened(self) -> Iterator[Display]:
        if not self.there:
            raise DeviceGone("display", "not found", "plug it in")
        yield cast("Display", self)

    def present(self, image: NDArray[np.uint8], timeout_s: float) -> Flip:
        self.limits_s.append(timeout_s)
        return Flip(0, None, 0)


@dataclass
class Desk:
    rig: Rig
    parts: Parts
    script: Script
    pad: KeyPad
    screen: Screen
    inbox: list[on.Event] = field(default_factory=list)

    @property
    def devices(self) -> Devices:
        return self.parts.devices

    def until(self, happened: Callable[[], object], timeout_s: float = 10.0) -> None:
        self.script.until(happened, timeout_s)

    def said(self) -> list[str]:
        """What the devices were told since the last call."""
        told = list(self.script.said)
        self.script.said.clear()
        return told


@contextmanager
def no_process() -> Iterator[None]:
    """Each process that is started dies at once."""
    before = multiprocessing.spawn.get_executable()
    multiprocessing.spawn.set_executable("/bin/false")
    yield
    multiprocessing.spawn.set_executable(before)


def small_rig(root: Path) -> Rig:
    return apply_options(load_rig(default_sim_rig()), SimOptions(root=root, size="400x300"))


@contextmanager
def a_desk(root: Path) -> Iterator[Desk]:
    rig, script, pad, screen = small_rig(root), Script(), KeyPad(), Screen()
    clock, calibration = script.clock, Instrument(rig).design()
    library = Library(root)
    library.prepare()
    wires = cast("Wires", _Wires(clock))
    left = rig.camera.left
    settings = CameraSettings(left.width_px, left.height_px, 1000.0 * left.exposure_ms, left.gain_db)
    devices = Devices(rig, wires, lambda _: None)

    def kept(device: Device, opened: Any) -> Any:
        return DeviceSupervisor(device, opened, clock, None)

    def grabber(side: str) -> AbstractContextManager[Grabber]:
        return Grabber(side, cast("Camera", ScriptedCamera(side, script)), clock, settings, Timeouts(HZ))

    for side, device in (("left", Device.CAMERA_LEFT), ("right", Device.CAMERA_RIGHT)):
        devices.cameras[side] = kept(device, partial(grabber, side))
    devices.board = kept(Device.BOARD, lambda: nullcontext(cast("Board", LiveBoard(script))))
    devices.projector = kept(Device.PROJECTOR, lambda: nullcontext(cast("Projector", Lamp(script))))
    devices.keys = kept(Device.KEYS, lambda: KeyReader(cast("Keys", pad)))
    devices.display = kept(Device.DISPLAY, screen.opened)
    scans = ScanController(rig, MeasuringSetup(calibration, SEQUENCE), ScanStorage(library), clock, KernelCalendar())
    with ExitStack() as stack:
        # Behind the frames' memory, for whose sake Python starts a process of its own, which must live.
        stack.enter_context(no_process())
        stack.callback(scans.__exit__, None, None, None)
        calibrating = stack.enter_context(CalibrationController(rig, scans))
        ranging = stack.enter_context(RangingController(None, calibration, calibration.water.index, clock, 0.1))
        aiming = stack.enter_context(AimingController(clock, 0.1, left.black_level_dn, drawn_light_of(rig)))
        gallery = GalleryController(library, scans.submit)
        for supervisor in devices._supervisors():
            stack.callback(supervisor.close)
        assert len(devices.poll()) == len(Device)
        parts = Parts(devices, scans, calibrating, gallery, ranging, aiming, TransferSwitch({}))
        yield Desk(rig, parts, script, pad, screen)


@dataclass
class _Wires:
    clock: MonotonicClock
