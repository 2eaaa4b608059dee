"""The worker's reports (clouds, verdicts, failures), for the scan in hand and the machine.

The machine decides; the scan in hand only has the data that screens and disk need.
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
"""Largest number of reports read in one cycle; a scan has four."""


class WorkerReports:
    """Enters clouds and verdicts into the scan in hand and makes events of them.

    Called only by the service's cycle.
    """

    def __init__(
        self, worker: ReconstructionWorker, calibration: CalibrationWatch, clock: Clock, drop: Callable[[], None]
    ) -> None:
        """Prepare; ``calibration`` judges every full cloud.

        ``drop`` gives up the latest sequence (``ScanController.drop``).
        """
        self._worker, self._calibration, self._clock, self._drop = worker, calibration, clock, drop
        self._windows = WindowWatch()

    def read(self, scan: ScanInMemory | None) -> list[on.Event]:
        """Return the events of the worker's next reports, which change the scan in hand, ``scan``."""
        report = self._worker.poll()
        if report is None:
            return [on.PartBusy(Part.WORKER)] if self._worker.gets_on() else []
        events = self.events_of(report, scan)
        for _ in range(MOST_REPORTS - 1):
            if not _may_read_next(report):
                break
            report = self._worker.poll()
            if report is None:
                break
            events += self.events_of(report, scan)
        return events

    def events_of(self, report: WorkerEvent, scan: ScanInMemory | None) -> list[on.Event]:
        """Return the events of ``report``; ``scan`` is the one in hand."""
        match report:
            case Ready():
                return [on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED), PartResult(Part.WORKER, True)]
            case LiveGuidance():
                return [report]
            case WorkerFailure(text):
                log.warning("%s", text)
                return self._worker_down(text)
            case News(number, ReconstructionFailure(fault)):
                log.warning("%s", fault.detail)
                if scan is not None and scan.number == number:
                    self._without_second(scan, fault)
                return [report, *self._worker_down(fault.detail)]
            case News():
                # News of a scan that was dropped or published meanwhile are ignored.
                if scan is None or scan.number != report.number:
                    return []
                conditions = self._enter_fact(report.fact, scan)
                return [] if conditions is None else [report, *conditions]
            case unknown:
                assert_never(unknown)

    def _worker_down(self, why: str) -> list[on.Event]:
        """Return the events of a process that stays down until the next scan begins.

        Frames can still be recorded and saved.
        """
        if self._worker.pid is not None:
            return []
        fault = Fault(FaultCode.RECONSTRUCTION_FAILED, why)
        return [on.ConditionRaised(fault), PartResult(Part.WORKER, False, Text.GIVEN_UP)]

    def _enter_fact(self, fact: SequenceFact, scan: ScanInMemory) -> list[on.Event] | None:
        """Enter a fact into its scan; return the conditions that follow, or ``None`` to skip the event."""
        match fact:
            case PatternIdentity(judgement):
                if judgement.fault is not None:
                    scan.enter(judgement.verdict)
            case CoarseCloud():
                self._record_time("coarse", fact.cpu_s, scan)
                scan.coarse = self._worker.coarse
            case Verdicts():
                scan.times_s["judged_cpu"] = scan.times_s.get("judged_cpu", 0.0) + fact.cpu_s
                return self._enter_verdicts(fact.judgements, scan)
            case FullCloud():
                self._record_time("full", fact.cpu_s, scan)
                conditions = self._enter_verdicts(fact.judgements, scan)
                # Only the first full cloud of a scan counts for the calibration: its ray gaps are one sample.
                is_repeated, scan.full = scan.full is not None, self._worker.full
                return (
                    conditions
                    if is_repeated or scan.full is None
                    else conditions + self._judge_calibration(scan, scan.full)
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

    def _record_time(self, stage: str, cpu_s: float, scan: ScanInMemory) -> None:
        # A scan that is processed again keeps the time of its first cloud.
        scan.times_s.setdefault(stage, scan.since_begun_s(self._clock.now_ns()))
        scan.times_s[f"{stage}_cpu"] = cpu_s

    def _judge_calibration(self, scan: ScanInMemory, cloud: Cloud) -> list[on.Event]:
        """Judge the calibration by the cloud's ray gaps.

        The scan keeps the verdict; the trend is written later.
        """
        if cloud.gaps is None or scan.record is None:
            return []
        scan.enter(self._calibration.judge(cloud.gaps))
        fault = self._calibration.fault
        return [] if fault is None else [on.ConditionRaised(fault)]

    def _enter_verdicts(self, judgements: tuple[Judgement, ...], scan: ScanInMemory) -> list[on.Event]:
        """Enter verdicts into the scan; return the conditions that follow from several scans."""
        events: list[on.Event] = []
        for judgement in judgements:
            if isinstance(judgement.remembered, Windows):
                window_result = self._windows.count(scan.number, judgement.remembered)
                if window_result is not None:
                    verdict, conditions = window_result
                    scan.enter(verdict)
                    events += conditions
            else:
                scan.enter(judgement.verdict)
        return events

    def _bracket(self, bracket: Bracket, scan: ScanInMemory) -> list[on.Event] | None:
        """Take the cloud of both sequences as the scan's, or give up the second one, without any change."""
        second, cloud = scan.second, self._worker.full
        if second is None or second.record is None:
            return None
        if bracket.cloud is None or cloud is None:
            self._without_second(scan, bracket.fault)
            return []
        verdicts = (*second.record.verdicts, *(judgement.verdict for judgement in bracket.second))
        second.record, second.merged = replace(second.record, verdicts=verdicts), True
        scan.enter(bracket.pair.verdict)
        scan.full, scan.coarse = cloud, cloud.thinned(COARSE_POINTS)
        scan.times_s["pair"], scan.times_s["pair_cpu"] = scan.since_begun_s(self._clock.now_ns()), bracket.cpu_s
        return []

    def _without_second(self, scan: ScanInMemory, fault: Fault) -> None:
        """Give up the second sequence; the scan is unchanged."""
        if scan.second is not None and not scan.second.merged:
            log.warning("second exposure of %s not added: %s", scan.second.exposure.label, fault.detail)
            self._drop()


def _may_read_next(report: WorkerEvent) -> bool:
    """Return True if another report may be read in the same cycle.

    Not after a full cloud, since its copy took time, nor after the end of a scan or of the process, which the machine
    must answer first.
    """
    match report:
        case News(_, PatternIdentity(judgement)):
            return judgement.fault is None
        case News(_, CoarseCloud() | Verdicts()):
            return True
        case _:
            return False
