"""Two checks over many scans.

    CalibrationWatch    the calibration in use: trend of its ray gaps, alarm, and when the trend is written
    WindowWatch         the cameras' ports: places of the image that stay blurred while the scene changes

For each cell of each camera's image the port check keeps a sum of the excess loss of contrast. The amount per scan is
limited, so that an alarm needs three scans; a clean scan reduces the sum. It is kept in memory only: a port is wiped
between two dives, and three scans find a scratch again.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate import (
    UNMEASURED,
    HealthFile,
    HealthTrend,
    ThirdEye,
    accept_change,
    judge_with_projector,
    third_eye_file,
)
from appliance.instrument.machine import events as on
from appliance.measure import (
    CELLS,
    SIDES,
    SLACK,
    Calibration,
    Fault,
    FaultCode,
    PatchGaps,
    Verdict,
    Windows,
)
from appliance.store import FileSystem, StorageError

log = logging.getLogger("kingfisher")

VERDICT = "ray-gaps"


class CalibrationWatch:
    """Judges the ray gaps of every full cloud.

    One thread; functions that ``unwritten`` returns may be called by another.
    """

    def __init__(self, root: Path, calibration: Calibration, fs: FileSystem | None = None) -> None:
        self._root, self._fs = root, fs
        self.use(calibration)

    def use(self, calibration: Calibration) -> None:
        """Check another calibration from now on, with its stored trend."""
        self._calibration = calibration
        self._measured = calibration.method not in UNMEASURED
        self._file = HealthFile(self._root, calibration.hash, self._fs)
        self._eye_file = third_eye_file(self._root, calibration.hash, self._fs)
        self.trend = self._file.read() if self._measured else HealthTrend()
        self._eye = self._eye_file.read() if self._measured else ThirdEye()
        self._written, self._written_eye = self.trend, self._eye

    @property
    def fault(self) -> Fault | None:
        """The present condition."""
        if self.trend.alarm is None:
            return None
        return Fault(FaultCode.VERIFY_CALIBRATION, self.trend.alarm)

    def judge(self, gaps: PatchGaps) -> Verdict:
        """Judge the ray gaps of one more scan."""
        if not self._measured:
            text = "not judged: the calibration is not one in water"
            return Verdict(VERDICT, None, {}, text)
        self.trend, self._eye, finding = judge_with_projector(self.trend, self._eye, self._calibration.rig, gaps)
        return Verdict(VERDICT, None if finding.point is None else not finding.alarm, finding.numbers, finding.text)

    def answer(self, evidence: str) -> Callable[[], None] | None:
        """End the alarm, as a length check found lengths right.

        Returns a function that writes the trend, as ``unwritten``; ``None``: there was no alarm.
        """
        if self.trend.alarm is None:
            return None
        self._written = self.trend = accept_change(self.trend, f"{evidence}, after: {self.trend.alarm}")
        file, trend = self._file, self.trend
        return lambda: file.write(trend)

    def unwritten(self, scan: str) -> Callable[[], None] | None:
        """Return a function that writes the trend, as the latest scan's id is known; ``None``: no change.

        The trend is durable when it returns. It raises StorageError.
        """
        if self.trend is self._written:
            return None
        self._written = self.trend = self.trend.named(scan)
        eye = None if self._eye is self._written_eye else self._eye
        self._written_eye = self._eye
        file, eye_file, trend = self._file, self._eye_file, self.trend

        def write() -> None:
            # The projector's file first: a trend may depend on it.
            if eye is not None:
                eye_file.write(eye)
            file.write(trend)

        return write


def write_trend(write: Callable[[], None]) -> list[on.Event]:
    """Write the trend of the ray gaps in the disk's thread; return no events.

    No scan depends on it, but the next start continues it.
    """
    try:
        write()
    except StorageError as error:
        log.warning("the trend of the ray gaps: %s", error)
    return []


Array = NDArray[np.float64]

MOST = 0.10
"""Largest amount that one scan adds to a sum."""
LIMIT = 0.28
"""Sum above which an alarm begins: three scans with much fog, or more with less."""
CLEAN = 0.12
"""Sum below which an alarm ends."""
CAP = 0.34
"""Largest sum: three clean scans end an alarm, however long it lasted."""
CHANGED = 0.05
"""Least relative change of the light in the median cell between scans that count.

With less, the scene is the same, and the blur may be part of it.
"""
_ACROSS = ("left", "middle", "right")
_DOWN = ("upper", "middle", "lower")


class WindowWatch:
    """Checks the ports by every scan. One thread."""

    def __init__(self) -> None:
        # The last sum of each side is that of the complete port.
        self._sums = {side: np.zeros(CELLS[0] * CELLS[1] + 1) for side in SIDES}
        self._alarm = dict.fromkeys(SIDES, False)
        self._light: dict[str, Array] | None = None
        self._counted: int | None = None

    def count(self, scan: int, windows: Windows) -> tuple[Verdict, list[on.Event]] | None:
        """Judge scan number ``scan`` once; return its verdict and the conditions, or ``None``.

        ``None``: the scan was counted before. A worker that was started again, or a compensated cloud, must not make
        several scans of one.
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
        """Judge one more scan; the verdict is that of all scans so far."""
        verdict = windows.verdict()
        if self._same_scene(windows):
            return replace(verdict, passed=self._passed, text=f"{verdict.text}; not counted: the scene has not changed")
        # Compared with the last scan that counted: ten scans of one wall are no independent evidence.
        self._light = {side: windows.light[side] for side in SIDES}
        for side in SIDES:
            full_fall = windows.wholes[side]
            falls = np.append(windows.falls[side], np.nan if full_fall is None else full_fall)
            # One side's gain is the other's fall: only a fall counts.
            # One-sided CUSUM: the excess over the tolerance adds up, a clean scan takes at most SLACK away, and no
            # single scan can raise the alarm.
            step = np.clip(np.maximum(falls, 0.0) - windows.forgiven[side], -SLACK, MOST)
            self._sums[side] = np.clip(self._sums[side] + np.nan_to_num(step), 0.0, CAP)
            worst = float(self._sums[side].max())
            self._alarm[side] = worst > LIMIT or (self._alarm[side] and worst > CLEAN)
        details = "; ".join(self._detail(side) for side in SIDES if self._alarm[side])
        return replace(verdict, passed=self._passed, text=details or verdict.text)

    def conditions(self) -> Iterator[tuple[FaultCode, str, Fault | None]]:
        """Yield the present fault of each camera, or ``None``."""
        for side in SIDES:
            device = f"camera.{side}"
            fault = Fault(FaultCode.WINDOW, self._detail(side), device=device) if self._alarm[side] else None
            yield FaultCode.WINDOW, device, fault

    @property
    def _passed(self) -> bool:
        return not any(self._alarm.values())

    def _detail(self, side: str) -> str:
        worst = int(np.argmax(self._sums[side]))
        if worst == CELLS[0] * CELLS[1]:
            return f"the whole {side} window blurs the fringes"
        column, row = worst % CELLS[0], worst // CELLS[0]
        where = f"{_DOWN[3 * row // CELLS[1]]} {_ACROSS[3 * column // CELLS[0]]}"
        return f"the {side} window blurs the fringes, {where} (cell {column}, {row} of {CELLS[0]} x {CELLS[1]})"

    def _same_scene(self, windows: Windows) -> bool:
        if self._light is None:
            return False
        before = np.concatenate([self._light[side] for side in SIDES])
        now = np.concatenate([windows.light[side] for side in SIDES])
        is_lit = np.maximum(before, now) > 1.0
        if not is_lit.any():
            return True
        return bool(np.median(np.abs(now - before)[is_lit] / np.maximum(before, now)[is_lit]) < CHANGED)
