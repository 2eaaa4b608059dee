"""Writes what the worker reports (clouds, verdicts, failures) into the scan in hand, and passes the reports on to the
machine.

The machine alone decides what the instrument does next; what is kept here is what the screens and the disk's thread
need of the scan.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import assert_never

from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Part, PartResult
from appliance.instrument.machine.words import Text
from appliance.instrument.service.scan_files import ScanInMemory
from appliance.instrument.service.watches import CalibrationWatch, WindowWatch
from appliance.instrument.worker.messages import Ready
from appliance.instrument.worker.process import ReconstructionWorker, WorkerEvent
from appliance.measure import (
    COARSE_POINTS,
    Bracket,
    Cloud,
    CoarseCloud,
    Fault,
    FaultCode,
    FullCloud,
    Judgement,
    LiveGuidance,
    News,
    PatternIdentity,
    ReconstructionFailure,
    ScanOverlap,
    SequenceFact,
    Verdicts,
    Windows,
    WorkerFailure,
    WorkProgress,
)
from drivers.api import Clock

log = logging.getLogger("kingfisher")
MOST_REPORTS = 8
"""Largest number of reports read at one heartbeat; a scan has four."""


class WorkerReports:
    """Enters clouds and verdicts into the scan in hand and turns them into events. Called by the heartbeat only."""

    def __init__(
        self, worker: ReconstructionWorker, calibration: CalibrationWatch, clock: Clock, drop: Callable[[], None]
    ) -> None:
        """``calibration`` judges every full cloud.

        ``drop`` gives up what was recorded last (``ScanController.drop``).
        """
        self._worker, self._calibration, self._clock, self._drop = worker, calibration, clock, drop
        self._windows = WindowWatch()

    def read(self, scan: ScanInMemory | None) -> list[on.Event]:
        """Return what the worker's next reports mean; ``scan`` is the one in hand, which is changed by them."""
        report = self._worker.poll()
        if report is None:
            return [on.PartBusy(Part.WORKER)] if self._worker.gets_on() else []
        events = self.meant(report, scan)
        for _ in range(MOST_REPORTS - 1):
            if not _only_tells(report):
                break
            report = self._worker.poll()
            if report is None:
                break
            events += self.meant(report, scan)
        return events

    def meant(self, report: WorkerEvent, scan: ScanInMemory | None) -> list[on.Event]:
        """Return what the machine hears after ``report``; ``scan`` is the one in hand."""
        match report:
            case Ready():
                return [on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED), PartResult(Part.WORKER, True)]
            case LiveGuidance():
                return [report]
            case WorkerFailure(text):
                log.warning("%s", text)
                return self._given_up(text)
            case News(number, ReconstructionFailure(fault)):
                log.warning("%s", fault.detail)
                if scan is not None and scan.number == number:
                    self._without_second(scan, fault)
                return [report, *self._given_up(fault.detail)]
            case News():
                # The worker may still tell of a scan that was dropped or published meanwhile: nobody wants that any
                # more.
                if scan is None or scan.number != report.number:
                    return []
                conditions = self._entered(report.fact, scan)
                return [] if conditions is None else [report, *conditions]
            case unknown:
                assert_never(unknown)

    def _given_up(self, why: str) -> list[on.Event]:
        """Return what is told of a process that stays down until the next scan begins: frames can still be recorded and
        saved."""
        if self._worker.pid is not None:
            return []
        fault = Fault(FaultCode.RECONSTRUCTION_FAILED, why)
        return [on.ConditionRaised(fault), PartResult(Part.WORKER, False, Text.GIVEN_UP)]

    def _entered(self, fact: SequenceFact, scan: ScanInMemory) -> list[on.Event] | None:
        """Enter a fact into its scan; return the conditions that follow, ``None``: the machine is not told of it."""
        match fact:
            case PatternIdentity(judgement):
                if judgement.fault is not None:
                    scan.enter(judgement.verdict)
            case CoarseCloud():
                self._see("coarse", fact.cpu_s, scan)
                scan.coarse = self._worker.coarse
            case Verdicts():
                scan.times_s["judged_cpu"] = scan.times_s.get("judged_cpu", 0.0) + fact.cpu_s
                return self._judged(fact.judgements, scan)
            case FullCloud():
                self._see("full", fact.cpu_s, scan)
                conditions = self._judged(fact.judgements, scan)
                # Only the first full cloud of a scan counts for the calibration: its gaps are one sample, however often
                # it is made.
                again, scan.full = scan.full is not None, self._worker.full
                return (
                    conditions if again or scan.full is None else conditions + self._judge_calibration(scan, scan.full)
                )
            case Bracket():
                return self._bracket(fact, scan)
            case ScanOverlap():
                scan.times_s["overlap_cpu"] = fact.cpu_s
            case WorkProgress() | ReconstructionFailure():
                return None
            case unknown:
                assert_never(unknown)
        return []

    def _see(self, stage: str, cpu_s: float, scan: ScanInMemory) -> None:
        # A scan that is processed again was seen when it was seen first.
        scan.times_s.setdefault(stage, scan.since_begun_s(self._clock.now_ns()))
        scan.times_s[f"{stage}_cpu"] = cpu_s

    def _judge_calibration(self, scan: ScanInMemory, cloud: Cloud) -> list[on.Event]:
        """Judge whether the calibration still holds. The scan keeps the verdict; the trend goes to the disk later."""
        if cloud.gaps is None or scan.record is None:
            return []
        scan.enter(self._calibration.judge(cloud.gaps))
        fault = self._calibration.fault
        return [] if fault is None else [on.ConditionRaised(fault)]

    def _judged(self, judgements: tuple[Judgement, ...], scan: ScanInMemory) -> list[on.Event]:
        """Write verdicts down; return the conditions that follow from what several scans have said."""
        events: list[on.Event] = []
        for judgement in judgements:
            if isinstance(judgement.remembered, Windows):
                counted = self._windows.count(scan.number, judgement.remembered)
                if counted is not None:
                    verdict, conditions = counted
                    scan.enter(verdict)
                    events += conditions
            else:
                scan.enter(judgement.verdict)
        return events

    def _bracket(self, bracket: Bracket, scan: ScanInMemory) -> list[on.Event] | None:
        """Take the cloud of both sequences as the scan's, or give the second one up: nothing has changed then."""
        second, cloud = scan.second, self._worker.full
        if second is None or second.record is None:
            return None
        if bracket.found is None or cloud is None:
            self._without_second(scan, bracket.fault)
            return []
        verdicts = (*second.record.verdicts, *(judgement.verdict for judgement in bracket.second))
        second.record, second.merged = replace(second.record, verdicts=verdicts), True
        scan.enter(bracket.pair.verdict)
        scan.full, scan.coarse = cloud, cloud.thinned(COARSE_POINTS)
        scan.times_s["pair"], scan.times_s["pair_cpu"] = scan.since_begun_s(self._clock.now_ns()), bracket.cpu_s
        return []

    def _without_second(self, scan: ScanInMemory, fault: Fault) -> None:
        """Give up a second sequence that is under way: the scan is what it was before."""
        if scan.second is not None and not scan.second.merged:
            log.warning("second exposure of %s not added: %s", scan.second.exposure.label, fault.detail)
            self._drop()


def _only_tells(report: WorkerEvent) -> bool:
    """Tell whether another report may be read at the same heartbeat.

    A full cloud was copied, which took its time, and the next heartbeat comes soon; and what ends a scan, or the
    process, is answered by the machine before anything else is heard.
    """
    match report:
        case News(_, PatternIdentity(judgement)):
            return judgement.fault is None
        case News(_, CoarseCloud() | Verdicts()):
            return True
        case _:
            return False
