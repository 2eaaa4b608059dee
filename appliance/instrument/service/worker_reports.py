"""Owns what the worker's news mean for the scan in hand. What they mean for the instrument, the machine says, which
gets them as they are.

It also owns the watch over the cameras' windows: what stays soft at one place of the image while the scene changes is
the window.

Of each cell of each camera's image a sum is kept of how far its fall exceeds what is forgiven, per scan at most so much
that three scans are needed; a scan that shows it clean takes away. Kept in memory only: a window is wiped between two
dives, and three scans find a scratch again.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Part
from appliance.instrument.machine.words import Text
from appliance.instrument.service.health import CalibrationWatch
from appliance.instrument.service.scan_files import ScanInMemory
from appliance.instrument.worker.messages import Ready
from appliance.instrument.worker.process import ReconstructionWorker, WorkerEvent
from appliance.measure import (
    CELLS,
    COARSE_POINTS,
    SIDES,
    SLACK,
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
    Verdict,
    Verdicts,
    Windows,
    WorkerFailure,
    WorkProgress,
)
from drivers.api import Clock

Array = NDArray[np.float64]

MOST = 0.10
"""Largest amount that one scan adds to a sum."""
LIMIT = 0.28
"""Sum above which the alarm begins: three scans with much fog, or more with less."""
CLEAN = 0.12
"""Sum below which an alarm ends."""
CAP = 0.34
"""Largest sum: three clean scans end an alarm, however long it lasted."""
CHANGED = 0.05
"""Least relative change of the light in the median cell from one scan to the next one that counts: else the scene is
the same, and what is soft may be part of it."""
_ACROSS = ("left", "middle", "right")
_DOWN = ("upper", "middle", "lower")


class WindowWatch:
    """Judges every scan. One thread."""

    def __init__(self) -> None:
        # The last sum of each side is that of all of the window.
        self._sums = {side: np.zeros(CELLS[0] * CELLS[1] + 1) for side in SIDES}
        self._alarm = dict.fromkeys(SIDES, False)
        self._light: dict[str, Array] | None = None
        self._counted: int | None = None

    def count(self, scan: int, windows: Windows) -> tuple[Verdict, list[on.Event]] | None:
        """Judge scan number ``scan`` and return its verdict and what holds from now on; ``None`` where it was counted
        before.

        A scan counts once, however often the worker judges it: a process that was started again, or a compensated
        cloud, must not make three scans of one.
        """
        if scan == self._counted:
            return None
        self._counted = scan
        verdict = self.judge(windows)
        return verdict, [
            on.ConditionCleared(code, device) if fault is None else on.ConditionRaised(fault)
            for code, device, fault in self.conditions()
        ]

    def judge(self, windows: Windows) -> Verdict:
        """Judge one more scan; its verdict says what holds after it."""
        verdict = windows.verdict()
        if self._same_scene(windows):
            return replace(
                verdict, passed=self._passed, text=f"{verdict.text}; not counted: the scene is that of before"
            )
        # Compared with the last scan that counted: ten scans of one wall are one testimony.
        self._light = {side: windows.light[side] for side in SIDES}
        for side in SIDES:
            whole = windows.wholes[side]
            falls = np.append(windows.falls[side], np.nan if whole is None else whole)
            # One side's gain is the other's fall: only a fall counts.
            # One-sided CUSUM: what exceeds the forgiven adds up, a clean scan takes at most SLACK away, and no single
            # scan can alarm.
            step = np.clip(np.maximum(falls, 0.0) - windows.forgiven[side], -SLACK, MOST)
            self._sums[side] = np.clip(self._sums[side] + np.nan_to_num(step), 0.0, CAP)
            worst = float(self._sums[side].max())
            self._alarm[side] = worst > LIMIT or (self._alarm[side] and worst > CLEAN)
        details = "; ".join(self._detail(side) for side in SIDES if self._alarm[side])
        return replace(verdict, passed=self._passed, text=details or verdict.text)

    def conditions(self) -> Iterator[tuple[FaultCode, str, Fault | None]]:
        """Yield for each camera the fault that holds now, or ``None``."""
        for side in SIDES:
            device = f"camera.{side}"
            held = Fault(FaultCode.WINDOW, self._detail(side), device=device) if self._alarm[side] else None
            yield FaultCode.WINDOW, device, held

    @property
    def _passed(self) -> bool:
        return not any(self._alarm.values())

    def _detail(self, side: str) -> str:
        worst = int(np.argmax(self._sums[side]))
        if worst == CELLS[0] * CELLS[1]:
            return f"all of the {side} window makes fringes soft"
        column, row = worst % CELLS[0], worst // CELLS[0]
        where = f"{_DOWN[3 * row // CELLS[1]]} {_ACROSS[3 * column // CELLS[0]]}"
        return f"the {side} window makes fringes soft, {where} (cell {column}, {row} of {CELLS[0]} x {CELLS[1]})"

    def _same_scene(self, windows: Windows) -> bool:
        if self._light is None:
            return False
        before = np.concatenate([self._light[side] for side in SIDES])
        now = np.concatenate([windows.light[side] for side in SIDES])
        seen = np.maximum(before, now) > 1.0
        if not seen.any():
            return True
        return bool(np.median(np.abs(now - before)[seen] / np.maximum(before, now)[seen]) < CHANGED)


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
        """Return what the machine hears after ``report``; ``scan`` is the one in hand."""
        match report:
            case Ready():
                self.settled = True
                return [on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED), on.PartTested(Part.WORKER, True)]
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
        self.settled = True
        fault = Fault(FaultCode.RECONSTRUCTION_FAILED, why)
        return [on.ConditionRaised(fault), on.PartTested(Part.WORKER, False, Text.GIVEN_UP)]

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
