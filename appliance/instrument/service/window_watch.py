"""Owns the watch over the cameras' windows: what stays soft at one place of the image while the scene changes is the
window.

Of each cell of each camera's image a sum is kept of how far its fall exceeds what is forgiven, per scan at most so much
that three scans are needed; a scan that shows it clean takes away. Kept in memory only: a window is wiped between two
dives, and three scans find a scratch again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine import events as on
from appliance.measure import CELLS, SIDES, SLACK, Fault, FaultCode, Verdict, Windows

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
