"""Owns the scan in hand: what was recorded of it, with what, and which work on it is under way.

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
    """The means that the instrument measures with at its start, beside its rig file."""

    calibration: Calibration
    sequence: PatternSequence
    noise: StereoNoise = TYPICAL_PAIR
    """Noise of the cameras as they are set."""
    response: Response | None = None
    """The projector's response that the patterns are drawn for; it is written down with each scan."""
    water: Water | None = None
    """The water it is in; ``None``: what the rig file states."""


@dataclass(frozen=True, slots=True)
class ScanStorage:
    """The disk that scans are written to."""

    library: Library
    room: Room | None = None
    """The library's file system, where it allocates space; ``None``: space is only counted."""


class ScanController:
    """Everything about recorded scans that is neither a device nor a decision. A context manager."""

    def __init__(
        self,
        rig: Rig,
        setup: MeasuringSetup,
        storage: ScanStorage,
        clock: Clock,
        calendar: Calendar,
        limits: WorkLimits | None = None,
    ) -> None:
        """``limits`` ``None``: the usual limits of what the worker process may take."""
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
        # Before the dive, with room for a second exposure (ADR 0025): memory that is short is noticed at the start, not
        # under water.
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
        """The scan's cloud as it was reviewed, (h, w, 3) RGB uint8; ``None`` until it was, and when the next one
        begins."""

    def __enter__(self) -> Self:
        self.worker.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # The disk first: it writes frames out of the store, and the worker still reads them.
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
        """The frames in memory may be overwritten, as they are on the disk, or nobody wants them; and the disk has said
        whether there is room for the next ones."""
        scan = self.scan
        return (scan is None or scan.raw is None or scan.raw.done()) and not self.busy

    def begin(self, number: int, exposure: Exposure, belongs_to: int | None = None) -> Fault | None:
        """Make room in memory for a new scan's frames; a fault when the previous ones are still only there, or there is
        no room for new ones on the disk. ``belongs_to``: the number of its object. Call when ``settled``."""
        if self.room.missing is not None:
            return self.room.missing
        scan = self.scan
        if scan is not None and scan.raw is not None:
            try:
                # Done already, as `settled` says: asked only for what it raises.
                scan.raw.result(0.0)
            except (StorageError, ValueError, TimeoutError) as error:
                return Fault(FaultCode.NOT_SAVED, f"the previous scan's frames are not on the disk: {error}")
            self._write_trend(scan)
        self.scan = ScanInMemory(number, self._clock.now_ns(), exposure, self._origin, belongs_to)
        # Told before the first frame, so that the worker decodes each one while the next is exposed.
        self.worker.begin(number, self._settings_at(exposure), belongs_to)
        return None

    def begin_second(self, number: int, exposure: Exposure) -> Fault | None:
        """Make ready for a second sequence, whose frames go to a place of their own: nothing of the scan in hand is
        touched."""
        scan = self.scan
        if scan is None:
            return Fault(FaultCode.INTERNAL, "a second exposure was wanted without a scan")
        if self.room.missing is not None:
            return self.room.missing
        scan.second = SecondInMemory(number, self._clock.now_ns(), exposure)
        self.worker.begin_second(scan.number, self._settings_at(exposure))
        return None

    def _settings_at(self, exposure: Exposure) -> AcquisitionSettings:
        return replace(self._settings, exposure=exposure, noise=Instrument(self._rig).noise(exposure))

    def recorded(self, report: CaptureReport, temperatures_c: dict[str, float | None]) -> None:
        """Take down what a sequence was recorded with; it ended, and every witness agrees."""
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
        # By the frames' own times: this line runs when all of it was audited.
        arrived_ns = max(frames[-1].received_ns for frames in ledger.frames.values())
        scan.times_s["recording"] = scan.since_begun_s(arrived_ns)
        scan.record = self._record(scan, ledger, temperatures_c, self._ledger_verdict())

    def keep_incomplete(self, report: CaptureReport, fault: Fault, temperatures_c: dict[str, float | None]) -> None:
        """Keep the first frames of a sequence that broke, where the rig file asks for it and they hold a whole
        direction.

        Call before ``drop``; the frames are written from where they are, and ``busy`` keeps others away meanwhile. A
        second sequence is not kept: the first one is a whole scan.
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
        """Return what is written down of a sequence that has just ended, as it should or not."""
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
        """Give up what is being recorded: it failed, or is not wanted; its frames may be overwritten.

        A scan stays whose second sequence it is.
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
        # Record and frames are taken now: verdicts that come while the disk writes belong to the final manifest only.
        frames: dict[str, NDArray[np.uint8]] = {side: self.store.frames(side) for side in SIDES}
        scan.raw = self._disk.submit(partial(self._library.begin, frames, scan.record, scan.origin))
        self._disk.ask(partial(self._files.raw_stored, scan))

    def publish(self, number: int, preview: NDArray[np.uint8] | None, verdict: Verdict | None = None) -> None:
        """Publish with whatever cloud there is; answer Saved or SaveFailed.

        ``preview`` (h, w, 3) RGB uint8. ``verdict``: what the diver was told of it.
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
        """Set the scan aside; answer that what was NOT_SAVED is cleared, or SaveFailed."""
        scan = self._current(number)
        if scan is not None:
            self._disk.ask(partial(self._files.reject, scan, reason))

    def accept(self, number: int, verdict: Verdict, entered: Callable[[str], list[on.Event]]) -> None:
        """Publish a scan that carries ``verdict``, then let it be ``entered`` by its id, in the disk's thread.

        Answers Saved and what ``entered`` answers, or SaveFailed.
        """
        scan = self._current(number)
        if scan is not None and scan.record is not None:
            scan.enter(verdict)
            self._disk.ask(partial(self._files.accept, scan, entered))

    def folder(self, number: int) -> Path | None:
        """Return where the scan's raw frames lie, once they are stored."""
        scan = self._current(number)
        return scan.pending.folder if scan is not None and scan.pending is not None else None

    def submit(self, work: Callable[[], Answer]) -> Future[Answer]:
        """Begin other work in the disk's thread, behind what it has to do."""
        return self._disk.submit(work)

    def test_storage(self) -> None:
        """Answer PartTested: whether the disk takes a file and gives it back."""
        self._disk.ask(self._files.test)

    def count_objects(self) -> None:
        """Answer ObjectsCounted."""
        self._disk.ask(self._files.count_objects)

    def count(self) -> None:
        """Answer StorageCounted."""
        self._disk.ask(self._files.count)

    # ------------------------------------------------------------------------------------- what is measured with

    def use(self, calibration: Calibration) -> None:
        """Measure with another calibration of this instrument from now on."""
        self._calibration = calibration
        self._origin = Instrument(self._rig).origin(calibration)
        self.watch.use(calibration)
        # The worker is started again: ray lattices and limits are computed when it starts, and a mixture of two
        # calibrations is none.
        self.worker.change(replace(self.worker.order, calibration=calibration))

    def use_water(self, salinity_psu: float, temperature_c: float) -> None:
        """Measure in other water from the next scan on."""
        self.water = replace(self.water, salinity_psu=salinity_psu, temperature_c=temperature_c)
        self.worker.change(replace(self.worker.order, water=self.water))

    def use_sequence(self, sequence: PatternSequence) -> None:
        """Record another sequence from the next scan on.

        Call when nothing is ``busy``: the frames in memory are given up.
        """
        left = self._rig.camera.left
        old, self.store = self.store, FrameStore(len(sequence), left.height_px, left.width_px, sequences=2)
        self.sequence, self.scan = sequence, None
        self.room.size(len(sequence), left.width_px, left.height_px)
        self._files.use(self.store)
        self.worker.change(replace(self.worker.order, sequence=sequence), self.store)
        old.close()  # only now: the worker's process that had it mapped is gone
        self.count()

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> list[on.Event]:
        """Return what the disk and the worker answered since the last call."""
        if self.room.due and not self.busy:
            self.count()
        answers = self._disk.answered()
        if answers and self.scan is not None:
            self._write_trend(self.scan)
        reported = self._reports.read(self.scan)
        if reported and self.scan is not None:
            self._write_trend(self.scan)
        return [*(event for answer in answers for event in answer), *reported]

    @property
    def busy(self) -> bool:
        """Something is on its way to the disk."""
        return self._disk.busy

    def _write_trend(self, scan: ScanInMemory) -> None:
        """Write the trend of the ray gaps down as soon as its latest scan has a number on the disk."""
        # Either may come first, the cloud or the number, hence this is called after both: the second call finds both
        # there.
        stored = scan.raw is not None and scan.raw.done() and scan.raw.exception() is None
        pending = scan.raw.result() if stored and scan.raw is not None else scan.pending
        if scan.full is None or pending is None:
            return
        write = self.watch.unwritten(pending.scan_id)
        if write is not None:
            self._disk.ask(partial(write_trend, write))

    def _current(self, number: int) -> ScanInMemory | None:
        return self.scan if self.scan is not None and self.scan.number == number else None
