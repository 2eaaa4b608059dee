"""Owns the scan in hand: its frames, its clouds, its times, and its way to the disk.

Disk work runs in one thread, ``kf-storage``; points are computed in the worker process; both report through ``poll``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.calibration.file import Calibration
from appliance.capture.scan import CaptureReport
from appliance.capture.store import FrameStore
from appliance.config import Rig
from appliance.instrument import exposure_of, noise_of, origin_of, settings_of, water_of
from appliance.machine import events as on
from appliance.machine.states import Part
from appliance.machine.words import Text
from appliance.optics.water import Water
from appliance.patterns.response import Response
from appliance.patterns.sequence import PatternSequence
from appliance.processing.bracket import faults_of
from appliance.reconstruct.pipeline import COARSE_POINTS, Cloud
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.noise import TYPICAL_PAIR, StereoNoise
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Judgement, Verdict
from appliance.service.health import CalibrationWatch
from appliance.service.room import ScanRoom
from appliance.service.scan_in_memory import ScanInMemory, SecondInMemory
from appliance.service.windows import WindowWatch
from appliance.storage.atomic import StorageError, replace_file
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library, PendingScan
from appliance.storage.record import ScanRecord, SecondSequence, SequenceInfo
from appliance.storage.room import Room
from appliance.verdict.window import Windows
from appliance.worker.process import (
    CloudReady,
    PairJudged,
    PatternsRight,
    ReconstructionWorker,
    ScanJudged,
    ScanSpoiled,
    WorkerFailed,
    WorkerReady,
    WorkLimits,
    WorkOrder,
)
from drivers.api import Calendar, Clock

log = logging.getLogger("kingfisher")

Answer = TypeVar("Answer")
PROBE = "self-test"
PROBE_CONTENT = b"written and read back at every start\n"


class ScanController:
    """Everything about recorded scans that is neither a device nor a decision. A context manager."""

    def __init__(
        self,
        rig: Rig,
        calibration: Calibration,
        sequence: PatternSequence,
        library: Library,
        clock: Clock,
        calendar: Calendar,
        limits: WorkLimits | None = None,
        noise: StereoNoise = TYPICAL_PAIR,
        response: Response | None = None,
        water: Water | None = None,
        room: Room | None = None,
    ) -> None:
        """``response``: the projector's, that the patterns are drawn for; it is written down. ``water``: if it is not what
        the rig file states. ``room``: the library's file system, where it allocates space; without one it is only counted."""
        left = rig.camera.left
        self._rig = rig
        self._calibration = calibration
        self._origin = origin_of(rig, calibration)
        self._response = response
        self._settings = settings_of(rig, exposure_of(rig))
        self._library = library
        self._fs = LocalFileSystem()
        self._clock = clock
        self.calendar = calendar
        self.sequence = sequence
        self.water = water or water_of(rig)
        self.store = FrameStore(len(sequence), left.height_px, left.width_px, sequences=2)
        order = WorkOrder(calibration, self.water, sequence.period_px, sequence.width_px, sequence.height_px, noise)
        self.worker = ReconstructionWorker(order, self.store, clock, limits)
        self.watch = CalibrationWatch(rig.storage.root, calibration)
        self.windows = WindowWatch()
        self._disk = ThreadPoolExecutor(1, "kf-storage")
        self._answers: list[Future[list[on.Event]]] = []
        self.room = ScanRoom(library, room, rig.storage.reserve_mb * 1_000_000, clock)
        self.room.size(len(sequence), left.width_px, left.height_px)
        self.scan: ScanInMemory | None = None
        self.worker_settled = False
        """It is warm, or it cannot be: nothing more is to be waited for at the start."""

    def __enter__(self) -> Self:
        self.worker.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._disk.shutdown(wait=True)  # whatever is being written is finished first
        self.worker.__exit__(kind, error, trace)
        self.store.close()

    # ------------------------------------------------------------------------------------- recording

    @property
    def calibration(self) -> Calibration:
        """In use."""
        return self._calibration

    @property
    def settled(self) -> bool:
        """The frames in memory may be overwritten, as they are on the disk, or nobody wants them; and the disk has said whether
        there is room for the next ones."""
        scan = self.scan
        return (scan is None or scan.raw is None or scan.raw.done()) and not self.busy

    def begin(self, number: int, exposure: Exposure) -> Fault | None:
        """Make room in memory for a new scan's frames; a fault when the previous ones are still only there, or there is no room
        for new ones on the disk. Call when ``settled``."""
        if self.room.missing is not None:
            return self.room.missing
        scan = self.scan
        if scan is not None and scan.raw is not None:
            try:
                scan.raw.result(0.0)
            except (StorageError, ValueError, TimeoutError) as error:
                return Fault(FaultCode.NOT_SAVED, f"the previous scan's frames are not on the disk: {error}")
            self._remember(scan)
        self.scan = ScanInMemory(number, self._clock.now_ns(), exposure)
        self.worker.begin(number, self._taken(exposure))
        return None

    def begin_second(self, number: int, exposure: Exposure) -> Fault | None:
        """Its frames go to a place of their own: nothing of the scan in hand is touched."""
        scan = self.scan
        if scan is None:
            return Fault(FaultCode.INTERNAL, "a second exposure was wanted without a scan")
        if self.room.missing is not None:
            return self.room.missing
        scan.second = SecondInMemory(number, self._clock.now_ns(), exposure)
        self.worker.begin_second(scan.number, self._taken(exposure))
        return None

    def _taken(self, exposure: Exposure) -> AcquisitionSettings:
        return replace(self._settings, exposure=exposure, noise=noise_of(self._rig, exposure))

    def recorded(self, report: CaptureReport, temperatures_c: dict[str, float | None]) -> None:
        """The sequence ended and every witness agrees."""
        scan = self.scan
        if scan is None:
            return
        second = scan.second
        if second is not None:
            second.record = SecondSequence(
                second.exposure, second.begun_ns, temperatures_c, report.ledger.as_dict(), (self._ledger_verdict(),)
            )
            return
        date = self.calendar.today()
        ledger = report.ledger
        scan.times_s["first_pattern"] = scan.since_begun_s(ledger.flips[0].time_ns)
        arrived_ns = max(frames[-1].received_ns for frames in ledger.frames.values())
        scan.times_s["recording"] = scan.since_begun_s(arrived_ns)
        scan.origin = self._origin
        scan.record = ScanRecord(
            sequence=SequenceInfo.of(self.sequence),
            rig_hash=self._rig.rig_hash,
            calibration_hash=self._calibration.hash,
            software_version=appliance.__version__,
            wall_time=date.utc.isoformat(timespec="seconds"),
            clock_trusted=date.kept,
            recorded_ns=scan.begun_ns,
            response_hash=None if self._response is None else self._response.hash,
            exposure=scan.exposure,
            water={
                "temperature_c": self.water.temperature_c,
                "salinity_psu": self.water.salinity_psu,
                "wavelength_nm": self.water.wavelength_nm,
                "index": self.water.index,
            },
            temperatures_c=temperatures_c,
            ledger=ledger.as_dict(),
            verdicts=(self._ledger_verdict(),),
        )

    def _ledger_verdict(self) -> Verdict:
        return Verdict("ledger", True, {"frames": float(len(self.sequence))}, "all four witnesses agree")

    def drop(self) -> None:
        """What is being recorded failed, or is not wanted; its frames may be overwritten. A scan stays whose second sequence
        it is."""
        if self.scan is not None and self.scan.second is not None and not self.scan.second.merged:
            self.scan.second = None
        else:
            self.scan = None
        self.worker.drop()

    # ------------------------------------------------------------------------------------- disk

    def store_raw(self, number: int) -> None:
        """Answer RawStored or SaveFailed."""
        scan = self._current(number)
        if scan is None or scan.record is None:
            return
        if scan.second is not None and scan.second.merged:
            self._ask(lambda: self._second_stored(scan))
            return
        record = scan.record
        frames: dict[str, NDArray[np.uint8]] = {side: self.store.frames(side) for side in SIDES}
        scan.raw = self._disk.submit(self._library.begin, frames, record, scan.origin)
        self._ask(lambda: self._raw_stored(scan))

    def publish(self, number: int, preview: NDArray[np.uint8] | None, verdict: Verdict | None = None) -> None:
        """Publish with whatever cloud there is; answer Saved or SaveFailed. ``preview`` (h, w, 3) RGB uint8. ``verdict``:
        what the diver was told of it."""
        scan = self._current(number)
        if scan is not None:
            if verdict is not None:
                scan.enter(verdict)
            if scan.second is not None and not scan.second.merged:
                self.drop()
            self._ask(lambda: self._publish(scan, preview))

    def reject(self, number: int, reason: str) -> None:
        """Answer Rejected or SaveFailed."""
        scan = self._current(number)
        if scan is not None:
            self._ask(lambda: self._reject(scan, reason))

    def accept(self, number: int, verdict: Verdict, entered: Callable[[str], list[on.Event]]) -> None:
        """Publish a scan that carries ``verdict``, then let it be ``entered`` by its id, in the disk's thread.

        Answers Saved and what ``entered`` answers, or SaveFailed.
        """
        scan = self._current(number)
        if scan is not None and scan.record is not None:
            scan.enter(verdict)
            self._ask(lambda: self._accept(scan, entered))

    def folder(self, number: int) -> Path | None:
        """Where the scan's raw frames lie, once they are stored."""
        scan = self._current(number)
        return scan.pending.folder if scan is not None and scan.pending is not None else None

    def submit(self, work: Callable[[], Answer]) -> Future[Answer]:
        """Other work for the disk's thread, behind what it has to do."""
        return self._disk.submit(work)

    def use(self, calibration: Calibration) -> None:
        """Measure with another calibration of this instrument from now on."""
        self._calibration = calibration
        self._origin = origin_of(self._rig, calibration)
        self.watch.use(calibration)
        self.worker.change(replace(self.worker.order, calibration=calibration))

    def use_water(self, salinity_psu: float, temperature_c: float) -> None:
        """Measure in other water from the next scan on."""
        self.water = replace(self.water, salinity_psu=salinity_psu, temperature_c=temperature_c)
        self.worker.change(replace(self.worker.order, water=self.water))

    def use_sequence(self, sequence: PatternSequence) -> None:
        """Record another sequence from the next scan on. Call when nothing is ``busy``: the frames in memory are given up."""
        left = self._rig.camera.left
        old, self.store = self.store, FrameStore(len(sequence), left.height_px, left.width_px, sequences=2)
        self.sequence, self.scan = sequence, None
        self.room.size(len(sequence), left.width_px, left.height_px)
        self.worker.change(replace(self.worker.order, period_px=sequence.period_px), self.store)
        old.close()
        self.count()

    def test_storage(self) -> None:
        """Answer PartTested: whether the disk takes a file and gives it back."""
        self._ask(self._storage_tested)

    def count(self) -> None:
        """Answer StorageCounted."""
        self._ask(self._counted_if_told)

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> list[on.Event]:
        """What the disk and the worker answered since the last call."""
        events: list[on.Event] = []
        if self.room.due and not self.busy:
            self.count()
        done = [answer for answer in self._answers if answer.done()]
        self._answers = [answer for answer in self._answers if not answer.done()]
        for answer in done:
            events += answer.result()
        if done and self.scan is not None:
            self._remember(self.scan)
        match self.worker.poll():
            case WorkerReady():
                self.worker_settled = True
                events.append(on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED))
                events.append(on.PartTested(Part.WORKER, True))
            case PatternsRight(number):
                events.append(on.PatternsRight(number))
            case CloudReady() as ready:
                events += self._cloud(ready)
            case ScanJudged() as judged:
                events += self._judged(judged)
            case PairJudged() as pair:
                events += self._paired(pair)
            case ScanSpoiled(number, judgement):
                events += self._spoiled(number, judgement)
            case WorkerFailed() as failed:
                log.warning("%s", failed.fault.detail)
                if failed.scan is not None:
                    events.append(self._lost(failed.scan, failed.fault))
                if self.worker.pid is None:
                    # It has given up until the next scan begins: frames can still be recorded and saved.
                    self.worker_settled = True
                    events.append(on.ConditionRaised(failed.fault))
                    events.append(on.PartTested(Part.WORKER, False, Text.GIVEN_UP))
            case None:
                if self.worker.gets_on():
                    events.append(on.PartBusy(Part.WORKER))
        return events

    @property
    def busy(self) -> bool:
        """Something is on its way to the disk."""
        return bool(self._answers)

    def _cloud(self, ready: CloudReady) -> list[on.Event]:
        scan = self._current(ready.scan)
        if scan is None:
            return []
        stage = "full" if ready.full else "coarse"
        # A scan that is processed again was seen when it was seen first.
        scan.times_s.setdefault(stage, scan.since_begun_s(self._clock.now_ns()))
        scan.times_s[f"{stage}_cpu"] = ready.cpu_s
        summary = ready.cloud.summary
        if ready.full:
            again = scan.full is not None
            scan.full = ready.cloud
            return [on.FullReady(scan.number, summary), *([] if again else self._judge(scan, ready.cloud))]
        scan.coarse = ready.cloud
        return [on.CoarseReady(scan.number, summary)]

    def _judged(self, judged: ScanJudged) -> list[on.Event]:
        scan = self._current(judged.scan)
        if scan is None:
            return []
        scan.times_s["judged_cpu"] = scan.times_s.get("judged_cpu", 0.0) + judged.cpu_s
        scan.judgements = judged.judgements
        events: list[on.Event] = []
        for judgement in judged.judgements:
            if isinstance(judgement.remembered, Windows):
                events += self._watch_windows(scan, judgement.remembered)
            else:
                scan.enter(judgement.verdict)
        faults = tuple(judgement.fault for judgement in judged.judgements if judgement.fault is not None)
        proposal = next((judgement.proposal for judgement in judged.judgements if judgement.proposal is not None), None)
        second = next((judgement.second for judgement in judged.judgements if judgement.second is not None), None)
        return [on.Judged(scan.number, faults, proposal, second), *events]

    def _watch_windows(self, scan: ScanInMemory, windows: Windows) -> list[on.Event]:
        """Count a scan once, however often it is judged; its verdict says what holds after it."""
        if scan.windows_watched:
            return []
        scan.windows_watched = True
        scan.enter(self.windows.judge(windows))
        return [
            on.ConditionCleared(code, device) if fault is None else on.ConditionRaised(fault)
            for code, device, fault in self.windows.conditions()
        ]

    def _paired(self, judged: PairJudged) -> list[on.Event]:
        """The scan's cloud is that of both sequences, or nothing has changed."""
        scan = self._current(judged.scan)
        second = None if scan is None else scan.second
        if scan is None or second is None or second.record is None:
            return []
        if judged.cloud is None:
            self.drop()
            fault = judged.pair.fault or Fault(FaultCode.RECONSTRUCTION_FAILED, judged.pair.verdict.text)
            log.warning("second exposure of %s not added: %s", second.exposure.label, judged.pair.verdict.text)
            return [on.PairFailed(scan.number, fault)]
        verdicts = (*second.record.verdicts, *(judgement.verdict for judgement in judged.second))
        second.record, second.merged = replace(second.record, verdicts=verdicts), True
        scan.enter(judged.pair.verdict)
        scan.full, scan.coarse = judged.cloud, judged.cloud.thinned(COARSE_POINTS)
        scan.times_s["pair"], scan.times_s["pair_cpu"] = scan.since_begun_s(self._clock.now_ns()), judged.cpu_s
        faults = faults_of(scan.judgements, judged.second, judged.pair)
        return [on.PairMerged(scan.number, judged.cloud.summary, faults)]

    def _lost(self, number: int, fault: Fault) -> on.Event:
        """The worker found no points: of the scan, or of its second sequence."""
        scan = self._current(number)
        if scan is None or scan.second is None or scan.second.merged:
            return on.ReconstructionFailed(number, fault)
        log.warning("second exposure of %s not added: %s", scan.second.exposure.label, fault.detail)
        self.drop()
        return on.PairFailed(number, fault)

    def _spoiled(self, number: int, judgement: Judgement) -> list[on.Event]:
        scan = self._current(number)
        if scan is None or judgement.fault is None:
            return []
        scan.enter(judgement.verdict)
        return [on.ReconstructionFailed(number, judgement.fault)]

    def _judge(self, scan: ScanInMemory, cloud: Cloud) -> list[on.Event]:
        """Whether the calibration still holds. The scan keeps the verdict, the disk the trend."""
        if cloud.gaps is None or scan.record is None:
            return []
        scan.enter(self.watch.judge(cloud.gaps))
        self._remember(scan)
        fault = self.watch.fault
        return [] if fault is None else [on.ConditionRaised(fault)]

    def _remember(self, scan: ScanInMemory) -> None:
        """The trend goes to the disk as soon as its latest scan has a number there."""
        stored = scan.raw is not None and scan.raw.done() and scan.raw.exception() is None
        pending = scan.raw.result() if stored and scan.raw is not None else scan.pending
        if scan.full is None or pending is None:
            return
        write = self.watch.unwritten(pending.scan_id)
        if write is not None:
            self._ask(lambda: remembered(write))

    def _current(self, number: int) -> ScanInMemory | None:
        return self.scan if self.scan is not None and self.scan.number == number else None

    def _ask(self, work: object) -> None:
        assert callable(work)
        self._answers.append(self._disk.submit(work))

    def _raw_stored(self, scan: ScanInMemory) -> list[on.Event]:
        assert scan.raw is not None
        try:
            scan.pending = scan.raw.result()
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        scan.times_s["saved"] = scan.since_begun_s(self._clock.now_ns())
        return [on.RawStored(scan.number), *self._counted_if_told()]

    def _second_stored(self, scan: ScanInMemory) -> list[on.Event]:
        try:
            self._pending(scan)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.RawStored(scan.number), *self._counted_if_told()]

    def _not_saved(self, scan: ScanInMemory, error: Exception) -> list[on.Event]:
        """What it took from the room is allocated again at once: it will be tried again."""
        return [on.SaveFailed(scan.number, Fault(FaultCode.NOT_SAVED, str(error))), *self._counted_if_told()]

    def _pending(self, scan: ScanInMemory) -> PendingScan:
        """The scan on the disk, with every sequence it has; what failed before is done again."""
        if scan.pending is None:
            assert scan.record is not None
            frames: dict[str, NDArray[np.uint8]] = {side: self.store.frames(side) for side in SIDES}
            scan.pending = self._library.begin(frames, scan.record, scan.origin)
            scan.times_s["saved"] = scan.since_begun_s(self._clock.now_ns())
        second = scan.second
        if second is not None and second.merged and not second.stored:
            frames = {side: self.store.frames(side, second=True) for side in SIDES}
            scan.pending.add_second(frames, scan.whole)
            second.stored = True
        return scan.pending

    def _publish(self, scan: ScanInMemory, preview: NDArray[np.uint8] | None) -> list[on.Event]:
        assert scan.record is not None
        record = replace(scan.whole, stage_times_s=dict(scan.times_s), cloud=_numbers(scan.full))
        png = None
        if preview is not None:
            _, encoded = cv2.imencode(".png", cv2.cvtColor(preview, cv2.COLOR_RGB2BGR))
            png = encoded.tobytes()
        try:
            pending = self._pending(scan)
            pending.publish(record, scan.full, png)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.Saved(scan.number, pending.scan_id), *self._counted_if_told()]

    def _accept(self, scan: ScanInMemory, entered: Callable[[str], list[on.Event]]) -> list[on.Event]:
        events = self._publish(scan, None)
        saved = next((event for event in events if isinstance(event, on.Saved)), None)
        if saved is None:
            return events
        try:
            return events + entered(saved.scan_id)
        except StorageError as error:
            return [*events, on.SaveFailed(scan.number, Fault(FaultCode.NOT_SAVED, str(error)))]

    def _reject(self, scan: ScanInMemory, reason: str) -> list[on.Event]:
        try:
            pending = self._pending(scan)
            pending.reject(reason, None if scan.record is None else scan.whole)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.Rejected(scan.number, pending.scan_id), *self._counted_if_told()]

    def _storage_tested(self) -> list[on.Event]:
        probe = self._library.root / PROBE
        try:
            replace_file(self._fs, probe, PROBE_CONTENT)
            if probe.read_bytes() != PROBE_CONTENT:
                return self._storage_failed(f"{probe} does not hold what was written")
            counted = self.room.counted()
        except (StorageError, OSError) as error:
            return self._storage_failed(str(error))
        return [*counted, on.PartTested(Part.STORAGE, True, self.room.said)]

    def _storage_failed(self, why: str) -> list[on.Event]:
        log.warning("self-test of the storage: %s", why)
        return [on.PartTested(Part.STORAGE, False, Text.REFUSES_FILES)]

    def _counted_if_told(self) -> list[on.Event]:
        try:
            return self.room.counted()
        except StorageError as error:
            log.warning("scans are not counted: %s", error)
            return []


def remembered(write: Callable[[], None]) -> list[on.Event]:
    """Of the ray gaps' trend. No scan depends on it; without it, the next start knows what was before."""
    try:
        write()
    except StorageError as error:
        log.warning("the trend of the ray gaps: %s", error)
    return []


def _numbers(cloud: Cloud | None) -> dict[str, float | None]:
    if cloud is None:
        return {}
    s = cloud.summary
    return {
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "distance_mm": s.distance_mm,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
    }
