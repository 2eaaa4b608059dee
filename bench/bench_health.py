"""Which changes of the instrument the gaps of rays and projector see from which size on, what that is in length, and how often
they err."""

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
from bench.result import Measured
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
"""Half of what a length check may find: a change that costs more before the gaps see it needs the check."""
LENGTH_LEFT_OUT_PERCENT = 0.03
"""A change that costs less before the gaps see it is not in the table."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What was found about one change, median over the rigs; ``None``: not within the sizes asked for."""

    change: Change
    second: float | None
    """Size that the second scan sees at the latest."""
    length_percent: float
    """Length error per unit of size."""


def measure() -> Iterator[Measured]:
    made = [calibrated(seed) for seed in RIGS]
    found = [_seen(change, made) for change in changes()]
    for one in found:
        yield Measured(
            f"seen at the second scan: {one.change.name}",
            float("nan") if one.second is None else one.second,
            one.change.unit,
            why=None if one.second is not None else f"not up to {one.change.most:g} {one.change.unit}",
        )
    largest = []
    for method in (Method.SPLINE, Method.PORTS):
        totals = [total for seed in RIGS for total in _normal(calibrated(seed, method))]
        largest.append(max(totals))
        yield Measured(
            f"largest sum of {len(totals)} normal scans, {method.value}",
            largest[-1],
            f"of {LIMIT:g}",
            at_most=LIMIT,
            key=f"health_largest_sum_{method.value}",
        )
    for bias in (0.0, 1.0, 2.0):
        yield Measured(
            f"false alarms of {CHAINS * LINKS:.0e} scans, offset of {bias:g} standard deviations",
            _false_alarms(bias),
            "alarms",
        )
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "health.md").write_text(_table(found, largest[0]), encoding="utf-8")
    draw_health(OUT / "health.png", made[0].modes, _story(made[0]))


def _seen(change: Change, made: list[Calibrated]) -> Seen:
    sizes: list[float | None] = []
    lengths = []
    for one in made:
        changed = change.make(one.truth, change.size)
        lengths.append(length_error_percent(one.truth, changed, one.rig) / change.size)
        trend, eye = _learnt(one)
        pairs = []
        for trial in range(2 * TRIALS):
            seen = [scan(one, t, np.random.default_rng([9, trial]), pattern=True) for t in (one.truth, changed)]
            third = [eye.gaps(one.rig, gaps) for gaps in seen]
            pairs.append((_Change(*seen), _Change(*third)))
        sizes.append(_smallest(trend, pairs, change))
    return Seen(change, _median(sizes), float(np.median(lengths)))


class _Change:
    """One kind of gap of a scan before and after a change, with the patches that both have."""

    def __init__(self, normal: PatchGaps | None, other: PatchGaps | None) -> None:
        if normal is None or other is None:
            raise ValueError("the projector is not learnt; give more normal scans")
        shared = np.intersect1d(normal.patch, other.patch)
        self._normal, self._other = (_only(one, np.isin(one.patch, shared)) for one in (normal, other))

    def at(self, share: float) -> PatchGaps:
        """The gaps after so much of the change."""
        moved_um = self._other.gap_um - self._normal.gap_um
        return replace(self._normal, gap_um=self._normal.gap_um + share * moved_um)


def _learnt(made: Calibrated) -> tuple[HealthTrend, ThirdEye]:
    """What is remembered after twelve normal scans."""
    rng = np.random.default_rng([1, made.truth.seed])
    *_, (trend, eye, _) = _followed(made, (scan(made, made.truth, rng, pattern=True) for _ in range(12)))
    return trend, eye


def _followed(made: Calibrated, scans: Iterable[PatchGaps]) -> Iterator[tuple[HealthTrend, ThirdEye, HealthJudgement]]:
    trend, eye = HealthTrend(), ThirdEye()
    for gaps in scans:
        trend, eye, said = judge_with_projector(trend, eye, made.rig, gaps)
        yield trend, eye, said


def _smallest(trend: HealthTrend, pairs: list[tuple[_Change, _Change]], change: Change) -> float | None:
    """Return, by bisection, the size that alarms at the second scan in 95 of 100 trials."""

    def seen(size: float) -> bool:
        hits = 0
        blocks = range(0, len(pairs), 2)
        for k in blocks:
            at = trend
            for rays, third in pairs[k : k + 2]:
                at, said = judge_health(at, rays.at(size / change.size), None, third.at(size / change.size))
                if said.alarm:
                    hits += 1
                    break
        return hits >= SEEN * len(blocks)

    low, high = 0.0, change.most
    if not seen(high):
        return None
    for _ in range(14):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if seen(middle) else (middle, high)
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
    known = [v for v in values if v is not None]
    return float(np.median(known)) if len(known) == len(values) else None


def _normal(made: Calibrated) -> list[float]:
    rng = np.random.default_rng([77, made.truth.seed])
    scans = (scan(made, made.truth, rng, pattern=True) for _ in range(NORMAL_SCANS))
    return [said.point.total for _, _, said in _followed(made, scans) if said.point is not None]


def _false_alarms(bias: float) -> int:
    """Alarms of the sum when scores are normal, with a constant offset in one direction; each ends its chain."""
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


def _story(made: Calibrated) -> HealthTrend:
    """Thirty normal scans, then the right camera turned by 0.02° about y."""
    rng = np.random.default_rng(3)
    turned = with_mount_shifted(made.truth, MountShift("right", yaw_deg=0.02))
    scans = [scan(made, made.truth if k < 30 else turned, rng) for k in range(36)]
    return [trend for trend, _ in follow(HealthTrend(), scans)][-1]


def _table(found: list[Seen], largest: float) -> str:
    """Return the table of the page: what the second scan sees, and what it costs by then."""
    lines = ["| change | seen from | E_L | |", "|---|---:|---:|---|"]
    for one in found:
        unit, change = one.change.unit, one.change
        size = one.second if one.second is not None else change.most
        percent = one.length_percent * size
        if percent < LENGTH_LEFT_OUT_PERCENT:
            continue
        seen = "—" if one.second is None else f"{one.second:.2g} {unit}"
        length = f"{percent:.2g} %" if one.second is not None else f"more than {percent:.2g} %"
        check = "" if percent <= LENGTH_THAT_MATTERS_PERCENT else "**length check**"
        lines.append(f"| {change.name} | {seen} | {length} | {check} |")
    normal = f"The largest sum of {NORMAL_SCANS * len(RIGS)} normal scans was {largest:.1f}."
    lines += ["", f"{normal} Changes whose E_L is below {LENGTH_LEFT_OUT_PERCENT:g} % are left out."]
    return "\n".join(lines) + "\n"
