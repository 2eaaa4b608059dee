"""The scan in hand: its data, the setup it was recorded with, and the pending work on it.

Points are computed in the worker process and read by ``WorkerReports``; files are written in the disk's thread by
``ScanFiles``. Both answer through ``poll``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.instrument.capture.ledger import Ledger, agreed_frames
from appliance.instrument.capture.scan import CaptureReport
from appliance.instrument.capture.store import FrameStore
from appliance.instrument.machine import events as on
from appliance.instrument.service.scan_files import DiskQueue, ScanFiles, ScanInMemory, ScanRoom, SecondInMemory
from appliance.instrument.service.watches import CalibrationWatch, write_trend
from appliance.instrument.service.worker_reports import WorkerReports
from appliance.instrument.worker.messages import WorkLimits, WorkOrder
from appliance.instrument.worker.process import ReconstructionWorker
from appliance.measure import (
    SIDES,
    TYPICAL_PAIR,
    AcquisitionSettings,
    Calibration,
    Direction,
    Exposure,
    Fault,
    FaultCode,
    PatternSequence,
    Response,
    StereoNoise,
    Verdict,
    Water,
)
from appliance.store import Instrument, Library, Rig, Room, ScanRecord, SecondSequence, SequenceInfo, StorageError
from drivers.api import Calendar, Clock

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class MeasuringSetup:
    """Setup for measuring at the start, besides the rig file."""

    calibration: Calibration
    sequence: PatternSequence
    noise: StereoNoise = TYPICAL_PAIR
    """Noise of the cameras with their settings."""
    response: Response | None = None
    """The projector's response that the patterns compensate; it is recorded with each scan."""
    water: Water | None = None
    """The water; ``None``: that of the rig file."""


@dataclass(frozen=True, slots=True)
class ScanStorage:
    """The disk that scans are written to."""

    library: Library
    room: Room | None = None
    """The library's file system, if it allocates space; ``None``: space is only counted."""


class ScanController:
    """Control of recorded scans. A context manager."""

    def __init__(
        self,
        rig: Rig,
        setup: MeasuringSetup,
        storage: ScanStorage,
        clock: Clock,
        calendar: Calendar,
        limits: WorkLimits | None = None,
    ) -> None:
        """Allocate memory and prepare the worker; ``limits``: of the worker, ``None``: the defaults."""
        left, sequence = rig.camera.left, setup.sequence
        self._rig = rig
        self._calibration = setup.calibration
        self._origin = Instrument(rig).origin(setup.calibration)
        self._response = setup.response
        self._settings = Instrument(rig).settings(Instrument(rig).exposure)
        self._library = storage.library
        self._clock = clock
        self.calendar = calendar
        self.sequence = sequence
        self.water = setup.water or Instrument(rig).water
        # Allocated at the start, with space for a second exposure (ADR 0025), so that a lack of memory shows before the
        # dive.
        self.store = FrameStore(len(sequence), left.height_px, left.width_px, sequences=2)
        self.worker = ReconstructionWorker(
            WorkOrder(setup.calibration, self.water, sequence, setup.noise),
            self.store,
            clock,
            limits,
        )
        self.watch = CalibrationWatch(rig.storage.root, setup.calibration)
        self._reports = WorkerReports(self.worker, self.watch, clock, self.drop)
        self._disk = DiskQueue()
        self.room = ScanRoom(storage.library, storage.room, rig.storage.reserve_mb * 1_000_000, clock)
        self.room.size(len(sequence), left.width_px, left.height_px)
        self._files = ScanFiles(storage.library, self.room, self.store, clock)
        self.scan: ScanInMemory | None = None
        self.preview: NDArray[np.uint8] | None = None
        """Picture of the cloud as it was reviewed, (h, w, 3) RGB uint8; ``None`` before, and for the next scan."""

    def __enter__(self) -> Self:
        self.worker.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The disk's thread ends first, since it writes frames from the store.
        self._disk.__exit__(kind, error, trace)
        self.worker.__exit__(kind, error, trace)
        self.store.close()

    # ------------------------------------------------------------------------------------- recording

    @property
    def calibration(self) -> Calibration:
        """The calibration in use."""
        return self._calibration

    @property
    def settled(self) -> bool:
        """True if the frames in memory may be overwritten, and the disk has reported its space.

        They are on the disk, or no longer needed.
        """
        scan = self.scan
        return (scan is None or scan.raw is None or scan.raw.done()) and not self.busy

    def begin(self, number: int, exposure: Exposure, belongs_to: int | None = None) -> Fault | None:
        """Prepare the memory for a new scan's frames; call when ``settled``.

        Returns a fault if the previous frames are not on the disk, or the disk has no space. ``belongs_to``: number of
        its object.
        """
        if self.room.missing is not None:
            return self.room.missing
        scan = self.scan
        if scan is not None and scan.raw is not None:
            try:
                # It has ended, as `settled` says: the call only raises its error.
                scan.raw.result(0.0)
            except (StorageError, ValueError, TimeoutError) as error:
                return Fault(FaultCode.NOT_SAVED, f"the previous scan's frames are not on the disk: {error}")
            self._write_trend(scan)
        self.scan = ScanInMemory(number, self._clock.now_ns(), exposure, self._origin, belongs_to)
        # Sent before the first frame, so that the worker decodes each one while the next is exposed.
        self.worker.begin(number, self._settings_at(exposure), belongs_to)
        return None

    def begin_second(self, number: int, exposure: Exposure) -> Fault | None:
        """Prepare a second sequence, whose frames have their own memory: the scan in hand is not changed."""
        scan = self.scan
        if scan is None:
            return Fault(FaultCode.INTERNAL, "a second exposure was requested without a scan")
        if self.room.missing is not None:
            return self.room.missing
        scan.second = SecondInMemory(number, self._clock.now_ns(), exposure)
        self.worker.begin_second(scan.number, self._settings_at(exposure))
        return None

    def _settings_at(self, exposure: Exposure) -> AcquisitionSettings:
        return replace(self._settings, exposure=exposure, noise=Instrument(self._rig).noise(exposure))

    def recorded(self, report: CaptureReport, temperatures_c: dict[str, float | None]) -> None:
        """Record the conditions of a sequence that has ended without a fault."""
        scan = self.scan
        if scan is None:
            return
        second = scan.second
        if second is not None:
            second.record = SecondSequence(
                second.exposure, second.begun_ns, temperatures_c, report.ledger.as_dict(), (self._ledger_verdict(),)
            )
            return
        ledger = report.ledger
        scan.times_s["first_pattern"] = scan.since_begun_s(ledger.flips[0].time_ns)
        # By the frames' times, since this runs after the audit.
        arrived_ns = max(frames[-1].received_ns for frames in ledger.frames.values())
        scan.times_s["recording"] = scan.since_begun_s(arrived_ns)
        scan.record = self._record(scan, ledger, temperatures_c, self._ledger_verdict())

    def keep_incomplete(self, report: CaptureReport, fault: Fault, temperatures_c: dict[str, float | None]) -> None:
        """Keep the first frames of a broken sequence, if the rig file asks for it.

        They must hold a complete direction. Call before ``drop``; ``busy`` keeps the frames from being overwritten. A
        second sequence is not kept: the first one is a complete scan.
        """
        scan = self.scan
        if not self._rig.storage.keep_incomplete or scan is None or scan.second is not None:
            return
        count = agreed_frames(report.ledger)
        if count <= self.sequence.axis(Direction.X).last:
            return
        record = self._record(
            scan, report.ledger, temperatures_c, Verdict("ledger", False, {"frames": float(count)}, fault.detail)
        )
        frames: dict[str, NDArray[np.uint8]] = {side: self.store.frames(side)[:count] for side in SIDES}
        self._disk.ask(partial(self._files.keep_incomplete, frames, record, self._origin, fault))

    def _record(
        self, scan: ScanInMemory, ledger: Ledger, temperatures_c: dict[str, float | None], verdict: Verdict
    ) -> ScanRecord:
        """Return the record of a sequence that has just ended, complete or not."""
        date = self.calendar.today()
        return ScanRecord(
            sequence=SequenceInfo.of(self.sequence),
            rig_hash=self._rig.rig_hash,
            calibration_hash=self._calibration.hash,
            software_version=appliance.__version__,
            wall_time=date.utc.isoformat(timespec="seconds"),
            clock_trusted=date.kept,
            recorded_ns=scan.begun_ns,
            response_hash=None if self._response is None else self._response.hash,
            exposure=scan.exposure,
            object=scan.belongs_to,
            water={
                "temperature_c": self.water.temperature_c,
                "salinity_psu": self.water.salinity_psu,
                "wavelength_nm": self.water.wavelength_nm,
                "index": self.water.index,
            },
            temperatures_c=temperatures_c,
            ledger=ledger.as_dict(),
            verdicts=(verdict,),
        )

    def _ledger_verdict(self) -> Verdict:
        return Verdict("ledger", True, {"frames": float(len(self.sequence))}, "all four witnesses agree")

    def drop(self) -> None:
        """Give up the current sequence, which failed or is not needed; its frames may be overwritten.

        If it is a second sequence, the scan stays.
        """
        if self.scan is not None and self.scan.second is not None and not self.scan.second.merged:
            self.scan.second = None
        else:
            self.scan = None
        self.worker.drop()

    # ------------------------------------------------------------------------------------- disk

    def store_raw(self, number: int) -> None:
        """Write the frames; answer RawStored or SaveFailed."""
        scan = self._current(number)
        if scan is None or scan.record is None:
            return
        if scan.second is not None and scan.second.merged:
            self._disk.ask(partial(self._files.store_second, scan))
            return
        # Record and frames are those of now: later verdicts belong only to the final manifest.
        frames: dict[str, NDArray[np.uint8]] = {side: self.store.frames(side) for side in SIDES}
        scan.raw = self._disk.submit(partial(self._library.begin, frames, scan.record, scan.origin))
        self._disk.ask(partial(self._files.raw_stored, scan))

    def publish(self, number: int, preview: NDArray[np.uint8] | None, verdict: Verdict | None = None) -> None:
        """Publish with the best cloud; answer Saved or SaveFailed.

        ``preview`` (h, w, 3) RGB uint8. ``verdict``: the grade that the diver saw.
        """
        scan = self._current(number)
        if scan is not None:
            if verdict is not None:
                scan.enter(verdict)
            if scan.second is not None and not scan.second.merged:
                self.drop()
            self.worker.keep()
            self._disk.ask(partial(self._files.publish, scan, preview))

    def reject(self, number: int, reason: str) -> None:
        """Reject the scan; answer that NOT_SAVED is cleared, or SaveFailed."""
        scan = self._current(number)
        if scan is not None:
            self._disk.ask(partial(self._files.reject, scan, reason))

    def accept(self, number: int, verdict: Verdict, entered: Callable[[str], list[on.Event]]) -> None:
        """Publish a scan with ``verdict``, then call ``entered`` with its id, in the disk's thread.

        Answers Saved and the events of ``entered``, or SaveFailed.
        """
        scan = self._current(number)
        if scan is not None and scan.record is not None:
            scan.enter(verdict)
            self._disk.ask(partial(self._files.accept, scan, entered))

    def folder(self, number: int) -> Path | None:
        """Return the folder of the scan's raw frames, once they are stored."""
        scan = self._current(number)
        return scan.pending.folder if scan is not None and scan.pending is not None else None

    def submit(self, work: Callable[[], Answer]) -> Future[Answer]:
        """Begin other work in the disk's thread, after its pending tasks."""
        return self._disk.submit(work)

    def test_storage(self) -> None:
        """Test whether the disk stores a file and returns it; answer PartResult."""
        self._disk.ask(self._files.test_disk)

    def count_objects(self) -> None:
        """Answer ObjectsCounted."""
        self._disk.ask(self._files.count_objects)

    def count(self) -> None:
        """Answer StorageCounted."""
        self._disk.ask(self._files.count)

    # ------------------------------------------------------------------------------------- what is measured with

    def use(self, calibration: Calibration) -> None:
        """Use another calibration of this instrument from now on."""
        self._calibration = calibration
        self._origin = Instrument(self._rig).origin(calibration)
        self.watch.use(calibration)
        # The worker is started again: ray lattices and limits are computed when it starts.
        self.worker.change(replace(self.worker.order, calibration=calibration))

    def use_water(self, salinity_psu: float, temperature_c: float) -> None:
        """Use another water from the next scan on."""
        self.water = replace(self.water, salinity_psu=salinity_psu, temperature_c=temperature_c)
        self.worker.change(replace(self.worker.order, water=self.water))

    def use_sequence(self, sequence: PatternSequence) -> None:
        """Use another sequence from the next scan on.

        Call when nothing is ``busy``: the frames in memory are given up.
        """
        left = self._rig.camera.left
        old, self.store = self.store, FrameStore(len(sequence), left.height_px, left.width_px, sequences=2)
        self.sequence, self.scan = sequence, None
        self.room.size(len(sequence), left.width_px, left.height_px)
        self._files.use(self.store)
        self.worker.change(replace(self.worker.order, sequence=sequence), self.store)
        old.close()  # only now that the former worker process, which had it mapped, has ended
        self.count()

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> list[on.Event]:
        """Return the answers of disk and worker since the last call."""
        if self.room.due and not self.busy:
            self.count()
        answers = self._disk.results()
        if answers and self.scan is not None:
            self._write_trend(self.scan)
        reported = self._reports.read(self.scan)
        if reported and self.scan is not None:
            self._write_trend(self.scan)
        return [*(event for answer in answers for event in answer), *reported]

    @property
    def busy(self) -> bool:
        """True while disk work is pending."""
        return self._disk.busy

    def _write_trend(self, scan: ScanInMemory) -> None:
        """Write the trend of the ray gaps as soon as its latest scan has a number on the disk."""
        # Cloud and number may come in either order, so this is called after both.
        stored = scan.raw is not None and scan.raw.done() and scan.raw.exception() is None
        pending = scan.raw.result() if stored and scan.raw is not None else scan.pending
        if scan.full is None or pending is None:
            return
        write = self.watch.unwritten(pending.scan_id)
        if write is not None:
            self._disk.ask(partial(write_trend, write))

    def _current(self, number: int) -> ScanInMemory | None:
        return self.scan if self.scan is not None and self.scan.number == number else None
