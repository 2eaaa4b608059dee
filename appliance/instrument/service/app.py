"""Start and end of the service: the order of opening, and the exit code.

run                        the service, until it is switched off
this_run, recovered        news of the previous run: its end, the fate of an update, recovered scans
installation               name of the installed version
ask_power_off, …           the flag file that makes a unit switch the computer off
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType

import appliance
from appliance.instrument.machine.words import Language
from appliance.instrument.screens.painter import Painter
from appliance.instrument.service.aiming import AimingController
from appliance.instrument.service.calibrating import CalibrationController
from appliance.instrument.service.devices import Devices
from appliance.instrument.service.gallery import GalleryController
from appliance.instrument.service.loop import Drawing, Service
from appliance.instrument.service.parts import Parts, StartFacts
from appliance.instrument.service.ranging import RangingController
from appliance.instrument.service.recording import DrawnPatterns
from appliance.instrument.service.remembered import BeamsFile, ChoicesFile
from appliance.instrument.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.instrument.service.settings import drawn_light_of, pointers_of, standard_choices
from appliance.instrument.service.status import StatusFile
from appliance.instrument.service.transfer import TransferSwitch
from appliance.instrument.service.watchdog import ServiceManager, Watchdog
from appliance.measure import Fault, FaultCode, Water
from appliance.store import Instrument, Library, LocalFileSystem, Rig, Room, hold_lock
from drivers import rig as drivers_rig
from drivers.output.gl import open_gl

log = logging.getLogger("kingfisher")

RUNNING = "running"
"""A file in the service's run-time folder, in memory: it exists until a run has ended well."""
MOST_BYTES = 1 << 16


def installation(prefix: Path) -> str:
    """Return the name of the installed version that runs from ``prefix``; of a source tree "source"."""
    return prefix.name if _is_installed(prefix) else "source"


@contextmanager
def this_run(environment: Mapping[str, str], prefix: Path) -> Iterator[tuple[Fault, ...]]:
    """Yield news of the previous run; a block that ends without an exception has ended well.

    Without a service's ``environment`` the end is not recorded.
    """
    runtime = environment.get("RUNTIME_DIRECTORY")
    mark = None if not runtime else Path(runtime.split(":")[0]) / RUNNING
    news = [fault for fault in (_undone(prefix), _restarted(mark)) if fault is not None]
    for fault in news:
        log.warning("%s: %s", fault.code.value, fault.detail)
    if mark is not None:
        with suppress(OSError):
            mark.touch()
    # No `finally`: after an error the mark must stay.
    yield tuple(news)
    if mark is not None:
        with suppress(OSError):
            mark.unlink(missing_ok=True)


def recovery_news(scans: Sequence[str]) -> tuple[Fault, ...]:
    """Return the news of complete scans that an earlier run, or a loss of power, left unpublished."""
    return (Fault(FaultCode.SCAN_RECOVERED, f"scan {', '.join(scans)}"),) if scans else ()


def _restarted(mark: Path | None) -> Fault | None:
    if mark is None or not mark.exists():
        return None
    return Fault(FaultCode.RESTARTED, "the last run did not end regularly; see the journal")


def _undone(prefix: Path) -> Fault | None:
    """Return the fault of an update that was undone, as ``systemd/kingfisher_setup`` has written it."""
    if not _is_installed(prefix):
        return None
    try:
        with (prefix.parent.parent / "outcome.json").open("rb") as file:
            ended = json.loads(file.read(MOST_BYTES))
        if ended["accepted"] is not False or ended["now"] != prefix.name:
            return None
        return Fault(FaultCode.UPDATE_UNDONE, f"{ended['version']}: {ended['reason']}")
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _is_installed(prefix: Path) -> bool:
    return prefix.parent.name == "versions"


def run(rig: Rig) -> int:
    """Run the instrument until it is switched off; return the process's exit code.

    Raises DeviceError when there is no GL or no wires, StorageError when the disk refuses the library, LockError when
    another service runs on the same storage. Missing devices do not end it.
    """
    with ExitStack() as stack:
        take_back_power_off(os.environ)
        # First, so that a failed start is reported to the manager, too.
        manager = stack.enter_context(ServiceManager.of(os.environ))
        news = stack.enter_context(this_run(os.environ, Path(sys.prefix)))
        # Before any file or device: a second service would take the cameras from the first.
        stack.enter_context(hold_lock(rig.storage.root))
        rig = Instrument(rig).with_measured_noise()
        room = Room(rig.storage.root, LocalFileSystem())
        library = Library(rig.storage.root, room)
        library.prepare()
        # Before the worker and the devices: unpublished scans are recovered while nothing writes.
        recovery = library.recover()
        if recovery.recovered or recovery.set_aside:
            recovered_ids, set_aside_ids = (
                ", ".join(ids) or "none" for ids in (recovery.recovered, recovery.set_aside)
            )
            log.warning("scans recovered: %s; set aside: %s", recovered_ids, set_aside_ids)
        news = (*news, *recovery_news(recovery.recovered))  # last, since it says more than the end of the previous run
        stopping = stack.enter_context(_signals())
        wires = stack.enter_context(drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options))
        calibration, conditions = Instrument(rig).calibration()
        gl = stack.enter_context(open_gl())
        response = Instrument(rig).response()
        choices = ChoicesFile(rig.storage.root, standard_choices(rig))
        chosen, _ = choices.read()
        patterns = DrawnPatterns(gl, rig, chosen.period_px, response)
        water = Water(chosen.water_c, chosen.salinity_psu, rig.water.wavelength_nm)
        setup = MeasuringSetup(calibration, patterns.sequence, Instrument(rig).noise(), response, water)
        # The stack closes in reverse order: devices first, so that no camera writes into freed memory; then all that
        # work on frames; the lock last.
        scans = stack.enter_context(ScanController(rig, setup, ScanStorage(library, room), wires.clock, wires.calendar))
        calibrating = stack.enter_context(CalibrationController(rig, scans))
        live_s = rig.board.live_every_vsyncs / rig.projector.refresh_hz
        pointers = pointers_of(rig)
        beams = None if pointers is None else BeamsFile(rig.storage.root, pointers)
        ranging = stack.enter_context(
            RangingController(pointers, calibration, water.index, wires.clock, live_s, beams, scans.submit)
        )
        black_dn, light = rig.camera.left.black_level_dn, drawn_light_of(rig)
        aiming = stack.enter_context(AimingController(wires.clock, live_s, black_dn, light))
        painter = stack.enter_context(
            Painter(gl, (rig.display.width_px, rig.display.height_px), Language(rig.display.language))
        )
        devices = stack.enter_context(Devices(rig, wires, patterns.load))
        status = StatusFile(rig.storage.root, os.getpid(), appliance.__version__)
        gallery = GalleryController(library, scans.submit)
        parts = Parts(devices, scans, calibrating, gallery, ranging, aiming, TransferSwitch(os.environ))
        beginning = StartFacts(choices, conditions, news)
        service = Service(
            rig, parts, Drawing(patterns, painter), status, wires.clock, beginning, lambda: stopping.reason
        )
        ended = service.run(Watchdog(manager, rig.storage.root, installation(Path(sys.prefix))))
        if ended.power_off:
            ask_power_off(os.environ)
        log.info("switched off" if ended.power_off else "stopped")
    return 0


def ask_power_off(environment: Mapping[str, str]) -> None:
    """Create the flag file by which a unit switches the computer off afterwards; no effect at a desk."""
    note = _power_off_note(environment)
    if note is not None:
        note.touch()


def take_back_power_off(environment: Mapping[str, str]) -> None:
    """Remove the flag file of an earlier run."""
    note = _power_off_note(environment)
    if note is not None:
        note.unlink(missing_ok=True)


def _power_off_note(environment: Mapping[str, str]) -> Path | None:
    folder = environment.get("RUNTIME_DIRECTORY")
    return None if not folder else Path(folder.split(":")[0]) / "power-off"


class _Stopping:
    """Signal handler that records SIGTERM and SIGINT."""

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
