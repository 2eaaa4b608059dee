"""Owns what the reports of the reconstruction's process mean for the scan in hand, and what the machine hears of them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import assert_never

from appliance.machine import events as on
from appliance.machine.states import Part
from appliance.machine.words import Text
from appliance.processing.bracket import faults_of
from appliance.reconstruct.pipeline import COARSE_POINTS
from appliance.reconstruct.table import Cloud
from appliance.scan.fault import Fault, FaultCode
from appliance.service.health import CalibrationWatch
from appliance.service.scan_in_memory import ScanInMemory
from appliance.service.windows import WindowWatch
from appliance.verdict.window import Windows
from appliance.worker.looking import LiveLookedAt
from appliance.worker.process import (
    CloudReady,
    PairJudged,
    ReconstructionWorker,
    ScanCompared,
    ScanJudged,
    ScanSpoiled,
    SequenceIdentified,
    WorkerEvent,
    WorkerFailed,
    WorkerReady,
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
        """``calibration`` judges every full cloud. ``drop`` gives up what was recorded last (``ScanController.drop``)."""
        self._worker, self._calibration, self._clock, self._drop = worker, calibration, clock, drop
        self._windows = WindowWatch()
        self.settled = False
        """The worker is warm, or it cannot be: nothing more is to be waited for at the start."""

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
        match report:
            case WorkerReady():
                self.settled = True
                return [on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED), on.PartTested(Part.WORKER, True)]
            case WorkerFailed():
                return self._failed(report, scan)
            case SequenceIdentified():
                # The machine compares the number by itself; nothing of the scan in hand is changed.
                return [on.PatternsRight(report.scan)]
            case LiveLookedAt(guidance, taken_ns):
                return [on.Guided(guidance, taken_ns)]
            case _:
                pass  # about one scan
        # The worker may still report on a scan that was dropped or published meanwhile: nobody wants that any more.
        return [] if scan is None or scan.number != report.scan else self._entered(report, scan)

    def _entered(
        self, report: CloudReady | ScanJudged | PairJudged | ScanSpoiled | ScanCompared, scan: ScanInMemory
    ) -> list[on.Event]:
        match report:
            case ScanCompared(_, overlap, cpu_s):
                scan.times_s["overlap_cpu"] = cpu_s
                return [on.OverlapTold(scan.number, overlap)]
            case CloudReady():
                return self._cloud(report, scan)
            case ScanJudged():
                return self._judged(report, scan)
            case PairJudged():
                return self._bracket(report, scan)
            case ScanSpoiled(_, judgement):
                if judgement.fault is None:
                    return []
                scan.enter(judgement.verdict)
                return [on.ReconstructionFailed(scan.number, judgement.fault)]
            case unknown:
                assert_never(unknown)

    def _cloud(self, ready: CloudReady, scan: ScanInMemory) -> list[on.Event]:
        stage = "full" if ready.full else "coarse"
        # A scan that is processed again was seen when it was seen first.
        scan.times_s.setdefault(stage, scan.since_begun_s(self._clock.now_ns()))
        scan.times_s[f"{stage}_cpu"] = ready.cpu_s
        summary = ready.cloud.summary
        if not ready.full:
            scan.coarse = ready.cloud
            return [on.CoarseReady(scan.number, summary)]
        # Only the first full cloud of a scan counts for the calibration: its gaps are one sample, however often it is made.
        again = scan.full is not None
        scan.full = ready.cloud
        return [on.FullReady(scan.number, summary), *([] if again else self._judge_calibration(scan, ready.cloud))]

    def _judge_calibration(self, scan: ScanInMemory, cloud: Cloud) -> list[on.Event]:
        """Judge whether the calibration still holds. The scan keeps the verdict; the trend goes to the disk later."""
        if cloud.gaps is None or scan.record is None:
            return []
        scan.enter(self._calibration.judge(cloud.gaps))
        fault = self._calibration.fault
        return [] if fault is None else [on.ConditionRaised(fault)]

    def _judged(self, judged: ScanJudged, scan: ScanInMemory) -> list[on.Event]:
        scan.times_s["judged_cpu"] = scan.times_s.get("judged_cpu", 0.0) + judged.cpu_s
        scan.judgements = judged.judgements
        events: list[on.Event] = []
        for judgement in judged.judgements:
            if isinstance(judgement.remembered, Windows):
                counted = self._windows.count(scan.number, judgement.remembered)
                if counted is not None:
                    verdict, conditions = counted
                    scan.enter(verdict)
                    events += conditions
            else:
                scan.enter(judgement.verdict)
        faults = tuple(judgement.fault for judgement in judged.judgements if judgement.fault is not None)
        proposal = next((judgement.proposal for judgement in judged.judgements if judgement.proposal is not None), None)
        second = next((judgement.second for judgement in judged.judgements if judgement.second is not None), None)
        return [on.Judged(scan.number, faults, proposal, second), *events]

    def _bracket(self, judged: PairJudged, scan: ScanInMemory) -> list[on.Event]:
        """Take the cloud of both sequences as the scan's, or give the second one up: nothing has changed then."""
        second = scan.second
        if second is None or second.record is None:
            return []
        if judged.cloud is None:
            self._drop()
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

    def _failed(self, failed: WorkerFailed, scan: ScanInMemory | None) -> list[on.Event]:
        log.warning("%s", failed.fault.detail)
        events: list[on.Event] = []
        if failed.scan is not None:
            events.append(self._lost(failed.scan, failed.fault, scan))
        if self._worker.pid is None:
            # It has given up until the next scan begins: frames can still be recorded and saved.
            self.settled = True
            events.append(on.ConditionRaised(failed.fault))
            events.append(on.PartTested(Part.WORKER, False, Text.GIVEN_UP))
        return events

    def _lost(self, number: int, fault: Fault, scan: ScanInMemory | None) -> on.Event:
        """Return what fails where the worker found no points: the scan, or its second sequence alone."""
        if scan is None or scan.number != number or scan.second is None or scan.second.merged:
            return on.ReconstructionFailed(number, fault)
        log.warning("second exposure of %s not added: %s", scan.second.exposure.label, fault.detail)
        self._drop()
        return on.PairFailed(number, fault)


def _only_tells(report: WorkerEvent) -> bool:
    """Tell whether another report may be read at the same heartbeat.

    A full cloud was copied, which took its time, and the next heartbeat comes soon; and what ends a scan, or the process, is
    answered by the machine before anything else is heard.
    """
    match report:
        case SequenceIdentified() | ScanJudged() | CloudReady(full=False):
            return True
        case _:
            return False
