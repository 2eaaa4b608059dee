"""Sizes from which changes of the instrument are detected by ray gaps and third gaps, their length errors, and false
alarms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.health import LIMIT, SLACK, HealthJudgement, HealthTrend, judge_health
from appliance.calibrate.third_eye import ThirdEye, judge_with_projector
from appliance.calibrate.water.method import Method
from appliance.measure.cloud import PatchGaps
from bench.health_changes import Change, changes, length_error_percent
from bench.health_picture import draw_health
from bench.result import Measurement
from hw_sim.mount_shift import MountShift, with_mount_shifted
from tests.support.gap_scans import Calibrated, calibrated, follow, scan

RIGS = (1, 2, 5)
TRIALS = 10
"""Of two scans each, per rig; a size counts as seen when 19 of 20 alarm."""
SEEN = 0.95
NORMAL_SCANS = 100
"""Per rig."""
CHAINS, LINKS = 1000, 1000
OUT = Path("bench/out")
LENGTH_THAT_MATTERS_PERCENT = 0.05
"""Half of the smallest error that a length check detects: a change with a larger one before its detection needs the
check."""
LENGTH_LEFT_OUT_PERCENT = 0.03
"""A change that costs less before the gaps see it is not in the table."""


@dataclass(frozen=True, slots=True)
class DetectionResult:
    """Result for one change, median over the rigs; ``None`` if it is outside the tested sizes."""

    change: Change
    second: float | None
    """Size that the second scan detects."""
    length_percent: float
    """Length error per unit of size."""


def measure() -> Iterator[Measurement]:
    rigs = [calibrated(seed) for seed in RIGS]
    results = [_seen(change, rigs) for change in changes()]
    for result in results:
        yield Measurement(
            f"seen at the second scan: {result.change.name}",
            float("nan") if result.second is None else result.second,
            result.change.unit,
            why=None if result.second is not None else f"not up to {result.change.largest:g} {result.change.unit}",
        )
    largest = []
    for method in (Method.SPLINE, Method.PORTS):
        totals = [total for seed in RIGS for total in _normal(calibrated(seed, method))]
        largest.append(max(totals))
        yield Measurement(
            f"largest sum of {len(totals)} normal scans, {method.value}",
            largest[-1],
            f"of {LIMIT:g}",
            at_most=LIMIT,
            key=f"health_largest_sum_{method.value}",
        )
    for bias in (0.0, 1.0, 2.0):
        yield Measurement(
            f"false alarms of {CHAINS * LINKS:.0e} scans, offset of {bias:g} standard deviations",
            _false_alarms(bias),
            "alarms",
        )
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "health.md").write_text(_table(results, largest[0]), encoding="utf-8")
    draw_health(OUT / "health.png", rigs[0].modes, _story(rigs[0]))


def _seen(change: Change, rigs: list[Calibrated]) -> DetectionResult:
    sizes: list[float | None] = []
    lengths = []
    for rig in rigs:
        changed = change.make(rig.truth, change.size)
        lengths.append(length_error_percent(rig.truth, changed, rig.rig) / change.size)
        trend, eye = _learnt(rig)
        pairs = []
        for trial in range(2 * TRIALS):
            gaps_of_both = [scan(rig, t, np.random.default_rng([9, trial]), pattern=True) for t in (rig.truth, changed)]
            third = [eye.gaps(rig.rig, gaps) for gaps in gaps_of_both]
            pairs.append((_Change(*gaps_of_both), _Change(*third)))
        sizes.append(_smallest(trend, pairs, change))
    return DetectionResult(change, _median(sizes), float(np.median(lengths)))


class _Change:
    """One kind of gap of a scan before and after a change, with the patches that both have."""

    def __init__(self, normal: PatchGaps | None, changed: PatchGaps | None) -> None:
        if normal is None or changed is None:
            raise ValueError("the projector is not learnt; give more normal scans")
        shared = np.intersect1d(normal.patch, changed.patch)
        self._normal, self._other = (_only(gaps, np.isin(gaps.patch, shared)) for gaps in (normal, changed))

    def at(self, share: float) -> PatchGaps:
        """Return the gaps after a share of the change."""
        moved_um = self._other.gap_um - self._normal.gap_um
        return replace(self._normal, gap_um=self._normal.gap_um + share * moved_um)


def _learnt(rig: Calibrated) -> tuple[HealthTrend, ThirdEye]:
    """Return trend and third eye after twelve normal scans."""
    rng = np.random.default_rng([1, rig.truth.seed])
    *_, (trend, eye, _) = _followed(rig, (scan(rig, rig.truth, rng, pattern=True) for _ in range(12)))
    return trend, eye


def _followed(rig: Calibrated, scans: Iterable[PatchGaps]) -> Iterator[tuple[HealthTrend, ThirdEye, HealthJudgement]]:
    trend, eye = HealthTrend(), ThirdEye()
    for gaps in scans:
        trend, eye, judgement = judge_with_projector(trend, eye, rig.rig, gaps)
        yield trend, eye, judgement


def _smallest(trend: HealthTrend, pairs: list[tuple[_Change, _Change]], change: Change) -> float | None:
    """Return, by bisection, the size that raises an alarm at the second scan in 95 of 100 trials."""

    def is_detected(size: float) -> bool:
        hits = 0
        blocks = range(0, len(pairs), 2)
        for k in blocks:
            trend_after = trend
            for rays, third in pairs[k : k + 2]:
                trend_after, judgement = judge_health(
                    trend_after, rays.at(size / change.size), None, third.at(size / change.size)
                )
                if judgement.alarm:
                    hits += 1
                    break
        return hits >= SEEN * len(blocks)

    low, high = 0.0, change.largest
    if not is_detected(high):
        return None
    for _ in range(14):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_detected(middle) else (middle, high)
    return high


def _only(gaps: PatchGaps, which: NDArray[np.bool_]) -> PatchGaps:
    return replace(
        gaps,
        patch=gaps.patch[which],
        gap_um=gaps.gap_um[which],
        noise_um=gaps.noise_um[which],
        modes=gaps.modes[which],
    )


def _median(values: list[float | None]) -> float | None:
    sizes = [v for v in values if v is not None]
    return float(np.median(sizes)) if len(sizes) == len(values) else None


def _normal(rig: Calibrated) -> list[float]:
    rng = np.random.default_rng([77, rig.truth.seed])
    scans = (scan(rig, rig.truth, rng, pattern=True) for _ in range(NORMAL_SCANS))
    return [judgement.point.total for _, _, judgement in _followed(rig, scans) if judgement.point is not None]


def _false_alarms(bias: float) -> int:
    """Return the number of alarms of the sum for normal scores with a constant offset; each ends its chain."""
    rng = np.random.default_rng(5)
    total = np.zeros((CHAINS, 8))
    alarms = 0
    for _ in range(LINKS):
        total += rng.normal(0.0, 1.0, total.shape)
        total[:, 0] += bias
        length = np.linalg.norm(total, axis=1, keepdims=True)
        total *= np.maximum(1.0 - SLACK / np.maximum(length, 1e-9), 0.0)
        over = np.linalg.norm(total, axis=1) > LIMIT
        alarms += int(over.sum())
        total[over] = 0.0
    return alarms


def _story(rig: Calibrated) -> HealthTrend:
    """Return the trend of thirty normal scans and six after a turn of the right camera by 0.02° about y."""
    rng = np.random.default_rng(3)
    turned = with_mount_shifted(rig.truth, MountShift("right", yaw_deg=0.02))
    scans = [scan(rig, rig.truth if k < 30 else turned, rng) for k in range(36)]
    return [trend for trend, _ in follow(HealthTrend(), scans)][-1]


def _table(results: list[DetectionResult], largest: float) -> str:
    """Return the table of the page: sizes that the second scan detects, and their length errors."""
    lines = ["| change | seen from | E_L | |", "|---|---:|---:|---|"]
    for result in results:
        unit, change = result.change.unit, result.change
        size = result.second if result.second is not None else change.largest
        percent = result.length_percent * size
        if percent < LENGTH_LEFT_OUT_PERCENT:
            continue
        size_text = "—" if result.second is None else f"{result.second:.2g} {unit}"
        length = f"{percent:.2g} %" if result.second is not None else f"more than {percent:.2g} %"
        check = "" if percent <= LENGTH_THAT_MATTERS_PERCENT else "**length check**"
        lines.append(f"| {change.name} | {size_text} | {length} | {check} |")
    normal = f"The largest sum of {NORMAL_SCANS * len(RIGS)} normal scans was {largest:.1f}."
    lines += ["", f"{normal} Changes whose E_L is below {LENGTH_LEFT_OUT_PERCENT:g} % are left out."]
    return "\n".join(lines) + "\n"
