"""Owns the watch over the calibration in use: its trend in memory, what the diver is told, and when it is written down."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from appliance.calibrate import UNMEASURED, HealthFile, HealthJudgement, HealthTrend, answered, judge_health, likeliest
from appliance.instrument.machine import events as on
from appliance.measure import TURNS, Calibration, Fault, FaultCode, GapModes, PatchGaps, Verdict, in_words
from appliance.store import FileSystem, StorageError

log = logging.getLogger("kingfisher")

VERDICT = "ray-gaps"


class CalibrationWatch:
    """Judges every full cloud's gaps. One thread; what ``unwritten`` returns may be called by another."""

    def __init__(self, root: Path, calibration: Calibration, fs: FileSystem | None = None) -> None:
        self._root, self._fs = root, fs
        self.use(calibration)

    def use(self, calibration: Calibration) -> None:
        """Watch another calibration from now on; what is remembered of it comes back."""
        self._calibration = calibration
        self._measured = calibration.method not in UNMEASURED
        self._file = HealthFile(self._root, calibration.hash, self._fs)
        self.trend = self._file.read() if self._measured else HealthTrend()
        self._written = self.trend

    @property
    def fault(self) -> Fault | None:
        """The condition that holds now."""
        if self.trend.alarm is None:
            return None
        return Fault(FaultCode.VERIFY_CALIBRATION, self.trend.alarm)

    def judge(self, gaps: PatchGaps) -> Verdict:
        """Judge the ray gaps of one more scan."""
        if not self._measured:
            text = "not judged: the calibration was never measured in water"
            return Verdict(VERDICT, None, {}, text)
        before = self.trend
        self.trend, outcome = judge_health(before, gaps)
        passed = None if outcome.point is None else not outcome.alarm
        text = outcome.text + self._explained(outcome, gaps)
        # The words are of the scan that brought the alarm; later ones only keep it.
        if before.alarm is None and self.trend.alarm is not None:
            self.trend = self.trend.alarmed(text)
        return Verdict(VERDICT, passed, outcome.numbers, text)

    def answer(self, evidence: str) -> Callable[[], None] | None:
        """Take the alarm back, as a length check found lengths right; return what writes that down, as ``unwritten``;
        ``None``: there is no alarm."""
        if self.trend.alarm is None:
            return None
        self._written = self.trend = answered(self.trend, f"{evidence}, after: {self.trend.alarm}")
        file, trend = self._file, self.trend
        return lambda: file.write(trend)

    def unwritten(self, scan: str) -> Callable[[], None] | None:
        """Return what writes down the latest scan, whose number is known now; ``None``: nothing is new.

        It is durable when the call returns. The call raises StorageError.
        """
        if self.trend is self._written:
            return None
        self._written = self.trend = self.trend.named(scan)
        file, trend = self._file, self.trend
        return lambda: file.write(trend)

    def _explained(self, outcome: HealthJudgement, gaps: PatchGaps) -> str:
        """Return which single change would look most like it; it is one of many, so only in words for a technician."""
        if outcome.point is None or not outcome.alarm:
            return ""
        answers = GapModes(self._calibration.rig, gaps.water_index).of_parameters(TURNS)
        name, size, share = likeliest(outcome.point.amplitudes_um, answers)
        return f"; most like {in_words(name, -size)} ({100.0 * share:.0f} %)" if name else ""


def write_trend(write: Callable[[], None]) -> list[on.Event]:
    """Write the trend of the ray gaps down in the disk's thread; return no events.

    No scan depends on it; with it, the next start knows what was before.
    """
    try:
        write()
    except StorageError as error:
        log.warning("the trend of the ray gaps: %s", error)
    return []
