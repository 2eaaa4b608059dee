"""Owns the start and the end of the service: what is opened in which order, and what the exit code says."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType

import numpy as np

import appliance
from appliance.calibration.design import Design, design_calibration
from appliance.calibration.file import Calibration, CalibrationError, load
from appliance.capture.fault import Fault, FaultCode
from appliance.config import Rig
from appliance.config.rig import CameraRig
from appliance.optics.water import Water
from appliance.patterns.draw import draw_patterns
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.reconstruct.noise import CameraNoise, StereoNoise, camera_noise
from appliance.screens.painter import Painter
from appliance.service.devices import Devices
from appliance.service.loop import Service
from appliance.service.scans import ScanDesk
from appliance.storage.library import Library
from appliance.storage.lock import hold_lock
from appliance.storage.status import StatusFile
from drivers import rig as drivers_rig
from drivers.api import DeviceError, Health, Projector
from drivers.output.gl import open_gl

log = logging.getLogger("kingfisher")

CALIBRATION_FILE = Path("calibration", "current.json")
"""Below the storage root."""


def run(rig: Rig) -> int:
    """Run the instrument until it is switched off; returns the process's exit code.

    Raises DeviceError when there is no GL or no wires, StorageError when the disk refuses the library, LockError when
    another service runs on the same storage. Devices that are missing do not end it.
    """
    sequence = sequence_of(rig)
    with ExitStack() as stack:
        stack.enter_context(hold_lock(rig.storage.root))
        library = Library(rig.storage.root)
        library.prepare()
        recovery = library.recover()
        if recovery.recovered or recovery.set_aside:
            log.warning("recovered %s, set aside %s", recovery.recovered, recovery.set_aside)
        calibration, conditions = calibration_of(rig)
        stopping = stack.enter_context(_signals())
        wires = stack.enter_context(drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options))
        gl = stack.enter_context(open_gl())
        tables = [(pattern.direction, pattern.codes()) for pattern in sequence.patterns]
        pictures = draw_patterns(gl, tables, sequence.width_px, sequence.height_px)
        dark = np.zeros((sequence.height_px, sequence.width_px), np.uint8)

        def load_projector(projector: Projector) -> None:
            projector.load([*pictures, dark])
            projector.show(len(pictures))

        desk = stack.enter_context(ScanDesk(rig, calibration, sequence, library, wires.clock, noise=noise_of(rig)))
        painter = stack.enter_context(Painter(gl, (rig.display.width_px, rig.display.height_px)))
        devices = stack.enter_context(Devices(rig, wires, load_projector))
        status = StatusFile(rig.storage.root, os.getpid(), appliance.__version__)
        service = Service(rig, devices, desk, painter, status, wires.clock, conditions, lambda: stopping.reason)
        ended = service.run()
        log.info("switched off" if ended.power_off else "stopped")
    return 0


SCRIPT_FAILED = 3


def simulate(rig: Rig) -> int:
    """``run`` with a rig whose wires lead to a simulated world. What goes wrong there ends the process with code 3."""
    try:
        return run(rig)
    except Exception as error:
        if type(error).__module__.partition(".")[0] != rig.rig.wires.partition(".")[0]:
            raise
        log.error("%s", error)
        return SCRIPT_FAILED


def check(rig: Rig) -> list[Health]:
    """Open every device once, one after the other, and collect what each says about itself."""
    found: list[Health] = []
    with drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options) as wires:

        def nothing_to_load(projector: Projector) -> None:
            projector.load([np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)])

        with Devices(rig, wires, nothing_to_load) as devices:
            for name, opened in devices.openers().items():
                try:
                    with opened() as device:
                        found.append(_health(name, device))
                except DeviceError as error:
                    found.append(Health(name, False, f"{error.message}. {error.remedy}"))
    return found


def _health(name: str, device: object) -> Health:
    ask = getattr(device, "health", None)
    if ask is None:
        return Health(name, True, "works")
    answer: Health = ask()
    return answer


def calibration_of(rig: Rig) -> tuple[Calibration, tuple[Fault, ...]]:
    """The instrument's calibration; the design's with the condition UNCALIBRATED where there is none that fits."""
    path = rig.storage.root / CALIBRATION_FILE
    try:
        calibration = load(path)
        problem = _misfit(calibration, rig)
    except CalibrationError as error:
        problem = str(error)
    else:
        if problem is None:
            return calibration, ()
    log.warning("uncalibrated: %s", problem)
    return design_of(rig), (Fault(FaultCode.UNCALIBRATED, problem),)


def design_of(rig: Rig) -> Calibration:
    """The calibration that the drawing in the rig file stands for."""
    d = rig.design
    design = Design(
        d.principal_distance_mm,
        d.pixel_um,
        d.baseline_mm,
        d.toe_in_deg,
        d.port_distance_mm,
        d.port_thickness_mm,
        d.port_index,
    )
    left = rig.camera.left
    return design_calibration(design, rig.rig.serial, left.width_px, left.height_px, water_of(rig))


def water_of(rig: Rig) -> Water:
    """The water the rig file states."""
    return Water(rig.water.temperature_c, rig.water.salinity_psu, rig.water.wavelength_nm)


def noise_of(rig: Rig) -> StereoNoise:
    """The noise of both cameras at the gain the rig file sets."""

    def of(camera: CameraRig) -> CameraNoise:
        return camera_noise(camera.full_well_e, camera.read_noise_e, camera.black_level_dn, camera.gain_db)

    return StereoNoise(of(rig.camera.left), of(rig.camera.right))


def sequence_of(rig: Rig) -> PatternSequence:
    """The sequence the rig file states."""
    return build_sequence(rig.scan.period_px, rig.projector.width_px, rig.projector.height_px)


def _misfit(calibration: Calibration, rig: Rig) -> str | None:
    if calibration.rig_serial != rig.rig.serial:
        return f"the calibration is of instrument {calibration.rig_serial}; this one is {rig.rig.serial}"
    for side, camera, spec in (
        ("left", calibration.rig.left, rig.camera.left),
        ("right", calibration.rig.right, rig.camera.right),
    ):
        if (camera.width_px, camera.height_px) != (spec.width_px, spec.height_px):
            return (
                f"the calibration's {side} camera has {camera.width_px}x{camera.height_px} px, "
                f"the rig's {spec.width_px}x{spec.height_px}"
            )
    return None


class _Stopping:
    """Set by SIGTERM and SIGINT."""

    def __init__(self) -> None:
        self.reason: str | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.reason = signal.Signals(number).name


@contextmanager
def _signals() -> Iterator[_Stopping]:
    stopping = _Stopping()
    before = {number: signal.signal(number, stopping) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
